"""How does the cell come from a trigger to what can be laid?  Takes the picture, asks the vision, plans; with times.

Everything that can go wrong on the way is a `LookError` with the number of the error catalogue.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable, Collection, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from slabcell.catalogue import Fault
from slabcell.cell.desk import Slots
from slabcell.cell.events import CycleRecord, Event, FrameTaken, PartsLocated, StageEnded
from slabcell.cell.executor import end_executor
from slabcell.cell.eyes import Eyes
from slabcell.cell.outfit import Outfit
from slabcell.cell.planning import Plan
from slabcell.cell.preparing import NO_CALIBRATION
from slabcell.cell.records import PlacementRecord
from slabcell.errors import CalibrationError, ImageError, SlabcellError
from slabcell.vision.result import LocateResult
from slabcell_drivers.camera.protocol import (
    Camera,
    CameraBusy,
    CameraConfigError,
    CameraError,
    CameraIncomplete,
    CameraLost,
    CameraTimeout,
    CameraUnlit,
    ImageFrame,
)

__all__ = ["CAMERA_FAULTS", "LookError", "Looking"]

_T = TypeVar("_T")

_CAMERA_FAULTS: tuple[tuple[type[CameraError], Fault], ...] = (
    (CameraLost, Fault.CAMERA_LOST),
    (CameraTimeout, Fault.CAMERA_TIMEOUT),
    (CameraIncomplete, Fault.CAMERA_INCOMPLETE),
    (CameraBusy, Fault.CAMERA_BUSY),
    (CameraConfigError, Fault.CAMERA_SETTING),
    (CameraUnlit, Fault.LIGHT_LOST),
    (CameraError, Fault.CAMERA_ERROR),
)
CAMERA_FAULTS = (*(fault for _, fault in _CAMERA_FAULTS), Fault.CAMERA_STALE)
"""The alarms that a good picture clears."""


class LookError(SlabcellError):
    """No result for this trigger; ``fault`` says why."""

    def __init__(self, fault: Fault, detail: str) -> None:
        super().__init__(detail, number=fault)
        self.fault = fault


class Looking:
    """The camera, the vision and the planning of one cell, with one worker thread for what computes."""

    def __init__(
        self,
        camera: Camera,
        outfit: Outfit,
        *,
        emit: Callable[[Event], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._camera = camera
        self._outfit = outfit
        self._emit = emit
        self._clock = clock
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="slabcell-vision")

    def change(self, outfit: Outfit) -> None:
        """Look otherwise from the next picture on."""
        self._outfit = outfit

    async def close(self) -> None:
        """End the worker thread; waits for what it computes.  May be called twice."""
        await end_executor(self._worker)

    async def acquire(self, cycle: CycleRecord) -> ImageFrame:
        """Return a complete picture that was exposed after this call began.  Raises `LookError`."""
        asked_s = self._clock()
        with self._stage(cycle, "acquire"):
            try:
                frame = await self._camera.snap(self._outfit.settings.camera_timeout_s)
            except CameraError as error:
                fault = next(fault for kind, fault in _CAMERA_FAULTS if isinstance(error, kind))
                raise LookError(fault, str(error)) from error
        if frame.triggered_s < asked_s:
            late_ms = (asked_s - frame.triggered_s) * 1000
            detail = f"frame {frame.frame_id} was triggered {late_ms:.1f} ms before it was asked for"
            raise LookError(Fault.CAMERA_STALE, detail)
        height, width = frame.pixels.shape[:2]
        try:
            if self._outfit.calibration is not None:
                self._outfit.calibration.require_size(width, height, f"frame {frame.frame_id}")
        except CalibrationError as error:
            raise LookError(Fault.CALIBRATION_MISMATCH, str(error)) from error
        cycle.frame, cycle.frame_id = frame, frame.frame_id
        self._emit(FrameTaken(frame))
        return frame

    def locate(self, frame: ImageFrame, slots: Slots, cycle: CycleRecord) -> Awaitable[Plan]:
        """Begin to look now, and return what has to be waited for: what can be laid into the free slots.

        The cycle then gets the vision's result.  Raises `LookError`, at the latest when it is waited for.
        """
        eyes, outfit = self._require_eyes(), self._outfit

        def work() -> tuple[LocateResult, Plan, float]:
            found = eyes.locate(frame.pixels, area_mm=outfit.settings.pick_area, free_slots=slots.free)
            began_s = self._clock()
            planned = outfit.planner.plan(found.parts, laid=slots.laid, correction_mm=cycle.correction_mm)
            return found, planned, (self._clock() - began_s) * 1000

        return self._located(self._compute(work), cycle)

    async def _located(self, found: Awaitable[tuple[LocateResult, Plan, float]], cycle: CycleRecord) -> Plan:
        result, plan, plan_ms = await found
        cycle.result = result
        for stage, duration_ms in [*result.timing_ms.items(), ("plan", plan_ms)]:
            if stage != "total":
                cycle.times_ms[stage] = duration_ms
                self._emit(StageEnded(stage, duration_ms))
        self._emit(PartsLocated(result))
        cycle.refused = plan.refused
        return plan

    async def measure(
        self, frame: ImageFrame, slots: Collection[int], cycle: CycleRecord
    ) -> tuple[PlacementRecord, ...]:
        """Return how the slabs lie in these slots.  Raises `LookError`."""
        eyes, assembly = self._require_eyes(), self._outfit.settings.assembly_in_table
        with self._stage(cycle, "measure"):
            cycle.placements = await self._compute(
                lambda: eyes.measure(frame.pixels, assembly_in_table=assembly, slots=slots)
            )
        return cycle.placements

    def _require_eyes(self) -> Eyes:
        if self._outfit.eyes is None:
            raise LookError(Fault.CALIBRATION_MISSING, NO_CALIBRATION)
        return self._outfit.eyes

    def _compute(self, work: Callable[[], _T]) -> Awaitable[_T]:
        """Begin now, in the worker thread.  A thread cannot be stopped: what comes after the deadline is dropped."""
        return self._computed(asyncio.get_running_loop().run_in_executor(self._worker, work))

    async def _computed(self, running: Awaitable[_T]) -> _T:
        timeout_s = self._outfit.settings.vision_timeout_s
        try:
            async with asyncio.timeout(timeout_s):
                return await running
        except TimeoutError as error:
            raise LookError(Fault.VISION_SLOW, f"not ready after {timeout_s} s") from error
        except ImageError as error:
            raise LookError(_fault_of(error, Fault.IMAGE_UNUSABLE), str(error)) from error
        except CalibrationError as error:
            raise LookError(Fault.CALIBRATION_MISSING, str(error)) from error
        except Exception as error:  # a picture that breaks the vision must not stop the cell; it has its own number
            fault = _fault_of(error, Fault.VISION_ERROR)
            raise LookError(fault, f"{type(error).__name__}: {error}") from error

    @contextmanager
    def _stage(self, cycle: CycleRecord, name: str) -> Generator[None]:
        began_s = self._clock()
        yield
        duration_ms = (self._clock() - began_s) * 1000
        cycle.times_ms[name] = duration_ms
        self._emit(StageEnded(name, duration_ms))


def _fault_of(error: Exception, otherwise: Fault) -> Fault:
    """Return the fault whose number an error of the house carries."""
    number = error.number if isinstance(error, SlabcellError) else 0
    return Fault(number) if number in {int(fault) for fault in Fault} else otherwise
