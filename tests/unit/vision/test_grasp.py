import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from slabcell.geometry import Polygon, RigidTransform2D
from slabcell.recipe import ForbiddenZone, GraspParameters
from slabcell.vision.grasp import choose_grasp

pytestmark = pytest.mark.unit

SQUARE = Polygon.from_points([(0, 0), (50, 0), (50, 50), (0, 50)])
L_SHAPE = Polygon.from_points([(0, 0), (90, 0), (90, 14), (14, 14), (14, 90), (0, 90)])


def seats(parameters: GraspParameters, point: np.ndarray, turn_deg: float) -> list[shapely.Point]:
    return [
        shapely.Point(x, y)
        for x, y in RigidTransform2D(turn_deg, float(point[0]), float(point[1])).apply(np.array(parameters.cups_mm))
    ]


def test_a_cup_that_fits_everywhere_goes_to_the_centre_of_mass():
    grasp = choose_grasp(SQUARE, GraspParameters(cup_radius_mm=5, margin_mm=2))
    assert grasp.point == pytest.approx([25, 25])
    assert grasp.clearance_mm == pytest.approx(25)
    assert grasp.lever_mm == 0


def test_where_the_centre_of_mass_is_beside_the_slab_the_cup_still_lies_on_it():
    grasp = choose_grasp(L_SHAPE, GraspParameters(cup_radius_mm=4, margin_mm=1))
    assert not L_SHAPE.shape.contains(shapely.Point(*L_SHAPE.centroid))
    assert L_SHAPE.shape.contains(shapely.Point(*grasp.point).buffer(5.0))
    assert grasp.clearance_mm >= 5.0


def test_a_slab_too_narrow_for_the_cup_is_refused_with_both_radii():
    grasp = choose_grasp(L_SHAPE, GraspParameters(cup_radius_mm=9, margin_mm=1))
    assert grasp.point is None
    assert "10.0 mm" in grasp.refusal
    assert "8.2 mm" in grasp.refusal or "8.1 mm" in grasp.refusal


def test_forbidden_zones_are_kept_clear():
    zone = ForbiddenZone(polygon=[(20, 20), (30, 20), (30, 30), (20, 30)])
    parameters = GraspParameters(cup_radius_mm=4, margin_mm=1, forbidden=[zone])
    grasp = choose_grasp(SQUARE, parameters)
    assert shapely.Point(*grasp.point).distance(shapely.Polygon(zone.polygon)) >= 5.0
    other = choose_grasp(SQUARE, GraspParameters(forbidden=[zone.model_copy(update={"slot": 3})]), number=2)
    assert other.point == pytest.approx([25, 25])


def test_a_zone_over_the_whole_slab_is_said():
    zone = ForbiddenZone(polygon=[(-1, -1), (60, -1), (60, 60), (-1, 60)])
    assert "cover the whole slab" in choose_grasp(SQUARE, GraspParameters(forbidden=[zone])).refusal


def test_several_cups_are_turned_until_they_fit():
    bar = Polygon.from_points(RigidTransform2D(90, 0, 0).apply(np.array([(0, 0), (80, 0), (80, 12), (0, 12)])))
    parameters = GraspParameters(cup_radius_mm=4, margin_mm=1, cups_mm=[(-25, 0), (25, 0)])
    grasp = choose_grasp(bar, parameters)
    assert abs(grasp.turn_deg) == 90
    for seat in seats(parameters, grasp.point, grasp.turn_deg):
        assert bar.shape.contains(seat.buffer(5.0))


def test_cups_that_fit_one_by_one_but_not_together_are_refused():
    grasp = choose_grasp(SQUARE, GraspParameters(cups_mm=[(-40, 0), (40, 0)]))
    assert grasp.point is None
    assert "in any rotation" in grasp.refusal


@settings(max_examples=60, deadline=None)
@given(
    radii=st.lists(st.floats(8, 60), min_size=4, max_size=12),
    cup=st.floats(1, 15),
    margin=st.floats(0, 4),
    spread=st.floats(0, 20),
)
def test_whatever_the_outline_every_cup_lies_on_the_slab_or_it_is_refused(
    radii: list[float], cup: float, margin: float, spread: float
):
    angle = np.arange(len(radii)) * 2 * np.pi / len(radii)
    outline = np.array(radii)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    slot = Polygon.from_points(outline)
    parameters = GraspParameters(cup_radius_mm=cup, margin_mm=margin, cups_mm=[(-spread, 0), (spread, 0)])
    grasp = choose_grasp(slot, parameters)
    if grasp.point is None:
        assert grasp.refusal
        return
    for seat in seats(parameters, grasp.point, grasp.turn_deg):
        assert slot.shape.buffer(1e-4).contains(seat.buffer(cup + margin))
