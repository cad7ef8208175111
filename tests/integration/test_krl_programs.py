"""The shipped programs on the software KRC, over TCP, against a scripted cell: the job is done, whatever is in its way."""

import asyncio
import contextlib
import math
from pathlib import Path

import pytest

from slabcell_drivers.krc.controller import SoftwareKrc, read_project
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
            if request.ack_state in {AckState.PLACED, AckState.UNREACHABLE}:
                del self.open[request.ack_result_id]
                self.queue.remove(request.ack_result_id)
            elif request.ack_state not in {AckState.ACCEPTED, AckState.GRASPED}:
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


def controller(table, address, **options):
    krc = SoftwareKrc(
        read_project(KRL),
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
