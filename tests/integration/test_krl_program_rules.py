"""What the shipped programs do by themselves, where the cell would cover for them: seen from a peer that knows nothing.

The peer answers raw telegrams, right or wrong, and notes what the robot had written to VT.dat, where its arm stood and
what its gripper did when each request arrived.
"""

import math
import socket
import threading
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from slabcell_drivers.krc import SoftwareKrc, read_project
from slabcell_drivers.krc.kernel import STATEMENT_S
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.eki.codec import decode_request, encode_answer
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import AckState, Answer, Offer, Request, RequestType, ResultCode

pytestmark = pytest.mark.integration
KRL = Path(__file__).parents[2] / "krl"
TOOL = Frame(z_mm=260.0)
PICK_BASE = Frame(190, -290, 0, 1.5)
PLACE_BASE = Frame(200, 80, 0, -1)
PICK = Frame(60, 120, 10, 20, 0, 180)
PLACE = Frame(40, 30, 10, 0, 0, 180)
PHOTO = (120.0, -90.0, 90.0, 0.0, 90.0, 0.0)
ACCEPTED, GRASPED, PLACED = int(AckState.ACCEPTED), int(AckState.GRASPED), int(AckState.PLACED)


@dataclass(frozen=True)
class Seen:
    """One request, and the robot at the moment it arrived."""

    request: Request
    memory: tuple[int, int]  # VT_LASTRES, VT_LASTSTATE
    axes: tuple[float, ...]
    tcp: Frame


class Peer:
    """The other end of the channel: one connection after the other, one answer to each request.

    ``answers`` may hold what to say instead of the usual, by the name of a request or acknowledged state: a function of
    the request and the usual answer that returns telegrams, or None to close the connection.  It is used once.
    """

    def __init__(self, results=1):
        self.offers = [Offer(101 + i, i, i, PICK, PLACE, 0.9) for i in range(results)]
        self.seen = []
        self.answers = {}
        self.krc = None
        self.trigger = 0
        self.sessions = 0
        self.queue = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = self._listener.getsockname()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def close(self):
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(30)
        assert not self._thread.is_alive()

    def _serve(self):
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection:
                self._talk(connection)

    def _talk(self, connection):
        pending = b""
        while True:
            while b"</Robot>" not in pending:
                try:
                    data = connection.recv(65536)
                except OSError:
                    return
                if not data:
                    return
                pending += data
            raw, _, pending = pending.partition(b"</Robot>")
            request = decode_request(raw + b"</Robot>")
            krc = self.krc
            memory = (krc.data("VT", "VT_LASTRES"), krc.data("VT", "VT_LASTSTATE"))
            self.seen.append(Seen(request, memory, krc.axes_deg, krc.tcp))
            usual = self.usual(request)
            kind = request.ack_state if request.type is RequestType.ACK else request.type
            special = self.answers.pop(kind.name, None)
            telegrams = [encode_answer(usual)] if special is None else special(request, usual)
            if telegrams is None:
                return
            for telegram in telegrams:
                connection.sendall(telegram)

    def usual(self, request):
        offer = None
        if request.type is RequestType.HELLO:
            self.sessions += 1
            self.queue = []
        elif request.type is RequestType.TRIGGER:
            self.trigger = request.sequence
            self.queue = list(self.offers)
        elif request.type is RequestType.NEXT and self.queue:
            offer = self.queue[0]
        elif request.type is RequestType.ACK and request.ack_state not in {AckState.ACCEPTED, AckState.GRASPED}:
            self.queue, self.offers = self.queue[1:], self.offers[1:]
        done = request.type is RequestType.TRIGGER and not self.queue
        code = ResultCode.JOB_COMPLETE if done else ResultCode.OK
        return Answer(
            self.sessions, len(self.seen), request.sequence, code, len(self.queue), self.trigger, offer, message="-"
        )

    def requests(self, type_=None):
        return [s for s in self.seen if type_ is None or s.request.type is type_]

    def acks(self):
        return [(s.request.ack_result_id, s.request.ack_state) for s in self.requests(RequestType.ACK)]


class Gripper:
    """Holds a part as soon as it sucks, and drops it when it stops."""

    def __init__(self, peer):
        self.krc = None
        self.peer = peer
        self.works = True
        self.history = []

    def output_changed(self, index, value, tcp):
        if index == 1:
            self.history.append((value, tcp, len(self.peer.seen)))
            self.krc.set_input(1, value and self.works)

    def moved(self, tcp):
        pass


class Robot:
    """The controller with the shipped programs."""

    def __init__(self, peer, *, more=None, **options):
        self.gripper = Gripper(peer)
        self.krc = SoftwareKrc(
            {**read_project(KRL), **(more or {})},
            robot=KR3_R540,
            eki_configs={"SlabCell": (KRL / "SlabCell.xml").read_bytes()},
            eki_addresses={"SlabCell": peer.address},
            io=self.gripper,
            **options,
        )
        self.gripper.krc = peer.krc = self.krc
        for name, frame in (("TOOL_DATA[1]", TOOL), ("BASE_DATA[1]", PICK_BASE), ("BASE_DATA[2]", PLACE_BASE)):
            self.krc.set_data("", name, frame)

    def run(self, program="SlabCell"):
        return self.krc.run(program, max_wall_s=30)

    def go_on(self):
        return self.krc.go_on(max_wall_s=30)

    @property
    def texts(self):
        return [message.text for message in self.krc.messages]


@pytest.fixture
def peer():
    peer = Peer()
    yield peer
    if peer.krc is not None:
        peer.krc.close()
    peer.close()


def first_line_of(routine):
    """Where a routine of the programs begins: file and line of its first statement."""
    for file, source in read_project(KRL).items():
        lines = source.decode().split("\n")
        for number, line in enumerate(lines, 1):
            if line.startswith(f"GLOBAL DEF {routine}("):
                body = (n for n in range(number, len(lines)) if not lines[n].startswith(("DECL", ";")))
                return file, next(body) + 1
    raise AssertionError(routine)


# --- what VT.dat says before the robot acts ---------------------------------------------------------------------------


def test_the_state_is_in_the_memory_before_the_step_that_follows_from_it(peer):
    places = {first_line_of(name): name for name in ("SC_TOPICK", "SC_FROMPICK", "SC_ABOVEPLACE", "SC_TOPLACE")}
    places[first_line_of("SC_FROMPLACE")] = "SC_FROMPLACE"
    found = {}

    def note(event):
        name = places.get((event.file, event.line))
        if name is not None:
            memory = robot.krc.data("VT", "VT_LASTRES"), robot.krc.data("VT", "VT_LASTSTATE")
            found.setdefault(name, memory)

    robot = Robot(peer, trace=note, trace_kinds=frozenset({"statement"}))
    assert robot.run().status == "done"
    assert found == {
        "SC_TOPICK": (101, ACCEPTED),
        "SC_FROMPICK": (101, GRASPED),
        "SC_ABOVEPLACE": (101, GRASPED),
        "SC_TOPLACE": (101, GRASPED),
        "SC_FROMPLACE": (101, PLACED),
    }


def test_the_state_is_in_the_memory_before_the_cell_hears_of_it(peer):
    robot = Robot(peer)
    assert robot.run().status == "done"
    acks = peer.requests(RequestType.ACK)
    assert [s.request.ack_state for s in acks] == [AckState.ACCEPTED, AckState.GRASPED, AckState.PLACED]
    assert all(s.memory == (s.request.ack_result_id, int(s.request.ack_state)) for s in acks)


def test_the_memory_never_holds_a_new_number_with_the_state_of_an_old_one(peer):
    held = set()

    def note(_event):
        held.add((robot.krc.data("VT", "VT_LASTRES"), robot.krc.data("VT", "VT_LASTSTATE")))

    robot = Robot(peer, trace=note, trace_kinds=frozenset({"statement"}))
    robot.krc.set_data("VT", "VT_LASTRES", 7)
    robot.krc.set_data("VT", "VT_LASTSTATE", PLACED)
    assert robot.run().status == "done"
    assert held == {(7, PLACED), (7, 0), (101, 0), (101, ACCEPTED), (101, GRASPED), (101, PLACED)}


def test_a_state_is_written_when_the_arm_stands_and_not_by_the_advance_run(peer):
    probe = b"DEF Probe()\nBAS(#INITMOV,0)\nPTP {A1 90}\nVT_MARK(5,1)\nAT=$AXIS_ACT.A1\nEND\n"
    robot = Robot(peer, more={"Probe.src": probe, "Probe.dat": b"DEFDAT Probe PUBLIC\nREAL AT=0.0\nENDDAT\n"})
    assert robot.run("Probe").status == "done"
    assert robot.krc.data("Probe", "AT") == pytest.approx(90)


# --- telegrams that are not the answer --------------------------------------------------------------------------------


def damaged(old, new):
    def change(_request, usual):
        telegram = encode_answer(usual)
        assert old in telegram
        return [telegram.replace(old, new)]

    return change


def said_otherwise(**changes):
    return lambda _request, usual: [encode_answer(replace(usual, **changes))]


@pytest.mark.parametrize(
    "wrong",
    [
        pytest.param(
            lambda r, usual: [encode_answer(replace(usual, acknowledges=r.sequence - 1))], id="of another request"
        ),
        pytest.param(said_otherwise(session=99), id="of another session"),
        pytest.param(damaged(b'ResId="101"', b'ResId="109"'), id="a whole number damaged"),
        pytest.param(damaged(b'<Pick X="60.', b'<Pick X="90.'), id="a position damaged"),
        pytest.param(damaged(b'Score="0.9', b'Score="0.1'), id="a score damaged"),
        pytest.param(lambda r, usual: [], id="none at all"),
    ],
)
def test_what_is_not_the_answer_is_dropped_and_the_request_repeated(peer, wrong):
    peer.answers["NEXT"] = wrong
    robot = Robot(peer)
    robot.krc.set_data("VT", "VT_TMOANSWER", 150)
    assert robot.run().status == "done"
    first, second = (s.request for s in peer.requests(RequestType.NEXT)[:2])
    assert first == second
    assert peer.acks() == [(101, state) for state in (AckState.ACCEPTED, AckState.GRASPED, AckState.PLACED)]
    (_, tcp, _), *_ = [change for change in robot.gripper.history if change[0]]
    assert math.dist(tcp.as_tuple()[:3], (PICK_BASE @ PICK).as_tuple()[:3]) < 0.01


def test_answers_to_earlier_requests_that_come_with_the_right_one_are_read_away(peer):
    peer.answers["NEXT"] = lambda r, usual: [
        *[encode_answer(replace(usual, acknowledges=r.sequence - k, offer=None)) for k in (3, 2, 1)],
        encode_answer(usual),
    ]
    robot = Robot(peer)
    assert robot.run().status == "done"
    assert len(peer.requests(RequestType.NEXT)) == 1
    assert peer.acks()[-1] == (101, AckState.PLACED)


def test_a_result_of_another_picture_is_refused(peer):
    peer.answers["NEXT"] = lambda r, usual: [encode_answer(replace(usual, trigger_sequence=r.sequence))]
    robot = Robot(peer)
    assert robot.run().status == "halted"
    assert robot.texts[-1] == "2002 Result refused by the robot: it is an old one."
    assert peer.acks() == []
    assert [value for value, *_ in robot.gripper.history if value] == []


# --- refusals of the cell ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("state", "held"), [(AckState.ACCEPTED, False), (AckState.GRASPED, True)])
def test_a_step_that_the_cell_refuses_is_not_taken(peer, state, held):
    peer.answers[state.name] = said_otherwise(code=1701, message="1701 No.")
    robot = Robot(peer)
    result = robot.run()
    assert (result.status, robot.texts[-1]) == ("halted", "1701 No.")
    assert peer.acks()[-1] == (101, state)
    assert [value for value, *_ in robot.gripper.history if value] == [True] * held
    assert (PLACE_BASE.inverse() @ robot.krc.tcp).y_mm < 0, "the arm went to the place"


@pytest.mark.parametrize("statement_s", [STATEMENT_S, 0.012], ids=["fast", "slow"])
def test_after_an_error_start_connects_anew_and_that_is_no_lost_link(peer, statement_s):
    peer.answers["TRIGGER"] = said_otherwise(code=1101, message="1101 Camera.")
    robot = Robot(peer, statement_s=statement_s)
    assert robot.run().status == "halted"
    before = len(peer.seen)
    assert robot.go_on().status == "done"
    assert peer.seen[before].request.type is RequestType.HELLO
    assert not [text for text in robot.texts if "lost" in text]


def test_a_link_that_breaks_is_told_and_made_anew(peer):
    peer.answers["NEXT"] = lambda r, usual: None
    robot = Robot(peer)
    assert robot.run().status == "done"
    names = [s.request.type.name for s in peer.seen]
    assert names[:5] == ["HELLO", "TRIGGER", "NEXT", "HELLO", "TRIGGER"]
    assert sum(text.startswith("Link to the cell lost") for text in robot.texts) == 1
    assert not [text for text in robot.texts if text.startswith("EKI")], "the channel was not given back before"


def test_a_run_says_hello_first_whatever_an_earlier_one_left_behind(peer):
    robot = Robot(peer)
    robot.krc.set_data("VT", "VT_READY", True)
    robot.krc.set_data("VT", "VT_SES", 55)
    assert robot.run().status == "done"
    first = peer.seen[0].request
    assert (first.type, first.session, first.sequence) == (RequestType.HELLO, 0, 1)  # nothing was tried before it


def test_a_channel_that_is_given_back_leaves_no_flag_behind(peer):
    numbers = (996, 997, 998)
    left_behind = "".join(f"$FLAG[{n}]=TRUE\n" for n in numbers)
    looked_at = " OR ".join(f"$FLAG[{n}]" for n in numbers)
    probe = f"DEF Probe()\n{left_behind}VT_INIT()\nLEFT={looked_at}\nEND\n".encode()
    robot = Robot(peer, more={"Probe.src": probe, "Probe.dat": b"DEFDAT Probe PUBLIC\nBOOL LEFT=TRUE\nENDDAT\n"})
    assert robot.run("Probe").status == "done"
    assert robot.krc.data("Probe", "LEFT") is False


# --- a part that is held at the start ---------------------------------------------------------------------------------


def held_robot(peer, *, held, last=101, **options):
    offer = peer.offers[0]

    def resume(_request, usual):
        peer.queue = [offer]
        return [encode_answer(replace(usual, left=1, offer=offer))]

    peer.answers["HELLO"] = resume
    robot = Robot(peer, more={"Suck.src": b"DEF Suck()\n$OUT[1]=TRUE\nEND\n"}, **options)
    robot.krc.set_data("VT", "VT_LASTRES", last)
    robot.krc.set_data("VT", "VT_LASTSTATE", ACCEPTED)
    if held:  # the valve has kept the vacuum
        assert robot.run("Suck").status == "done"
        robot.gripper.history.clear()
    return robot


def test_a_held_part_is_placed_if_the_cell_and_the_memory_agree_on_it(peer):
    robot = held_robot(peer, held=True)
    assert robot.run().status == "done"
    assert peer.acks()[0] == (101, AckState.PLACED)
    assert robot.gripper.history[0][0] is False
    tcp = robot.gripper.history[0][1]
    assert math.dist(tcp.as_tuple()[:3], (PLACE_BASE @ PLACE).as_tuple()[:3]) < 0.01


def test_from_then_on_it_counts_as_grasped(peer):
    place, states = first_line_of("SC_ABOVEPLACE"), []

    def note(event):
        if (event.file, event.line) == place:
            states.append(robot.krc.data("VT", "VT_LASTSTATE"))

    robot = held_robot(peer, held=True, trace=note, trace_kinds=frozenset({"statement"}))
    assert robot.run().status == "done"
    assert states[0] == GRASPED


@pytest.mark.parametrize(("held", "last"), [(True, 77), (False, 101)])
def test_a_part_that_is_another_or_gone_is_not_placed(peer, held, last):
    robot = held_robot(peer, held=held, last=last)
    result = robot.run()
    assert peer.acks()[0] == (101, AckState.ABORTED)
    if held:
        assert (result.status, robot.texts[-1][:4]) == ("halted", "2005")
        assert [value for value, *_ in robot.gripper.history] == []
    else:  # nothing was carried, so nothing can have been lost on the way
        assert (result.status, robot.texts) == ("done", ["Job complete: every slot is filled"])


# --- where the arm stands when it asks --------------------------------------------------------------------------------


def test_every_picture_is_asked_for_with_the_arm_standing_at_the_photo_position(peer):
    peer.offers = [replace(peer.offers[0], result_id=101 + i) for i in range(2)]
    robot = Robot(peer)
    assert robot.run().status == "done"
    triggers = peer.requests(RequestType.TRIGGER)
    assert len(triggers) == 2
    for seen in triggers:
        assert seen.request.axes_deg == pytest.approx(PHOTO, abs=1e-3)
        assert seen.axes == pytest.approx(PHOTO, abs=1e-3)
        flange_tcp = KR3_R540.forward(PHOTO) @ TOOL
        assert seen.request.tcp.as_tuple()[:3] == pytest.approx(flange_tcp.as_tuple()[:3], abs=1e-2)
    assert robot.krc.axes_deg == pytest.approx(PHOTO, abs=1e-3)


@pytest.mark.parametrize("code", [ResultCode.JOB_COMPLETE, ResultCode.NOTHING_LEFT])
def test_the_arm_goes_aside_at_the_end_wherever_the_cell_ends_the_job(peer, code):
    peer.answers["PLACED"] = said_otherwise(code=code)
    robot = Robot(peer)
    assert robot.run().status == "done"
    assert len(peer.requests(RequestType.TRIGGER)) == 1
    assert robot.krc.axes_deg == pytest.approx(PHOTO, abs=1e-3)


def test_the_gripper_is_told_truly_and_every_request_has_a_number_of_its_own(peer):
    robot = Robot(peer)
    assert robot.run().status == "done"
    held = {s.request.ack_state: s.request.status.gripper_holds_part for s in peer.requests(RequestType.ACK)}
    assert held == {AckState.ACCEPTED: False, AckState.GRASPED: True, AckState.PLACED: False}
    numbers = [s.request.sequence for s in peer.seen]
    assert numbers == sorted(set(numbers))
    assert peer.seen[-1].request.type is RequestType.BYE


def test_a_slab_that_is_not_grasped_is_told_so_and_let_go(peer):
    robot = Robot(peer)
    robot.gripper.works = False
    assert robot.run().status == "done"
    assert peer.acks() == [(101, AckState.ACCEPTED), (101, AckState.PICK_FAILED)]
    assert robot.gripper.history[-1][0] is False


# --- paths and the gripper --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pick", "place", "reachable"),
    [
        pytest.param(replace(PICK, x_mm=200, y_mm=-80), PLACE, False, id="not above the part"),
        pytest.param(PICK, replace(PLACE, x_mm=180, y_mm=300), False, id="not the slot, though in the other base"),
        pytest.param(PICK, replace(PLACE, x_mm=240, y_mm=-100), True, id="the slot, though not in the other base"),
    ],
)
def test_reach_is_judged_at_and_above_both_ends_each_in_its_own_base(peer, pick, place, reachable):
    peer.offers = [replace(peer.offers[0], pick=pick, place=place)]
    robot = Robot(peer)
    assert robot.run().status == "done"
    assert peer.acks()[0] == (101, AckState.ACCEPTED if reachable else AckState.UNREACHABLE)
    assert bool(robot.gripper.history) is reachable


def test_the_arm_goes_straight_down_to_and_straight_up_from_both_ends(peer):
    places = {0: [], 1: [], 2: []}

    def note(event):
        if event.kind == "path":
            places[len(robot.gripper.history)].append(robot.krc.tcp)

    robot = Robot(peer, trace=note, trace_kinds=frozenset({"path"}))
    assert robot.run().status == "done"
    pick, slot = PICK_BASE @ PICK, PLACE_BASE @ PLACE

    def low(tcps):
        return [tcp for tcp in tcps if tcp.z_mm < 85.0]

    def astray(tcps, end):
        return max(math.hypot(tcp.x_mm - end.x_mm, tcp.y_mm - end.y_mm) for tcp in tcps)

    down, carried, up = low(places[0]), low(places[1]), low(places[2])
    half = next(i for i, tcp in enumerate(carried) if astray([tcp], pick) > 1.0)
    for tcps, end in ((down, pick), (carried[:half], pick), (carried[half:], slot), (up, slot)):
        assert len(tcps) > 5
        assert astray(tcps, end) < 0.1
    assert min(tcp.z_mm for tcps in places.values() for tcp in tcps) > 9.9


def test_vacuum_that_comes_and_goes_slowly_is_waited_for(peer):
    due, changes = [], []

    def late(index, value, _tcp):
        if index == 1:
            due.append((robot.krc.virtual_time_s + 0.4, value))

    def note(event):
        while due and event.time_s >= due[0][0]:
            _, value = due.pop(0)
            changes.append((value, robot.krc.tcp.as_tuple()[:3]))
            robot.krc.set_input(1, value)

    robot = Robot(peer, trace=note, trace_kinds=frozenset({"statement"}))
    robot.gripper.output_changed = late
    assert (robot.run().status, robot.texts) == ("done", ["Job complete: every slot is filled"])
    assert peer.acks()[-1] == (101, AckState.PLACED)
    # the arm stood at the part until it was held, and in the slot until it was released
    (held, held_at), (released, released_at) = changes[-2:]
    assert (held, released) == (True, False)
    assert held_at == pytest.approx((PICK_BASE @ PICK).as_tuple()[:3], abs=0.01)
    assert released_at == pytest.approx((PLACE_BASE @ PLACE).as_tuple()[:3], abs=0.01)


def test_a_gripper_that_does_not_let_go_is_named(peer):
    robot = Robot(peer)
    robot.gripper.output_changed = lambda index, value, tcp: robot.krc.set_input(1, True) if value else None
    result = robot.run()
    assert (result.status, robot.texts[-1]) == ("halted", "2004 Gripper does not release the slab. Check the valve.")
    assert peer.acks()[-1] == (101, AckState.GRASPED)


def test_a_blow_off_valve_that_is_there_is_pulsed(peer):
    blown = []
    robot = Robot(peer, trace=lambda event: blown.append(event.text), trace_kinds=frozenset({"io"}))
    robot.krc.set_data("SlabCell", "SC_OUTBLOW", 2)
    assert robot.run().status == "done"
    assert [text for text in blown if text.startswith("$OUT[2]")][:2] == ["$OUT[2]=TRUE", "$OUT[2]=FALSE"]
