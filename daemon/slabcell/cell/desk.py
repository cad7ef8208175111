"""What does the cell know of the present job?  The job, its results in the ledger, and every change to them told on.

Each change is in the ledger when the call returns, and each costs one fsync.  Nobody else writes to the ledger of a
running cell, so what was read or written is known from then on; only a result that is unknown is looked up every time:
a person may have settled it by hand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from slabcell.catalogue import Fault
from slabcell.cell.events import Event, JobBegan, JobEnded, ResultMoved, Verified
from slabcell.cell.greeting import Settlement, settle
from slabcell.cell.ledger import Ledger, LedgerError, LedgerFile
from slabcell.cell.records import (
    HAND_STATES,
    TAKEN_STATES,
    Job,
    JobState,
    OfferRecord,
    OfferState,
    Pair,
    PlacementRecord,
)
from slabcell.recipe import Recipe
from slabcell_drivers.robot.protocol import Request

__all__ = ["JobDesk", "Slots"]

FEWEST_MEASURED = 3

_O = OfferState
_NOT_BEGUN = frozenset({_O.PLANNED, _O.OFFERED})
_OPEN_STATES = _NOT_BEGUN | HAND_STATES
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Slots:
    """What is known of the slots of a job.  A slot that is none of these waits for a person to say what is in it."""

    laid: tuple[int, ...]
    free: tuple[int, ...]
    given_up: tuple[int, ...]


class JobDesk:
    """The job and its ledger.  Every method may raise LedgerError."""

    def __init__(self, ledger: Ledger, recipe: Recipe, emit: Callable[[Event], None]) -> None:
        self.job: Job | None = None
        self.finished: Job | None = None
        self._forgive = False
        self.forgiven_up_to = 0
        self._known: dict[int, OfferRecord] | None = None
        self._ledger = ledger
        self._recipe = recipe
        self._emit = emit

    @property
    def slot_count(self) -> int:
        """How many slots a job has."""
        return len(self._recipe.template.slots)

    def change(self, recipe: Recipe) -> None:
        """Have the jobs to come be of another recipe; the finished one is of no concern any more."""
        self._recipe = recipe
        self.job = self.finished = self._known = None

    async def abandon(self, reason: str) -> Job | None:
        """Close the open job before it is complete; return it, or None if there is none."""
        job = self.job
        if job is None or job.state is not JobState.OPEN:
            return None
        await self._abandon(job, reason)
        return job

    async def take_up(self) -> str | None:
        """Take up the job that was open when the cell stopped.

        Returns what was abandoned, in words, if it belongs to another template.
        """
        job = await self._ledger.run(LedgerFile.last_job)
        if job is None or job.template_sha256 != self._recipe.template.sha256:
            if job is None or job.state is not JobState.OPEN:
                return None
            await self._abandon(job, "another recipe")
            return f"job {job.job_id} of recipe {job.recipe} was open; the recipe now is {self._recipe.name}"
        if job.state is JobState.OPEN:
            self.job = job
        elif job.state is JobState.COMPLETE:
            self.finished = job
        return None

    async def job_for(self, request: Request) -> Job | None:
        """Return the job that a trigger is for: the open one, or the one just finished; None if one has to begin."""
        job = self.job
        if job is not None and request.job_id not in {0, job.robot_job}:
            if job.state is JobState.OPEN:
                await self._abandon(job, f"the robot began job {request.job_id}")
            self.job = None
        return self.job

    async def draft(self, request: Request, *, correct_up_to_mm: float = 0.0) -> Job:
        """Return a job that is not begun yet: `write_cycle` begins it, with its first results.

        It is laid otherwise by what the last one of its template was off as a whole, up to a limit.  Fewer than three
        measured slabs say nothing about the whole.
        """
        recipe = self._recipe
        sha = recipe.template.sha256
        correction = (0.0, 0.0)
        if correct_up_to_mm > 0.0:
            number, dx_mm, dy_mm = await self._ledger.run(lambda book: book.systematic_error(sha))
            limit = correct_up_to_mm if number >= FEWEST_MEASURED else 0.0
            correction = max(-limit, min(limit, -dx_mm)), max(-limit, min(limit, -dy_mm))
        return Job(0, request.job_id, recipe.name, sha, self.slot_count, JobState.OPEN, correction)

    def still_lies(self) -> Job | None:
        """Take the finished job for the present one again: it lies there still.  Returns it, or None."""
        if self.finished is not None:
            self.job = self.finished
        return self.finished

    async def greet(self, request: Request) -> tuple[int, Settlement]:
        """Begin a session and settle what was under way; return its number and what came out."""
        job_id = self.job.job_id if self.job is not None else None

        def work(book: LedgerFile) -> tuple[int, Settlement, dict[int, OfferRecord] | None]:
            with book.step():
                session = book.new_session(f"HELLO {request.sequence}")
                outcome = settle(book, job_id, request, session)
            return session, outcome, None if job_id is None else _by_id(book.offers(job_id))

        session, outcome, self._known = await self._write(work)  # so that the trigger need not read them
        for offer in outcome.moved:
            self._emit(ResultMoved(offer))
        if self.job is not None and self.job.state is not JobState.OPEN:
            self.job = None  # a new run of the program fills a new template, once the finished one is taken out
        return session, outcome

    async def offers(self) -> list[OfferRecord]:
        """Return every result of the job."""
        if self.job is None:
            return []
        job_id = self.job.job_id
        known = self._known
        if known is None or any(offer.job_id != job_id or offer.state is _O.UNKNOWN for offer in known.values()):
            known = self._known = _by_id(await self._ledger.run(lambda book: book.offers(job_id)))
        return list(known.values())

    async def _write(self, work: Callable[[LedgerFile], _T]) -> _T:
        """Change the ledger; what it then holds has to be read again, unless the caller knows."""
        self._known = None
        return await self._ledger.run(work)

    async def open_offers(self) -> list[OfferRecord]:
        """Return the results that are still to be fetched or finished."""
        return [offer for offer in await self.offers() if offer.state in _OPEN_STATES]

    async def slots(self, attempts: int) -> Slots:
        """Return which slots of the job are laid, free, or given up after so many failed attempts."""
        offers = await self.offers()
        if self._forgive:
            self.forgiven_up_to, self._forgive = max((offer.result_id for offer in offers), default=0), False
        failed = (offer for offer in offers if offer.state is _O.FAILED and offer.result_id > self.forgiven_up_to)
        failures = Counter(offer.slot for offer in failed)
        taken = {offer.slot for offer in offers if offer.state in TAKEN_STATES}
        every = range(self.slot_count)
        return Slots(
            laid=tuple(sorted(offer.slot for offer in offers if offer.state is _O.PLACED)),
            free=tuple(slot for slot in every if slot not in taken and failures[slot] < attempts),
            given_up=tuple(slot for slot in every if slot not in taken and failures[slot] >= attempts),
        )

    async def unknown(self) -> list[OfferRecord]:
        """Return the results of the job of which a person has to say what became of them."""
        return [offer for offer in await self.offers() if offer.state is _O.UNKNOWN]

    async def resolve(self, result_id: int, *, placed: bool) -> OfferRecord:
        """Write what a person saw: the slab lies in its slot, or it does not.  Raises LedgerError if settled."""
        state = _O.PLACED if placed else _O.FAILED
        found = await self.find(result_id)
        if found is None or found.state is not _O.UNKNOWN:
            known = f"is {found.state}" if found else "is not of the present job"
            waiting = ", ".join(str(offer.result_id) for offer in await self.unknown()) or "none"
            msg = (
                f"result {result_id} {known}: only an unknown result of the present job can be resolved, now {waiting}"
            )
            raise LedgerError(msg)
        moved = await self._write(lambda book: book.move(result_id, state, reason="seen by a person"))
        self._emit(ResultMoved(moved))
        return moved

    def forgive(self) -> None:
        """Count the failures of each slot anew."""
        self._forgive = True

    async def find(self, result_id: int) -> OfferRecord | None:
        """Return a result of the job, or None."""
        return next((offer for offer in await self.offers() if offer.result_id == result_id), None)

    async def write_cycle(self, request: Request, job: Job, pairs: Callable[[], Sequence[Pair]]) -> list[OfferRecord]:
        """Write the results of a trigger, the first as offered: the robot asks for it next; begin a drafted job.

        All of it is one step of the ledger.  ``pairs`` is called in the ledger's thread.
        """
        drafted = job.job_id == 0
        known = self._known if self._known is not None else ({} if drafted else None)

        def work(book: LedgerFile) -> tuple[Job, list[OfferRecord]]:
            chosen = pairs()
            with book.step():
                begun = job
                if drafted:
                    about = (job.robot_job, job.recipe, job.template_sha256, job.slots, job.correction_mm)
                    begun = book.begin_job(*about)
                session, sequence = request.session, request.sequence
                return begun, book.record_cycle(begun.job_id, session, sequence, chosen, offer_first=True)

        begun, written = await self._write(work)
        if drafted:
            self.job, self.finished, known = begun, None, {}
            self._emit(JobBegan(begun))
        if known is not None:
            self._known = known | _by_id(written)
        if written:
            self._emit(ResultMoved(written[0]))
        return written

    async def record(self, placements: tuple[PlacementRecord, ...]) -> None:
        """Write what was measured of the job, which goes on."""
        if self.job is not None:
            job_id = self.job.job_id
            await self._ledger.run(lambda book: book.record_placements(job_id, placements))

    async def move(
        self,
        offer: OfferRecord,
        state: OfferState,
        request: Request,
        reason: str = "",
        fault: Fault | None = None,
        *,
        void_others: str = "",
    ) -> OfferRecord:
        """Write a result's new state; with ``void_others`` the reason why what is not begun with is taken back too."""
        known = self._known

        def work(book: LedgerFile) -> list[OfferRecord]:
            with book.step():
                by = {"session": request.session, "sequence": request.sequence}
                moved = book.move(offer.result_id, state, **by, reason=reason, fault=fault or 0)
                taken_back = book.void(offer.job_id, session=request.session, reason=void_others) if void_others else []
                return [moved, *(found for number in taken_back if (found := book.offer(number)) is not None)]

        moved = await self._write(work)
        if known is not None:
            self._known = known | _by_id(moved)
        for item in moved:
            self._emit(ResultMoved(item))
        return moved[0]

    async def void(self, reason: str, *, session: int = 0) -> None:
        """Take back what the robot has not begun with."""
        job = self.job
        if job is None or not any(offer.state in _NOT_BEGUN for offer in await self.offers()):
            return

        def work(book: LedgerFile) -> tuple[set[int], list[OfferRecord]]:
            return set(book.void(job.job_id, session=session, reason=reason)), book.offers(job.job_id)

        taken_back, offers = await self._write(work)
        self._known = _by_id(offers)
        for offer in offers:
            if offer.result_id in taken_back:
                self._emit(ResultMoved(offer))

    async def complete(self, placements: tuple[PlacementRecord, ...]) -> Job | None:
        """Close the job with what was measured of it."""
        job = self.job
        if job is None:
            return None

        def work(book: LedgerFile) -> None:
            with book.step():
                book.record_placements(job.job_id, placements)
                book.end_job(job.job_id, JobState.COMPLETE)
            book.tidy()

        await self._write(work)
        self.job = self.finished = replace(job, state=JobState.COMPLETE)
        self._emit(Verified(self.job, placements, final=True))
        self._emit(JobEnded(self.job))
        return self.job

    async def _abandon(self, job: Job, reason: str) -> None:
        def work(book: LedgerFile) -> None:
            with book.step():
                book.void(job.job_id, reason=reason)
                for offer in book.offers(job.job_id):
                    if offer.state in HAND_STATES:
                        book.move(offer.result_id, _O.UNKNOWN, reason=reason)
                book.end_job(job.job_id, JobState.ABANDONED)
            book.tidy()

        await self._write(work)
        self.job = None
        self._emit(JobEnded(replace(job, state=JobState.ABANDONED)))


def _by_id(offers: Iterable[OfferRecord]) -> dict[int, OfferRecord]:
    return {offer.result_id: offer for offer in offers}
