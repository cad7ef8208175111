"""How do tests reach a cell without a socket?  `LoopbackLink`: a robot link within one process."""

from slabcell_drivers.robot.protocol import Answer, Handler, LinkState, Request

__all__ = ["LoopbackLink"]


class LoopbackLink:
    """A `RobotLink` whose robot is whoever calls `ask`."""

    def __init__(self) -> None:
        self._handler: Handler | None = None
        self._connected = False

    @property
    def state(self) -> LinkState:
        """Where the link stands now."""
        if self._handler is None:
            return LinkState.CLOSED
        return LinkState.CONNECTED if self._connected else LinkState.LISTENING

    async def start(self, handler: Handler) -> None:
        """Begin to serve."""
        self._handler = handler

    async def stop(self) -> None:
        """Stop serving."""
        self._handler, self._connected = None, False

    async def ask(self, request: Request) -> Answer:
        """Return the cell's answer to one request.  Raises ConnectionError while the link is closed."""
        if self._handler is None:
            raise ConnectionError("the loopback link is closed")
        self._connected = True
        return await self._handler(request)

    def cut(self) -> None:
        """Lose the robot: the link listens again."""
        self._connected = False
