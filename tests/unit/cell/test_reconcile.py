"""After a lost link: is every slab laid once, or recorded?"""

import itertools

import pytest

from slabcell.catalogue import Fault
from slabcell.cell.reconcile import reconcile
from slabcell.cell.records import STEPS, OfferState
from slabcell_drivers.robot.protocol import AckState, RequestType, ResultCode

pytestmark = pytest.mark.unit

S, A = OfferState, AckState
UNDER_WAY = (S.OFFERED, S.ACCEPTED, S.GRASPED)


@pytest.mark.parametrize(
    ("ledger", "robot", "holds", "becomes", "resume", "fault"),
    [
        (S.OFFERED, A.NONE, False, S.VOID, False, None),
        (S.OFFERED, A.ACCEPTED, False, S.VOID, False, None),
        (S.ACCEPTED, A.ACCEPTED, False, S.VOID, False, None),
        (S.ACCEPTED, A.ACCEPTED, True, S.GRASPED, True, None),
        (S.ACCEPTED, A.GRASPED, True, S.GRASPED, True, None),
        (S.GRASPED, A.GRASPED, True, S.GRASPED, True, None),
        (S.GRASPED, A.GRASPED, False, S.UNKNOWN, False, Fault.PART_LOST),
        (S.GRASPED, A.PLACED, False, S.PLACED, False, None),
        (S.ACCEPTED, A.PLACED, False, S.PLACED, False, None),
        (S.GRASPED, A.PLACED, True, S.UNKNOWN, False, Fault.PLACEMENT_UNKNOWN),
        (S.GRASPED, A.NONE, False, S.UNKNOWN, False, Fault.PLACEMENT_UNKNOWN),
        (S.GRASPED, A.NONE, True, S.FAILED, False, Fault.GRIPPER_NOT_EMPTY),
        (S.GRASPED, A.ACCEPTED, False, S.UNKNOWN, False, Fault.PLACEMENT_UNKNOWN),
        (S.ACCEPTED, A.PICK_FAILED, False, S.FAILED, False, None),
        (S.GRASPED, A.ABORTED, False, S.UNKNOWN, False, Fault.PART_LOST),
        (S.ACCEPTED, A.ABORTED, False, S.VOID, False, None),
        (S.ACCEPTED, A.ABORTED, True, S.FAILED, False, Fault.GRIPPER_NOT_EMPTY),
    ],
)
def test_a_result_under_way_is_settled_by_what_the_robot_says_and_feels(ledger, robot, holds, becomes, resume, fault):
    decision = reconcile(ledger, robot, holds_part=holds)
    assert (decision.state, decision.resume, decision.fault) == (becomes, resume, fault)


EVERY = list(itertools.product(UNDER_WAY, AckState, (False, True)))


@pytest.mark.parametrize(("ledger", "robot", "holds"), EVERY)
def test_no_decision_is_against_the_ledger_or_without_a_reason(ledger, robot, holds):
    decision = reconcile(ledger, robot, holds_part=holds)
    assert decision.state is ledger or decision.state in STEPS[ledger]
    assert decision.reason


@pytest.mark.parametrize(("ledger", "robot", "holds"), EVERY)
def test_the_robot_goes_on_only_with_a_part_that_it_feels_and_knows(ledger, robot, holds):
    if reconcile(ledger, robot, holds_part=holds).resume:
        assert holds
        assert robot in {A.ACCEPTED, A.GRASPED}


@pytest.mark.parametrize(("robot", "holds"), [(r, h) for r in AckState for h in (False, True)])
def test_a_slab_that_was_grasped_is_never_forgotten_silently(robot, holds):
    decision = reconcile(S.GRASPED, robot, holds_part=holds)
    assert decision.state is not S.VOID
    if decision.state in {S.FAILED, S.UNKNOWN}:
        assert decision.fault is not None


async def test_a_part_still_in_the_gripper_is_placed_without_a_new_pick(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    offered = (await bench.robot.next()).offer
    await bench.robot.say(A.ACCEPTED, offered.result_id)
    await bench.robot.say(A.GRASPED)
    answer = await bench.robot.hello()
    assert (answer.offer, answer.left, answer.code) == (offered, 1, 0)
    assert (await bench.robot.say(A.PLACED)).left == 0
    assert (await bench.states())[offered.result_id] == "placed"


async def test_a_part_still_in_the_gripper_is_placed_after_a_restart_of_the_cell(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    offered = (await bench.robot.next()).offer
    await bench.robot.say(A.ACCEPTED, offered.result_id)
    bench.robot.holds, bench.robot.ack = True, A.GRASPED  # its acknowledgement never arrived
    await bench.restart()
    answer = await bench.robot.hello()
    assert answer.offer == offered
    assert (await bench.robot.next()).offer == offered
    await bench.robot.say(A.PLACED)
    assert (await bench.robot.lay_all()).code == ResultCode.JOB_COMPLETE


async def test_a_slab_placed_while_the_link_was_lost_is_not_laid_again(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    offered = (await bench.robot.next()).offer
    await bench.robot.say(A.ACCEPTED, offered.result_id)
    await bench.robot.say(A.GRASPED)
    bench.robot.ack, bench.robot.holds = A.PLACED, False
    await bench.restart()
    assert (await bench.robot.hello()).offer is None
    await bench.robot.trigger()
    assert bench.eyes.asked[-1] == (1, 2)


async def test_an_accepted_result_is_not_offered_again_as_it_was(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    offered = (await bench.robot.next()).offer
    await bench.robot.say(A.ACCEPTED, offered.result_id)
    assert (await bench.robot.hello()).offer is None
    assert (await bench.robot.next()).offer is None
    assert (await bench.robot.trigger()).left == 3
    assert (await bench.robot.next()).offer.result_id > offered.result_id


async def test_a_robot_that_lost_its_memory_stops_the_picking_until_a_person_looks(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    await bench.robot.say(A.ACCEPTED, (await bench.robot.next()).offer.result_id)
    await bench.robot.say(A.GRASPED)
    bench.robot.result_id, bench.robot.ack, bench.robot.holds = 0, A.NONE, False
    await bench.robot.hello()
    assert (await bench.robot.trigger()).code == Fault.PLACEMENT_UNKNOWN
    await bench.restart()
    await bench.robot.hello()
    assert (await bench.robot.trigger()).code == Fault.PLACEMENT_UNKNOWN


async def test_new_results_are_above_what_the_robot_remembers(bench):
    bench.robot.result_id, bench.robot.ack = 900, A.PLACED
    await bench.robot.hello()
    await bench.robot.trigger()
    assert (await bench.robot.next()).offer.result_id == 901


async def test_the_same_greeting_again_gets_the_same_session(bench):
    request = bench.robot.request(RequestType.HELLO)
    assert await bench.cell.handle(request) == await bench.cell.handle(request)


async def test_leaving_takes_back_what_was_offered(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    await bench.robot.next()
    assert (await bench.robot.ask(RequestType.BYE)).code == 0
    assert set((await bench.states()).values()) == {"void"}
