"""The clock jumps, back to 1970 or years ahead, in the middle of jobs: does anything but the written time change?"""

import itertools
from datetime import UTC, datetime, timedelta

import pytest

from slabcell.cell.retention import Retention

pytestmark = pytest.mark.faults

JUMPS = [
    datetime(2026, 6, 1, tzinfo=UTC),
    datetime(1970, 1, 1, tzinfo=UTC),  # a PC without a battery
    datetime(2031, 1, 1, tzinfo=UTC),
    datetime(2026, 3, 29, 2, 59, 59, tzinfo=UTC),
]


async def test_jobs_results_and_bundles_keep_their_order_however_the_clock_jumps(make_bench):
    bench = make_bench()
    bench.bundles, bench.retention = True, Retention(max_age_s=30 * 86_400.0, min_free_bytes=0)
    ticks, jump = itertools.count(), [0]
    bench.utc_now = lambda: JUMPS[jump[0]] + timedelta(seconds=next(ticks))
    await bench.start()
    for number in range(1, 4):
        bench.robot.job_id = number
        bench.eyes.lying.clear()
        await bench.robot.hello()
        assert (await bench.robot.lay_all()).code == 1
        bench.eyes.lying.clear()
        jump[0] += 1
    await bench.restart()
    bench.robot.job_id = 4
    await bench.robot.hello()
    assert (await bench.robot.lay_all()).code == 1
    offers = await bench.ledger.run(lambda book: book.rows("offers"))
    assert [offer["result_id"] for offer in offers] == list(range(1, 13))
    assert [offer["job_id"] for offer in offers] == [1] * 3 + [2] * 3 + [3] * 3 + [4] * 3
    assert {offer["state"] for offer in offers} == {"placed"}
    times = [offer["changed_utc"] for offer in offers]
    assert times != sorted(times)  # the clock did jump
    await bench.stop()
    names = sorted(path.name for path in (bench.folder / "bundles").iterdir())
    jobs = [name.split("_job")[1][0] for name in names]
    assert jobs == sorted(jobs)
    assert set("34") <= set(jobs)  # five years ahead for the time of one job cost bundles, but never the newest


async def test_a_frame_is_judged_by_the_monotonic_clock_alone(make_bench):
    bench = make_bench()
    bench.utc_now = lambda: datetime(1970, 1, 1, tzinfo=UTC)
    await bench.start()
    await bench.robot.hello()
    assert (await bench.robot.trigger()).left == 3
    bench.camera.age_s = 1.0  # exposed before it was asked for
    assert (await bench.robot.trigger()).code == 1106
    await bench.stop()
