"""What can be told of a link while it works?  What went over it, its changes of state, and why a connection ended."""

from collections.abc import Callable
from enum import StrEnum

from slabcell_drivers.robot.protocol import LinkState

__all__ = ["Direction", "EndReason", "StateHook", "TelegramHook"]


class Direction(StrEnum):
    """Which way a telegram went, seen from the cell."""

    RECEIVED = "received"
    SENT = "sent"


TelegramHook = Callable[[Direction, bytes, float], None]
"""Sees every telegram: direction, bytes, and the monotonic clock in seconds."""

StateHook = Callable[[LinkState], None]
"""Sees every change of state."""


class EndReason(StrEnum):
    """Why a connection ended."""

    PEER_CLOSED = "the robot closed the connection"
    BROKEN = "the connection broke"
    SILENT = "the robot no longer answers"
    NOT_READING = "the robot does not read its answers"
    GARBAGE = "too many bytes that are no telegrams"
    FLOODED = "more requests than a lock-step robot sends"
    REPLACED = "the robot connected anew"
    STOPPED = "the link was stopped"
    FAILED = "an error of the link itself, see the log"
