"""Does planning hand out only poses that the arm reaches, and say why not?"""

import numpy as np
import pytest

from slabcell.catalogue import Fault
from slabcell.cell.planning import plan
from slabcell.cell.settings import CellSettings
from slabcell.errors import ConfigurationError
from slabcell.geometry import PlanarPose, Polygon, RigidTransform2D
from slabcell.vision.result import ImagePose, LocatedPart, Sigma
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

WIDE = Polygon.from_points([(-2000, -2000), (2000, -2000), (2000, 2000), (-2000, 2000)])
SETTINGS = CellSettings(Frame(200, -200), Frame(220, 100, 0, 5), Frame(z_mm=260), WIDE)


def part(slot: int = 0, pick: tuple[float, float, float] = (50, 40, 0), place: tuple[float, float] = (20, 20)):
    return LocatedPart(
        *(slot, 0.9, 0.1, 1, ImagePose(0, 0, 0), RigidTransform2D(0, 0, 0)),
        *(PlanarPose(*pick), PlanarPose(*place, 0.0), Sigma(0, 0, 0), np.zeros((0, 2))),
    )


def test_both_poses_keep_the_rotation_that_the_part_needs():
    (pair,) = plan([part(pick=(50, 40, 37.0))], 12.0, SETTINGS, KR3_R540).pairs
    assert (pair.place.a_deg - pair.pick.a_deg + 37.0) % 360 == pytest.approx(0, abs=1e-9)
    assert (pair.pick.z_mm, pair.place.z_mm) == (12.0, 12.0)
    assert pair.pick.as_tuple()[4:] == pair.place.as_tuple()[4:] == (0.0, 180.0)


def test_the_arm_reaches_every_planned_pose_with_the_tool_and_from_above():
    rng = np.random.default_rng(3)
    parts = [part(i, tuple(rng.uniform(-100, 300, 3)), tuple(rng.uniform(-100, 300, 2))) for i in range(60)]
    outcome = plan(parts, 10.0, SETTINGS, KR3_R540)
    assert outcome.pairs
    assert outcome.refused
    assert sorted([p.slot for p in outcome.pairs] + [r.slot for r in outcome.refused]) == list(range(60))
    for pair in outcome.pairs:
        for base, pose in ((SETTINGS.pick_base, pair.pick), (SETTINGS.place_base, pair.place)):
            for lift in (0.0, SETTINGS.approach_mm):
                above = Frame(*pose.as_tuple()[:2], pose.z_mm + lift, *pose.as_tuple()[3:])
                axes = KR3_R540.inverse(base @ above @ SETTINGS.tool.inverse())
                tcp = KR3_R540.forward(axes) @ SETTINGS.tool
                assert np.allclose(tcp.matrix, (base @ above).matrix, atol=1e-6)


@pytest.mark.parametrize(("pick", "place"), [((900, 0, 0), (20, 20)), ((50, 40, 0), (900, 0))])
def test_what_is_out_of_reach_is_refused_with_the_distance(pick, place):
    (refused,) = plan([part(pick=pick, place=place)], 10.0, SETTINGS, KR3_R540).refused
    assert refused.fault is Fault.UNREACHABLE
    assert "mm from the A2 axis" in refused.detail


def test_a_grasp_point_outside_of_the_pick_area_is_refused():
    small = Polygon.from_points([(0, 0), (10, 0), (10, 10), (0, 10)])
    settings = CellSettings(SETTINGS.pick_base, SETTINGS.place_base, SETTINGS.tool, small)
    (refused,) = plan([part()], 10.0, settings, KR3_R540).refused
    assert refused.fault is Fault.OUTSIDE_WORKSPACE
    assert "X 50.0 Y 40.0" in refused.detail


def test_the_assembly_in_the_table_follows_from_both_bases():
    point = np.array([[10.0, 20.0]])
    direct = SETTINGS.assembly_in_table.apply(point)[0]
    root = SETTINGS.place_base.matrix @ (10.0, 20.0, 0.0, 1.0)
    through_root = np.linalg.inv(SETTINGS.pick_base.matrix) @ root
    assert direct == pytest.approx(through_root[:2])


def test_bases_that_are_tilted_against_each_other_are_refused():
    with pytest.raises(ConfigurationError, match=r"B 0\.500°"):
        CellSettings(Frame(200, -200), Frame(220, 100, 0, 0, 0.5), Frame(z_mm=260), WIDE)
