"""Spline blocks: the times of TIME_BLOCK, the even speed of CONST_VEL, the stops of STOP WHEN PATH, points of axes."""

import math
import threading

import pytest

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.krc.motion_joint_spline import plan_joint_spline
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

START = """BAS(#INITMOV,0)
$TOOL=$NULLFRAME
$BASE=$NULLFRAME
BAS(#VEL_CP,0.1)
PTP {A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0}
PTP {X 350,Y -100,Z 400,A 0,B 0,C 180}
WAIT SEC 0
"""


def at(y, x=350):
    return f"{{X {x},Y {y},Z 400,A 0,B 0,C 180}}"


class Bench:
    def __init__(self, body, data="", more=""):
        self.events = []
        self.krc = SoftwareKrc(
            {
                "t.src": f"DEF t()\n{START}{body}\nWAIT SEC 0\nEND\n{more}\n".encode(),
                "t.dat": f"DEFDAT t PUBLIC\n{data}\nENDDAT\n".encode(),
            },
            robot=KR3_R540,
            trace=self.events.append,
        )
        assert [str(d) for d in self.krc.diagnostics] == []
        self.result = self.krc.run("t", max_wall_s=30)

    def done(self):
        assert (self.result.status, self.result.message) == ("done", "")
        return self

    def time_of(self, output):
        (time_s,) = [e.time_s for e in self.events if f"$OUT[{output}]=TRUE" in e.text]
        return time_s

    @property
    def notes(self):
        return [(m.number, m.text) for m in self.krc.messages]


def marked(output):
    """A trigger at the end of the next segment."""
    return f"TRIGGER WHEN PATH=0 DELAY=0 DO $OUT[{output}]=TRUE\n"


def test_a_time_block_takes_the_time_that_is_asked_for_and_its_parts_their_shares():
    bench = Bench(f"""SPLINE
{marked(1)}SPL {at(-50)}
TIME_BLOCK START
{marked(2)}SPL {at(0, 360)}
TIME_BLOCK PART=25
SPL {at(50, 370)}
{marked(3)}SPL {at(100)}
TIME_BLOCK END=6.0
SPL {at(120)}
ENDSPLINE""").done()
    assert bench.time_of(2) - bench.time_of(1) == pytest.approx(1.5, abs=0.03)
    assert bench.time_of(3) - bench.time_of(1) == pytest.approx(6.0, abs=0.03)
    assert bench.krc.tcp.y_mm == pytest.approx(120, abs=1e-3)


def test_a_time_block_of_axes_takes_its_time_too():
    bench = Bench(f"""PTP_SPLINE
SPTP {{A1 10}}
TIME_BLOCK START
{marked(1)}SPTP {{A1 20}}
TIME_BLOCK PART=50
{marked(2)}SPTP {{A1 60}}
TIME_BLOCK END=4.0
ENDSPLINE""").done()
    assert bench.time_of(2) - bench.time_of(1) == pytest.approx(2.0, abs=0.03)


@pytest.mark.parametrize(
    ("block", "number"),
    [
        (f"TIME_BLOCK START\nSPL {at(100)}\nTIME_BLOCK END=0.01", 1102),
        (f"TIME_BLOCK START\nSPL {at(100)}\nTIME_BLOCK END=0", 90007),
        (f"TIME_BLOCK START\nSPL {at(0)}\nTIME_BLOCK PART=100\nSPL {at(100)}\nTIME_BLOCK END=5", 90007),
        (f"SPL {at(100)}\nTIME_BLOCK END=5", 90007),
    ],
)
def test_a_time_block_that_cannot_be_is_refused(block, number):
    assert Bench(f"SPLINE\n{block}\nENDSPLINE").result.message_number == number


def test_a_range_of_even_speed_without_room_to_speed_up_or_slow_down_is_noted():
    bench = Bench(f"SPLINE\nCONST_VEL START=0 ONSTART\nSLIN {at(100)}\nCONST_VEL END=0\nENDSPLINE").done()
    assert [number for number, _ in bench.notes] == [3216, 3217]
    assert "Instead of $VEL.CP = 0.1 m/s" in bench.notes[0][1]


def test_a_range_of_even_speed_that_can_be_kept_is_not_noted():
    body = f"SPLINE\nCONST_VEL START=20 ONSTART\nSLIN {at(0)}\nCONST_VEL END=-20\nSLIN {at(100)}\nENDSPLINE"
    assert Bench(body).done().notes == []


def test_of_the_speeds_of_its_segments_the_lowest_holds_for_a_range_of_even_speed():
    slow = f"SLIN {at(0)} WITH $VEL.CP=0.05"
    body = f"SPLINE\nCONST_VEL START=20 ONSTART\n{slow}\nSLIN {at(80)}\nCONST_VEL END=-20\nSLIN {at(100)}\nENDSPLINE"
    assert Bench(body).done().notes == []


def test_a_speed_of_a_segment_alone_is_what_its_range_has_to_reach():
    fast = f"SLIN {at(0)} WITH $VEL.CP=1.5"
    body = f"SPLINE\nCONST_VEL START=40 ONSTART\n{fast}\nCONST_VEL END=-40 ONSTART\nSLIN {at(100)}\nENDSPLINE"
    bench = Bench(body).done()
    assert [number for number, _ in bench.notes] == [3214]
    assert "$VEL.CP = 1.5 m/s" in bench.notes[0][1]


def test_a_range_too_short_for_the_programmed_speed_is_noted_as_reduced():
    body = f"BAS(#VEL_CP,1.5)\nSPLINE\nCONST_VEL START=40 ONSTART\nSLIN {at(0)}\nCONST_VEL END=-40\nENDSPLINE"
    assert [number for number, _ in Bench(body).done().notes] == [3214]


WATCH = """DEF seen()
stood=$POS_ACT.Y
END
DEF free()
$FLAG[1]=FALSE
END"""
TIMERS = """INTERRUPT DECL 20 WHEN $TIMER[1]>2500 DO seen()
INTERRUPT DECL 21 WHEN $TIMER[1]>3000 DO free()
$TIMER[1]=0
$TIMER_STOP[1]=FALSE
INTERRUPT ON
"""


@pytest.mark.parametrize(
    ("stop", "place"),
    [
        ("STOP WHEN PATH=-30 IF $FLAG[1]", 70.0),
        ("STOP WHEN PATH=25 ONSTART IF $FLAG[1]", -75.0),
        ("STOP WHEN PATH=0 IF $FLAG[1]==TRUE", 100.0),
        ("STOP WHEN PATH=0 ONSTART IF NOT $TIMER_FLAG[2]", -100.0),
    ],
)
@pytest.mark.parametrize("motion", ["SPLINE\n{}\nSPL {}\nENDSPLINE", "{}\nSLIN {}"])
def test_the_arm_stands_at_the_point_while_the_condition_holds_and_then_goes_on(motion, stop, place):
    body = "$FLAG[1]=TRUE\n$TIMER[2]=-3500\n$TIMER_STOP[2]=FALSE\n" + TIMERS + motion.format(stop, at(100))
    bench = Bench(body, data="REAL stood=0.0", more=WATCH).done()
    assert bench.krc.data("t", "stood") == pytest.approx(place, abs=0.05)
    assert bench.krc.tcp.y_mm == pytest.approx(100, abs=1e-3)
    assert bench.notes == []
    assert bench.result.virtual_time_s > 3.0


def test_a_condition_that_does_not_hold_does_not_slow_the_arm_down():
    free = Bench(f"SPLINE\nSPL {at(100)}\nENDSPLINE").done().result.virtual_time_s
    body = f"SPLINE\nSTOP WHEN PATH=-30 IF $FLAG[1]\nSPL {at(100)}\nENDSPLINE"
    assert Bench(body).done().result.virtual_time_s == pytest.approx(free, abs=0.013)


def test_a_condition_that_comes_too_late_stops_the_arm_behind_the_point_with_a_message():
    body = (
        TIMERS
        + f"""SPLINE
STOP WHEN PATH=-100 IF $FLAG[1]
TRIGGER WHEN PATH=-101 DELAY=0 DO $FLAG[1]=TRUE
SLIN {at(100)}
ENDSPLINE"""
    )
    bench = Bench(body, data="REAL stood=0.0", more=WATCH).done()
    assert [number for number, _ in bench.notes] == [3230]
    assert 0.0 < bench.krc.data("t", "stood") < 20.0
    assert bench.krc.tcp.y_mm == pytest.approx(100, abs=1e-3)


def test_time_passes_as_on_the_wall_while_an_input_holds_the_arm_on_its_path():
    source = f"DEF t()\n{START}SPLINE\nSTOP WHEN PATH=-30 IF $IN[1]\nSPL {at(100)}\nENDSPLINE\nWAIT SEC 0\nEND\n"
    krc = SoftwareKrc({"t.src": source.encode()}, robot=KR3_R540)
    krc.set_input(1, True)
    timer = threading.Timer(0.3, krc.set_input, (1, False))
    timer.start()
    result = krc.run("t", max_wall_s=30)
    timer.join()
    assert (result.status, result.message) == ("done", "")
    assert result.virtual_time_s < 20


def test_axes_pass_every_point_of_a_block_within_their_limits():
    start = (0.0, -90.0, 90.0, 0.0, 30.0, 0.0)
    targets = [
        (20.0, -80.0, 95.0, 10.0, 40.0, 0.0),
        (40.0, -80.0, 100.0, -30.0, 50.0, 90.0),
        (0.0, -90.0, 90.0, 0.0, 30.0, 0.0),
    ]
    move = plan_joint_spline(KR3_R540, start, targets, [(60.0, 60.0)] * 3, tool=Frame())
    for mark, target in zip(move.marks_s, targets, strict=False):
        assert move.axes_at(mark) == pytest.approx(target, abs=1e-6)
    assert move.axes_at(move.duration_s) == pytest.approx(targets[-1], abs=1e-9)
    steps = math.ceil(move.duration_s / 0.004)
    samples = [move.axes_at(move.duration_s * k / steps) for k in range(steps + 1)]
    step_s = move.duration_s / steps
    for a, b, c in zip(samples, samples[1:], samples[2:], strict=False):
        for i in range(6):
            assert abs(b[i] - a[i]) / step_s <= KR3_R540.axis_speed_deg_s[i] * 0.61
            assert abs(a[i] - 2 * b[i] + c[i]) / step_s**2 <= KR3_R540.axis_acceleration_deg_s2[i] * 0.7


def three_segments(setting, block="SPLINE", end="ENDSPLINE"):
    """A block with marks 1 and 2 at both ends of its middle segment, which has a setting of its own."""
    return (
        f"{block}\n{marked(1)}SLIN {at(-60)}\n{marked(2)}SLIN {at(60)}{setting}\nSLIN {at(100)}\n{end}\nspeed=$VEL.CP"
    )


@pytest.mark.parametrize(
    ("setting", "block", "seconds"),
    [
        ("", "SPLINE", 1.2),
        (" WITH $VEL.CP=0.02", "SPLINE", 6.0),
        (" WITH $VEL={CP 0.02,ORI1 200.0,ORI2 200.0}", "SPLINE", 6.0),
        (" WITH $VEL.CP=0.2", "SPLINE", 0.6),
        ("", "SPLINE WITH $VEL.CP=0.02", 6.0),
        (" WITH $VEL.CP=0.06", "SPLINE WITH $VEL.CP=0.02", 2.0),
    ],
)
def test_a_segment_of_a_block_is_run_at_the_speed_that_is_set_for_it(setting, block, seconds):
    bench = Bench(three_segments(setting, block), data="DECL REAL speed").done()
    assert bench.time_of(2) - bench.time_of(1) == pytest.approx(seconds, rel=0.1)
    assert bench.krc.data("t", "speed") == pytest.approx(0.1)
    assert bench.krc.tcp.y_mm == pytest.approx(100.0, abs=1e-3)


def test_a_segment_of_axes_is_run_at_the_speed_that_is_set_for_it():
    def time_of_second(setting):
        bench = Bench(f"""PTP_SPLINE
{marked(1)}SPTP {{A1 10}}
{marked(2)}SPTP {{A1 40}}{setting}
SPTP {{A1 50}}
ENDSPLINE""").done()
        return bench.time_of(2) - bench.time_of(1)

    at_a_tenth_s = 30.0 / (KR3_R540.axis_speed_deg_s[0] / 10.0)
    assert time_of_second("") < at_a_tenth_s <= time_of_second(" WITH $VEL_AXIS[1]=10")


def test_a_segment_may_keep_the_orientation_of_the_one_before_it():
    turned = "{X 350,Y 60,Z 400,A 30,B 0,C 180}"
    kept = Bench(f"SPLINE\nSPL {at(0)}\nSPL {turned} WITH $ORI_TYPE=#CONSTANT\nENDSPLINE").done()
    assert kept.krc.tcp.a_deg == pytest.approx(0.0, abs=1e-6)
    assert Bench(f"SPLINE\nSPL {at(0)}\nSPL {turned}\nENDSPLINE").done().krc.tcp.a_deg == pytest.approx(30.0, abs=1e-6)
