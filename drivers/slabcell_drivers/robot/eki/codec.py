"""What do the telegrams say?  Bytes to `Request` and `Answer` and back; pure, no socket.

How they are written, and what is refused in reading, is in `slabcell_drivers.robot.eki.telegram`.
"""

from typing import Any

from slabcell_drivers.robot.eki.schema import (
    ATTRIBUTES_OF_FRAME,
    EMPTY_TEXT,
    HEARTBEAT_ROOT,
    PROTOCOL_VERSION,
    ROBOT,
    VIS,
)
from slabcell_drivers.robot.eki.telegram import (
    InvalidTelegramError,
    MalformedTelegramError,
    TelegramError,
    Values,
    read,
    write,
)
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.message import printable
from slabcell_drivers.robot.protocol import AckState, Answer, Offer, Request, RequestType, RobotStatus

__all__ = [
    "HEARTBEAT",
    "InvalidTelegramError",
    "MalformedTelegramError",
    "TelegramError",
    "decode_answer",
    "decode_request",
    "encode_answer",
    "encode_request",
]

HEARTBEAT = f"<{HEARTBEAT_ROOT}></{HEARTBEAT_ROOT}>".encode("ascii")
"""The cell's answer to a heartbeat: an element without a type, which only sets its flag and fills no memory."""

_FRAMES = {node: tuple(f"{node}/@{key}" for key in ATTRIBUTES_OF_FRAME) for node in ("Pose", "Pick", "Place")}
_AXES = tuple(f"Axis/@A{axis}" for axis in range(1, 7))


def encode_request(request: Request) -> bytes:
    """Return the robot's telegram, as the KRC sends it."""
    status = request.status
    values: Values = {
        "Head/@Ver": PROTOCOL_VERSION,
        "Head/@Ses": request.session,
        "Head/@Seq": request.sequence,
        "Head/@Type": int(request.type),
        "Job/@Id": request.job_id,
        "Job/@Model": request.model,
        **dict(zip(_FRAMES["Pose"], request.tcp.as_tuple(), strict=True)),
        **dict(zip(_AXES, request.axes_deg, strict=True)),
        "Ack/@ResId": request.ack_result_id,
        "Ack/@State": int(request.ack_state),
        "Stat/@Mode": status.mode,
        "Stat/@Tool": status.tool,
        "Stat/@Base": status.base,
        "Stat/@Grip": int(status.gripper_holds_part),
        "Stat/@Err": status.error,
    }
    return write(ROBOT, values)


def decode_request(telegram: bytes) -> Request:
    """Return what the robot asks.  Raises MalformedTelegramError or InvalidTelegramError."""
    values = read(ROBOT, telegram, required=("Head/@Seq", "Head/@Type"))
    session, sequence = values["Head/@Ses"], values["Head/@Seq"]
    try:
        type_, state = RequestType(values["Head/@Type"]), AckState(values["Ack/@State"])
    except ValueError as error:
        raise InvalidTelegramError(f"Robot telegram: {error}", session=session, sequence=sequence) from error
    return Request(
        type=type_,
        session=session,
        sequence=sequence,
        job_id=values["Job/@Id"],
        model=values["Job/@Model"],
        tcp=Frame(*_all(values, _FRAMES["Pose"])),
        axes_deg=_all(values, _AXES),
        ack_result_id=values["Ack/@ResId"],
        ack_state=state,
        status=RobotStatus(
            mode=values["Stat/@Mode"],
            tool=values["Stat/@Tool"],
            base=values["Stat/@Base"],
            gripper_holds_part=values["Stat/@Grip"] != 0,
            error=values["Stat/@Err"],
        ),
    )


def encode_answer(answer: Answer) -> bytes:
    """Return the cell's telegram.  Text that is not printable ASCII is replaced, and cut at MAX_TEXT_CHARS."""
    offer = answer.offer or Offer(0, 0, 0, Frame(), Frame(), 0.0)
    values: Values = {
        "Head/@Ver": PROTOCOL_VERSION,
        "Head/@Ses": answer.session,
        "Head/@Seq": answer.sequence,
        "Head/@Ack": answer.acknowledges,
        "Res/@Code": int(answer.code),
        "Res/@ResId": offer.result_id,
        "Res/@Idx": offer.index,
        "Res/@Left": answer.left,
        "Res/@TrigSeq": answer.trigger_sequence,
        **dict(zip(_FRAMES["Pick"], offer.pick.as_tuple(), strict=True)),
        **dict(zip(_FRAMES["Place"], offer.place.as_tuple(), strict=True)),
        "Part/@Slot": offer.slot,
        "Part/@Score": offer.score,
        "Part/@Grip": offer.grip,
        "Msg": _escaped(printable(answer.message)) or EMPTY_TEXT,
    }
    return write(VIS, values)


def decode_answer(telegram: bytes) -> Answer:
    """Return what the cell answers, as a robot reads it.  Raises MalformedTelegramError or InvalidTelegramError."""
    values = read(VIS, telegram, required=("Head/@Seq", "Head/@Ack", "Res/@Code"))
    result_id = values["Res/@ResId"]
    offer = (
        Offer(
            result_id=result_id,
            index=values["Res/@Idx"],
            slot=values["Part/@Slot"],
            pick=Frame(*_all(values, _FRAMES["Pick"])),
            place=Frame(*_all(values, _FRAMES["Place"])),
            score=values["Part/@Score"],
            grip=values["Part/@Grip"],
        )
        if result_id
        else None
    )
    text = values["Msg"]
    return Answer(
        session=values["Head/@Ses"],
        sequence=values["Head/@Seq"],
        acknowledges=values["Head/@Ack"],
        code=values["Res/@Code"],
        left=values["Res/@Left"],
        trigger_sequence=values["Res/@TrigSeq"],
        offer=offer,
        message="" if text == EMPTY_TEXT else text,
    )


def _all(values: Values, paths: tuple[str, ...]) -> tuple[Any, Any, Any, Any, Any, Any]:
    a, b, c, d, e, f = [values[path] for path in paths]
    return a, b, c, d, e, f


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
