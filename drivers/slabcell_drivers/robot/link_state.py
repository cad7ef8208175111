"""Where does a link stand, and who is told?  What every `RobotLink` keeps of its state."""

import asyncio

import structlog

from slabcell_drivers.robot.link_events import StateHook
from slabcell_drivers.robot.protocol import LinkState

__all__ = ["LinkStates", "pause"]

_log = structlog.get_logger(__name__)


class LinkStates:
    """The state of one link: each change is logged, under the protocol's name, and told once."""

    def __init__(self, protocol: str, on_state: StateHook | None) -> None:
        self._event = f"{protocol}.state"
        self._on_state = on_state
        self._now = LinkState.CLOSED

    @property
    def now(self) -> LinkState:
        """Where the link stands."""
        return self._now

    def become(self, state: LinkState) -> None:
        """Take this state, and tell it if it is another one."""
        if state is self._now:
            return
        self._now = state
        _log.info(self._event, state=state.value)
        if self._on_state is not None:
            self._on_state(state)


async def pause(seconds: float, *, unless: asyncio.Event) -> None:
    """Wait so long, or until the event is set: the pause of a link between two attempts, which `stop` ends."""
    try:
        await asyncio.wait_for(unless.wait(), seconds)
    except TimeoutError:
        return
