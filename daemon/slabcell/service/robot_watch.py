"""What is known of the robot?  Whether it is connected, and what it said of itself in its last request."""

from __future__ import annotations

import time
from collections.abc import Callable

from slabcell.cell.cell import Cell
from slabcell.service.links import LinkName, Links, LinkState
from slabcell_drivers.robot.eki.link import EkiServer
from slabcell_drivers.robot.link_events import Direction
from slabcell_drivers.robot.modbus import ModbusTcpServer
from slabcell_drivers.robot.protocol import Answer, Request, RobotLink
from slabcell_drivers.robot.protocol import LinkState as RobotLinkState

__all__ = ["RobotWatch"]

MODES = ("unknown", "T1", "T2", "AUT", "EXT")


class RobotWatch:
    """Stands between link and cell: hands every request on, and notes what passes."""

    def __init__(self, cell: Cell, links: Links, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.last: Request | None = None
        """The newest request."""
        self.last_s = 0.0
        self._cell = cell
        self._links = links
        self._clock = clock
        self._address = ""
        self._link: RobotLink | None = None

    async def handle(self, request: Request) -> Answer:
        """Answer a request: what a `RobotLink` needs."""
        self.last, self.last_s = request, self._clock()
        return await self._cell.handle(request)

    def telegram(self, direction: Direction, telegram: bytes, at_s: float) -> None:
        """Have a telegram kept with its cycle: the hook of a link."""
        self._cell.overhear(direction.value, telegram, at_s)

    def link_changed(self, state: RobotLinkState) -> None:
        """Note where the link stands, and tell the cell: the hook of a `RobotLink`."""
        if state is RobotLinkState.CONNECTED:
            said = f"the robot is connected at {self._address}" if self._address else "the robot is connected"
            self._links.set(LinkName.ROBOT, LinkState.UP, said)
            self._cell.robot_link(connected=True)
            return
        if state is RobotLinkState.LISTENING:
            said = f"waiting for the robot at {self._address}" if self._address else "waiting for the robot"
            self._links.set(LinkName.ROBOT, LinkState.CONNECTING, said)
            self._cell.robot_link(connected=False)
        else:  # what we do ourselves, in the end
            self._links.set(LinkName.ROBOT, LinkState.DOWN, "the link is closed")

    def unreachable(self, why: str) -> None:
        """Note that nobody listens for the robot, and why."""
        self._links.set(LinkName.ROBOT, LinkState.DOWN, why)

    def meets_at(self, host: str, port: int, link: RobotLink) -> None:
        """Note where both meet, once that is known."""
        self._address = f"{host}:{port}"
        self._link = link
        self.link_changed(link.state)

    @property
    def refused_peers(self) -> int:
        """How many connections were turned away, because they came from elsewhere or there were too many."""
        match self._link:
            case EkiServer():
                return self._link.refused
            case ModbusTcpServer():
                return self._link.counters.refused_peers + self._link.counters.refused_limit
            case _:
                return 0

    @property
    def connected(self) -> bool:
        """Whether a robot is connected."""
        return self._links[LinkName.ROBOT].state is LinkState.UP

    @property
    def mode(self) -> str:
        """The robot's mode of operation by its last word."""
        mode = self.last.status.mode if self.last else 0
        return MODES[mode] if 0 <= mode < len(MODES) else "unknown"

    @property
    def age_s(self) -> float:
        """How long ago it asked for something, in seconds."""
        return self._clock() - self.last_s
