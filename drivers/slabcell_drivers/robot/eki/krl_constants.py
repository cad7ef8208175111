"""Which numbers and structures of the schema do the KRL programs need?  The generated fold of ``VT.dat``.

KRL names hold at most 24 characters.  `splice` puts the fold into a file that a person keeps.
"""

from slabcell_drivers.robot.eki.schema import PROTOCOL_VERSION, VIS, Channel, ElementType
from slabcell_drivers.robot.protocol import AckState, RequestType, ResultCode

__all__ = ["MAX_NAME_CHARS", "constants_fold", "splice"]

MAX_NAME_CHARS = 24
FOLD_BEGIN = ";FOLD Generated from the telegram schema, do not edit"
FOLD_END = ";ENDFOLD (Generated)"

_STATES = {
    AckState.NONE: "NONE",
    AckState.ACCEPTED: "ACCEPTED",
    AckState.GRASPED: "GRASPED",
    AckState.PLACED: "PLACED",
    AckState.PICK_FAILED: "PICKFAILED",
    AckState.UNREACHABLE: "UNREACHABLE",
    AckState.ABORTED: "ABORTED",
}
_CODES = {
    ResultCode.OK: "OK",
    ResultCode.JOB_COMPLETE: "COMPLETE",
    ResultCode.NOTHING_LEFT: "NOTHINGLEFT",
    ResultCode.BAD_REQUEST: "BADREQUEST",
    ResultCode.BUSY: "BUSY",
}
_OWN_ERRORS = {
    "ELINK": (-1, "the link is lost"),
    "ETIMEOUT": (-2, "no answer in time"),
    "ENOCELL": (2001, "no connection after all tries"),
    "ESTALE": (2002, "the cell offered an old result"),
    "EVERSION": (2003, "the cell speaks another version"),
}


def constants_fold(channel: Channel) -> str:
    """Return the fold: version, flags, request types, states, codes and the result's structure."""
    lines = [FOLD_BEGIN, _constant("VERSION", PROTOCOL_VERSION)]
    lines.append("; Flags, as in the channel's XML file")
    lines += [
        _constant("FLAGHB", channel.flag_heartbeat, "the cell's answer to a heartbeat"),
        _constant("FLAGALIVE", channel.flag_alive, "TRUE while connected"),
        _constant("FLAGRX", channel.flag_received, "a telegram has arrived"),
    ]
    lines.append("; Types of a request")
    lines += [_constant(f"TY{type_.name}", type_) for type_ in RequestType]
    lines.append("; How far the robot got with a result")
    lines += [_constant(name, state) for state, name in _STATES.items()]
    lines.append("; Codes of an answer; from 1000 on: error numbers of the cell")
    lines += [_constant(name, code) for code, name in _CODES.items()]
    lines.append("; Codes of errors that are found here; from 2000 on with a text in VT_MSG[]")
    lines += [_constant(name, value, why) for name, (value, why) in _OWN_ERRORS.items()]
    lines.append("; One answer; its text is in VT_MSG[]")
    lines += [_structure(), FOLD_END]
    return "\n".join(lines)


def splice(text: str, fold: str) -> str:
    """Return the file with its generated fold replaced.  Raises ValueError if it has none."""
    begin, end = text.find(FOLD_BEGIN), text.find(FOLD_END)
    if begin < 0 or end < begin:
        raise ValueError(f'the file has no fold that begins with "{FOLD_BEGIN}" and ends with "{FOLD_END}"')
    return text[:begin] + fold + text[end + len(FOLD_END) :]


def _constant(name: str, value: int, comment: str = "") -> str:
    line = f"DECL GLOBAL CONST INT VT_{name}={int(value)}"
    return f"{line} ; {comment}" if comment else line


def _structure() -> str:
    groups: list[tuple[str, list[str]]] = []
    for node in VIS.nodes:
        if node.name in {"Head", "Check", "Msg"}:
            continue
        members = (
            [("FRAME", node.name.upper())]
            if node.is_frame
            else [(element.type.value, element.attribute.upper()) for element in node.elements]
        )
        for type_, name in members:
            if not groups or groups[-1][0] != type_:
                groups.append((type_, []))
            groups[-1][1].append(name)
    assert all(type_ != ElementType.STRING for type_, _ in groups), "a CHAR array needs its length"  # noqa: S101 - ours
    return "GLOBAL STRUC VT_RES_T " + ",".join(f"{type_} {','.join(names)}" for type_, names in groups)
