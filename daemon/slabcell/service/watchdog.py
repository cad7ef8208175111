"""Does the control loop get on?  Only then is systemd's watchdog fed.

A sign of life means: the event loop turned, the ledger's thread answered, and no request of the robot is served for
longer than all its deadlines together.  Without it systemd ends the process and starts it anew; the robot has to ask
again.
"""

import asyncio

import structlog

from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.service.notify import notify

__all__ = ["feed"]

ALIVE_TIMEOUT_S = 2.0
DEADLINES = 3.0
"""How often camera and vision may each come to their deadline within one request."""

_log = structlog.get_logger(__name__)


async def feed(cell: Cell, ledger: Ledger, interval_s: float, *, alive_timeout_s: float = ALIVE_TIMEOUT_S) -> None:
    """Give a sign of life every ``interval_s``, as long as there is reason to; runs until it is cancelled."""
    while True:
        problem = await _problem(cell, ledger, alive_timeout_s)
        if problem:
            _log.error("the watchdog is not fed", reason=problem)
        else:
            notify("WATCHDOG=1")
        await asyncio.sleep(interval_s)


async def _problem(cell: Cell, ledger: Ledger, alive_timeout_s: float) -> str:
    """Return why no sign of life may be given, or nothing."""
    settings = cell.settings
    longest_s = DEADLINES * (settings.camera_timeout_s + settings.vision_timeout_s) + settings.busy_timeout_s
    if cell.serving_for_s > longest_s:
        return f"a request has been served for {cell.serving_for_s:.0f} s; its deadlines end after {longest_s:.0f} s"
    try:
        async with asyncio.timeout(alive_timeout_s):
            await ledger.run(lambda _: None)
    except TimeoutError:
        return f"the ledger has not answered for {alive_timeout_s:g} s"
    return ""
