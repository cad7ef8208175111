"""When KRL programs do things: advance run, interrupts, triggers, timers, and what a person does to a program."""

import pytest

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

HOME = "{A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0}"
AWAY = "{A1 60,A2 -90,A3 90,A4 0,A5 30,A6 0}"
START = f"BAS(#INITMOV,0)\nPTP {HOME}\n"


class Bench:
    """A controller with one program, and everything that was traced."""

    def __init__(self, body, declarations="", *, data="", more="", **options):
        self.events = []
        self.krc = SoftwareKrc(
            {
                "t.src": f"DEF t()\n{declarations}\n{body}\nEND\n{more}\n".encode(),
                "t.dat": f"DEFDAT t PUBLIC\n{data}\nENDDAT\n".encode(),
            },
            robot=KR3_R540,
            trace=self.events.append,
            **options,
        )
        assert [str(d) for d in self.krc.diagnostics] == []

    def run(self, **options):
        return self.krc.run("t", max_wall_s=options.get("max_wall_s", 60))

    def times(self, text):
        return [e.time_s for e in self.events if text in e.text]

    def data(self, name):
        return self.krc.data("t", name)


def done(body, declarations="", **options):
    bench = Bench(body, declarations, **options)
    result = bench.run()
    assert result.status == "done", result
    return bench


# --- advance run -----------------------------------------------------------------------------------------------------


def test_the_advance_run_computes_ahead_of_the_motion_and_an_output_waits_for_it():
    bench = done(f"{START}PTP {AWAY}\nfirst=$ROB_TIMER\n$OUT[1]=TRUE\nsecond=$ROB_TIMER", data="INT first,second")
    assert bench.data("first") < 100
    assert bench.data("second") >= 300
    assert bench.times("$OUT[1]=TRUE")[0] >= 0.3


def test_continue_lets_an_output_switch_while_the_arm_moves():
    bench = done(f"{START}PTP {AWAY}\nCONTINUE\n$OUT[1]=TRUE\n$OUT[2]=TRUE")
    assert bench.times("$OUT[1]=TRUE")[0] < 0.1
    assert bench.times("$OUT[2]=TRUE")[0] >= 0.3


def test_the_position_read_without_synchronisation_is_that_of_an_arm_on_its_way():
    early = done(f"{START}PTP {AWAY}\na=$AXIS_ACT.A1", data="REAL a")
    assert early.data("a") < 30
    late = done(f"{START}PTP {AWAY}\nWAIT SEC 0\na=$AXIS_ACT.A1", data="REAL a")
    assert late.data("a") == pytest.approx(60)


@pytest.mark.parametrize(
    "statement", ["WAIT SEC 0", "WAIT FOR TRUE", "$OUT[5]=FALSE", "b=$IN[1]", "PULSE($OUT[6],TRUE,0.1)"]
)
def test_what_stops_the_advance_run(statement):
    bench = done(f"{START}PTP {AWAY}\n{statement}\na=$AXIS_ACT.A1", data="REAL a\nBOOL b")
    assert bench.data("a") == pytest.approx(60)


@pytest.mark.parametrize(("advance", "ahead"), [(0, 0), (1, 2), (3, 4), (5, 6)])
def test_advance_limits_how_many_motions_are_planned_ahead(advance, ahead):
    moves = "\n".join(f"PTP {{A1 {10 * (i % 2)}}}\nn=n+1" for i in range(8))
    bench = Bench(
        f"BAS(#INITMOV,0)\n$ADVANCE={advance}\nPTP {HOME}\nn=0\n{moves}",
        data="INT n",
        trace_kinds=frozenset({"motion"}),
    )
    seen = []
    bench.krc._trace = lambda event: seen.append(bench.krc.data("t", "n"))
    assert bench.run().status == "done"
    # when the third motion begins, the ones that wait behind it are planned already
    assert seen[3] - 2 == ahead - (1 if advance else 0)


def test_with_advance_nothing_is_computed_ahead():
    bench = done(f"BAS(#INITMOV,0)\n$ADVANCE=0\nPTP {HOME}\nPTP {AWAY}\na=$AXIS_ACT.A1", data="REAL a")
    assert bench.data("a") == pytest.approx(60)


# --- motion ----------------------------------------------------------------------------------------------------------


def test_an_approximated_point_is_passed_without_a_stop_and_sooner():
    points = ["{A1 20}", "{A1 20,A2 -70}", "{A1 40,A2 -70}"]

    def duration(mark):
        return done(START + "\n".join(f"PTP {p} {mark}" for p in points)).krc.virtual_time_s

    assert duration("C_PTP") < duration("") - 0.05


def test_approximation_that_cannot_be_planned_in_time_is_a_message_and_an_exact_stop():
    bench = done(f"{START}$ADVANCE=0\nPTP {AWAY} C_PTP\nPTP {HOME}")
    assert any(m.number == 1123 for m in bench.krc.messages)


def test_tool_and_base_place_a_point():
    body = f"""{START}$BASE={{X 300,Y 0,Z 100,A 0,B 0,C 0}}
$TOOL={{X 0,Y 0,Z 50,A 0,B 0,C 0}}
PTP {{X 50,Y 0,Z 200,A 0,B 90,C 0}}
LIN {{X 80,Y 20,Z 200,A 0,B 90,C 0}}
WAIT SEC 0
p=$POS_ACT"""
    bench = done(body, data="E6POS p")
    assert bench.krc.tcp.as_tuple()[:3] == pytest.approx((380, 20, 300), abs=1e-6)
    assert bench.data("p")["X"] == pytest.approx(80, abs=1e-4)
    assert bench.data("p")["Y"] == pytest.approx(20, abs=1e-4)


def test_relative_motions_add_to_the_last_point_in_base_or_tool():
    body = f"""{START}$BASE=$NULLFRAME
$TOOL=$NULLFRAME
PTP {{X 350,Y 0,Z 400,A 0,B 90,C 0}}
LIN_REL {{X 10,Z -20}}
LIN_REL {{Z 30}} #TOOL
PTP_REL {{A1 10}}
PTP_REL {{A1 -10}}"""
    assert done(body).krc.tcp.as_tuple()[:3] == pytest.approx((390, 0, 380), abs=1e-4)


def test_a_point_with_members_left_out_keeps_the_rest():
    bench = done(f"{START}PTP {{A1 30}}\nPTP {{A5 60}}")
    assert bench.krc.axes_deg == pytest.approx((30, -90, 90, 0, 60, 0))


def test_with_holds_for_one_motion_only():
    bench = done(f"{START}SPTP {AWAY} WITH $VEL_AXIS[1]=5\nWAIT SEC 0\nn=$ROB_TIMER\nPTP {HOME}", data="INT n")
    slow = bench.data("n")
    assert slow > 1500
    assert bench.krc.virtual_time_s * 1000 - slow < 800


def test_a_spline_block_is_driven_through_its_points():
    body = f"""{START}$BASE=$NULLFRAME
$TOOL=$NULLFRAME
PTP {{X 350,Y 0,Z 400,A 0,B 90,C 0}}
SPLINE
 SPL {{X 370,Y 30,Z 400,A 0,B 90,C 0}}
 SLIN {{X 380,Y 60,Z 400,A 0,B 90,C 0}}
ENDSPLINE"""
    assert done(body).krc.tcp.as_tuple()[:3] == pytest.approx((380, 60, 400), abs=1e-4)


@pytest.mark.parametrize(
    ("body", "number", "text"),
    [
        (f"PTP {HOME}", 1422, "$VEL_AXIS[1] value invalid"),
        (
            f"FOR i=1 TO 6\n$VEL_AXIS[i]=50\n$ACC_AXIS[i]=50\nENDFOR\nPTP {HOME}\nPTP {{X 400,Y 0,Z 400,A 0,B 90,C 0}}",
            1419,
            "TOOL not programmed",
        ),
        ("BAS(#INITMOV,0)\nLIN {X 400,Y 0,Z 400,A 0,B 90,C 0}", 1443, "has to be a PTP"),
        (f"{START}PTP {{A1 171}}", 1447, "A1"),
        (f"{START}PTP {{X 900,Y 0,Z 400,A 0,B 90,C 0}}", 90002, "Work envelope"),
        (f"{START}PTP f", 1422, "is no position"),
        (f"{START}PTP !", 91015, "never taught"),
        (f"{START}BAS(#VEL_PTP,0)", 91008, "not in 1 to 100"),
        (f"{START}BAS(#TOOL,5)", 1422, "TOOL_DATA[5] value invalid"),
        (f"{START}BAS(#BASE,99)", 1444, "BASE_DATA[99]"),
    ],
)
def test_a_motion_that_the_controller_would_refuse_is_an_error(body, number, text):
    result = Bench(body, "INT i\nFRAME f").run()
    assert (result.status, result.message_number) == ("error", number)
    assert text in result.message


def test_inverse_tells_whether_a_point_can_be_reached_and_forward_undoes_it():
    body = f"""{START}$BASE=$NULLFRAME
$TOOL=$NULLFRAME
ax=INVERSE({{X 350,Y 50,Z 400,A 0,B 90,C 0}},$AXIS_ACT,good)
p=FORWARD(ax,n)
ax=INVERSE({{X 2000,Y 50,Z 400,A 0,B 90,C 0}},$AXIS_ACT,bad)"""
    bench = done(body, data="E6AXIS ax\nE6POS p\nINT good,bad,n")
    assert (bench.data("good"), bench.data("n")) == (0, 0)
    assert bench.data("bad") != 0
    assert bench.data("p")["Y"] == pytest.approx(50, abs=1e-3)


# --- interrupts ------------------------------------------------------------------------------------------------------

ISR = "DEF isr()\nn=n+1\nt=$ROB_TIMER\nEND"


def test_an_interrupt_is_served_while_the_arm_moves_and_the_motion_goes_on():
    body = f"""INTERRUPT DECL 10 WHEN $TIMER_FLAG[1]==TRUE DO isr()
INTERRUPT ON 10
{START}$TIMER[1]=-200
$TIMER_STOP[1]=FALSE
PTP {AWAY}
PTP {HOME}
PTP {AWAY}"""
    bench = done(body, data="INT n=0\nINT t", more=ISR)
    assert bench.data("n") == 1
    assert 400 <= bench.data("t") < 500
    assert bench.krc.axes_deg[0] == pytest.approx(60)


def test_an_interrupt_fires_on_the_edge_and_only_while_it_is_on():
    body = """INTERRUPT DECL 10 WHEN $FLAG[1] DO isr()
$FLAG[1]=TRUE
INTERRUPT ON 10
WAIT SEC 0.1
a=n
$FLAG[1]=FALSE
WAIT SEC 0.1
$FLAG[1]=TRUE
WAIT SEC 0.1
b=n
INTERRUPT OFF 10
$FLAG[1]=FALSE
WAIT SEC 0.1
$FLAG[1]=TRUE
WAIT SEC 0.1
c=n"""
    bench = done(body, data="INT n=0\nINT t,a,b,c", more=ISR)
    assert [bench.data(x) for x in "abc"] == [0, 1, 1]


def test_a_disabled_interrupt_is_kept_until_it_is_enabled():
    body = """INTERRUPT DECL 10 WHEN $FLAG[1] DO isr()
INTERRUPT ON 10
INTERRUPT DISABLE 10
$FLAG[1]=TRUE
WAIT SEC 0.1
a=n
INTERRUPT ENABLE 10
WAIT SEC 0.1"""
    bench = done(body, data="INT n=0\nINT t,a", more=ISR)
    assert (bench.data("a"), bench.data("n")) == (0, 1)


def test_the_lower_number_goes_first_and_breaks_into_the_higher_one():
    more = """DEF low()
log=log*10+1
$FLAG[2]=TRUE
WAIT SEC 0.1
log=log*10+3
END
DEF high()
log=log*10+2
END"""
    body = """INTERRUPT DECL 20 WHEN $FLAG[1] DO low()
INTERRUPT DECL 5 WHEN $FLAG[2] DO high()
INTERRUPT ON
$FLAG[1]=TRUE
WAIT SEC 0.3"""
    assert done(body, data="INT log=0", more=more).data("log") == 123


def test_the_higher_number_waits_until_the_lower_one_is_served():
    more = """DEF first()
log=log*10+1
$FLAG[2]=TRUE
WAIT SEC 0.1
log=log*10+2
END
DEF second()
log=log*10+3
END"""
    body = """INTERRUPT DECL 5 WHEN $FLAG[1] DO first()
INTERRUPT DECL 20 WHEN $FLAG[2] DO second()
INTERRUPT ON
$FLAG[1]=TRUE
WAIT SEC 0.3"""
    assert done(body, data="INT log=0", more=more).data("log") == 123


def test_an_interrupt_ends_with_the_routine_that_declared_it_unless_it_is_global():
    more = f"""DEF local()
INTERRUPT DECL 10 WHEN $FLAG[1] DO isr()
INTERRUPT ON 10
END
DEF everywhere()
GLOBAL INTERRUPT DECL 11 WHEN $FLAG[2] DO isr()
INTERRUPT ON 11
END
{ISR}"""
    body = "local()\neverywhere()\n$FLAG[1]=TRUE\nWAIT SEC 0.1\na=n\n$FLAG[2]=TRUE\nWAIT SEC 0.1"
    bench = done(body, data="INT n=0\nINT t,a", more=more)
    assert (bench.data("a"), bench.data("n")) == (0, 1)


def test_switching_an_interrupt_that_was_never_declared_is_error_1430():
    assert Bench("INTERRUPT ON 7").run().message_number == 1430


def test_brake_stops_the_arm_on_its_path_and_the_motion_goes_on_afterwards():
    more = "DEF isr()\nBRAKE\nWAIT SEC 0.5\na=$AXIS_ACT.A1\nWAIT SEC 0.5\nb=$AXIS_ACT.A1\nEND"
    body = f"""INTERRUPT DECL 10 WHEN $TIMER_FLAG[1] DO isr()
INTERRUPT ON 10
{START}$TIMER[1]=-100
$TIMER_STOP[1]=FALSE
PTP {AWAY}"""
    bench = done(body, data="REAL a,b", more=more)
    assert 0 < bench.data("a") < 60
    assert bench.data("a") == bench.data("b")
    assert bench.krc.axes_deg[0] == pytest.approx(60)


def test_resume_leaves_everything_below_the_routine_that_declared_the_interrupt():
    more = f"""DEF search()
INT i
FOR i=1 TO 100
PTP {AWAY}
PTP {HOME}
ENDFOR
missed=TRUE
END
DEF isr()
BRAKE F
RESUME
END"""
    body = f"""INTERRUPT DECL 10 WHEN $TIMER_FLAG[1] DO isr()
{START}$TIMER[1]=-700
$TIMER_STOP[1]=FALSE
INTERRUPT ON 10
search()
INTERRUPT OFF 10
reached=TRUE
PTP {HOME}"""
    bench = done(body, data="BOOL missed=FALSE\nBOOL reached=FALSE", more=more)
    assert bench.data("reached") is True
    assert bench.data("missed") is False
    assert bench.krc.axes_deg[0] == pytest.approx(0)


def test_resume_while_the_program_is_in_the_declaring_routine_is_an_error():
    body = "INTERRUPT DECL 10 WHEN $FLAG[1] DO isr()\nINTERRUPT ON 10\n$FLAG[1]=TRUE\nWAIT SEC 1"
    assert Bench(body, more="DEF isr()\nRESUME\nEND").run().message_number == 91011


def test_a_motion_within_an_interrupt_returns_to_the_interrupted_path():
    more = "DEF isr()\nBRAKE\nPTP_REL {A5 20}\nWAIT SEC 0\na=$AXIS_ACT.A5\nEND"
    body = f"""INTERRUPT DECL 10 WHEN $TIMER_FLAG[1] DO isr()
INTERRUPT ON 10
{START}$TIMER[1]=-300
$TIMER_STOP[1]=FALSE
PTP {AWAY}"""
    bench = done(body, data="REAL a", more=more)
    assert bench.data("a") == pytest.approx(50)
    assert bench.krc.axes_deg == pytest.approx((60, -90, 90, 0, 30, 0))


# --- triggers, timers, flags -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("trigger", "earliest", "latest"),
    [
        ("DISTANCE=0 DELAY=0", 0.22, 0.26),
        ("DISTANCE=0 DELAY=100", 0.32, 0.36),
        ("DISTANCE=1 DELAY=0", 0.50, 0.70),
        ("PATH=0 DELAY=-100", 0.40, 0.60),
        ("PATH=10 ONSTART DELAY=0", 0.25, 0.40),
    ],
)
def test_a_trigger_switches_at_its_place_on_the_way_of_the_next_motion(trigger, earliest, latest):
    bench = done(f"{START}PTP {{A1 1}}\nTRIGGER WHEN {trigger} DO $OUT[4]=TRUE\nPTP {AWAY}")
    (switched,) = bench.times("$OUT[4]=TRUE")
    start = next(e.time_s for e in bench.events if "A1 60" in e.text)
    assert earliest - 0.22 <= switched - start + 0.013 <= latest - 0.22 + 0.04


def test_a_trigger_may_call_a_routine():
    bench = done(
        f"{START}TRIGGER WHEN DISTANCE=1 DELAY=0 DO isr() PRIO=-1\nPTP {AWAY}\nWAIT SEC 0",
        data="INT n=0\nINT t",
        more=ISR,
    )
    assert bench.data("n") == 1


def test_timers_count_milliseconds_and_their_flags_follow():
    body = """$TIMER[3]=-250
$TIMER_STOP[3]=FALSE
a=$TIMER_FLAG[3]
WAIT FOR $TIMER_FLAG[3]
b=$TIMER[3]
$TIMER_STOP[3]=TRUE
WAIT SEC 1
c=$TIMER[3]
s=$TIMER_STOP[3]"""
    bench = done(body, data="BOOL a,s\nINT b,c")
    assert bench.data("a") is False
    assert 0 < bench.data("b") <= 13
    assert bench.data("c") == bench.data("b")
    assert bench.data("s") is True
    assert bench.krc.virtual_time_s == pytest.approx(1.26, abs=0.03)


def test_a_pulse_ends_by_itself():
    bench = done("PULSE($OUT[8],TRUE,0.5)\nWAIT SEC 1")
    (up,), (down,) = bench.times("$OUT[8]=TRUE"), bench.times("$OUT[8]=FALSE")
    assert down - up == pytest.approx(0.5, abs=0.02)


def test_a_cyclic_flag_follows_its_condition():
    body = "$CYCFLAG[1]=$FLAG[1] AND NOT $FLAG[2]\na=$CYCFLAG[1]\n$FLAG[1]=TRUE\nWAIT SEC 0.02\nb=$CYCFLAG[1]"
    bench = done(body, data="BOOL a,b")
    assert (bench.data("a"), bench.data("b")) == (False, True)


def test_a_loop_without_wait_lets_time_pass():
    bench = done("$TIMER[1]=-100\n$TIMER_STOP[1]=FALSE\nWHILE NOT $TIMER_FLAG[1]\nn=n+1\nENDWHILE", data="INT n=0")
    assert bench.data("n") > 100


# --- what a person does ----------------------------------------------------------------------------------------------


class Wires:
    """A sensor that answers an output, as a gripper does."""

    def __init__(self):
        self.krc = None
        self.places = []

    def output_changed(self, index, value, tcp):
        assert isinstance(tcp, Frame)
        if index == 1:
            self.krc.set_input(2, value)

    def moved(self, tcp):
        self.places.append(tcp)


def test_inputs_answer_outputs_through_the_cell():
    wires = Wires()
    bench = Bench(f"{START}$OUT[1]=TRUE\nWAIT FOR $IN[2]\nn=1", data="INT n", io=wires)
    wires.krc = bench.krc
    assert bench.run().status == "done"
    assert bench.data("n") == 1
    assert len(wires.places) == 1


def test_a_halt_ends_the_run_and_start_goes_on_behind_it():
    bench = Bench("n=1\nHALT\nn=2", data="INT n")
    assert bench.run().status == "halted"
    assert bench.data("n") == 1
    assert bench.krc.go_on(max_wall_s=60).status == "done"
    assert bench.data("n") == 2


def test_a_program_that_never_ends_is_ended_by_the_clock_on_the_wall():
    assert Bench("LOOP\nWAIT SEC 0.1\nENDLOOP").run(max_wall_s=0.2).status == "deadline"
    assert Bench("WAIT FOR $IN[1]").run(max_wall_s=0.2).status == "deadline"


def test_cancel_from_a_statement_executes_no_further_one():
    bench = Bench("n=1\nn=2\nn=3", data="INT n", trace_kinds=frozenset({"statement"}))
    bench.krc._trace = lambda event: bench.krc.cancel() if event.line == 5 else None
    result = bench.run()
    assert (result.status, result.line) == ("cancelled", 5)
    assert bench.data("n") == 2


@pytest.mark.parametrize(("verb", "status"), [("reset", "reset"), ("deselect", "deselected")])
def test_a_program_that_is_reset_or_deselected_begins_anew(verb, status):
    bench = Bench("n=n+1\nn=n+10", data="INT n=0", trace_kinds=frozenset({"statement"}))
    bench.krc._trace = lambda event: getattr(bench.krc, verb)() if event.line == 4 else None
    assert bench.run().status == status
    bench.krc._trace = lambda event: None
    assert bench.run().status == "done"
    assert bench.data("n") == 12


@pytest.mark.parametrize("statement", range(3, 9))
def test_data_outlasts_a_power_loss_at_any_statement_and_flags_do_not(statement):
    body = "n=n+1\n$FLAG[5]=TRUE\n$OUT[5]=TRUE\nn=n+1\nlocal=7\nn=n+1"
    bench = Bench(body, "INT local", data="INT n=0", trace_kinds=frozenset({"statement"}))
    bench.krc._trace = lambda event: bench.krc.power_loss() if event.line == statement else None
    result = bench.run()
    assert (result.status, result.line) == ("power_lost", statement)
    kept = bench.data("n")
    assert kept == (statement > 3) + (statement > 6)
    assert not bench.krc.output(5)
    bench.krc._trace = lambda event: None
    assert bench.run().status == "done"
    assert bench.data("n") == kept + 3


def test_outputs_hold_over_a_power_loss_where_the_wiring_does():
    bench = Bench("$OUT[5]=TRUE\nWAIT SEC 1", trace_kinds=frozenset({"statement"}))
    bench.krc._trace = lambda event: bench.krc.power_loss(outputs_hold=True) if event.line == 4 else None
    assert bench.run().status == "power_lost"
    assert bench.krc.output(5)


def test_an_emergency_stop_stands_until_it_is_released_and_start_is_pressed():
    bench = Bench(f"{START}n=1\nPTP {AWAY}\nn=2\nWAIT SEC 0\nn=3", data="INT n", trace_kinds=frozenset({"motion"}))
    bench.krc._trace = lambda event: bench.krc.emergency_stop() if "A1 60" in event.text else None
    result = bench.run()
    assert result.status == "stopped"
    assert bench.krc.axes_deg[0] < 60
    bench.krc._trace = lambda event: None
    bench.krc.release_emergency_stop()
    assert bench.krc.go_on(max_wall_s=60).status == "done"
    assert bench.krc.axes_deg[0] == pytest.approx(60)
    assert bench.data("n") == 3


def test_a_change_of_mode_stops_the_program_which_sees_the_new_mode():
    bench = Bench("n=1\nIF $MODE_OP==#T1 THEN\nn=2\nENDIF", data="INT n", trace_kinds=frozenset({"statement"}))
    bench.krc._trace = lambda event: bench.krc.change_mode("T1") if event.line == 4 and not bench.krc.messages else None
    assert bench.run().status == "stopped"
    bench.krc._trace = lambda event: None
    assert bench.krc.go_on(max_wall_s=60).status == "done"
    assert bench.data("n") == 2
    with pytest.raises(ValueError, match="no mode"):
        bench.krc.change_mode("T9")


def test_a_slow_interpreter_takes_more_time_for_the_same():
    body = "FOR i=1 TO 1000\nn=n+i\nENDFOR"
    fast = done(body, "INT i", data="INT n=0").krc.virtual_time_s
    slow = done(body, "INT i", data="INT n=0", statement_s=1e-3).krc.virtual_time_s
    assert slow > 10 * fast


def test_the_same_seed_gives_the_same_run():
    runs = [done(f"{START}PTP {AWAY}\n$OUT[1]=TRUE\nn=FRAND(0,1000)", data="INT n", seed=4) for _ in range(2)]
    assert runs[0].events == runs[1].events
    assert runs[0].data("n") == runs[1].data("n")


def test_a_program_that_is_not_there_is_named_with_those_that_are():
    bench = Bench("n=1", data="INT n")
    result = bench.krc.run("other", max_wall_s=1)
    assert result.status == "error"
    assert "there are: T" in result.message


def test_a_program_with_a_syntax_error_is_not_started():
    krc = SoftwareKrc({"t.src": b"DEF t()\nx=\nEND\n"}, robot=KR3_R540)
    result = krc.run("t", max_wall_s=1)
    assert (result.status, result.line) == ("error", 2)
    assert "expected an expression" in result.message


# --- submit interpreter ----------------------------------------------------------------------------------------------


def test_the_submit_program_runs_beside_the_selected_one_and_sees_its_data():
    submit = b"DEF sps()\nDECL INT i\nLOOP\nWAIT SEC 0.012\nticks=ticks+1\n$FLAG[9]=$OUT[1]\nENDLOOP\nEND\n"
    krc = SoftwareKrc(
        {
            "sps.sub": submit,
            "t.src": f"DEF t()\n{START}$OUT[1]=TRUE\nWAIT FOR $FLAG[9]\nWAIT SEC 1\nEND\n".encode(),
            "$config.dat": b"DEFDAT $CONFIG\nINT ticks=0\nENDDAT\n",
        },
        robot=KR3_R540,
        submit="sps",
    )
    assert krc.run("t", max_wall_s=60).status == "done"
    ticks = krc.data("", "ticks")
    assert ticks > 50
    assert krc.run("t", max_wall_s=60).status == "done"
    assert krc.data("", "ticks") > ticks
    krc.cancel_submit()


@pytest.mark.parametrize(
    ("command", "status"), [("CANCEL 1", "cancelled"), ("reset 1", "reset"), ("STOP %d", "stopped")]
)
def test_a_submit_program_stops_the_robot_program_by_cwrite(command, status):
    values = ",1" if "%" in command else ""
    submit = (
        "DEF sps()\nDECL STATE_T s\nDECL MODUS_T m\nm=#SYNC\nWAIT SEC 0.1\n"
        f'CWRITE($CMD,s,m,"{command}"{values})\nanswer=s.RET1\nEND\n'
    )
    krc = SoftwareKrc(
        {
            "sps.sub": submit.encode(),
            "t.src": b"DEF t()\nWAIT SEC 5\nEND\n",
            "t.dat": b"DEFDAT t PUBLIC\nDECL GLOBAL CMD_STAT answer\nENDDAT\n",
        },
        robot=KR3_R540,
        submit="sps",
    )
    result = krc.run("t", max_wall_s=60)
    assert (result.status, result.message) == (status, f"{command.replace('%d', '1')} by CWRITE")


@pytest.mark.parametrize("command", ["RUN /R1/CELL()", "STOP 0", "CANCEL 2"])
def test_a_command_that_cannot_be_carried_out_is_refused_and_noted(command):
    bench = done(
        f'm=#SYNC\nCWRITE($CMD,s,m,"{command}")\nanswer=s.RET1',
        "DECL STATE_T s\nDECL MODUS_T m",
        data="DECL CMD_STAT answer",
    )
    assert bench.data("answer") == "#CMD_REJ"
    assert [m.text for m in bench.krc.messages] == [f"{command}: not carried out here"]


@pytest.mark.parametrize(
    ("kind", "declaration", "value", "target"),
    [
        ("Int", "INT v", "0", "v"),
        ("Real", "REAL v", "0.0", "v"),
        ("Bool", "BOOL v", "FALSE", "v"),
        ("Frame", "FRAME v", "$NULLFRAME", "v"),
        ("String", "CHAR v[8]", '" "', "v[]"),
    ],
)
def test_eki_writes_to_no_variable_that_was_never_set(kind, declaration, value, target):
    get = f'RET=EKI_Get{kind}("Ch","A/B",{target})'
    declarations = f"DECL {declaration}\nDECL EKI_STATUS RET"
    result = Bench(get, declarations).run()
    assert (result.status, result.message_number) == ("error", 1422)
    assert "has to be initialised before" in result.message
    assert done(f"{target}={value}\n{get}\nn=RET.MSG_NO", declarations, data="INT n").data("n") == 9


def test_an_error_in_the_submit_program_ends_it_and_not_the_robot():
    krc = SoftwareKrc(
        {"sps.sub": b"DEF sps()\nPTP {A1 0}\nEND\n", "t.src": b"DEF t()\nWAIT SEC 0.1\nEND\n"},
        robot=KR3_R540,
        submit="sps",
    )
    assert krc.run("t", max_wall_s=60).status == "done"
    assert krc.messages[0].originator == "SUBMIT"
    assert "may not move" in krc.messages[0].text


# --- real time -------------------------------------------------------------------------------------------------------


def test_at_a_speed_every_step_of_the_way_is_told():
    class Watcher(Wires):
        def output_changed(self, index, value, tcp):
            pass

    watcher = Watcher()
    assert Bench(f"{START}PTP {AWAY}", io=watcher, speed=50.0).run().status == "done"
    assert len(watcher.places) > 20
    assert watcher.places[-1].as_tuple() == pytest.approx(done(f"{START}PTP {AWAY}").krc.tcp.as_tuple(), abs=1e-6)


def test_after_a_dialog_is_answered_time_runs_free_again():
    bench = Bench('MsgDialog(n,"go on?","cell",,"YES")\nWAIT SEC 1000', data="INT n", dialog=lambda message: 1)
    assert bench.run(max_wall_s=60).status == "done"
    assert bench.krc.virtual_time_s > 1000


def test_an_analog_output_follows_its_expression_until_it_is_switched_off():
    body = """ANOUT ON speed=0.01*level-0.1
WAIT SEC 0.05
level=50
WAIT SEC 0.05
a=$ANOUT[2]
ANOUT OFF speed
level=20
WAIT SEC 0.05
b=$ANOUT[2]"""
    bench = done(body, data="SIGNAL speed $ANOUT[2]\nREAL level=30.0\nREAL a,b")
    assert bench.data("a") == pytest.approx(0.4)
    assert bench.data("b") == pytest.approx(0.4)


def test_an_analog_output_stays_within_its_bounds():
    body = "ANOUT ON out=0.01*level MINIMUM=0.1 MAXIMUM=0.6\n"
    for name, level in (("a", 0), ("b", 30), ("c", 200)):
        body += f"level={level}\nWAIT SEC 0.05\n{name}=$ANOUT[2]\n"
    bench = done(body, data="SIGNAL out $ANOUT[2]\nREAL level=0.0\nREAL a,b,c")
    assert [bench.data(name) for name in "abc"] == pytest.approx([0.1, 0.3, 0.6])


def test_an_analog_output_with_a_delay_comes_so_much_later():
    body = """ANOUT ON out=0.01*level DELAY=0.2
WAIT SEC 0.5
level=50
WAIT SEC 0.15
a=$ANOUT[2]
WAIT SEC 0.1
b=$ANOUT[2]"""
    bench = done(body, data="SIGNAL out $ANOUT[2]\nREAL level=30.0\nREAL a,b")
    assert (bench.data("a"), bench.data("b")) == (pytest.approx(0.3), pytest.approx(0.5))


def test_an_analog_output_ahead_of_its_time_is_refused():
    result = Bench("ANOUT ON out=0.5 DELAY=-0.1", data="SIGNAL out $ANOUT[2]").run()
    assert (result.status, result.message_number) == ("error", 91014)
    assert "DELAY=-0.1" in result.message


def test_continue_is_for_the_condition_behind_it_and_not_for_the_block():
    body = f"{START}PTP {AWAY}\nCONTINUE\nIF NOT $IN[9] THEN\nn=$ROB_TIMER\n$OUT[2]=TRUE\nENDIF"
    bench = done(body, data="INT n")
    assert bench.data("n") < 290
    assert bench.times("$OUT[2]=TRUE")[0] >= 0.5


def test_on_error_proceed_is_for_the_condition_behind_it_and_not_for_the_block():
    body = "ON_ERROR_PROCEED\nIF n==0 THEN\nn=u\nENDIF"
    assert Bench(body, "INT u", data="INT n=0").run().message_number == 1422
    skipped = done("ON_ERROR_PROCEED\nIF u==0 THEN\nn=5\nENDIF\nm=$ERR.NUMBER", "INT u", data="INT n=0,m")
    assert (skipped.data("n"), skipped.data("m")) == (0, 1422)
