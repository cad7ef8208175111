"""How do a request and an answer read in registers?  `Request` and `Answer` to words and back; pure.

Errors::

    RegisterValueError            a value that its register cannot hold: an answer that cannot be sent
    InvalidRequestError           a whole request with a value out of range; knows session and sequence
"""

from collections.abc import Sequence

from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.message import printable
from slabcell_drivers.robot.modbus.register_map import MAP_VERSION, Area, RegisterMap, RegisterValueError, Value
from slabcell_drivers.robot.protocol import (
    AckState,
    Answer,
    Offer,
    Request,
    RequestType,
    ResultCode,
    RobotStatus,
)

__all__ = ["InvalidRequestError", "decode_answer", "decode_request", "encode_answer", "encode_request"]

_ERROR = 5
"""The code register's value for "see error_number"."""


class InvalidRequestError(ValueError):
    """A value is out of range, or the map is of another version."""

    def __init__(self, message: str, *, session: int, sequence: int) -> None:
        super().__init__(message)
        self.session = session
        self.sequence = sequence


def encode_request(register_map: RegisterMap, request: Request, toggle: int) -> list[int]:
    """Return the words of the request area, as a PLC writes them.  Raises RegisterValueError."""
    status = request.status
    return register_map.encode(
        Area.REQUEST,
        {
            "version": MAP_VERSION,
            "sequence": request.sequence,
            "session": request.session,
            "command": int(request.type),
            "job_id": request.job_id,
            "model": request.model,
            "ack_result_id": request.ack_result_id,
            "ack_state": int(request.ack_state),
            "mode": status.mode,
            "tool": status.tool,
            "base": status.base,
            "gripper": int(status.gripper_holds_part),
            "robot_error": status.error,
            **_frame_values("tcp", request.tcp),
            **{f"axis_{axis}": angle for axis, angle in enumerate(request.axes_deg, 1)},
            "sequence_end": request.sequence,
            "toggle": toggle,
        },
    )


def decode_request(register_map: RegisterMap, words: Sequence[int]) -> Request:
    """Return what a sound request area asks.  Raises InvalidRequestError."""
    start = register_map.span(Area.REQUEST)[0]

    def number(name: str) -> int:
        register = register_map.register(Area.REQUEST, name)
        return register_map.number(register, words[register.address - start : register.end - start])

    session, sequence = number("session"), number("sequence")
    if number("version") != MAP_VERSION:
        raise InvalidRequestError(
            f"request.version = {number('version')}: the cell speaks version {MAP_VERSION}; install its map",
            session=session,
            sequence=sequence,
        )
    try:
        values = register_map.decode(Area.REQUEST, words)
        type_, state = RequestType(int(values["command"])), AckState(int(values["ack_state"]))
    except ValueError as error:  # RegisterValueError is one
        raise InvalidRequestError(f"request: {error}", session=session, sequence=sequence) from error
    a1, a2, a3, a4, a5, a6 = (float(values[f"axis_{axis}"]) for axis in range(1, 7))
    return Request(
        type=type_,
        session=session,
        sequence=sequence,
        job_id=int(values["job_id"]),
        model=int(values["model"]),
        tcp=_frame(values, "tcp"),
        axes_deg=(a1, a2, a3, a4, a5, a6),
        ack_result_id=int(values["ack_result_id"]),
        ack_state=state,
        status=RobotStatus(
            mode=int(values["mode"]),
            tool=int(values["tool"]),
            base=int(values["base"]),
            gripper_holds_part=values["gripper"] != 0,
            error=int(values["robot_error"]),
        ),
    )


def encode_answer(register_map: RegisterMap, answer: Answer, *, publication: int, toggle: int) -> list[int]:
    """Return the words of the answer area.  Raises RegisterValueError if a value does not fit its register."""
    offer = answer.offer or Offer(0, 0, 0, Frame(), Frame(), 0.0)
    is_error = answer.code >= _ERROR
    return register_map.encode(
        Area.ANSWER,
        {
            "publication": publication,
            "version": MAP_VERSION,
            "session": answer.session,
            "sequence": answer.sequence,
            "ack_sequence": answer.acknowledges,
            "code": _ERROR if is_error else answer.code,
            "error_number": answer.code if is_error else 0,
            "result_id": offer.result_id,
            "index": offer.index,
            "left": answer.left,
            "trigger_sequence": answer.trigger_sequence,
            **_frame_values("pick", offer.pick),
            **_frame_values("place", offer.place),
            "slot": offer.slot,
            "grip": offer.grip,
            "score": offer.score,
            "message": printable(answer.message),
            "publication_end": publication,
            "toggle": toggle,
        },
    )


def decode_answer(register_map: RegisterMap, words: Sequence[int]) -> Answer:
    """Return what a sound answer area says, as a PLC reads it.  Raises RegisterValueError."""
    values = register_map.decode(Area.ANSWER, words)
    if values["version"] != MAP_VERSION:
        raise RegisterValueError(f"answer.version = {values['version']}: this side speaks version {MAP_VERSION}")
    result_id = int(values["result_id"])
    offer = (
        Offer(
            result_id=result_id,
            index=int(values["index"]),
            slot=int(values["slot"]),
            pick=_frame(values, "pick"),
            place=_frame(values, "place"),
            score=float(values["score"]),
            grip=int(values["grip"]),
        )
        if result_id
        else None
    )
    code = int(values["code"])
    return Answer(
        session=int(values["session"]),
        sequence=int(values["sequence"]),
        acknowledges=int(values["ack_sequence"]),
        code=int(values["error_number"]) if code == _ERROR else ResultCode(code),
        left=int(values["left"]),
        trigger_sequence=int(values["trigger_sequence"]),
        offer=offer,
        message=str(values["message"]),
    )


def _frame_values(name: str, frame: Frame) -> dict[str, Value]:
    return {f"{name}_{key}": value for key, value in zip("xyzabc", frame.as_tuple(), strict=True)}


def _frame(values: dict[str, Value], name: str) -> Frame:
    return Frame(*(float(values[f"{name}_{key}"]) for key in "xyzabc"))
