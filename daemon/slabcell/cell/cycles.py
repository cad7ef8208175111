"""Which cycle is on its way, and which were there?  Keeps the records, and has each bundled when it ends."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import asdict

from slabcell.cell.bundle import BundleContext
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.events import CycleEnded, CycleKept, CycleRecord, Event
from slabcell.cell.ledger import Ledger
from slabcell.errors import SlabcellError
from slabcell_drivers.robot.protocol import Answer, Request

__all__ = ["Cycles"]

KEPT_RECORDS = 200
KEPT_EXCHANGES = 2000
"""Of one cycle; a robot that asks NEXT for ever must not fill the memory."""


class Cycles:
    """The present cycle and the records of the last ones.

    ``failed`` is told why a bundle could not be kept, ``kept`` that one was.
    """

    def __init__(
        self,
        ledger: Ledger,
        context: BundleContext | None,
        bundles: BundleWriter | None,
        *,
        emit: Callable[[Event], None],
        failed: Callable[[str], None],
        kept: Callable[[], None],
    ) -> None:
        self.records: deque[CycleRecord] = deque(maxlen=KEPT_RECORDS)
        self.present: CycleRecord | None = None
        self._ledger = ledger
        self._context = context
        self._bundles = bundles
        self._emit = emit
        self._failed = failed
        self._ended: list[CycleRecord] = []
        self._keeping: set[asyncio.Task[None]] = set()
        if bundles is not None:
            bundles.failed = failed
            bundles.kept = self._was_kept
        self._kept = kept

    def _was_kept(self, cycle: CycleRecord, file: str) -> None:
        self._kept()
        self._emit(CycleKept(cycle, file))

    def change(self, context: BundleContext) -> None:
        """Keep the cycles to come with another recipe, calibration or settings."""
        if self._context is not None:
            self._context = context

    def begin(self, cycle: CycleRecord) -> None:
        """Make this the present cycle; one before it ends."""
        self.end()
        self.present = cycle
        self.records.append(cycle)

    def end(self) -> None:
        """End the present cycle; it is kept with the next `settle`."""
        if self.present is not None:
            self._ended.append(self.present)
            self.present = None

    def settle(
        self, request: Request | None = None, answer: Answer | None = None, *, before: CycleRecord | None = None
    ) -> None:
        """Add an exchange to the cycles that it touched, and have those that ended kept, without waiting for it."""
        if request is not None and answer is not None:
            touched = {id(item): item for item in (before, self.present, *self._ended) if item is not None}
            for cycle in touched.values():
                if len(cycle.transcript) < KEPT_EXCHANGES:
                    cycle.transcript.append({"request": asdict(request), "answer": asdict(answer)})
        for cycle in self._ended:
            self._emit(CycleEnded(cycle))
            if self._bundles is None or self._context is None:
                cycle.frame = None
            else:
                task = asyncio.create_task(self._keep(cycle, self._bundles, self._context), name="slabcell-keep")
                self._keeping.add(task)
                task.add_done_callback(self._keeping.discard)
        self._ended.clear()

    async def close(self) -> None:
        """Wait until what ended is kept."""
        await asyncio.gather(*self._keeping)
        if self._bundles is not None:
            await self._bundles.close()

    async def _keep(self, cycle: CycleRecord, bundles: BundleWriter, context: BundleContext) -> None:
        try:
            rows = await self._ledger.run(lambda book: book.excerpt(cycle.job_id))
        except SlabcellError as error:
            self._failed(str(error))
            return
        bundles.keep(cycle, context, rows)
        cycle.frame = None  # pictures are large: the record stays, the picture is in the bundle
