"""Who shows the calibration board to the simulated camera?  A person who is not there: held, laid, or on the flange.

Every place has many poses, counted from 0; the same number is the same pose.  The scene says what the board is.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Final, Literal

from slabcell.service.simulated import SimulatedCell
from slabcell_drivers.robot import Frame
from slabcell_drivers.simulation import camera_views, plane_views

__all__ = ["BoardPlace", "BoardStand", "ShownBoard"]

BoardPlace = Literal["away", "held", "table", "flange"]

ON_FLANGE: Final = Frame(-20.0, 15.0, 60.0, 10.0, -3.0, 4.0)
"""The board in the flange's frame, as somebody has screwed it on."""
HELD: Final = 30
LAID: Final = 8


@dataclass(frozen=True, slots=True)
class ShownBoard:
    """Which board is shown, where, and where the flange is that holds it."""

    board: str
    thickness_mm: float
    place: BoardPlace
    number: int
    flange: tuple[float, ...] | None


class BoardStand:
    """The board of one simulated cell.  Methods compute for some milliseconds: run them in a thread."""

    def __init__(self, cell: SimulatedCell, seed: int) -> None:
        self._cell = cell
        self._seed = seed
        self._shown: tuple[BoardPlace, int, Frame | None] = ("away", 0, None)
        self._poses: dict[str, tuple[Frame, ...]] = {}
        self._lock = threading.Lock()

    @property
    def shown(self) -> ShownBoard:
        """What is shown now."""
        place, number, flange = self._shown
        board = self._cell.scene.board
        pose = None if flange is None else tuple(round(value, 4) for value in flange.as_tuple())
        return ShownBoard(board.name, board.thickness_mm, place, number, pose)

    def show(self, place: BoardPlace, number: int) -> ShownBoard:
        """Hold the board before the camera, lay it on the table, have the flange hold it, or take it away."""
        with self._lock:
            poses = self._of(place)
            pose = poses[number % len(poses)] if poses else None
            flange = pose @ ON_FLANGE.inverse() if pose is not None and place == "flange" else None
            self._cell.board = pose
            self._shown = (place, number, flange)
            return self.shown

    def _of(self, place: BoardPlace) -> tuple[Frame, ...]:
        scene = self._cell.scene
        if place == "away":
            return ()
        if place not in self._poses:
            found = plane_views(scene, LAID) if place == "table" else camera_views(scene, self._seed, HELD)
            self._poses[place] = tuple(found)
        return self._poses[place]
