"""What can go wrong with the camera in software, and how is it told to?  Fault verbs, switched by tests or a person.

``Faults.apply("loss 0.005")`` is what a test calls and what `slabcell sim camera` reads from its input, line by line.
"""

import random
import threading
from dataclasses import dataclass, field
from typing import Final

__all__ = ["FAULT_VERBS", "FaultError", "Faults", "FrameFault"]

FAULT_VERBS: Final = {
    "loss": "loss SHARE: every packet is lost with this probability (0 to 1)",
    "drop": "drop K: the K-th frame from now on is not sent at all",
    "truncate": "truncate K: of the K-th frame only the first half is sent, and it is not sent again",
    "size": "size K: the K-th frame has half its height",
    "late": "late SECONDS: frames are sent so much later",
    "hang": "hang on|off: control answers, no frame comes",
    "freeze": "freeze on|off: control does not answer",
    "reset-ids": "reset-ids [ID]: the next frame has this id (1)",
    "noresend": "noresend on|off: lost packets are not sent again",
    "dark": "dark on|off: the light is out",
    "blur": "blur on|off: out of focus",
    "stuck": "stuck on|off: every picture is the one before",
    "mend": "mend: all faults end",
}
_SWITCHES: Final = ("hang", "freeze", "noresend", "dark", "blur", "stuck")


class FaultError(Exception):
    """A fault verb was not understood; the message shows how it is written."""


@dataclass(frozen=True, slots=True)
class FrameFault:
    """What is wrong with one frame."""

    dropped: bool = False
    truncated: bool = False
    half_height: bool = False


@dataclass(slots=True)
class Faults:
    """Every fault of one camera.  All methods may be called from any thread."""

    seed: int = 0
    loss: float = 0.0
    late_s: float = 0.0
    next_block: int | None = None
    _on: set[str] = field(default_factory=set[str])
    _planned: dict[str, list[int]] = field(default_factory=dict[str, list[int]])
    _random: random.Random = field(init=False)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)  # noqa: S311 - which packet is lost is no secret

    def is_on(self, switch: str) -> bool:
        """Whether a fault that is switched on and off is on."""
        return switch in self._on

    def lose(self) -> bool:
        """Decide for one packet whether the network loses it."""
        return self.loss > 0.0 and self._random.random() < self.loss

    def begin_frame(self) -> FrameFault:
        """Count one frame and return what is wrong with it."""
        with self._lock:
            hit = {name: 1 in counts for name, counts in self._planned.items()}
            self._planned = {name: [n - 1 for n in counts if n > 1] for name, counts in self._planned.items()}
        return FrameFault(hit.get("drop", False), hit.get("truncate", False), hit.get("size", False))

    def take_next_block(self) -> int | None:
        """Return the id that the next frame must have, once; None if it simply goes on."""
        with self._lock:
            block, self.next_block = self.next_block, None
        return block

    def apply(self, line: str) -> None:
        """Do what a fault verb says.  Raises FaultError."""
        words = line.split()
        verb = words[0] if words else ""
        usage = FAULT_VERBS.get(verb)
        if usage is None:
            raise FaultError(f"fault '{verb}' is not known; there are {', '.join(FAULT_VERBS)}")
        try:
            with self._lock:
                self._apply(verb, words[1:])
        except (ValueError, IndexError) as error:
            raise FaultError(f"'{line.strip()}' is not understood; write {usage}") from error

    def _apply(self, verb: str, values: list[str]) -> None:
        if verb in _SWITCHES:
            {"on": self._on.add, "off": self._on.discard}[_one_of(values[0], "on", "off")](verb)
        elif verb == "loss":
            self.loss = _within(float(values[0]), 0.0, 1.0)
        elif verb == "late":
            self.late_s = _within(float(values[0]), 0.0, 3600.0)
        elif verb == "reset-ids":
            self.next_block = int(_within(int(values[0]) if values else 1, 1, 65_535))
        elif verb == "mend":
            self.loss = self.late_s = 0.0
            self.next_block = None
            self._on.clear()
            self._planned.clear()
        else:
            self._planned.setdefault(verb, []).append(int(_within(int(values[0]), 1, 1_000_000_000)))


def _one_of(word: str, *allowed: str) -> str:
    if word not in allowed:
        raise ValueError(word)
    return word


def _within(value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ValueError(value)
    return value
