"""What the system variables say of the controller and its arm, while a program runs."""

import pytest

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.robot.arm import KR3_R540

pytestmark = pytest.mark.unit


def controller(body, data=""):
    return SoftwareKrc(
        {
            "t.src": f"DEF t()\n{body}\nEND\n".encode(),
            "t.dat": f"DEFDAT t PUBLIC\n{data}\nENDDAT\n".encode(),
        },
        robot=KR3_R540,
    )


def ran(body, data=""):
    krc = controller(body, data)
    assert [str(d) for d in krc.diagnostics] == []
    result = krc.run("t", max_wall_s=60)
    assert (result.status, result.message) == ("done", "")
    return krc


MOTION = """BAS(#INITMOV,0)
$TOOL=$NULLFRAME
$BASE=$NULLFRAME
BAS(#VEL_CP,0.1)
PTP {A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0}
"""


def test_the_mode_of_operation_has_a_bit_for_each_key_position():
    data = "DECL BOOL a\nDECL BOOL b\nDECL BOOL c\nDECL BOOL d"
    krc = controller("a=$T1\nb=$T2\nc=$AUT\nd=$EXT", data)
    for mode, bits in (("T1", "a"), ("T2", "b"), ("AUT", "c"), ("EX", "d")):
        krc.change_mode(mode)
        assert krc.run("t", max_wall_s=60).status == "done"
        assert [name for name in "abcd" if krc.data("t", name)] == [bits]


def test_a_moving_robot_says_so_and_how_fast():
    data = "DECL BOOL before\nDECL BOOL during\nDECL BOOL act\nDECL REAL speed\nDECL REAL axis\nDECL REAL rest"
    krc = ran(
        MOTION
        + "WAIT SEC 0\nCONTINUE\nbefore=$PRO_MOVE\n"
        + "INTERRUPT DECL 10 WHEN $FLAG[1] DO look()\nINTERRUPT ON 10\n"
        + "TRIGGER WHEN PATH=50 ONSTART DELAY=0 DO $FLAG[1]=TRUE\n"
        + "SLIN_REL {Y 100}\nWAIT SEC 0\nrest=$VEL_ACT\nEND\n"
        + "DEF look()\nCONTINUE\nduring=$PRO_MOVE\nCONTINUE\nact=$PRO_ACT\nspeed=$VEL_ACT\naxis=$VEL_AXIS_ACT[1]",
        data,
    )
    assert (krc.data("t", "before"), krc.data("t", "during"), krc.data("t", "act")) == (False, True, True)
    assert krc.data("t", "speed") == pytest.approx(0.1, rel=0.02)
    assert krc.data("t", "axis") != 0.0
    assert krc.data("t", "rest") == 0.0


def test_home_is_where_every_axis_is_near_the_home_position():
    data = "DECL BOOL unset\nDECL BOOL home\nDECL BOOL away"
    krc = ran(
        "BAS(#INITMOV,0)\nunset=$IN_HOME\n$H_POS=XHOME\nPTP XHOME\nhome=$IN_HOME\nPTP_REL {A6 2}\naway=$IN_HOME", data
    )
    assert (krc.data("t", "unset"), krc.data("t", "home"), krc.data("t", "away")) == (False, True, False)


def test_the_robot_has_a_name_and_a_number_of_inputs_and_outputs():
    data = "DECL CHAR name[24]\nDECL CHAR trafo[32]\nDECL INT inputs\nDECL INT outputs"
    krc = ran("name[]=$ROBNAME[]\ntrafo[]=$ROBTRAFO[]\ninputs=$NUM_IN\noutputs=$NUM_OUT", data)
    assert (krc.data("t", "name"), krc.data("t", "trafo")) == ("KR 3 R540", "#KR 3 R540")
    assert (krc.data("t", "inputs"), krc.data("t", "outputs")) == (8192, 8192)
