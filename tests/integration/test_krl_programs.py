"""The shipped programs on the software KRC, over TCP, against a scripted cell: the job gets done."""

import asyncio
import contextlib
import itertools
import math
import random
from pathlib import Path

import pytest

from slabcell_drivers.krc import SoftwareKrc, read_project
from slabcell_drivers.krc.eki_channel import Segmentation, WireOptions
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.eki import Direction, EkiClient, EkiServer
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import AckState, Answer, Offer, RequestType, ResultCode

pytestmark = pytest.mark.integration
KRL = Path(__file__).parents[2] / "krl"
TOOL = Frame(z_mm=260.0)
PICK_BASE = Frame(190, -290, 0, 1.5)
PLACE_BASE = Frame(200, 80, 0, -1)
THICKNESS_MM = 10.0
MAX_WALL_S = 60.0


def lying(x_mm, y_mm, a_deg):
    """A pose on the upper face of a slab, tool down."""
    return Frame(x_mm, y_mm, THICKNESS_MM, a_deg, 0.0, 180.0)


PAIRS = [
    (lying(40, 60, 10), lying(30, 20, 0)),
    (lying(120, 60, -75), lying(80, 20, 90)),
    (lying(60, 160, 170), lying(130, 25, 0)),
    (lying(150, 200, 33), lying(40, 60, -90)),
    (lying(80, 260, 90), lying(110, 65, 180)),
]


class Table:
    """Slabs, and a gripper that holds one of them at most."""

    def __init__(self, poses_in_root):
        self.slabs = list(poses_in_root)
        self.held = None
        self.picks = []
        self.leaks = 0
        self.krc = None

    def output_changed(self, index, value, tcp):
        if index != 1:
            return
        if value:
            near = [i for i, slab in enumerate(self.slabs) if _distance(slab, tcp) < 1.0]
            if near and self.leaks > 0:
                self.leaks -= 1
                return
            if near:
                self.held = near[0]
                self.picks.append(near[0])
        elif self.held is not None:
            self.slabs[self.held] = tcp
            self.held = None
        self.krc.set_input(1, self.held is not None)

    def moved(self, tcp):
        if self.held is not None:
            self.slabs[self.held] = tcp


class ScriptedCell:
    """A cell that offers given pairs, four results a picture at most, and keeps account."""

    def __init__(self, pairs, per_picture=3):
        self.open = dict(enumerate(pairs, 101))
        self.per_picture = per_picture
        self.session = 0
        self.answered = 0
        self.trigger = 0
        self.queue = []
        self.states = {}
        self.requests = []
        self.hook = None
        self._last = None

    async def __call__(self, request):
        self.requests.append(request)
        if self.hook is not None:
            answer = await self.hook(request)
            if answer is not None:
                return answer
        if self._last is not None and self._last[0] == request:
            return self._last[1]
        answer = self.answer(request)
        self._last = (request, answer)
        return answer

    def answer(self, request):
        self.answered += 1
        if request.type is RequestType.HELLO:
            self.session += 1
            self.queue = []
            return self.reply(request)
        if request.session != self.session:
            return self.reply(request, ResultCode.BAD_REQUEST, message="wrong session")
        if request.type is RequestType.TRIGGER:
            self.trigger = request.sequence
            self.queue = list(self.open)[: self.per_picture]
            return self.reply(request, ResultCode.OK if self.queue else ResultCode.JOB_COMPLETE)
        if request.type is RequestType.NEXT:
            result_id = self.queue[0]
            pick, place = self.open[result_id]
            return self.reply(request, offer=Offer(result_id, 0, 0, pick, place, 0.9))
        if request.type is RequestType.ACK:
            self.states.setdefault(request.ack_result_id, []).append(request.ack_state)
            if request.ack_state in {AckState.PLACED, AckState.UNREACHABLE, AckState.ABORTED}:
                del self.open[request.ack_result_id]
                self.queue.remove(request.ack_result_id)
            elif request.ack_state is AckState.PICK_FAILED:
                pick_and_place = self.open.pop(request.ack_result_id)
                self.open[max([request.ack_result_id, *self.open]) + 100] = pick_and_place
                self.queue = []
        return self.reply(request)

    def reply(self, request, code=ResultCode.OK, *, offer=None, message=""):
        return Answer(
            self.session,
            self.answered,
            request.sequence,
            code,
            left=len(self.queue),
            trigger_sequence=self.trigger,
            offer=offer,
            message=message,
        )


def _distance(one, other):
    return math.dist(one.as_tuple()[:3], other.as_tuple()[:3])


def on_table(pairs):
    return [PICK_BASE @ pick for pick, _ in pairs]


def controller(table, address, *, sources=None, **options):
    krc = SoftwareKrc(
        sources or read_project(KRL),
        robot=KR3_R540,
        eki_configs={path.stem: path.read_bytes() for path in KRL.glob("*.xml")},
        eki_addresses={"SlabCell": address, "SlabCellServer": address},
        io=table,
        **options,
    )
    table.krc = krc
    for name, frame in (("TOOL_DATA[1]", TOOL), ("BASE_DATA[1]", PICK_BASE), ("BASE_DATA[2]", PLACE_BASE)):
        krc.set_data("", name, frame)
    return krc


@contextlib.asynccontextmanager
async def serving(cell, **options):
    link = EkiServer("127.0.0.1", 0, **options)
    await link.start(cell)
    try:
        yield link
    finally:
        await link.stop()


async def run(krc, program="SlabCell"):
    return await asyncio.to_thread(krc.run, program, max_wall_s=MAX_WALL_S)


def assert_laid(table, pairs, states=None):
    for index, (_, place) in enumerate(pairs):
        assert _distance(table.slabs[index], PLACE_BASE @ place) < 0.01, f"slab {index}"
    assert table.held is None


def texts(krc):
    return [message.text for message in krc.messages]


async def test_the_shipped_programs_lay_every_slab_and_end():
    table, cell, transcript = Table(on_table(PAIRS)), ScriptedCell(PAIRS), []
    async with serving(cell, on_telegram=lambda way, raw, at_s: transcript.append((way, raw))) as link:
        with controller(table, link.address) as krc:
            result = await run(krc)
            assert (result.status, result.message) == ("done", "")
    assert_laid(table, PAIRS)
    assert sorted(table.picks) == list(range(len(PAIRS)))
    assert all(states == [AckState.ACCEPTED, AckState.GRASPED, AckState.PLACED] for states in cell.states.values())
    assert [r.type for r in cell.requests[:2]] == [RequestType.HELLO, RequestType.TRIGGER]
    assert cell.requests[-1].type is RequestType.BYE
    assert sum(way is Direction.RECEIVED for way, _ in transcript) == len(cell.requests)


async def test_a_picture_without_results_left_on_the_table_ends_the_job_in_words():
    table, cell = Table([]), ScriptedCell([])

    async def nothing(request):
        if request.type is RequestType.TRIGGER:
            return cell.reply(request, ResultCode.NOTHING_LEFT, message="1502 Nothing found on the table.")
        return None

    cell.hook = nothing
    async with serving(cell) as link:
        with controller(table, link.address) as krc:
            assert (await run(krc)).status == "done"
            assert texts(krc) == ["1502 Nothing found on the table."]
    assert cell.requests[-1].type is RequestType.BYE


async def test_an_error_of_the_cell_is_shown_and_stops_and_start_goes_on():
    table, cell, faults = Table(on_table(PAIRS)), ScriptedCell(PAIRS), [1101]

    async def camera_lost(request):
        if request.type is RequestType.TRIGGER and faults:
            return cell.reply(request, faults.pop(), message="1101 Camera does not answer. Check its cable and power.")
        return None

    cell.hook = camera_lost
    async with serving(cell) as link:
        with controller(table, link.address) as krc:
            assert (await run(krc)).status == "halted"
            message = krc.messages[-1]
            assert (message.kind, message.number) == ("QUIT", 1101)
            assert message.text == "1101 Camera does not answer. Check its cable and power."
            result = await asyncio.to_thread(krc.go_on, max_wall_s=MAX_WALL_S)
            assert result.status == "done"
    assert_laid(table, PAIRS)


async def test_a_slab_that_is_not_held_in_time_is_reported_and_tried_again():
    table, cell = Table(on_table(PAIRS)), ScriptedCell(PAIRS)
    table.leaks = 1
    async with serving(cell) as link:
        with controller(table, link.address) as krc:
            assert (await run(krc)).status == "done"
    assert_laid(table, PAIRS)
    assert cell.states[101] == [AckState.ACCEPTED, AckState.PICK_FAILED]


async def test_a_slab_lost_on_the_way_stops_the_arm_and_is_reported():
    table, cell = Table(on_table(PAIRS)), ScriptedCell(PAIRS)
    grasped_above = PICK_BASE @ PAIRS[0][0] @ Frame(z_mm=-80.0)

    def path(event):
        """Break the vacuum as soon as the arm is on its way from above the pick to above the slot."""
        carried = event.kind == "path" and table.held == 0 and cell.states[101][-1] is AckState.GRASPED
        if carried and _distance(table.krc.tcp, grasped_above) > 20.0:
            table.held = None
            table.krc.set_input(1, False)

    async with serving(cell) as link:
        with controller(table, link.address, trace=path, trace_kinds=frozenset({"path"})) as krc:
            assert (await run(krc)).status == "done"
            assert "1605 Slab lost after grasping. Find it, then acknowledge." in texts(krc)
    assert cell.states[101] == [AckState.ACCEPTED, AckState.GRASPED, AckState.ABORTED]
    aborted = next(request for request in cell.requests if request.ack_state is AckState.ABORTED)
    above_slot = PLACE_BASE @ PAIRS[0][1] @ Frame(z_mm=-80.0)
    assert _distance(aborted.tcp, above_slot) > 20.0, "the arm did not stop on its way"


async def test_what_is_out_of_reach_is_told_before_anything_moves():
    pairs = [(lying(400, 600, 0), PAIRS[0][1]), PAIRS[1]]
    table, cell = Table(on_table(pairs)), ScriptedCell(pairs)
    async with serving(cell) as link:
        with controller(table, link.address) as krc:
            assert (await run(krc)).status == "done"
            assert "1601 Slab or slot out of reach of the robot." in texts(krc)
    assert cell.states[101] == [AckState.UNREACHABLE]
    assert cell.states[102][-1] is AckState.PLACED
    assert table.picks == [1]


@pytest.mark.parametrize("type_", [RequestType.HELLO, RequestType.TRIGGER, RequestType.NEXT])
async def test_a_busy_cell_is_asked_again_with_a_new_number(type_):
    table, cell, busy = Table(on_table(PAIRS)), ScriptedCell(PAIRS), [1, 2]

    async def answer_busy(request):
        if request.type is type_ and busy:
            busy.pop()
            return cell.reply(request, ResultCode.BUSY)
        return None

    cell.hook = answer_busy
    async with serving(cell) as link:
        with controller(table, link.address) as krc:
            assert (await run(krc)).status == "done"
    assert_laid(table, PAIRS)
    assert len({request.sequence for request in cell.requests}) == len(cell.requests)


async def test_an_answer_that_does_not_come_is_asked_for_again_with_the_same_number():
    table, cell = Table(on_table(PAIRS)), ScriptedCell(PAIRS)
    late, asked = asyncio.Event(), []

    async def late_once(request):
        if request.type is RequestType.NEXT and len(asked) == 1:
            await late.wait()

    def watch(way, raw, _at_s):
        if way is Direction.RECEIVED and b'Type="3"' in raw:
            asked.append(raw)
            if len(asked) == 2:
                late.set()

    cell.hook = late_once
    async with serving(cell, on_telegram=watch) as link:
        with controller(table, link.address) as krc:
            krc.set_data("VT", "VT_TMOANSWER", 150)
            assert (await run(krc)).status == "done"
    assert asked[0] == asked[1]
    assert_laid(table, PAIRS)
    assert sorted(table.picks) == list(range(len(PAIRS)))


async def test_the_reverse_role_does_the_same_job():
    table, cell = Table(on_table(PAIRS)), ScriptedCell(PAIRS)
    port = await _free_port()
    link = EkiClient("127.0.0.1", port, retry_s=0.02)
    await link.start(cell)
    try:
        with controller(table, ("127.0.0.1", port)) as krc:
            krc.set_data("VT", "VT_CH[]", "SlabCellServer")
            assert (await run(krc)).status == "done"
    finally:
        await link.stop()
    assert_laid(table, PAIRS)


async def _free_port():
    server = await asyncio.start_server(lambda r, w: None, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    server.close()
    await server.wait_closed()
    return port


async def test_without_a_cell_the_program_says_so_and_stops():
    table = Table([])
    with controller(table, ("127.0.0.1", await _free_port())) as krc:
        krc.set_data("VT", "VT_OPENTRIES", 3)
        result = await run(krc)
        assert result.status == "halted"
        assert krc.messages[-1].text == "2001 Cell PC does not answer. Check cable, IP and service."


async def test_an_old_result_is_refused_by_the_robot_itself():
    table, cell = Table(on_table(PAIRS)), ScriptedCell(PAIRS)
    async with serving(cell) as link:
        with controller(table, link.address) as krc:
            krc.set_data("VT", "VT_LASTRES", 500)
            krc.set_data("VT", "VT_LASTSTATE", int(AckState.PLACED))
            result = await run(krc)
            assert result.status == "halted"
            assert krc.messages[-1].text == "2002 Result refused by the robot: it is an old one."
    assert table.picks == []


async def test_a_part_that_the_cell_does_not_know_is_taken_off_by_a_person():
    table, cell = Table(on_table(PAIRS)), ScriptedCell(PAIRS)
    table.slabs.append(Frame())
    table.held = len(PAIRS)
    async with serving(cell) as link:
        with controller(table, link.address) as krc:
            krc.set_input(1, True)
            result = await run(krc)
            assert result.status == "halted"
            assert krc.messages[-1].text == "2005 Hold the slab, press START, and take it away."
            assert cell.requests[-1].type is RequestType.HELLO
            krc.set_input(1, False)
            table.held = None
            result = await asyncio.to_thread(krc.go_on, max_wall_s=MAX_WALL_S)
            assert result.status == "done"
    assert_laid(table, PAIRS)


async def test_a_program_that_was_cancelled_deep_down_goes_up_before_it_goes_aside():
    table, cell, path, cancelled = Table(on_table(PAIRS)), ScriptedCell(PAIRS), [], []

    def event(event):
        if event.kind == "path":
            path.append(table.krc.tcp)
        elif len(table.picks) == 1 and not cancelled:
            cancelled.append(table.krc.tcp)
            table.krc.cancel()

    async with serving(cell) as link:
        kinds = frozenset({"statement", "path"})
        with controller(table, link.address, trace=event, trace_kinds=kinds) as krc:
            assert (await run(krc)).status == "cancelled"
            low = krc.tcp
            assert low.z_mm < THICKNESS_MM + 1.0
            path.clear()
            cell.hook = _hello_that_resumes(cell)
            assert (await run(krc)).status == "done"
    assert_laid(table, PAIRS)
    rising = list(itertools.takewhile(lambda tcp: tcp.z_mm < 70.0, path))
    assert len(rising) > 3
    assert max(math.hypot(tcp.x_mm - low.x_mm, tcp.y_mm - low.y_mm) for tcp in rising) < 15.0


def _hello_that_resumes(cell):
    async def resume(request):
        if request.type is RequestType.HELLO and request.status.gripper_holds_part:
            cell.session += 1
            cell.queue = [request.ack_result_id]
            pick, place = cell.open[request.ack_result_id]
            return cell.reply(request, offer=Offer(request.ack_result_id, 0, 0, pick, place, 0.9))
        return None

    return resume


async def test_the_link_test_moves_nothing_and_says_that_the_cell_answers():
    table, cell = Table([]), ScriptedCell([])
    async with serving(cell) as link:
        with controller(table, link.address) as krc:
            before = krc.axes_deg
            assert (await run(krc, "SC_Diag")).status == "done"
            assert krc.axes_deg == before
            assert texts(krc) == ["Link test: the cell answers"]
    assert [request.type for request in cell.requests] == [RequestType.HELLO, RequestType.BYE]


async def test_the_link_test_names_what_is_not_measured_and_why_the_cell_refuses():
    table, cell = Table([]), ScriptedCell([])

    async def not_ready(request):
        return cell.reply(request, 1802, message="1802 Cell is not ready. See the cell's page.")

    cell.hook = not_ready
    async with serving(cell) as link:
        with controller(table, link.address) as krc:
            krc.set_data("", "TOOL_DATA[1]", Frame())
            krc.set_data("", "BASE_DATA[2]", Frame())
            krc.set_input(1, True)
            assert (await run(krc, "SC_Diag")).status == "done"
            assert [text.split(":")[0] for text in texts(krc)] == [
                "Tool is not measured",
                "Base of the assembly is not measured",
                "Vacuum input is on",
                "Link test failed. The reason follows",
                "1802 Cell is not ready. See the cell's page.",
            ]


async def test_a_cell_of_another_version_is_named():
    table, cell = Table([]), ScriptedCell([])
    async with serving(cell) as link:
        sources = read_project(KRL)
        sources["VT.dat"] = sources["VT.dat"].replace(b"VT_VERSION=1", b"VT_VERSION=2")
        with controller(table, link.address, sources=sources) as krc:
            result = await run(krc)
            assert result.status == "halted"
            assert krc.messages[-1].text == "2003 Cell speaks another version. Install its programs."


@pytest.mark.parametrize("segmentation", list(Segmentation))
async def test_the_job_is_done_whatever_liberties_the_controller_takes_on_the_wire(segmentation):
    table, cell = Table(on_table(PAIRS)), ScriptedCell(PAIRS)
    wire = WireOptions(shuffle_attributes=True, segmentation=segmentation)
    async with serving(cell) as link:
        with controller(table, link.address, eki_wire=wire, seed=random.randrange(10**6)) as krc:
            assert (await run(krc)).status == "done"
    assert_laid(table, PAIRS)
    assert sorted(table.picks) == list(range(len(PAIRS)))
