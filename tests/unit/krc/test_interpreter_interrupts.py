"""What interrupts watch and do: conditions with functions, global interrupts, triggers within a routine."""

import pytest

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.robot.arm import KR3_R540

pytestmark = pytest.mark.unit

START = "BAS(#INITMOV,0)\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\n"


def run(body, *, data="", more=""):
    krc = SoftwareKrc(
        {
            "t.src": f"DEF t()\n{body}\nEND\n{more}\n".encode(),
            "t.dat": f"DEFDAT t PUBLIC\n{data}\nENDDAT\n".encode(),
        },
        robot=KR3_R540,
    )
    assert [str(d) for d in krc.diagnostics] == []
    return krc.run("t", max_wall_s=60), krc


HOT = """DEFFCT BOOL hot(limit:IN)
INT limit
IF $IN[3] THEN
RETURN FALSE
ENDIF
RETURN doubled(n)>limit
ENDFCT
DEFFCT INT doubled(x:IN)
INT x
RETURN 2*x
ENDFCT
DEF isr()
fired=fired+1
END"""


def test_the_condition_of_an_interrupt_may_call_functions():
    body = "INTERRUPT DECL 5 WHEN hot(10) DO isr()\nINTERRUPT ON 5\nFOR n=1 TO 9\nWAIT SEC 0.1\nENDFOR\nat=fired"
    result, krc = run(body, data="INT n=0,fired=0,at=0", more=HOT)
    assert (result.status, result.message) == ("done", "")
    assert krc.data("t", "at") == 1


def test_the_condition_is_looked_at_while_the_arm_moves_and_does_not_wait_for_it():
    body = f"""INTERRUPT DECL 5 WHEN hot(-1) DO isr()
{START}n=-5
INTERRUPT ON 5
PTP {{A1 90}}
CONTINUE
n=1
WAIT SEC 0
"""
    more = HOT.replace("fired=fired+1", "fired=fired+1\nat=$AXIS_ACT.A1")
    result, krc = run(body, data="INT n=0,fired=0\nREAL at=-1.0", more=more)
    assert (result.status, result.message) == ("done", "")
    assert krc.data("t", "fired") == 1
    assert krc.data("t", "at") < 60


def test_a_function_in_a_condition_that_waits_stops_the_program_with_a_message():
    more = "DEFFCT BOOL slow()\nWAIT SEC 1\nRETURN TRUE\nENDFCT\nDEF isr()\nEND"
    result, _ = run("INTERRUPT DECL 5 WHEN slow() DO isr()\nINTERRUPT ON 5\nWAIT SEC 1", more=more)
    assert (result.status, result.message_number) == ("error", 91014)
    assert "waits" in result.message


def test_a_routine_that_sets_its_timer_back_is_called_again_however_short_the_time():
    body = """INTERRUPT DECL 16 WHEN $TIMER_FLAG[1]==TRUE DO again()
INTERRUPT ON 16
$TIMER[1]=-50
$TIMER_STOP[1]=FALSE
WAIT SEC 1.0
"""
    result, krc = run(body, data="INT n=0", more="DEF again()\nn=n+1\n$TIMER[1]=-5\nEND")
    assert result.status == "done"
    assert krc.data("t", "n") > 50


def test_a_global_interrupt_cannot_resume():
    body = "GLOBAL INTERRUPT DECL 5 WHEN $FLAG[1] DO isr()\nINTERRUPT ON 5\nsub()"
    result, _ = run(body, more="DEF sub()\n$FLAG[1]=TRUE\nWAIT SEC 1\nEND\nDEF isr()\nBRAKE\nRESUME\nEND")
    assert (result.message_number, result.message) == (72, "RESUME inadmissible for global interrupts: interrupt 5")


def test_a_trigger_has_no_place_in_an_interrupt_routine():
    body = f"INTERRUPT DECL 5 WHEN $FLAG[1] DO isr()\n{START}INTERRUPT ON 5\n$FLAG[1]=TRUE\nWAIT SEC 1"
    more = "DEF isr()\nTRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE\nPTP {A1 5}\nEND"
    result, _ = run(body, more=more)
    assert result.message_number == 1409
