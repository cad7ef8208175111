import math
from itertools import pairwise
from xml.etree import ElementTree as ET

import pytest

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.krc.motion import MotionKind, PathLimits, plan_lin, plan_ptp
from slabcell_drivers.krc.path_picture import PathMark, PathPen, PathSegment, draw_path, segment_of
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

SVG = "{http://www.w3.org/2000/svg}"
TOOL = Frame(z_mm=260.0)


def moves() -> list[PathSegment]:
    above = KR3_R540.inverse(Frame(300.0, 0.0, 90.0, 0.0, 0.0, 180.0) @ TOOL.inverse(), status=2)
    ptp = plan_ptp(KR3_R540, (120.0, -90.0, 90.0, 0.0, 90.0, 0.0), above, tool=TOOL)
    lin = plan_lin(KR3_R540, above, Frame(300.0, 0.0, 10.0, 0.0, 0.0, 180.0), PathLimits(), tool=TOOL)
    return [segment_of(ptp), segment_of(lin)]


def test_every_move_is_drawn_in_both_views_to_the_same_scale() -> None:
    root = ET.fromstring(draw_path(moves(), title="job <1>"))  # noqa: S314  our own text
    lines = root.findall(f"{SVG}polyline")
    assert len(lines) == 4
    assert [line.get("stroke-dasharray") is not None for line in lines] == [True, False, True, False]
    down = [tuple(map(float, point.split(","))) for point in lines[3].get("points", "").split()]
    across = [tuple(map(float, point.split(","))) for point in lines[1].get("points", "").split()]
    assert down[-1][1] - down[0][1] == pytest.approx(80.0 * (900 - 100) / (300 + 140 + 40), rel=0.02)
    assert max(abs(x - across[0][0]) + abs(y - across[0][1]) for x, y in across) < 0.2  # straight down, from above
    assert any(text.text == "job <1>" for text in root.iter(f"{SVG}text"))


def test_marks_are_ringed_and_named_in_both_views() -> None:
    text = draw_path(moves(), marks=[PathMark((300.0, 0.0, 10.0), "vacuum on & held")])
    assert text.count("vacuum on &amp; held") == 2


def test_no_move_at_all_gives_an_empty_picture() -> None:
    root = ET.fromstring(draw_path([]))  # noqa: S314  our own text
    assert not root.findall(f"{SVG}polyline")


def test_a_picture_with_too_many_points_is_refused() -> None:
    with pytest.raises(ValueError, match="at most 200000"):
        draw_path([PathSegment(MotionKind.LIN, ((0.0, 0.0, 0.0),) * 200_001)])


def drawn(approximation: str) -> PathPen:
    pen = PathPen()
    source = f"""DEF t()
BAS(#INITMOV,0)
$TOOL=$NULLFRAME
$BASE=$NULLFRAME
$APO.CDIS=20
PTP {{A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0}}
PTP {{X 350,Y -100,Z 400,A 0,B 0,C 180}}
LIN {{X 350,Y 100}} {approximation}
LIN {{X 250,Y 100}}
$OUT[3]=TRUE
END
"""
    krc = SoftwareKrc(
        {"t.src": source.encode()},
        robot=KR3_R540,
        io=pen,
        on_trajectory=pen.begin,
        trace=lambda _event: None,
        trace_kinds=frozenset({"path"}),
    )
    assert krc.run("t", max_wall_s=60).status == "done"
    return pen


def distance_to_corner(pen: PathPen) -> float:
    return min(math.dist(point, (350.0, 100.0, 400.0)) for segment in pen.segments for point in segment.points)


def test_a_pen_follows_the_way_that_the_tool_really_goes() -> None:
    exact, rounded = drawn(""), drawn("C_DIS")
    assert [segment.kind.value for segment in exact.segments] == ["PTP", "PTP", "LIN", "LIN"]
    assert distance_to_corner(exact) < 0.5
    assert 3.0 < distance_to_corner(rounded) < 20.0
    for pen in (exact, rounded):
        assert pen.segments[-1].points[-1] == pytest.approx((250.0, 100.0, 400.0), abs=1e-3)
        (mark,) = pen.marks
        assert (mark.text, mark.position) == ("$OUT[3]=TRUE", pytest.approx((250.0, 100.0, 400.0), abs=1e-3))
        for before, after in pairwise(pen.segments):
            assert before.points[-1] == after.points[0]
