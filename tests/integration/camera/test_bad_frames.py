"""Is a bad, late or foreign frame never delivered, whichever driver takes it, and is it taken again once?"""

import asyncio

import pytest

from slabcell_drivers.camera import CameraIncomplete, CameraTimeout
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.camera.supervision import SupervisedCamera
from slabcell_drivers.simulation.gige import CheckedPattern, GigeCamera

from .conftest import PLAIN, MakeCamera, opened, serial_of

pytestmark = pytest.mark.integration


async def whole_number(camera: SupervisedCamera, pattern: CheckedPattern, timeout_s: float = 5.0) -> int:
    """Take a frame, and return the number that its pixels tell."""
    number = pattern.number_of((await camera.snap(timeout_s)).pixels)
    assert number is not None
    return number


async def until_sent(gige: GigeCamera) -> None:
    """Wait until the camera has sent a frame for every trigger."""
    async with asyncio.timeout(30.0):
        while gige.counts.frames < gige.counts.triggers:  # noqa: ASYNC110 - its threads know no asyncio
            await asyncio.sleep(0.01)


async def test_one_bad_frame_is_taken_again_within_the_deadline(
    gige: GigeCamera, pattern: CheckedPattern, make: MakeCamera
) -> None:
    async with opened(make(gige.address, PLAIN)) as camera:
        await camera.snap(5.0)
        for tried, fault in enumerate(("drop 1", "truncate 1", "size 1", "reset-ids 500"), start=1):
            before = camera.statistics.incomplete + camera.statistics.timeouts
            gige.faults.apply(fault)
            assert await whole_number(camera, pattern, 3.0) == gige.counts.triggers
            assert camera.statistics.retries == tried, fault
            assert camera.statistics.restarts == tried, fault
            assert camera.statistics.incomplete + camera.statistics.timeouts > before, fault
            assert await whole_number(camera, pattern) == gige.counts.triggers
            assert camera.statistics.retries == tried, fault
        assert camera.statistics.gaps > 0  # the ids that jumped


async def test_frames_that_stay_bad_are_named_and_never_delivered(gige: GigeCamera, make: MakeCamera) -> None:
    async with opened(make(gige.address, PLAIN)) as camera:
        for k in range(1, 40):
            gige.faults.apply(f"truncate {k}")
        with pytest.raises(CameraIncomplete, match="stream-test"):
            await camera.snap(5.0)
        gige.faults.apply("mend")
        await camera.snap(5.0)


async def test_frames_that_nobody_waits_for_are_given_back_before_each_trigger(
    gige: GigeCamera, pattern: CheckedPattern, make: MakeCamera
) -> None:
    async with opened(make(gige.address, CameraSettings(packet_size=8000, buffers=3))) as camera:
        for pulses in range(1, 7):  # more in all than there are buffers
            gige.pulse()  # a frame that nobody asked for
            await until_sent(gige)
            assert await whole_number(camera, pattern) == gige.counts.triggers
            assert camera.statistics.stale == pulses
        assert (camera.statistics.retries, camera.statistics.underruns) == (0, 0)


async def test_a_frame_that_found_no_buffer_is_counted(
    gige: GigeCamera, pattern: CheckedPattern, make: MakeCamera
) -> None:
    async with opened(make(gige.address, CameraSettings(packet_size=8000, buffers=5))) as camera:
        for _ in range(8):  # more than there are buffers
            gige.pulse()
            await until_sent(gige)
        assert await whole_number(camera, pattern, 8.0) == gige.counts.triggers
        assert camera.statistics.underruns > 0


async def test_a_frame_that_comes_too_late_is_never_taken_for_the_next_one(
    gige: GigeCamera, pattern: CheckedPattern, make: MakeCamera
) -> None:
    async with opened(make(gige.address, PLAIN)) as camera:
        for _ in range(2):
            gige.faults.apply("late 1.2")
            with pytest.raises((CameraTimeout, CameraIncomplete)):
                await camera.snap(1.0)
            gige.faults.apply("late 0")
            before = gige.counts.triggers
            assert await whole_number(camera, pattern) > before


async def test_a_camera_that_sends_nothing_is_a_timeout_before_the_deadline_while_the_loop_turns(
    gige: GigeCamera, pattern: CheckedPattern, make: MakeCamera
) -> None:
    turns = 0

    async def turn() -> None:
        nonlocal turns
        while True:
            await asyncio.sleep(0.01)
            turns += 1

    async with opened(make(gige.address, PLAIN)) as camera:
        gige.faults.apply("hang on")
        turning = asyncio.create_task(turn())
        async with asyncio.timeout(10.0):
            with pytest.raises(CameraTimeout):
                await camera.snap(1.5)
        turning.cancel()
        assert turns > 10  # of 150: a library that held the interpreter would leave none
        gige.faults.apply("hang off")
        assert await whole_number(camera, pattern) == gige.counts.triggers
        assert camera.statistics.timeouts > 0


async def test_block_ids_may_wrap_from_65535_to_1(gige: GigeCamera, make: MakeCamera) -> None:
    gige.faults.apply("reset-ids 65530")
    async with opened(make(gige.address, PLAIN)) as camera:
        ids = [(await camera.snap(5.0)).frame_id for _ in range(8)]
        first = ids[0]
        assert first > 65_530
        assert ids == [(first - 1 + step) % 65_535 + 1 for step in range(8)]
        assert 0 not in ids
        assert camera.statistics.retries == 0


async def test_at_one_percent_of_loss_lost_packets_are_sent_again(address: str, make: MakeCamera) -> None:
    pattern = CheckedPattern()
    with GigeCamera(pattern, address, serial=serial_of(address)) as gige:
        async with opened(make(address, CameraSettings(packet_size=8000))) as camera:
            gige.faults.apply("loss 0.01")
            for _ in range(8):
                assert await whole_number(camera, pattern) == gige.counts.triggers
            assert gige.counts.packets_resent > 0


async def test_at_one_percent_of_loss_without_resends_no_bad_frame_is_delivered(
    gige: GigeCamera, pattern: CheckedPattern, make: MakeCamera
) -> None:
    # 39 packets a frame: two frames in three are lost.
    async with opened(make(gige.address, CameraSettings(packet_size=8000, frame_retention_us=30_000))) as camera:
        gige.faults.apply("noresend on")
        before = gige.counts.packets_resent  # on a busy machine some are, while the camera is opened
        gige.faults.apply("loss 0.01")
        whole = 0
        while not whole or not camera.statistics.incomplete:
            try:
                number = await whole_number(camera, pattern)
            except (CameraIncomplete, CameraTimeout):
                continue
            assert number == gige.counts.triggers
            whole += 1
        assert gige.counts.packets_resent == before
