"""How does a thread end without the event loop standing still?"""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

__all__ = ["end_executor"]


async def end_executor(executor: ThreadPoolExecutor) -> None:
    """Let an executor of one thread finish what it was given, and end it.  May be called twice."""
    with suppress(RuntimeError):  # it has been shut down already
        await asyncio.get_running_loop().run_in_executor(executor, lambda: None)
    executor.shutdown(wait=True)
