"""Planar values: motions compose, invert and turn polygons without changing them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slabcell.geometry import PlanarPose, Polygon, RigidTransform2D, normalize_deg

pytestmark = pytest.mark.unit

angles = st.floats(-1e4, 1e4)
lengths = st.floats(-1e4, 1e4)
motions = st.builds(RigidTransform2D, angles, lengths, lengths)
POINTS = np.array([[0.0, 0.0], [88.0, 0.0], [88.0, 50.0], [10.0, 20.0]])


@given(angles)
def test_a_normalized_angle_is_the_same_direction_in_half_a_turn(angle: float) -> None:
    result = normalize_deg(angle)
    assert -180.0 < result <= 180.0
    assert np.cos(np.deg2rad(result)) == pytest.approx(np.cos(np.deg2rad(angle)), abs=1e-9)


@given(motions, motions)
def test_composition_is_one_motion_after_the_other(first: RigidTransform2D, then: RigidTransform2D) -> None:
    assert np.allclose((then @ first).apply(POINTS), then.apply(first.apply(POINTS)), atol=1e-6)


@given(motions)
def test_the_inverse_undoes_a_motion(motion: RigidTransform2D) -> None:
    assert np.allclose(motion.inverse().apply(motion.apply(POINTS)), POINTS, atol=1e-6)


@given(motions)
def test_a_pose_moves_as_its_origin_and_its_x_axis_do(motion: RigidTransform2D) -> None:
    pose = PlanarPose(3.0, 4.0, 30.0)
    moved = motion.apply_pose(pose)
    tip = np.array([3.0, 4.0]) + 5.0 * np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    direction = np.deg2rad(moved.a_deg)
    assert np.allclose(
        motion.apply(tip), [moved.x_mm + 5.0 * np.cos(direction), moved.y_mm + 5.0 * np.sin(direction)], atol=1e-6
    )


@given(motions)
def test_a_polygon_keeps_its_area_and_perimeter_when_it_moves(motion: RigidTransform2D) -> None:
    polygon = Polygon.from_points(POINTS)
    moved = polygon.transformed(motion)
    assert moved.area_mm2 == pytest.approx(polygon.area_mm2, rel=1e-6)
    assert moved.perimeter_mm == pytest.approx(polygon.perimeter_mm, rel=1e-9)
    assert np.allclose(moved.centroid, motion.apply(polygon.centroid), atol=1e-4)


def test_clockwise_points_become_counter_clockwise() -> None:
    assert Polygon.from_points(POINTS[::-1]).area_mm2 == pytest.approx(Polygon.from_points(POINTS).area_mm2)


def test_two_points_are_no_polygon() -> None:
    with pytest.raises(ValueError, match="at least three"):
        Polygon.from_points([[0, 0], [1, 1]])


@pytest.mark.parametrize("points", [[(0, 0), (4, 0), (8, 0)], [(1, 2)] * 3], ids=["a line", "a point"])
def test_the_centre_of_what_encloses_no_area_is_that_of_its_vertices(points: list[tuple[float, float]]) -> None:
    polygon = Polygon.from_points(points)
    assert polygon.area_mm2 == 0
    assert polygon.centroid == pytest.approx(np.mean(points, axis=0))
