"""What does a link do with the gripper's I/O, where it hangs on the cell PC?  A small port; most cells have none.

The PLC wishes (vacuum on or off), the gripper tells what is (part present, interlock closed, whether its I/O answers).
"""

from collections.abc import Callable
from typing import Protocol

__all__ = ["NoGripper", "PeerGripper", "state_bits"]


class PeerGripper(Protocol):
    """The gripper's I/O as a link sees it."""

    @property
    def state_bits(self) -> int:
        """The io_state register: bit 0 part present, bit 1 interlock closed, bit 2 the I/O answers."""
        ...

    def wish(self, *, vacuum: bool) -> None:
        """Take note of what the PLC wants; must not block."""
        ...

    def subscribe(self, changed: Callable[[], None]) -> None:
        """Have ``changed`` called, in the event loop, after each change of `state_bits`."""
        ...


class NoGripper:
    """The gripper hangs on the robot: nothing is known of it here."""

    state_bits = 0

    def wish(self, *, vacuum: bool) -> None:
        """Do nothing."""

    def subscribe(self, changed: Callable[[], None]) -> None:
        """Nothing ever changes."""


def state_bits(*, part_present: bool, interlock_closed: bool, answers: bool) -> int:
    """Return the io_state register."""
    return int(part_present) | int(interlock_closed) << 1 | int(answers) << 2
