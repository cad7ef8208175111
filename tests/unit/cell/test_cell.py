"""How does the cell answer the robot, request by request?"""

import asyncio
import sqlite3
import zipfile
from dataclasses import replace

import pytest
import structlog

from slabcell.catalogue import Fault
from slabcell.cell import events
from slabcell.cell.records import JobState
from slabcell.cell.states import CellState, HeldCause, SuspendedCause
from slabcell.errors import ImageError, SlabcellError
from slabcell_drivers.camera.protocol import CameraIncomplete, CameraLost, CameraTimeout
from slabcell_drivers.robot.protocol import AckState, RequestType, ResultCode

pytestmark = pytest.mark.unit


async def test_a_whole_job_is_laid_and_verified(bench):
    await bench.robot.hello()
    last = await bench.robot.lay_all()
    assert last.code == ResultCode.JOB_COMPLETE
    assert bench.cell.state is CellState.READY
    assert bench.cell.job.state is JobState.COMPLETE
    assert set((await bench.states()).values()) == {"placed"}
    final = [event for event in bench.events if isinstance(event, events.Verified) and event.final]
    assert [item.slot for item in final[0].placements] == [0, 1, 2]


async def test_poses_are_the_grasp_point_on_the_upper_face_with_the_tool_down(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    await bench.robot.lay((await bench.robot.next()).offer.result_id)
    offer = (await bench.robot.next()).offer
    assert offer.slot == 1
    assert offer.pick.as_tuple()[:3] == pytest.approx((50.0, 40.0, 10.0))
    assert offer.place.as_tuple()[:3] == pytest.approx((55.0, 15.0, 10.0))
    assert offer.pick.as_tuple()[4:] == offer.place.as_tuple()[4:] == (0.0, 180.0)
    turn = offer.place.a_deg - offer.pick.a_deg + 10.0
    assert turn % 90.0 == pytest.approx(0.0)  # the part lies at 10 degrees, and looks alike after a quarter turn


async def test_the_same_offer_is_told_until_it_is_accepted(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    first, again = await bench.robot.next(), await bench.robot.next()
    assert first.offer == again.offer
    assert first.left == again.left == 3


async def test_an_offer_is_in_the_ledger_before_the_robot_hears_of_it(bench):
    await bench.robot.hello()
    seen = []

    def look(event):
        if isinstance(event, events.Offered):
            book = sqlite3.connect(bench.folder / "ledger.sqlite")
            seen.extend(book.execute("SELECT state FROM offers WHERE result_id = ?", (event.offer.result_id,)))
            book.close()

    bench.cell.subscribe(look)
    await bench.robot.trigger()
    assert sorted((await bench.states()).values()) == ["offered", "planned", "planned"]
    for _ in range(3):
        await bench.robot.lay((await bench.robot.next()).offer.result_id)
    assert seen == [("offered",)] * 3


async def test_a_line_of_the_log_names_the_job_the_cycle_and_the_result_that_it_is_about(bench):
    with structlog.testing.capture_logs(processors=[structlog.contextvars.merge_contextvars]) as lines:
        await bench.robot.hello()
        await bench.robot.trigger()
        result_id = (await bench.robot.next()).offer.result_id
        await bench.robot.say(AckState.ACCEPTED, result_id)
        await bench.robot.say(AckState.ABORTED)
        await bench.robot.trigger()
    offering = next(line for line in lines if line.get("after") == "single_execution.offering")
    assert (offering["job"], offering["cycle"]) == (1, 1)
    ready = next(line for line in lines if line.get("cause") == "every result is settled")
    assert (ready["job"], ready["cycle"], ready["result"]) == (1, 1, result_id)
    assert all("result" not in line for line in lines[lines.index(ready) + 1 :])  # the next picture is of no result


async def test_every_request_is_one_step_of_the_ledger_at_most(bench):
    commits = []
    await bench.ledger.run(
        lambda book: book._db.set_trace_callback(lambda text: commits.append(text) if text == "COMMIT" else None)
    )

    async def cost(asking):
        before = len(commits)
        answer = await asking
        return len(commits) - before, answer

    robot = bench.robot
    assert (await cost(robot.hello()))[0] == 1
    assert (await cost(robot.trigger()))[0] == 1  # job, cycle, results, and the first offer
    steps, answer = await cost(robot.next())
    assert steps == 0
    assert (await cost(robot.say(AckState.ACCEPTED, answer.offer.result_id)))[0] == 1
    assert (await cost(robot.say(AckState.GRASPED)))[0] == 1
    assert (await cost(robot.say(AckState.PLACED)))[0] == 1
    steps, answer = await cost(robot.next())
    assert steps == 1
    await robot.say(AckState.ACCEPTED, answer.offer.result_id)
    assert (await cost(robot.say(AckState.PICK_FAILED)))[0] == 1  # the result, and the others taken back
    assert sorted((await bench.states()).values()) == ["failed", "placed", "void"]


async def test_the_same_trigger_again_gets_the_same_answer_and_no_second_picture(bench):
    await bench.robot.hello()
    request = bench.robot.request(RequestType.TRIGGER)
    first = await bench.cell.handle(request)
    again = await bench.cell.handle(request)
    assert again == first
    assert bench.camera.snaps == 1
    assert len(await bench.states()) == 3


async def test_two_identical_triggers_at_the_same_time_give_one_set_of_results(bench):
    await bench.robot.hello()
    request = bench.robot.request(RequestType.TRIGGER)
    first, second = await asyncio.gather(bench.cell.handle(request), bench.cell.handle(request))
    assert first == second
    assert bench.camera.snaps == 1


async def test_a_cancelled_caller_does_not_undo_the_request(bench):
    await bench.robot.hello()
    request = bench.robot.request(RequestType.TRIGGER)
    caller = asyncio.create_task(bench.cell.handle(request))
    await asyncio.sleep(0)
    caller.cancel()
    with pytest.raises(asyncio.CancelledError):
        await caller
    assert (await bench.cell.handle(request)).left == 3
    assert bench.camera.snaps == 1


async def test_the_same_number_with_other_content_is_refused(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    bench.robot.sequence -= 1
    answer = await bench.robot.next()
    assert (answer.code, answer.offer) == (ResultCode.BAD_REQUEST, None)


async def test_a_request_of_an_old_session_is_refused(bench):
    await bench.robot.hello()
    await bench.robot.hello()
    bench.robot.session -= 1
    assert (await bench.robot.trigger()).code == ResultCode.BAD_REQUEST
    assert bench.camera.snaps == 0


async def test_a_request_before_any_greeting_is_refused(bench):
    assert (await bench.robot.trigger()).code == ResultCode.BAD_REQUEST


async def test_a_late_duplicate_neither_acts_nor_spoils_the_sequence(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    offered = await bench.robot.next()
    await bench.robot.say(AckState.ACCEPTED, offered.offer.result_id)
    late = bench.robot.request(RequestType.NEXT, sequence=0)
    assert (await bench.cell.handle(late)).code == ResultCode.BAD_REQUEST
    assert (await bench.robot.say(AckState.GRASPED)).code == 0


@pytest.mark.parametrize(
    ("error", "fault"),
    [
        (CameraLost("gone"), Fault.CAMERA_LOST),
        (CameraTimeout("late"), Fault.CAMERA_TIMEOUT),
        (CameraIncomplete("torn"), Fault.CAMERA_INCOMPLETE),
    ],
)
async def test_a_camera_fault_is_a_named_alarm_that_goes_with_the_next_picture(bench, error, fault):
    await bench.robot.hello()
    bench.camera.script.append(error)
    answer = await bench.robot.trigger()
    assert answer.code == fault
    assert answer.message.startswith(str(int(fault)))
    assert bench.cell.state is CellState.READY
    assert bench.cell.held is HeldCause.CAMERA
    assert (await bench.robot.trigger()).left == 3
    assert bench.cell.held is None
    assert bench.cell.alarms.standing == ()


async def test_a_picture_older_than_its_trigger_gives_no_pose(bench):
    await bench.robot.hello()
    bench.camera.age_s = 0.5
    answer = await bench.robot.trigger()
    assert (answer.code, answer.left) == (Fault.CAMERA_STALE, 0)
    assert await bench.states() == {}


async def test_a_picture_of_another_size_than_the_calibration_gives_no_pose(bench):
    await bench.robot.hello()
    bench.camera.shape = (50, 64)
    assert (await bench.robot.trigger()).code == Fault.CALIBRATION_MISMATCH


async def test_an_unusable_picture_is_named_and_the_cell_goes_on(bench):
    await bench.robot.hello()
    bench.eyes.problem = ImageError("all black")
    assert (await bench.robot.trigger()).code == Fault.IMAGE_UNUSABLE
    bench.eyes.problem = None
    assert (await bench.robot.trigger()).left == 3


async def test_a_vision_that_breaks_has_its_own_number_and_does_not_stop_the_cell(bench):
    await bench.robot.hello()
    bench.eyes.problem = ZeroDivisionError("oops")
    assert (await bench.robot.trigger()).code == Fault.VISION_ERROR
    assert bench.cell.state is CellState.READY


async def test_an_empty_table_suspends(bench):
    await bench.robot.hello()
    bench.eyes.on_table.clear()
    answer = await bench.robot.trigger()
    assert answer.code == ResultCode.NOTHING_LEFT
    assert answer.message.startswith("1502")
    assert bench.cell.suspended is SuspendedCause.NOTHING_ON_TABLE


async def test_slabs_that_fit_nothing_hold_the_cell(bench):
    await bench.robot.hello()
    bench.eyes.on_table.clear()
    bench.eyes.rejected = 2
    answer = await bench.robot.trigger()
    assert answer.message.startswith("1503")
    assert bench.cell.held is HeldCause.NO_MATCH


async def test_a_slab_out_of_reach_is_left_out_with_the_reason(bench):
    await bench.robot.hello()
    bench.eyes.far_away = {1}
    assert (await bench.robot.trigger()).left == 2
    (refused,) = bench.cell.cycles[-1].refused
    assert (refused.slot, refused.fault) == (1, Fault.UNREACHABLE)
    assert "out of reach" in refused.detail


async def test_only_free_slots_are_matched_and_laid_ones_are_measured(bench):
    await bench.robot.hello()
    bench.eyes.on_table = {0}
    await bench.robot.trigger()
    await bench.robot.lay((await bench.robot.next()).offer.result_id)
    bench.eyes.on_table = {0, 1, 2}
    await bench.robot.trigger()
    assert bench.eyes.asked[-1] == (1, 2)
    assert bench.eyes.measured == [(0, 1, 2), (0,)]


async def test_after_a_failed_pick_the_rest_of_the_picture_is_void(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    offered = await bench.robot.next()
    await bench.robot.say(AckState.ACCEPTED, offered.offer.result_id)
    assert (await bench.robot.say(AckState.PICK_FAILED)).left == 0
    assert bench.cell.state is CellState.READY
    assert sorted((await bench.states()).values()) == ["failed", "void", "void"]


async def test_a_pose_that_the_robot_cannot_reach_leaves_the_others_valid(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    offered = await bench.robot.next()
    assert (await bench.robot.say(AckState.UNREACHABLE, offered.offer.result_id)).left == 2
    assert (await bench.robot.next()).offer.slot == 1


async def test_a_slot_that_fails_too_often_is_left_out(bench):
    await bench.robot.hello()
    bench.eyes.on_table = {0}
    for _ in range(bench.settings.attempts_per_slot):
        await bench.robot.trigger()
        await bench.robot.say(AckState.UNREACHABLE, (await bench.robot.next()).offer.result_id)
    await bench.robot.trigger()
    assert bench.eyes.asked[-1] == (1, 2)


async def test_a_slab_lost_after_grasping_stops_picking_until_a_person_acknowledges(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    await bench.robot.say(AckState.ACCEPTED, (await bench.robot.next()).offer.result_id)
    await bench.robot.say(AckState.GRASPED)
    bench.robot.holds = False
    await bench.robot.say(AckState.ABORTED)
    assert (await bench.robot.trigger()).code == Fault.PART_LOST
    assert bench.camera.snaps == 1
    await bench.cell.acknowledge(Fault.PART_LOST)
    assert (await bench.robot.trigger()).left == 3


async def test_nothing_is_looked_for_with_a_part_in_the_gripper(bench):
    await bench.robot.hello()
    bench.robot.holds = True
    assert (await bench.robot.trigger()).code == Fault.GRIPPER_NOT_EMPTY
    bench.robot.holds = False
    assert (await bench.robot.trigger()).left == 3


async def test_acknowledging_a_result_that_was_not_offered_is_refused(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    offered = (await bench.robot.next()).offer.result_id
    for wrong in (offered + 1, offered + 100, 0):
        assert (await bench.robot.say(AckState.ACCEPTED, wrong)).code == ResultCode.BAD_REQUEST
    assert (await bench.states())[offered] == "offered"


async def test_the_same_acknowledgement_again_is_taken_and_changes_nothing(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    result_id = (await bench.robot.next()).offer.result_id
    await bench.robot.lay(result_id)
    before = await bench.ledger.run(lambda book: book.rows("acknowledgements"))
    assert (await bench.robot.say(AckState.PLACED, result_id)).code == 0
    assert await bench.ledger.run(lambda book: book.rows("acknowledgements")) == before


async def test_a_slab_out_of_tolerance_raises_the_alarm_but_the_job_ends(bench):
    bench.eyes.offset_mm = 0.9
    await bench.robot.hello()
    assert (await bench.robot.lay_all()).code == ResultCode.JOB_COMPLETE
    (alarm,) = bench.cell.alarms.standing
    assert alarm.fault is Fault.PLACEMENT_OUT_OF_TOLERANCE
    assert "slot 0: dx +0.90 mm" in alarm.detail
    assert alarm.detail.endswith("out of tolerance too: slot 1, 2")


async def test_a_slab_of_which_the_picture_does_not_tell_how_it_lies_is_an_alarm_at_the_end_of_the_job(bench):
    bench.eyes.unmeasured = {1}
    await bench.robot.hello()
    await bench.robot.trigger()
    for _ in range(2):
        await bench.robot.lay((await bench.robot.next()).offer.result_id)
    await bench.robot.hello()
    await bench.robot.trigger()  # the slab of slot 1 lies, and its neighbours are still to come
    assert not bench.cell.alarms.standing
    assert (await bench.robot.lay_all()).code == ResultCode.JOB_COMPLETE
    (alarm,) = bench.cell.alarms.standing
    assert alarm.fault is Fault.VERIFICATION_IMPOSSIBLE
    assert alarm.detail.startswith("slot 1: edges and joints")


async def test_after_the_job_a_trigger_answers_complete_until_the_program_greets_anew(bench):
    await bench.robot.hello()
    await bench.robot.lay_all()
    snaps = bench.camera.snaps
    assert (await bench.robot.trigger()).code == ResultCode.JOB_COMPLETE
    assert bench.camera.snaps == snaps
    bench.eyes.lying.clear()
    await bench.robot.hello()
    assert (await bench.robot.trigger()).left == 3
    assert bench.cell.job.job_id == 2


async def test_a_finished_job_that_lies_there_still_is_not_laid_again_on_top_of_itself(bench):
    await bench.robot.hello()
    await bench.robot.lay_all()
    await bench.restart()
    await bench.robot.hello()
    assert (await bench.robot.trigger()).code == ResultCode.JOB_COMPLETE
    assert len(await bench.ledger.run(lambda book: book.rows("jobs"))) == 1


async def test_a_finished_job_that_is_found_again_still_knows_its_slabs(bench):
    await bench.robot.hello()
    await bench.robot.lay_all()
    await bench.restart()
    await bench.robot.hello()
    assert (await bench.robot.trigger()).code == ResultCode.JOB_COMPLETE
    assert [item.slot for item in await bench.cell.verify()] == [0, 1, 2]


async def test_no_job_begins_where_something_lies(bench):
    await bench.robot.hello()
    bench.eyes.lying = {1}
    assert (await bench.robot.trigger()).code == Fault.ASSEMBLY_NOT_EMPTY
    assert bench.cell.held is HeldCause.OPERATOR
    assert await bench.states() == {}
    bench.eyes.lying.clear()
    assert (await bench.robot.trigger()).left == 3
    assert bench.cell.alarms.standing == ()


async def test_another_job_number_begins_another_job(bench):
    bench.robot.job_id = 7
    await bench.robot.hello()
    await bench.robot.lay_all()
    bench.robot.job_id = 8
    bench.eyes.lying.clear()
    assert (await bench.robot.trigger()).left == 3
    assert (bench.cell.job.job_id, bench.cell.job.robot_job) == (2, 8)


async def test_a_job_goes_on_after_a_restart(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    await bench.robot.lay((await bench.robot.next()).offer.result_id)
    old_session = bench.robot.session
    await bench.restart()
    assert bench.cell.state is CellState.READY
    await bench.robot.hello()
    assert bench.robot.session > old_session
    assert (await bench.robot.lay_all()).code == ResultCode.JOB_COMPLETE
    assert bench.cell.job.job_id == 1
    states = await bench.states()
    assert sorted(states) == list(range(1, len(states) + 1))
    assert list(states.values()).count("placed") == 3


async def test_a_restart_with_another_template_abandons_the_open_job_by_number(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    bench.recipe = replace(bench.recipe, template=replace(bench.recipe.template, sha256="b" * 64))
    await bench.restart()
    assert [alarm.fault for alarm in bench.cell.alarms.standing] == [Fault.RECIPE_CHANGED]
    assert set((await bench.states()).values()) == {"void"}


async def test_a_ledger_that_cannot_be_written_stops_the_cell_by_number(bench):
    await bench.robot.hello()
    await bench.ledger.close()
    await bench.robot.trigger()  # says how many there would be: they are written while the robot hears of it
    assert bench.cell.state is CellState.ERROR
    assert bench.cell.alarms.has(Fault.LEDGER_UNWRITABLE)
    answer = await bench.robot.next()
    assert (answer.code, answer.offer) == (Fault.LEDGER_UNWRITABLE, None)
    assert (await bench.robot.trigger()).code == Fault.LEDGER_UNWRITABLE


async def test_a_watcher_that_raises_does_not_disturb_a_cycle(bench):
    def broken(event):
        raise RuntimeError(event)

    bench.cell.subscribe(broken)
    await bench.robot.hello()
    assert (await bench.robot.lay_all()).code == ResultCode.JOB_COMPLETE


async def test_each_cycle_is_kept_as_a_bundle(bench):
    await bench.stop()
    bench.bundles = True
    await bench.start()
    await bench.robot.hello()
    await bench.robot.lay_all()
    await bench.cell.stop()
    paths = sorted((bench.folder / "bundles").iterdir())
    assert [path.name.rpartition("_")[2] for path in paths] == ["cycle.zip", "verification.zip"]
    with zipfile.ZipFile(paths[0]) as archive:
        assert archive.testzip() is None
        assert set(archive.namelist()) == {
            *("manifest.json", "frame.png", "recipe.json", "calibration.json", "result.json", "ledger.json"),
            *("transcript.json", "cell.json", "telegrams.json", "overlay.json"),
        }
    with zipfile.ZipFile(paths[1]) as archive:
        assert {"as-built.json", "as-built.csv", "as-built.svg"} <= set(archive.namelist())
    assert all(cycle.frame is None for cycle in bench.cell.cycles)


async def test_stopping_takes_back_what_the_robot_has_not_begun_with(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    await bench.robot.say(AckState.ACCEPTED, (await bench.robot.next()).offer.result_id)
    await bench.cell.stop()
    assert sorted((await bench.states()).values()) == ["accepted", "void", "void"]
    assert (await bench.robot.hello()).code == Fault.NOT_READY


async def test_a_person_may_have_laid_slabs_measured_at_any_time(bench):
    with pytest.raises(SlabcellError, match="has no job"):
        await bench.cell.verify()
    await bench.robot.hello()
    bench.eyes.on_table = {0, 2}
    await bench.robot.lay_all()
    assert [item.slot for item in await bench.cell.verify()] == [0, 2]
    assert bench.cell.state is CellState.READY
    assert len(await bench.ledger.run(lambda book: book.rows("placements"))) == 2
    bench.camera.script.append(CameraLost("gone"))
    with pytest.raises(SlabcellError, match="gone"):
        await bench.cell.verify()
    assert bench.cell.state is CellState.READY


async def test_a_halted_cell_takes_no_trigger_but_hears_what_became_of_the_slab_in_hand(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    await bench.robot.say(AckState.ACCEPTED, (await bench.robot.next()).offer.result_id)
    await bench.robot.say(AckState.GRASPED)
    await bench.cell.halt("a person looks")
    assert bench.cell.state is CellState.HALTED
    assert (await bench.robot.say(AckState.PLACED)).code == 0
    assert sorted((await bench.states()).values()) == ["placed", "void", "void"]
    assert (await bench.robot.trigger()).code == Fault.NOT_READY
    await bench.cell.resume()
    assert (await bench.robot.lay_all()).code == ResultCode.JOB_COMPLETE


@pytest.mark.parametrize(("offset_mm", "corrected_mm"), [(0.2, -0.2), (-0.3, 0.3), (0.9, -0.5)])
async def test_the_next_job_is_laid_otherwise_by_what_the_last_was_off_if_that_is_wanted(
    bench, offset_mm, corrected_mm
):
    await bench.stop()
    bench.settings = replace(bench.settings, correct_systematic=True)
    await bench.start()
    bench.eyes.offset_mm = offset_mm
    await bench.robot.hello()
    await bench.robot.lay_all()
    first = {offer.slot: offer.place for offer in bench.cell.cycles[0].offers}
    bench.eyes.lying.clear()
    await bench.robot.hello()
    await bench.robot.trigger()
    second = {offer.slot: offer.place for offer in bench.cell.cycles[-1].offers}
    for slot, place in second.items():
        assert place.x_mm - first[slot].x_mm == pytest.approx(corrected_mm)
        assert place.y_mm - first[slot].y_mm == pytest.approx(0.0)
    # The correction helps, and therefore stays: it is not taken back because nothing is off any more.
    bench.eyes.offset_mm = offset_mm + corrected_mm
    await bench.robot.hello()
    await bench.robot.lay_all()
    bench.eyes.lying.clear()
    await bench.robot.hello()
    await bench.robot.trigger()
    assert bench.cell.cycles[-1].correction_mm == pytest.approx((corrected_mm, 0.0))


async def test_without_being_wanted_nothing_is_corrected(bench):
    bench.eyes.offset_mm = 0.3
    await bench.robot.hello()
    await bench.robot.lay_all()
    bench.eyes.lying.clear()
    await bench.robot.hello()
    await bench.robot.trigger()
    assert bench.cell.cycles[-1].correction_mm == (0.0, 0.0)
