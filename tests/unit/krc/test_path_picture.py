from xml.etree import ElementTree as ET

import pytest

from slabcell_drivers.krc.motion import MotionKind, PathLimits, plan_lin, plan_ptp
from slabcell_drivers.krc.path_picture import PathMark, PathSegment, draw_path, segment_of
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
