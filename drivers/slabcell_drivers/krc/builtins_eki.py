"""How do the functions of KUKA.EthernetKRL look from KRL?  Names, arguments and EKI_STATUS around `EthernetKrl`."""

from collections.abc import Callable
from dataclasses import replace

from slabcell_drivers.krc.builtin_table import Builtin
from slabcell_drivers.krc.builtins_basic import text
from slabcell_drivers.krc.cells import ElementRef, Place
from slabcell_drivers.krc.eki import EkiStatus
from slabcell_drivers.krc.eki_config import ElementType
from slabcell_drivers.krc.eki_messages import EkiMessage
from slabcell_drivers.krc.host import Host
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.operators import frame_of, set_frame
from slabcell_drivers.krc.values import ArrayValue, CharArray, EnumConstant, StructType, StructValue, Value, text_of
from slabcell_drivers.robot.frame import Frame

__all__ = ["EKI_BUILTINS"]


def _status(host: Host, status: EkiStatus) -> StructValue:
    type_ = host.project.find_type("EKI_STATUS", None)
    assert isinstance(type_, StructType)  # noqa: S101  # predefined.dat declares it
    fields: dict[str, Value] = {
        "BUFF": int(status.buff),
        "READ": int(status.read),
        "MSG_NO": int(status.msg_no),
        "CONNECTED": status.connected,
        "COUNTER": int(status.counter),
    }
    return StructValue(type_, fields)


def _on_channel(name: str) -> Callable[..., Value]:
    def call(host: Host, channel: Value) -> Value:
        host.eki.poll(0.0)
        return _status(host, getattr(host.eki, name)(text(channel)))

    return call


def _open(host: Host, channel: Value) -> Value:
    return _status(host, host.open_channel(text(channel)))


def _on_memory(name: str) -> Callable[..., Value]:
    def call(host: Host, channel: Value, path: Value) -> Value:
        host.eki.poll(0.0)
        status: EkiStatus = getattr(host.eki, name)(text(channel), text(path))
        if not status.buff:
            host.expect_network()
        return _status(host, status)

    return call


def _send(host: Host, channel: Value, path: Value, length: Place | None = None) -> Value:
    limit = length.value if length is not None else None
    host.eki.poll(0.0)
    status = host.eki.send(text(channel), text(path), limit if isinstance(limit, int) and limit > 0 else None)
    host.expect_network()
    return _status(host, status)


_KINDS: dict[str, tuple[ElementType, Callable[[Value], Value]]] = {
    "INT": (ElementType.INT, int),
    "REAL": (ElementType.REAL, float),
    "BOOL": (ElementType.BOOL, bool),
    "STRING": (ElementType.STRING, text),
    "FRAME": (ElementType.FRAME, frame_of),
}


def _setter(kind: str) -> Callable[..., Value]:
    convert = _KINDS[kind][1]

    def call(host: Host, channel: Value, path: Value, value: Value) -> Value:
        if kind not in {"STRING", "FRAME"} and isinstance(value, str | StructValue):
            raise KrlError(RunMessage.TYPE, f"EKI_SET{kind}: {text_of(value)} is no {kind}")
        return _status(host, host.eki.set_value(text(channel), text(path), convert(value)))

    return call


def _store(place: Place, value: object) -> EkiMessage:
    """Store what was received; return what EKI has to say if it does not fit."""
    target = place.value
    if isinstance(target, CharArray) and len(str(value)) > target.size:
        return EkiMessage.ARRAY_TOO_SMALL
    if not isinstance(value, Frame):
        place.set(value)
    elif isinstance(target, StructValue):
        set_frame(target, value)
    else:
        place.set(set_frame(StructValue(None, {}), value))
    return EkiMessage.NONE


def _is_set(value: Value) -> bool:
    """Tell whether a variable was ever set: EKI takes no other to write to."""
    if isinstance(value, StructValue):
        return bool(value.fields)
    if isinstance(value, CharArray):
        return value.text is not None
    return value is not None


def _getter(kind: str) -> Callable[..., Value]:
    element = _KINDS[kind][0]

    def call(host: Host, channel: Value, path: Value, target: Place) -> Value:
        host.eki.poll(0.0)
        if not _is_set(target.value):
            text_ = f"EKI_Get{kind.capitalize()}: the variable for {text(path)} has to be initialised before"
            raise KrlError(RunMessage.VALUE_INVALID, text_)
        status, value = host.eki.get_value(text(channel), text(path), element)
        if value is not None and (message := _store(target, value)):
            status = replace(status, msg_no=message, read=0)
        return _status(host, status)

    return call


def _array_getter(kind: str) -> Callable[..., Value]:
    element = _KINDS[kind][0]

    def call(host: Host, channel: Value, path: Value, target: Place) -> Value:
        host.eki.poll(0.0)
        array = target.value
        if not isinstance(array, ArrayValue):
            raise KrlError(RunMessage.TYPE, f"EKI_GET{kind}ARRAY: {text_of(array)} is no array")
        if element is ElementType.FRAME and not all(isinstance(i, StructValue) and i.fields for i in array.items):
            return _status(host, EkiStatus(msg_no=EkiMessage.ARRAY_NOT_INITIALIZED))
        status, values = host.eki.get_array(text(channel), text(path), element, len(array.items))
        for position, value in enumerate(values):
            if message := _store(ElementRef(target, (position + 1,)), value):
                status = replace(status, msg_no=message)
        return _status(host, status)

    return call


def _check(host: Host, status: Value, kind: Value, channel: Value = None) -> None:
    if not isinstance(status, StructValue):
        raise KrlError(RunMessage.TYPE, f"EKI_CHECK: {text_of(status)} is no EKI_STATUS")
    found = host.eki.check(EkiStatus(msg_no=int(status.get("MSG_NO") or 0)), None if channel is None else text(channel))
    if found is not None:
        number, message = found
        host.messages.show(kind.name if isinstance(kind, EnumConstant) else "NOTIFY", "EthernetKRL", number, message)


EKI_BUILTINS: dict[str, Builtin] = {
    "EKI_INIT": Builtin(_on_channel("init"), 1, 1, result="EKI_STATUS"),
    "EKI_OPEN": Builtin(_open, 1, 1, result="EKI_STATUS"),
    "EKI_CLOSE": Builtin(_on_channel("close"), 1, 1, result="EKI_STATUS"),
    "EKI_CLEAR": Builtin(_on_channel("clear"), 1, 1, result="EKI_STATUS"),
    "EKI_LOCK": Builtin(_on_channel("lock"), 1, 1, result="EKI_STATUS"),
    "EKI_UNLOCK": Builtin(_on_channel("unlock"), 1, 1, result="EKI_STATUS"),
    "EKI_CHECKBUFFER": Builtin(_on_memory("check_buffer"), 2, 2, result="EKI_STATUS"),
    "EKI_CLEARBUFFER": Builtin(_on_memory("clear_buffer"), 2, 2, result="EKI_STATUS"),
    "EKI_SEND": Builtin(_send, 2, 3, frozenset({2}), result="EKI_STATUS"),
    **{f"EKI_SET{kind}": Builtin(_setter(kind), 3, 3, result="EKI_STATUS") for kind in _KINDS},
    **{f"EKI_GET{kind}": Builtin(_getter(kind), 3, 3, frozenset({2}), result="EKI_STATUS") for kind in _KINDS},
    **{
        f"EKI_GET{kind}ARRAY": Builtin(_array_getter(kind), 3, 3, frozenset({2}), result="EKI_STATUS")
        for kind in _KINDS
    },
    "EKI_CHECK": Builtin(_check, 2, 3),
}
