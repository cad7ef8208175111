"""How do KRL programs show messages and ask the operator?"""

from slabcell_drivers.krc.builtin_table import Builtin
from slabcell_drivers.krc.builtins_basic import shown_text, text
from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.host import Host
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.values import ArrayValue, CharArray, EnumConstant, StructValue, Value, text_of

__all__ = ["MESSAGE_BUILTINS"]


def _parameter_text(parameter: Value) -> str | None:
    if not isinstance(parameter, StructValue):
        return None
    kind = parameter.fields.get("PAR_TYPE")
    if isinstance(kind, EnumConstant) and kind.name == "EMPTY":
        return ""
    for name in ("PAR_TXT", "PAR_INT", "PAR_REAL", "PAR_BOOL"):
        value = parameter.fields.get(name)
        if isinstance(value, CharArray) and value.text is None:
            value = None
        if value is not None:
            return shown_text(value)
    return ""


def _filled(message: str, parameters: Value) -> str:
    values: list[str | None] = []
    if isinstance(parameters, ArrayValue):
        values = [_parameter_text(item) for item in parameters.items]
    for number in (1, 2, 3):
        value = values[number - 1] if number <= len(values) else None
        message = message.replace(f"%{number}", value or "")
    return message


def _message_parts(message: Value) -> tuple[str, int, str]:
    if not isinstance(message, StructValue):
        raise KrlError(RunMessage.TYPE, f"{text_of(message)} is no KRLMSG_T")
    originator, content = message.fields.get("MODUL"), message.fields.get("MSG_TXT")
    return shown_text(originator or ""), int(message.fields.get("NR") or 0), shown_text(content or "")


def _set_message(host: Host, kind: Value, message: Value, parameters: Value = None, *_: Value) -> int:
    originator, number, content = _message_parts(message)
    name = kind.name if isinstance(kind, EnumConstant) else "NOTIFY"
    return host.messages.show(name, originator, number, _filled(content, parameters))


def _set_dialog(host: Host, message: Value, parameters: Value = None, softkeys: Value = None, *_: Value) -> int:
    originator, number, content = _message_parts(message)
    keys: list[str] = []
    if isinstance(softkeys, ArrayValue):
        keys = [shown_text(k.fields.get("SK_TXT") or "") for k in softkeys.items if isinstance(k, StructValue)]
    return host.messages.show("DIALOG", originator, number, _filled(content, parameters), tuple(keys))


def _message_exists(host: Host, handle: Value) -> bool:
    return host.messages.is_open(int(handle))


def _clear_message(host: Host, handle: Value) -> bool:
    return host.messages.clear(int(handle))


def _dialog_exists(host: Host, handle: Value, answer: Place | None = None) -> bool:
    key = host.messages.answered(int(handle))
    host.expect_operator(waits=key is None)
    if key is None:
        return True
    if answer is not None:
        answer.set(key)
    return False


class _Short:
    """MsgNotify, MsgQuit and MsgWait of KUKA's message library: (text, module, number for %1, text for %1, number)."""

    def __init__(self, kind: str) -> None:
        self._kind = kind

    def __call__(
        self,
        host: Host,
        content: Value,
        originator: Value = None,
        value: Value = None,
        addition: Value = None,
        number: Value = None,
        *_: Value,
    ) -> int:
        filling = shown_text(value) if value is not None else "" if addition is None else shown_text(addition)
        shown = text(content).replace("%1", filling)
        module = "" if originator is None else text(originator)
        return host.messages.show(self._kind, module, int(number or 0), shown)


def _notify_texts(
    host: Host,
    content: Value,
    originator: Value = None,
    value: Value = None,
    first: Value = None,
    second: Value = None,
    number: Value = None,
    *_: Value,
) -> None:
    """MsgNotifyTextPar: a number above 0 fills %1, or else two texts fill %1 and %2."""
    shown = text(content)
    if value:
        shown = shown.replace("%1", shown_text(value))
    else:
        shown = shown.replace("%1", shown_text(first or "")).replace("%2", shown_text(second or ""))
    host.messages.show("NOTIFY", "" if originator is None else text(originator), int(number or 0), shown)


def _state_message(host: Host, handle: Place, *arguments: Value) -> None:
    handle.set(_Short("STATE")(host, *arguments))


def _ask(
    host: Host, answer: Place, content: Value, originator: Value = None, addition: Value = None, *rest: Value
) -> None:
    # MsgDialog puts its first text on softkey 7 and its seventh on softkey 1: the answer counts down
    given = [text(key) if isinstance(key, str | CharArray) else "" for key in rest[:7]]
    keys = tuple(reversed(given + [""] * (7 - len(given))))
    filling = "" if addition is None else shown_text(addition)
    module = "" if originator is None else text(originator)
    handle = host.messages.show("DIALOG", module, 0, text(content).replace("%1", filling), keys)
    host.open_dialog = (handle, answer)


def _is_acknowledged(host: Host) -> bool:
    return not host.messages.is_open(host.messages.last_handle)


def _is_answered(host: Host) -> bool:
    if host.open_dialog is None:
        return True
    handle, answer = host.open_dialog
    key = host.messages.answered(handle)
    host.expect_operator(waits=key is None)
    if key is None:
        return False
    answer.set(key)
    host.open_dialog = None
    return True


MESSAGE_BUILTINS: dict[str, Builtin] = {
    "SET_KRLMSG": Builtin(_set_message, 2, 4, result="INT"),
    "SET_KRLDLG": Builtin(_set_dialog, 1, 4, result="INT"),
    "EXISTS_KRLMSG": Builtin(_message_exists, 1, 1, result="BOOL"),
    "EXISTS_KRLDLG": Builtin(_dialog_exists, 1, 2, frozenset({1}), result="BOOL"),
    "CLEAR_KRLMSG": Builtin(_clear_message, 1, 1, result="BOOL"),
    "MSGNOTIFY": Builtin(_Short("NOTIFY"), 1, 6, result="INT"),
    "MSGNOTIFYTEXTPAR": Builtin(_notify_texts, 1, 7),
    "MSGQUIT": Builtin(_Short("QUIT"), 1, 6, waits=_is_acknowledged),
    "MSGSTATE": Builtin(_state_message, 2, 7, frozenset({0})),
    "MSGLOOP": Builtin(_Short("STATE"), 1, 2),
    "MSGDIALOG": Builtin(_ask, 2, 14, frozenset({0}), waits=_is_answered),
}
