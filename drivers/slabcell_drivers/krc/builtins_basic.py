"""What do KRL's functions on numbers, texts, variables and time do?"""

import math

from slabcell_drivers.krc.builtin_table import Builtin
from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.host import Host
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.values import CharArray, EnumConstant, StructValue, Value, text_of

__all__ = ["BASIC_BUILTINS"]


def _number(value: Value) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise KrlError(RunMessage.TYPE, f"{text_of(value)} is no number")
    return float(value)


def text(value: Value) -> str:
    """Return the text of an argument, up to its first NUL."""
    if isinstance(value, CharArray):
        value = value.text or ""
    if not isinstance(value, str):
        raise KrlError(RunMessage.TYPE, f"{text_of(value)} is no text")
    return value.split("\0", 1)[0]


def shown_text(value: Value) -> str:
    """Return a value as a message shows it: a text without its quotation marks."""
    if isinstance(value, CharArray):
        return value.text or ""
    if isinstance(value, str):
        return value
    return text_of(value)


def place_text(place: Place) -> str:
    """Return the text that a place holds; one never set is empty."""
    value = place.value
    return "" if value is None else text(value)


def _sine(_: Host, x: Value) -> float:
    return math.sin(math.radians(_number(x)))


def _cosine(_: Host, x: Value) -> float:
    return math.cos(math.radians(_number(x)))


def _tangent(_: Host, x: Value) -> float:
    return math.tan(math.radians(_number(x)))


def _root(_: Host, x: Value) -> float:
    number = _number(x)
    if number < 0:
        raise KrlError(RunMessage.RANGE, f"SQRT of {text_of(x)}: a number below 0 has no root")
    return math.sqrt(number)


def _arc_cosine(_: Host, x: Value) -> float:
    number = _number(x)
    if not -1.0 <= number <= 1.0:
        raise KrlError(RunMessage.RANGE, f"ACOS of {text_of(x)}: not in -1 to 1")
    return math.degrees(math.acos(number))


def _arc_tangent(_: Host, y: Value, x: Value) -> float:
    return math.degrees(math.atan2(_number(y), _number(x)))


def _magnitude(_: Host, x: Value) -> Value:
    _number(x)
    return abs(x)


# --- texts ---------------------------------------------------------------------------------------------------------


def _declared_length(value: Value) -> int:
    return value.size if isinstance(value, CharArray) else len(text(value))


def _string_declared_length(_: Host, place: Place) -> int:
    return _declared_length(place.value)


def _string_length(_: Host, place: Place) -> int:
    return len(place_text(place))  # 0 for an argument left out, which message libraries rely on


def _string_add(_: Host, target: Place, addition: Value) -> int:
    value = target.value
    joined = place_text(target) + text(addition)
    if isinstance(value, CharArray) and len(joined) > value.size:
        return 0
    target.set(joined)
    return len(text(addition)) and len(joined)


def _string_clear(_: Host, target: Place) -> bool:
    target.set("")
    return True


def _ignores_case(option: Value) -> bool:
    return isinstance(option, EnumConstant) and option.name.startswith("NOT")


def _string_compare(_: Host, a: Value, b: Value, option: Value = None) -> bool:
    first, second = text(a), text(b)
    return first.upper() == second.upper() if _ignores_case(option) else first == second


def _string_copy(_: Host, target: Place, source: Value) -> bool:
    value = target.value
    if isinstance(value, CharArray) and len(text(source)) > value.size:
        return False
    target.set(text(source))
    return True


def _string_find(_: Host, start: Value, where: Value, what: Value, option: Value = None) -> int:
    haystack, needle = text(where), text(what)
    if _ignores_case(option):
        haystack, needle = haystack.upper(), needle.upper()
    return haystack.find(needle, max(0, int(start) - 1)) + 1


def _to_number(target: Place, source: Value, convert: "type[int] | type[float]") -> bool:
    try:
        target.set(convert(text(source).strip()))
    except (ValueError, KrlError):
        return False
    return True


def _string_to_int(_: Host, source: Value, target: Place) -> bool:
    return _to_number(target, source, int)


def _string_to_real(_: Host, source: Value, target: Place) -> bool:
    return _to_number(target, source, float)


def _string_to_bool(_: Host, source: Value, target: Place) -> bool:
    word = text(source).strip().upper()
    if word not in {"TRUE", "FALSE", "1", "0"}:
        return False
    target.set(word in {"TRUE", "1"})
    return True


def _string_to_structure(host: Host, source: Value, target: Place) -> bool:
    try:
        target.set(host.evaluate_text(text(source)))
    except KrlError:
        return False
    return True


# --- variables and time --------------------------------------------------------------------------------------------


def _variable_state(host: Host, name: Value) -> EnumConstant:
    return EnumConstant(host.variable_state(text(name)))


def _raise_error(host: Host, error: Value) -> None:
    number = error.get("NUMBER") if isinstance(error, StructValue) else 0
    if number:
        raise KrlError(int(number), host.error_text or "ERR_RAISE")


def _clear_error(host: Host, *_: Place) -> None:
    host.clear_error()


def _timer_limit(_: Host, value: Value) -> float:
    return min(max(_number(value), -2147483.0), 2147483.0)


def _random(host: Host, low: Value, high: Value) -> float:
    return host.rng.uniform(_number(low), _number(high))


def _zero(_: Host) -> int:
    return 0


def _zero_of(_: Host, *__: Value) -> int:
    return 0


def _system_state(_: Host, __: Value, number: Place, ___: Place) -> bool:
    number.set(0)  # STOPBITS, what programs ask for: nothing stops the robot
    return True


def _one(_: Host, *__: Value) -> int:
    return 1


def _yes(_: Host, *__: Value) -> bool:
    return True


def _no(_: Host, *__: Value) -> bool:
    return False


BASIC_BUILTINS: dict[str, Builtin] = {
    "ABS": Builtin(_magnitude, 1, 1),
    "SQRT": Builtin(_root, 1, 1, result="REAL"),
    "SIN": Builtin(_sine, 1, 1, result="REAL"),
    "COS": Builtin(_cosine, 1, 1, result="REAL"),
    "TAN": Builtin(_tangent, 1, 1, result="REAL"),
    "ACOS": Builtin(_arc_cosine, 1, 1, result="REAL"),
    "ATAN2": Builtin(_arc_tangent, 2, 2, result="REAL"),
    "STRLEN": Builtin(_string_length, 1, 1, frozenset({0}), result="INT"),
    "STRDECLLEN": Builtin(_string_declared_length, 1, 1, frozenset({0}), result="INT"),
    "STRADD": Builtin(_string_add, 2, 2, frozenset({0}), result="INT"),
    "STRCLEAR": Builtin(_string_clear, 1, 1, frozenset({0}), result="BOOL"),
    "STRCOMP": Builtin(_string_compare, 2, 3, result="BOOL"),
    "STRCOPY": Builtin(_string_copy, 2, 2, frozenset({0}), result="BOOL"),
    "STRFIND": Builtin(_string_find, 3, 4, result="INT"),
    "STRTOINT": Builtin(_string_to_int, 2, 2, frozenset({1}), result="BOOL"),
    "STRTOREAL": Builtin(_string_to_real, 2, 2, frozenset({1}), result="BOOL"),
    "STRTOBOOL": Builtin(_string_to_bool, 2, 2, frozenset({1}), result="BOOL"),
    **{
        f"STRTO{name}": Builtin(_string_to_structure, 2, 2, frozenset({1}), result="BOOL")
        for name in ("FRAME", "POS", "E3POS", "E6POS", "AXIS", "E3AXIS", "E6AXIS", "STRING", "ENUM", "CHAR")
    },
    "VARSTATE": Builtin(_variable_state, 1, 1),
    "ERR_RAISE": Builtin(_raise_error, 1, 1),
    "ERR_CLEAR": Builtin(_clear_error, 0, 1, frozenset({0})),
    "TIMER_LIMIT": Builtin(_timer_limit, 1, 1, result="REAL"),
    "FRAND": Builtin(_random, 2, 2, result="REAL"),
    "SYNC": Builtin(_zero, 0, 0, result="INT"),
    # of the controller's surroundings: no message waits, no key is pressed, every work space is free
    "MBX_REC": Builtin(_one, 2, 2, frozenset({1}), result="INT"),
    "IS_KEY_PRESSED": Builtin(_no, 1, 1, result="BOOL"),
    "ISMESSAGESET": Builtin(_no, 1, 1, result="BOOL"),
    "WSPACEGIVE": Builtin(_yes, 1, 1, result="BOOL"),
    "WSPACETAKE": Builtin(_yes, 1, 2, result="BOOL"),
    "GETSYSSTATE": Builtin(_system_state, 3, 3, frozenset({1, 2}), result="BOOL"),
    "GET_MSGBUFFER": Builtin(_zero_of, 1, 1, frozenset({0}), result="INT"),
    "DELETE_BACKWARD_BUFFER": Builtin(_zero, 0, 0),
}
