"""The values of data lists come back into their files."""

import pytest

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.robot.arm import KR3_R540

pytestmark = pytest.mark.unit

DATA = b"""&ACCESS RV\r
DEFDAT t PUBLIC\r
INT n=1,m = 2 , k ; three\r
DECL FRAME f={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0} ; a place, {here}\r
DECL FRAME g\r
CONST INT limit=5\r
CHAR name[12]="first; name"\r
CHAR rows[2,8]\r
rows[1,]="one"\r
INT a[3]\r
a[2]=20 ; the second\r
BOOL b=FALSE\r
ENUM lamp_t red,green\r
DECL lamp_t lamp=#red\r
ENDDAT\r
"""
PROGRAM = b"""DEF t()
n=n+10
k=7
f.X=9.5
g=f
name[]="second"
rows[2,]="two"
a[1]=-1
a[2]=a[2]+1
b=TRUE
lamp=#green
END
"""


def controller(data):
    return SoftwareKrc({"t.src": PROGRAM, "t.dat": data}, robot=KR3_R540)


def test_a_file_that_nothing_was_stored_in_stays_as_it_is_but_for_the_form_of_numbers():
    (text,) = controller(DATA).data_files().values()
    assert text.replace(b"m =2", b"m = 2").decode().split("\r\n")[:3] == DATA.decode().split("\r\n")[:3]
    assert len(text.split(b"\r\n")) == len(DATA.split(b"\r\n"))


def test_values_outlast_the_controller_that_stored_them():
    first = controller(DATA)
    assert first.run("t", max_wall_s=60).status == "done"
    (kept,) = first.data_files().values()
    assert b"; a place, {here}" in kept
    assert b"a[2]=21 ; the second" in kept
    second = controller(kept)
    assert [str(d) for d in second.diagnostics] == []
    for name, value in {
        "n": 11,
        "m": 2,
        "k": 7,
        "name": "second",
        "rows": ["one", "two"],
        "a": [-1, 21, None],
        "b": True,
        "lamp": "#GREEN",
    }.items():
        assert second.data("t", name) == value
    assert second.data("t", "g").as_tuple() == (9.5, 2, 3, 0, 0, 0)
    assert second.run("t", max_wall_s=60).status == "done"
    assert second.data("t", "n") == 21


def test_writing_back_twice_changes_nothing_more():
    first = controller(DATA)
    first.run("t", max_wall_s=60)
    (once,) = first.data_files().values()
    (twice,) = controller(once).data_files().values()
    assert twice == once
