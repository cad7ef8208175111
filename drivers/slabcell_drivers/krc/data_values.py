"""How do Python values and KRL values become each other, for those who set data of a controller from outside?"""

from collections.abc import Mapping, Sequence
from typing import cast

from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.operators import frame_of, set_frame
from slabcell_drivers.krc.values import ArrayValue, CharArray, EnumConstant, StructValue, Value
from slabcell_drivers.robot.frame import Frame

__all__ = ["to_krl", "to_python"]


def to_krl(value: object) -> Value:
    """Return a value that a KRL variable takes.  Raises KrlError for what has no counterpart."""
    if isinstance(value, bool | int | float | EnumConstant | StructValue):
        return value
    if isinstance(value, str):
        return EnumConstant(value[1:].upper()) if value.startswith("#") else value
    if isinstance(value, Frame):
        return set_frame(StructValue(None, {}), value)
    if isinstance(value, Mapping):
        items = cast("Mapping[str, object]", value).items()
        return StructValue(None, {name.upper(): to_krl(item) for name, item in items})
    if isinstance(value, Sequence):
        members = enumerate(cast("Sequence[object]", value))
        return StructValue(None, {f"\0{i}": to_krl(item) for i, item in members})
    raise KrlError(RunMessage.TYPE, f"{value!r} has no counterpart in KRL")


def to_python(value: Value) -> object:
    """Return a number, text, Frame, dict or list; an enumeration value as ``#NAME``; None for one never set."""
    if isinstance(value, CharArray):
        return value.text
    if isinstance(value, EnumConstant):
        return str(value)
    if isinstance(value, StructValue):
        if value.type is not None and value.type.name == "FRAME":
            return frame_of(value) if value.fields else None
        return {name: to_python(item) for name, item in value.fields.items()}
    if isinstance(value, ArrayValue):
        return [to_python(item) for item in value.items]
    return value
