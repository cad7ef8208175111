"""Which cycle is on its way, and which were there?  Keeps the records, and has each bundled when it ends."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from slabcell.cell.bundle import BundleContext
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.events import CycleEnded, CycleKept, CycleRecord, Event
from slabcell.cell.ledger import Ledger
from slabcell.errors import SlabcellError
from slabcell_drivers.robot.protocol import Answer, Request

__all__ = ["Cycles"]

KEPT_RECORDS = 200
KEPT_TELEGRAMS = 4000
ANSWER_SENT_S = 0.5
"""An answer is on the wire within this time, or not at all."""
KEPT_EXCHANGES = 2000
"""Of one cycle; a robot that asks NEXT for ever must not fill the memory."""


class Cycles:
    """The present cycle and the records of the last ones.

    ``failed`` is told why a bundle could not be kept, ``kept`` that one was.  ``catch_up`` has the events told that are
    not told yet.
    """

    def __init__(
        self,
        ledger: Ledger,
        context: BundleContext | None,
        bundles: BundleWriter | None,
        *,
        emit: Callable[[Event], None],
        catch_up: Callable[[], None],
        failed: Callable[[str], None],
        kept: Callable[[], None],
    ) -> None:
        self.records: deque[CycleRecord] = deque(maxlen=KEPT_RECORDS)
        self.present: CycleRecord | None = None
        self._ledger = ledger
        self._context = context
        self._bundles = bundles
        self._emit = emit
        self._catch_up = catch_up
        self._failed = failed
        self._ended: list[CycleRecord] = []
        self._telegrams: deque[tuple[int, dict[str, object]]] = deque(maxlen=KEPT_TELEGRAMS)
        self._heard = 0
        self._sent = asyncio.Event()
        self._keeping: set[asyncio.Task[None]] = set()
        if bundles is not None:
            bundles.failed = failed
            bundles.kept = self._was_kept
        self._kept = kept

    def _was_kept(self, cycle: CycleRecord, file: str) -> None:
        self._kept()
        self._emit(CycleKept(cycle, file))

    def change(self, context: BundleContext | None) -> None:
        """Keep the cycles to come with another recipe, calibration or settings."""
        if self._bundles is not None:
            self._context = context

    def overhear(self, direction: str, telegram: bytes, at_s: float) -> None:
        """Take what went over the wire to or from the robot; it is kept with the cycles it belongs to.

        XML is kept as text, registers as words in hexadecimal.
        """
        self._heard += 1
        xml = telegram.lstrip().startswith(b"<")
        text = telegram.decode("utf-8", errors="backslashreplace") if xml else telegram.hex(" ", 2)
        self._telegrams.append((self._heard, {"at_s": round(at_s, 6), "direction": direction, "telegram": text}))
        if direction == "sent":
            self._sent.set()

    def begin(self, cycle: CycleRecord) -> None:
        """Make this the present cycle; one before it ends."""
        self.end()
        cycle.heard_from = self._heard  # its trigger was heard last
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
                    cycle.transcript.append((request, answer))
        if self._ended:
            self._sent.clear()
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
        await self._answered()
        self._catch_up()  # who keeps a history has given the cycle its number then
        telegrams = [entry for number, entry in self._telegrams if number >= cycle.heard_from]
        bundles.keep(replace(cycle, telegrams=telegrams), context, rows)  # the record itself stays small
        cycle.frame = None  # pictures are large: the record stays, the picture is in the bundle

    async def _answered(self) -> None:
        """Wait until the answer that ended a cycle is on the wire, if there is a wire that tells."""
        if not self._telegrams:
            return
        try:
            async with asyncio.timeout(ANSWER_SENT_S):
                await self._sent.wait()
        except TimeoutError:  # the connection broke first: there is nothing more to keep
            return
