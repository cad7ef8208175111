"""How do KRL programs format texts, pack values into buffers, and reach interfaces and outputs?"""

import re
import struct
from collections.abc import Sequence

from slabcell_drivers.krc.builtin_table import Builtin
from slabcell_drivers.krc.builtins_basic import place_text, shown_text, text
from slabcell_drivers.krc.cells import Place, Trait
from slabcell_drivers.krc.host import Host
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.values import (
    BOOL,
    CHAR,
    REAL,
    CharArray,
    EnumConstant,
    StructValue,
    Value,
    text_of,
)

__all__ = ["BUFFER_BUILTINS"]

_STOP = frozenset({Trait.STOPS_ADVANCE})
_CONVERSION = re.compile(r"%([-+ 0#]*)(\d*)(?:\.(\d+))?([a-zA-Z%])")


# --- formatting ----------------------------------------------------------------------------------------------------


def _format_text(template: str, values: Sequence[Value]) -> str:
    """Return the text that SWRITE or CWRITE makes of a format and values.  Raises KrlError if they do not match."""
    rest = list(values)

    def convert(match: re.Match[str]) -> str:
        flags, width, precision, letter = match.groups()
        if letter == "%":
            return "%"
        if not rest:
            raise KrlError(RunMessage.ARGUMENTS, f"the format {template!r} needs more values than are given")
        value = rest.pop(0)
        spec = f"%{flags}{width}" + (f".{precision}" if precision is not None else "")
        if letter in "dioxXc":
            if letter == "c" and isinstance(value, str):
                return (spec + "s") % value[:1]
            if isinstance(value, bool) or not isinstance(value, int):
                value = int(value) if isinstance(value, bool | float) else ord(str(value)[:1] or " ")
            return (spec + letter) % value
        if letter in "feEgG":
            return (spec + letter) % float(value)
        return (spec + "s") % shown_text(value)

    return _CONVERSION.sub(convert, template)


def _set_state(state: Place | None, return_code: str, hits: int, length: int) -> None:
    if state is None:
        return
    structure = state.value
    if isinstance(structure, StructValue) and structure.type is not None:
        for name, value in (("RET1", EnumConstant(return_code)), ("HITS", hits), ("LENGTH", length), ("MSG_NO", 0)):
            if name in structure.type.members:
                structure.set(name, value)


def _write_text(_: Host, target: Place, state: Place | None, offset: Place | None, form: Place, *values: Place) -> None:
    start = int(offset.value or 0) if offset is not None else 0
    written = _format_text(text(form.value), [v.value for v in values])
    before = place_text(target)[:start].ljust(start)
    array = target.value
    joined = before + written
    if isinstance(array, CharArray) and len(joined) > array.size:
        joined = joined[: array.size]
        _set_state(state, "DATA_BLK", 0, 0)
    else:
        _set_state(state, "CMD_OK", len(values), len(written))
    target.set(joined)
    if offset is not None:
        offset.set(len(joined))


_SCAN = {
    "d": r"\s*([-+]?\d+)",
    "i": r"\s*([-+]?\d+)",
    "x": r"\s*([0-9A-Fa-f]+)",
    "s": r"\s*(\S+)",
    "c": r"(.)",
    **dict.fromkeys("feEgG", r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"),
}


def _read_text(_: Host, source: Place, state: Place | None, offset: Place | None, form: Place, *targets: Place) -> None:
    start = int(offset.value or 0) if offset is not None else 0
    content = place_text(source)
    position, hits = start, 0
    template = text(form.value)
    rest = list(targets)
    last = 0
    ok = True
    for match in _CONVERSION.finditer(template):
        literal = template[last : match.start()]
        last = match.end()
        skipped = re.compile(r"\s*".join(re.escape(part) for part in literal.split(" "))).match(content, position)
        if skipped is None:
            ok = False
            break
        position = skipped.end()
        letter, width = match.group(4), match.group(2)
        pattern = _SCAN.get(letter, r"(\S+)")
        if letter == "s" and width:
            pattern = rf"(.{{1,{int(width)}}})"
        found = re.compile(pattern).match(content, position)
        if found is None or not rest:
            ok = False
            break
        position = found.end()
        raw = found.group(1)
        value: Value = int(raw, 16) if letter == "x" else int(raw) if letter in "di" else raw
        rest.pop(0).set(float(raw) if letter in "feEgG" else value)
        hits += 1
    _set_state(state, "CMD_OK" if ok else "FMT_ERR", hits, position - start)
    if offset is not None:
        offset.set(position)


# --- packing ---------------------------------------------------------------------------------------------------------


def _packed(value: Value) -> bytes:
    if isinstance(value, bool):
        return bytes([value])
    if isinstance(value, int):
        return struct.pack("<i", value)
    if isinstance(value, float):
        return struct.pack("<f", value)
    if isinstance(value, CharArray):
        return (value.text or "").encode("latin-1", "replace").ljust(value.size, b"\0")
    if isinstance(value, str):
        return value.encode("latin-1", "replace")
    raise KrlError(RunMessage.TYPE, f"CAST_TO: {text_of(value)} cannot be packed")


def _cast_to(_: Host, buffer: Place, offset: Place, *values: Place) -> None:
    start = int(offset.value or 0)
    content = buffer.value
    before = (content.text or "") if isinstance(content, CharArray) else ""
    packed = b"".join(_packed(v.value) for v in values).decode("latin-1")
    buffer.set(before[:start].ljust(start, "\0") + packed + before[start + len(packed) :])
    offset.set(start + len(packed))


def _cast_from(_: Host, buffer: Place, offset: Place, *targets: Place) -> None:
    position = int(offset.value or 0)
    content = buffer.value
    raw = ((content.text or "") if isinstance(content, CharArray) else "").encode("latin-1", "replace")
    for target in targets:
        type_ = getattr(target, "type", None)
        present = target.value
        size = present.size if isinstance(present, CharArray) else 1 if type_ in {BOOL, CHAR} else 4
        piece = raw[position : position + size]
        if len(piece) < size:
            raise KrlError(
                RunMessage.RANGE, f"CAST_FROM: the buffer holds {len(raw)} characters, not {position + size}"
            )
        if isinstance(present, CharArray):
            target.set(piece.decode("latin-1").rstrip("\0"))
        elif type_ is BOOL:
            target.set(piece != b"\0")
        elif type_ is CHAR:
            target.set(piece.decode("latin-1"))
        else:
            target.set(struct.unpack("<f" if type_ is REAL else "<i", piece)[0])
        position += size
    offset.set(position)


# --- outputs -------------------------------------------------------------------------------------------------------


def _pulse(host: Host, output: Place, level: Value, seconds: Value) -> None:
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or seconds <= 0:
        raise KrlError(RunMessage.RANGE, f"PULSE: {text_of(seconds)} s is not above 0")
    output.set(level)
    host.schedule(float(seconds), lambda: output.set(not level))


class _NotHere:
    """A function of interfaces that this controller does not have."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __call__(self, _: Host, *arguments: Value) -> None:
        del arguments
        raise KrlError(RunMessage.NOT_SUPPORTED, f"{self._name}: this controller has no such interface")


def _channel_write(
    host: Host, handle: Value, state: Place | None, mode: Value, template: Value, *values: Value
) -> None:
    """CWRITE: commands to $CMD; the controller refuses those that it cannot carry out."""
    del mode
    if handle != host.system.read("$CMD"):
        raise KrlError(RunMessage.NOT_SUPPORTED, "CWRITE: this controller has no serial or external channels")
    command = _format_text(text(template), values)
    done = host.command(command)
    _set_state(state, "CMD_OK" if done else "CMD_REJ", 1, len(command))
    if not done:
        host.messages.show("NOTIFY", "CWRITE", 0, f"{command}: not carried out here")


BUFFER_BUILTINS: dict[str, Builtin] = {
    "SWRITE": Builtin(_write_text, 4, 34, frozenset({0, 1, 2}), rest_out=True),
    "SREAD": Builtin(_read_text, 4, 34, frozenset({0, 1, 2}), rest_out=True),
    "CAST_TO": Builtin(_cast_to, 3, 34, frozenset({0, 1}), rest_out=True),
    "CAST_FROM": Builtin(_cast_from, 3, 34, frozenset({0, 1}), rest_out=True),
    "CWRITE": Builtin(_channel_write, 4, 34, frozenset({1})),
    "CREAD": Builtin(_NotHere("CREAD"), 1, 34),
    "COPEN": Builtin(_NotHere("COPEN"), 1, 4),
    "CCLOSE": Builtin(_NotHere("CCLOSE"), 1, 4),
    "PULSE": Builtin(_pulse, 3, 3, frozenset({0}), traits=_STOP),
}
