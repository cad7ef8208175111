"""What was collected for a calibration?  Views: the board's points in a picture, and where the robot was.

Only points are kept, no pictures: a view is some kilobytes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

from slabcell.errors import TemporaryError

__all__ = ["MAX_VIEWS", "Pose", "View", "Views"]

MAX_VIEWS: Final = 100

Json = dict[str, Any]
Pose = tuple[float, float, float, float, float, float]
"""X Y Z in mm, A B C in degrees: of the flange in the robot's base."""


@dataclass(frozen=True, slots=True)
class View:
    """One view.  ``detection`` is what the bench found; ``pose`` X Y Z A B C of the flange, if it is known."""

    number: int
    picture: str
    board: str
    detection: Json
    pose: Pose | None

    @property
    def name(self) -> str:
        """What it is called in results."""
        return f"view-{self.number}"


class Views:
    """The views of one daemon, in memory."""

    def __init__(self) -> None:
        self._views: dict[int, View] = {}
        self._last = 0

    @property
    def all(self) -> tuple[View, ...]:
        """Every view, the oldest first."""
        return tuple(self._views.values())

    def add(self, picture: str, board: str, detection: Json, pose: tuple[float, ...] | None) -> View:
        """Keep a view.  Raises TemporaryError where there are too many."""
        if len(self._views) >= MAX_VIEWS:
            msg = f"there are {MAX_VIEWS} views, more are not kept: remove some"
            raise TemporaryError(msg)
        self._last += 1
        x, y, z, a, b, c = pose or (0.0,) * 6
        view = View(self._last, picture, board, detection, None if pose is None else (x, y, z, a, b, c))
        self._views[view.number] = view
        return view

    def place(self, number: int, pose: Pose | None) -> View:
        """Note where the robot was for a view that is kept; return the view as it is now."""
        view = self._views[number] = replace(self._views[number], pose=pose)
        return view

    def get(self, number: int) -> View | None:
        """Return a view, or None."""
        return self._views.get(number)

    def remove(self, number: int) -> None:
        """Forget a view."""
        self._views.pop(number, None)

    def clear(self) -> None:
        """Forget every view."""
        self._views.clear()
