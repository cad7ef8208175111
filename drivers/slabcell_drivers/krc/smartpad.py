"""Which messages does the SmartPAD show?  KrlMsg, KrlDlg, EKI and the controller's own."""

from collections.abc import Callable
from dataclasses import dataclass

from slabcell_drivers.krc.clock import Clock

__all__ = ["MessageWindow", "ShownMessage"]

MAX_MESSAGES = 1000
ACKNOWLEDGED_AFTER_S = 1.0
"""How long the operator lets a message stand that has to be acknowledged: programs wait for it."""


@dataclass(frozen=True, slots=True)
class ShownMessage:
    """One message: ``kind`` is NOTIFY, STATE, QUIT, WAITING or DIALOG."""

    handle: int
    time_s: float
    kind: str
    originator: str
    number: int
    text: str
    softkeys: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the line that the window shows."""
        return f"{self.kind} {self.originator} {self.number}: {self.text}"


class MessageWindow:
    """The message window.  A dialog is answered by ``answer``: the number of a softkey, or 0 to let it stand."""

    def __init__(
        self, clock: Clock, *, shown: Callable[[ShownMessage], None], answer: Callable[[ShownMessage], int]
    ) -> None:
        self._clock = clock
        self._shown = shown
        self._answer = answer
        self._next_handle = 1
        self.log: list[ShownMessage] = []
        self._open: dict[int, ShownMessage] = {}
        self.acknowledged_after_s: float | None = ACKNOWLEDGED_AFTER_S
        self._answers: dict[int, int] = {}

    def show(self, kind: str, originator: str, number: int, text: str, softkeys: tuple[str, ...] = ()) -> int:
        """Show a message and return its handle."""
        message = ShownMessage(self._next_handle, self._clock.now_s, kind, originator, number, text, softkeys)
        self._next_handle += 1
        self.log.append(message)
        del self.log[:-MAX_MESSAGES]
        if kind != "NOTIFY":
            self._open[message.handle] = message
            if len(self._open) > MAX_MESSAGES:
                del self._open[next(iter(self._open))]
        self._shown(message)
        return message.handle

    @property
    def last_handle(self) -> int:
        """The handle of the message shown last."""
        return self._next_handle - 1

    def clear(self, handle: int) -> bool:
        """Take a message away; return whether it was there."""
        return self._open.pop(handle, None) is not None

    def is_open(self, handle: int) -> bool:
        """Tell whether a message is still shown; one to be acknowledged is, after its time."""
        message = self._open.get(handle)
        if message is None:
            return False
        patience = self.acknowledged_after_s
        if message.kind == "QUIT" and patience is not None and self._clock.now_s >= message.time_s + patience:
            del self._open[handle]
            return False
        return True

    def answered(self, handle: int) -> int | None:
        """Return the softkey that answered a dialog, None while it stands open."""
        message = self._open.get(handle)
        if message is None:
            return self._answers.get(handle, 0)
        key = self._answer(message)
        if key <= 0:
            return None
        self._answers[handle] = key
        del self._open[handle]
        return key

    @property
    def open_dialog(self) -> ShownMessage | None:
        """The dialog that waits longest for its answer."""
        return next((message for message in self._open.values() if message.kind == "DIALOG"), None)

    def acknowledge_all(self) -> None:
        """Take away every message that an operator can acknowledge."""
        self._open = {h: m for h, m in self._open.items() if m.kind != "QUIT"}
