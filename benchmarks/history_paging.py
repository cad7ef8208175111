"""Does a page of the history cost the same with 100 000 cycles as with ten?

    python benchmarks/history_paging.py [--cycles 100000]

Fills a history with cycles as the daemon writes them, then reads pages as the control API does: the newest, one from
the middle, the failed ones, those of one job, and a single cycle.
"""

import argparse
import asyncio
import tempfile
import time
from pathlib import Path

import numpy as np

from slabcell.service.history import History
from slabcell.service.history_file import CycleRow

REPEATS = 200
DOCUMENT = '{"filler": "' + "x" * 3000 + '"}'
FIRST = 1 << 60
BEGAN = "2026-01-01T00:00:00.000+00:00"


async def fill(history: History, cycles: int) -> None:
    """Write cycles, as fast as the history takes them."""
    for count in range(cycles):
        number = history.next_cycle()
        code = 1101 if count % 50 == 0 else 0
        history.add_cycle(
            CycleRow(number, 1 + count // 20, verification=False, code=code, began_utc=BEGAN, document=DOCUMENT)
        )
        if count % 200 == 199:
            await history.read(lambda file: file.cycle(1))  # so that no line is dropped


async def measure(folder: Path, cycles: int) -> dict[str, float]:
    """Return the median time of each kind of page in ms."""
    history = await History.open(folder / f"history-{cycles}.sqlite")
    await fill(history, cycles)
    assert history.lost == 0
    middle = cycles // 2 + 1
    pages = {
        "newest page": lambda file: file.cycles(before=FIRST, limit=51, job=None, code=None, failed=False),
        "middle page": lambda file: file.cycles(before=middle, limit=51, job=None, code=None, failed=False),
        "failed only": lambda file: file.cycles(before=FIRST, limit=51, job=None, code=None, failed=True),
        "of one job": lambda file: file.cycles(before=FIRST, limit=51, job=1, code=None, failed=False),
        "one cycle": lambda file: file.cycle(middle),
    }
    found: dict[str, float] = {}
    for name, page in pages.items():
        times = []
        for _ in range(REPEATS):
            began = time.perf_counter()
            await history.read(page)
            times.append((time.perf_counter() - began) * 1e3)
        found[name] = float(np.median(times))
    await history.close()
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=100_000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        few = asyncio.run(measure(Path(folder), 60))
        many = asyncio.run(measure(Path(folder), options.cycles))
    print(f"{'median ms':14} {'60 cycles':>10} {options.cycles:>10}")
    for name, value in few.items():
        print(f"{name:14} {value:10.2f} {many[name]:10.2f}")


if __name__ == "__main__":
    main()
