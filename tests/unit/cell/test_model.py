"""Whatever happens in whatever order: is every slab laid once, or recorded?

A model of the world holds the truth: which slab lies where, and what the gripper holds.  A robot that keeps to its
rules (it acts only on an answer, and writes its memory before it acts) meets lost telegrams, duplicates, failing picks,
dropped slabs, a camera that fails and a cell that is killed, in any order that Hypothesis thinks of.
"""

import asyncio

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test

from slabcell.catalogue import Fault
from slabcell.cell.states import CellState
from slabcell_drivers.camera.protocol import CameraTimeout
from slabcell_drivers.robot.protocol import AckState, RequestType, ResultCode

pytestmark = pytest.mark.unit

SLABS = 3


class CellUnderFaults(RuleBasedStateMachine):
    """Drives one cell; the robot's rules are in the preconditions."""

    def __init__(self, make_bench):
        super().__init__()
        self.runner = asyncio.Runner()
        self.bench = make_bench()
        self.bench.settings = self.bench.settings.__class__(
            *(self.bench.settings.pick_base, self.bench.settings.place_base),
            *(self.bench.settings.tool, self.bench.settings.pick_area),
            attempts_per_slot=1000,
        )
        self.run(self.bench.start())
        self.where = dict.fromkeys(range(SLABS), "table")
        self.slot_of = {}  # slab -> slot that it was laid into
        self.offer = None  # what the robot is about to act on
        self.pending = None  # the request that waits for an answer
        self.connected = False
        self.picks = {}  # result id -> how often a slab was lifted for it
        self.offered = []
        self.past = []
        self.left = 0
        self.completed = 0
        self.look()

    def run(self, work):
        return self.runner.run(work)

    def look(self):
        self.bench.eyes.lying = set(self.slot_of.values())
        self.bench.eyes.on_table = {slab for slab, place in self.where.items() if place == "table"}

    @property
    def robot(self):
        return self.bench.robot

    def ask(self, kind, fate):
        """Send a request, which may meet a fate; return the answer or None."""
        request = self.pending if self.pending is not None else self.robot.request(kind)
        self.pending = request
        if fate == "request lost":
            return None
        answer = self.run(self.bench.cell.handle(request))
        if fate == "twice":
            again = self.run(self.bench.cell.handle(request))
            assert again == answer
        self.past.append(request)
        if fate == "answer lost":
            return None
        self.pending = None
        return answer

    def gripped(self):
        return next((slab for slab, place in self.where.items() if place == "hand"), None)

    # The robot's program, one telegram with its act at a time

    @rule(steps=st.integers(1, 15))
    def program_runs_on(self, steps):
        for _ in range(steps):
            self.step("arrives", picks=True)

    @rule(fate=st.sampled_from(["request lost", "answer lost", "twice"]), picks=st.booleans())
    def program_meets_a_fault(self, fate, picks):
        self.step(fate, picks=picks)

    @rule()
    def pick_fails(self):
        self.step("arrives", picks=False)

    def step(self, fate, *, picks):
        if not self.connected:
            self.greet(fate)
        elif self.pending is not None:
            self.repeat(fate, picks=picks)
        elif self.offer is None:
            self.fetch_or_trigger(fate)
        else:
            self.go_on(fate, picks=picks)

    def repeat(self, fate, *, picks):
        """Send the last request again: it was not answered."""
        kind, state = self.pending.type, self.pending.ack_state
        answer = self.ask(kind, fate)
        if answer is None:
            return
        if kind is RequestType.TRIGGER:
            self.triggered(answer)
        elif kind is RequestType.NEXT:
            self.fetched(answer)
        else:
            self.acknowledged(answer, state, picks=picks)

    def greet(self, fate):
        self.pending = self.offer = None
        answer = self.ask(RequestType.HELLO, fate)
        self.pending = None  # the next greeting has a number of its own
        if answer is None or answer.code != 0:
            return
        self.robot.session, self.connected, self.left = answer.session, True, 0
        if answer.offer is not None:
            assert self.robot.holds
            assert answer.offer.result_id == self.robot.result_id
            self.offer, self.robot.ack = answer.offer, AckState.GRASPED

    def fetch_or_trigger(self, fate):
        if self.left:
            answer = self.ask(RequestType.NEXT, fate)
            if answer is not None:
                self.fetched(answer)
        else:
            self.look()
            answer = self.ask(RequestType.TRIGGER, fate)
            if answer is not None:
                self.triggered(answer)

    def triggered(self, answer):
        self.left = answer.left
        if answer.code == ResultCode.JOB_COMPLETE:
            assert set(self.where.values()) == {"slot"}
            assert sorted(self.slot_of.values()) == list(range(SLABS))
            self.completed += 1
            # A person carries the assembly away and puts the slabs back; the program starts again.
            self.where = dict.fromkeys(range(SLABS), "table")
            self.slot_of.clear()
            self.connected = False

    def fetched(self, answer):
        self.left = answer.left
        if answer.offer is None:
            return
        assert answer.offer.result_id not in self.offered
        self.offered.append(answer.offer.result_id)
        self.offer = answer.offer
        self.robot.result_id, self.robot.ack = answer.offer.result_id, AckState.NONE

    def go_on(self, fate, *, picks):
        """Write the memory, act, tell: in this order."""
        if self.robot.ack is AckState.NONE:
            self.robot.ack = AckState.ACCEPTED
        elif self.robot.ack is AckState.ACCEPTED:
            self.robot.ack = AckState.GRASPED if self.robot.holds else AckState.PICK_FAILED
        elif self.robot.ack is AckState.GRASPED and self.robot.holds:
            self.robot.ack = AckState.PLACED
            self.lay_down()
        else:
            self.robot.ack = AckState.ABORTED  # the part fell
        state = self.robot.ack
        answer = self.ask(RequestType.ACK, fate)
        if answer is not None:
            self.acknowledged(answer, state, picks=picks)

    def lay_down(self):
        slab, slot = self.gripped(), self.offer.slot
        assert slot not in self.slot_of.values(), "two slabs in one slot"
        self.where[slab], self.slot_of[slab] = "slot", slot
        self.robot.holds = False

    def acknowledged(self, answer, state, *, picks):
        if answer.code != 0:
            self.connected = False  # the program stops on a refusal, and begins anew
            return
        self.left = answer.left
        if state is AckState.ACCEPTED and picks:
            slab = self.offer.slot  # the scripted eyes give slab n to slot n
            assert self.where[slab] == "table", "picked where nothing lies"
            assert self.gripped() is None, "picked with a full gripper"
            self.where[slab] = "hand"
            self.picks[self.offer.result_id] = self.picks.get(self.offer.result_id, 0) + 1
            self.robot.holds = True
        elif state in {AckState.PLACED, AckState.PICK_FAILED, AckState.ABORTED}:
            self.offer = None

    # Mishaps

    @precondition(lambda self: self.robot.holds)
    @rule()
    def slab_falls_back_onto_the_table(self):
        self.where[self.gripped()] = "table"
        self.robot.holds = False

    @rule()
    def program_is_cancelled_or_the_link_breaks(self):
        self.connected = False
        self.pending = self.offer = None

    @rule()
    def cell_is_killed_and_starts_again(self):
        self.run(self.bench.restart())

    @rule()
    def camera_fails_once(self):
        self.bench.camera.script.append(CameraTimeout("late"))

    @precondition(lambda self: bool(self.past))
    @rule(data=st.data())
    def an_old_telegram_comes_once_more(self, data):
        old = data.draw(st.sampled_from(self.past))
        if self.pending is not None and old == self.pending:
            return
        if old.type is RequestType.HELLO:
            return  # a greeting begins a session: the link never repeats one by itself
        self.run(self.bench.cell.settled())
        before = self.run(self.bench.states())
        self.run(self.bench.cell.handle(old))
        assert self.run(self.bench.states()) == before

    # A person

    @rule()
    def operator_takes_the_slab_out_of_the_gripper_and_clears_what_stands(self):
        if self.robot.holds and not self.connected:  # nobody reaches into a running cell
            self.where[self.gripped()] = "table"
            self.robot.holds = False
        states = self.run(self.bench.states())
        rows = self.run(self.bench.ledger.run(lambda book: book.rows("offers")))
        for row in rows:
            if row["state"] == "unknown":
                lies = row["slot"] in self.slot_of.values()
                self.run(self.bench.cell.resolve(row["result_id"], placed=lies))
        assert len(states) == len(rows)
        if self.bench.cell.alarms.has(Fault.PART_LOST):
            self.run(self.bench.cell.acknowledge(Fault.PART_LOST))

    # What must hold at any time

    @invariant()
    def no_slab_is_lifted_twice_for_one_result(self):
        assert all(times <= 1 for times in self.picks.values())

    @invariant()
    def result_ids_rise(self):
        assert self.offered == sorted(set(self.offered))

    @invariant()
    def no_slot_holds_two_slabs(self):
        assert len(set(self.slot_of.values())) == len(self.slot_of)

    @invariant()
    def the_ledger_knows_of_every_laid_slab(self):
        """Every laid slab has a result that is placed, or still under way until the robot's next word."""
        rows = self.run(self.bench.ledger.run(lambda book: book.rows("offers")))
        known = {row["slot"] for row in rows if row["state"] in {"placed", "grasped", "unknown"}}
        assert set(self.slot_of.values()) <= known

    @invariant()
    def the_cell_is_alive(self):
        """It stands ready, or with a cycle: the results of a trigger may still be on their way into the ledger."""
        assert self.bench.cell.state is CellState.READY or self.bench.cell.state.is_executing
        assert self.bench.cell.alarms.has(Fault.INTERNAL, Fault.LEDGER_ERROR) is None

    def teardown(self):
        self.finishes_when_nothing_more_happens()
        self.run(self.bench.stop())
        self.runner.close()

    def finishes_when_nothing_more_happens(self):
        """Whatever has happened: left alone, and with a person who helps, the program finishes the job."""
        self.bench.camera.script.clear()
        done = self.completed
        self.program_is_cancelled_or_the_link_breaks()
        for _ in range(2):
            self.step("arrives", picks=True)  # the greeting settles what was under way
            if not self.robot.holds or self.offer is not None:
                break
            self.connected = False
            self.operator_takes_the_slab_out_of_the_gripper_and_clears_what_stands()
        self.operator_takes_the_slab_out_of_the_gripper_and_clears_what_stands()
        for _ in range(8 * SLABS):
            if self.completed > done:
                return
            self.step("arrives", picks=True)
        standing = [(alarm.fault.name, alarm.detail) for alarm in self.bench.cell.alarms.standing]
        raise AssertionError(f"the job does not end: {self.bench.cell.state}, {standing}, {self.where}")


def test_no_order_of_mishaps_lays_a_slab_twice_or_loses_one(make_bench):
    run_state_machine_as_test(
        lambda: CellUnderFaults(make_bench),
        settings=settings(
            max_examples=8,
            stateful_step_count=25,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            print_blob=True,
        ),
    )


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_no_order_of_mishaps_lays_a_slab_twice_or_loses_one_at_length(make_bench):
    run_state_machine_as_test(
        lambda: CellUnderFaults(make_bench),
        settings=settings(
            max_examples=2000,
            stateful_step_count=80,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            print_blob=True,
        ),
    )
