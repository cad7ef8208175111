"""What does an endpoint work with?  The parts of the running daemon that the API speaks to."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from slabcell.cell.cell import Cell
from slabcell.service.active_recipe import RecipeShelf
from slabcell.service.api.ring import EventRing
from slabcell.service.api.stream import StreamSeats
from slabcell.service.bundles import BundleShelf
from slabcell.service.calibrations import CalibrationShelf
from slabcell.service.frames import FrameStore
from slabcell.service.history import History
from slabcell.service.ledger_view import LedgerView
from slabcell.service.links import Links
from slabcell.service.robot_watch import RobotWatch
from slabcell.service.simulated_board import BoardStand
from slabcell.service.studio import Studio
from slabcell_drivers.camera.protocol import CameraInfo

__all__ = ["ApiContext"]

LOOKING_WAITS_S = 0.5
"""So long at most does a client that only looks wait for a robot that is being served."""


@dataclass(slots=True)
class ApiContext:
    """One running cell, as the API sees it.  ``started_s`` is of the monotonic clock."""

    name: str
    started_s: float
    cell: Cell
    links: Links
    robot: RobotWatch
    history: History
    ledger: LedgerView
    ring: EventRing
    seats: StreamSeats
    frames: FrameStore
    bundles: BundleShelf
    studio: Studio
    tell_config: Callable[[dict[str, Any]], None] = lambda _: None
    recipes: RecipeShelf | None = None
    calibrations: CalibrationShelf | None = None
    camera: Callable[[], CameraInfo | None] = lambda: None
    """Who the camera is, once it was open."""
    metrics: Callable[[], bytes] | None = None
    config_path: Path | None = None
    """The configuration file, for who looks at it; None in a cell that has none."""
    board: BoardStand | None = None
    """The calibration board of a simulated cell."""
    doctor_turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    pending_reload: list[str] = field(default_factory=list[str])

    async def pause(self) -> None:
        """Return when no robot is being served, or after `LOOKING_WAITS_S`."""
        await self.cell.leisure.pause(LOOKING_WAITS_S)
