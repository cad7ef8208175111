"""Which devices can be reached?  The state of each link, since when, and why; told on when it changes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum

import structlog

__all__ = ["Link", "LinkName", "LinkState", "Links"]

_log = structlog.get_logger(__name__)


class LinkName(StrEnum):
    """What the cell is linked to."""

    CAMERA = "camera"
    ROBOT = "robot"
    DISK = "disk"
    LIGHT = "light"


class LinkState(StrEnum):
    """Where a link stands."""

    CONNECTING = "connecting"
    UP = "up"
    DOWN = "down"


@dataclass(frozen=True, slots=True)
class Link:
    """One link.  ``since_s`` is of the monotonic clock, ``since_utc`` the same moment for people."""

    name: LinkName
    state: LinkState
    since_s: float
    since_utc: datetime
    detail: str = ""


class Links:
    """The links of one cell, ``light`` if it has one.  ``changed`` is told of each new state, in the event loop."""

    def __init__(
        self,
        changed: Callable[[Link], None] | None = None,
        *,
        light: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock
        self.changed = changed
        now_s, now = clock(), datetime.now(UTC)
        self._links = {
            name: Link(name, LinkState.CONNECTING, now_s, now)
            for name in LinkName
            if light or name is not LinkName.LIGHT
        }

    def __getitem__(self, name: LinkName) -> Link:
        """Return how a link stands now."""
        return self._links[name]

    @property
    def all(self) -> tuple[Link, ...]:
        """Every link, in the order of `LinkName`."""
        return tuple(self._links.values())

    def age_s(self, link: Link) -> float:
        """Return how long a link has been in its state, in seconds."""
        return self._clock() - link.since_s

    def set(self, name: LinkName, state: LinkState, detail: str = "") -> bool:
        """Note how a link stands; return whether that is new.  New words alone are no change of state."""
        before = self._links[name]
        if before.state is state:
            self._links[name] = Link(name, state, before.since_s, before.since_utc, detail)
            return False
        after = Link(name, state, self._clock(), datetime.now(UTC), detail)
        self._links[name] = after
        _log.info("link", link=name.value, before=before.state.value, after=state.value, detail=detail)
        if self.changed is not None:
            self.changed(after)
        return True
