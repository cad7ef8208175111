import numpy as np
import pytest

from slabcell.geometry import RigidTransform2D
from slabcell.recipe import MatchingParameters
from slabcell.vision.classic import classic_distances, hu_moments
from slabcell.vision.describe import describe_polygons
from slabcell.vision.matching import Candidate, MatchLimits, assign, find_candidates
from slabcell.vision.symmetry import symmetry_order

from .pictures import L_SHAPE, RECTANGLE, SHAPES, moved, recipe

pytestmark = pytest.mark.unit

SLOTS = describe_polygons([np.array(shape, float) for shape in SHAPES])
ORDERS = [1] * len(SHAPES)


def candidates(outlines: list[np.ndarray], limit_mm: float = 2.0) -> list[Candidate]:
    limits = MatchLimits(np.full(len(SHAPES), limit_mm), ORDERS, margin_mm=0.3, floor_mm=0.05, area=0.12)
    return find_candidates(describe_polygons(outlines), SLOTS, limits)


@pytest.mark.parametrize("turn_deg", [0, 31, 90, -123.4, 179.9])
@pytest.mark.parametrize("slot", [0, 3, 4])
def test_an_outline_is_found_as_its_slot_with_its_motion(turn_deg: float, slot: int):
    motion = RigidTransform2D(turn_deg, 33.0, -12.0)
    outline = motion.apply(np.array(SHAPES[slot], float))
    best = min(candidates([np.roll(outline, 1, axis=0)]), key=lambda item: item.distance_mm)
    assert best.slot == slot
    assert best.distance_mm < 0.3
    assert abs((best.motion.rotation_deg - turn_deg + 180) % 360 - 180) < 0.5


def test_a_mirror_image_has_no_candidate():
    assert candidates([np.array(L_SHAPE, float)[::-1] * (-1.0, 1.0)]) == []


def test_a_rectangle_has_both_its_rotations_unless_they_look_alike():
    outline = [np.array(RECTANGLE, float)]
    turns = sorted(round(item.motion.rotation_deg) % 360 for item in candidates(outline) if item.slot == 1)
    assert turns == [0, 180]


def test_the_assignment_fills_as_many_as_possible_at_least_cost():
    cost = np.array([[1.0, 2.0, np.inf], [1.0, np.inf, np.inf], [np.inf, np.inf, np.inf]])
    assert sorted(assign(cost)) == [(0, 1), (1, 0)]
    assert assign(np.full((2, 3), np.inf)) == []
    assert assign(np.zeros((0, 3))) == []


@pytest.mark.parametrize(
    ("corners", "order"),
    [(4, 4), (3, 3), (6, 6), (5, 5), (12, 12)],
)
def test_regular_polygons_have_the_symmetry_of_their_corners(corners: int, order: int):
    angle = np.arange(corners) * 2 * np.pi / corners
    shape = moved(40 * np.column_stack([np.cos(angle), np.sin(angle)]), 7, 9)
    product = recipe([[tuple(point) for point in shape]])
    assert symmetry_order(product.template.slots[0], 0.05) == order


def test_a_small_notch_breaks_the_symmetry():
    notched = [(0, 0), (40, 0), (40, 40), (21, 40), (20, 38), (19, 40), (0, 40)]
    assert symmetry_order(recipe([notched]).template.slots[0], 0.05) == 1


def test_hu_moments_do_not_change_with_place_turn_and_size():
    shape = np.array(L_SHAPE, float)
    changed = RigidTransform2D(77, 5, 6).apply(1.7 * shape)
    first, second = hu_moments(describe_polygons([shape, changed]))
    assert second[:4] == pytest.approx(first[:4], rel=0.03)


@pytest.mark.parametrize("method", ["hu", "polygon"])
def test_the_classic_methods_find_every_shape_nearest_to_itself(method: str):
    turned = [RigidTransform2D(25, 3, 4).apply(np.array(shape, float)) for shape in SHAPES]
    parameters = MatchingParameters.model_validate({"method": method})
    distance = classic_distances(describe_polygons(turned), SLOTS, parameters)
    assert np.argmin(distance, axis=1).tolist() == list(range(len(SHAPES)))
    assert np.isfinite(distance.min(axis=1)).all()


def test_polygons_of_the_same_sides_are_told_apart_by_their_angles():
    rectangle = np.array([(0, 0), (80, 0), (80, 40), (0, 40)], float)
    leaning = np.array(
        [(0, 0), (80, 0), (80 + 40 * np.sin(0.2), 40 * np.cos(0.2)), (40 * np.sin(0.2), 40 * np.cos(0.2))]
    )
    both = describe_polygons([rectangle, leaning])
    distance = classic_distances(both, both, MatchingParameters(method="polygon"))
    assert np.isfinite(distance).tolist() == [[True, False], [False, True]]
    loose = MatchingParameters(method="polygon", max_angle_difference_deg=20.0)
    assert np.isfinite(classic_distances(both, both, loose)).all()
