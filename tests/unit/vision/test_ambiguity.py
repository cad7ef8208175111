import numpy as np
import pytest

from slabcell.geometry import Polygon, RigidTransform2D
from slabcell.vision.ambiguity import Explanation, doubts, kinds_of

from .pictures import KITE, L_SHAPE, RECTANGLE, SQUARE

pytestmark = pytest.mark.unit

ALL = {0, 1, 2}
DIFFERENT = (0, 1, 2)
NO_SYMMETRY = (1, 1, 1)


def doubt(explanations, assigned, *, kinds=DIFFERENT, orders=NO_SYMMETRY, free=ALL, lead=0.05):
    return doubts(explanations, assigned, kinds=kinds, orders=orders, free=free, min_lead_mm=lead)


def test_a_blob_with_one_explanation_is_sure():
    assert doubt([Explanation(0, 0, 10.0, 0.02)], {0: 0}) == {}


def test_two_slots_that_explain_a_blob_about_as_well_are_a_doubt_with_its_number():
    found = doubt([Explanation(0, 0, 10.0, 0.030), Explanation(0, 1, 10.0, 0.032)], {0: 0})
    assert found == {0: "fits slot 0 and slot 1 alike: 0.011 mm tell them apart, 0.050 mm are needed"}


def test_a_slot_that_explains_it_clearly_worse_is_no_doubt():
    assert doubt([Explanation(0, 0, 10.0, 0.03), Explanation(0, 1, 10.0, 0.12)], {0: 0}) == {}


def test_a_bad_fit_needs_a_larger_lead():
    near = [Explanation(0, 0, 10.0, 0.30), Explanation(0, 1, 10.0, 0.33)]
    assert "0.137 mm tell them apart, 0.150 mm are needed" in doubt(near, {0: 0})[0]


def test_slots_of_the_same_outline_are_no_doubt():
    same = [Explanation(0, 0, 10.0, 0.03), Explanation(0, 1, 10.0, 0.03)]
    assert doubt(same, {0: 0}, kinds=(0, 0, 1)) == {}


def test_a_slot_that_is_filled_already_is_no_doubt():
    near = [Explanation(0, 0, 10.0, 0.03), Explanation(0, 1, 10.0, 0.03)]
    assert doubt(near, {0: 0}, free={0, 2}) == {}


def test_a_rotation_that_explains_it_as_well_is_a_doubt_unless_it_looks_alike():
    turned = [Explanation(0, 0, 10.0, 0.03), Explanation(0, 0, -170.0, 0.03)]
    assert "turned by 180°" in doubt(turned, {0: 0})[0]
    assert doubt(turned, {0: 0}, orders=(2, 1, 1)) == {}
    assert doubt([Explanation(0, 0, 10.0, 0.03), Explanation(0, 0, 11.0, 0.03)], {0: 0}) == {}


def test_another_slabs_claim_to_the_other_slot_settles_the_doubt():
    both = [Explanation(0, 0, 0.0, 0.03), Explanation(0, 1, 0.0, 0.03), Explanation(1, 1, 0.0, 0.03)]
    # Blob 1 can be nothing but slot 1, so blob 0 is slot 0.
    assert doubt(both, {0: 0, 1: 1}) == {}
    # If it could be slot 0 as well, both might have to change places.
    assert set(doubt([*both, Explanation(1, 0, 0.0, 0.03)], {0: 0, 1: 1})) == {0, 1}
    # But not if that would fit clearly worse.
    assert doubt([*both, Explanation(1, 0, 0.0, 0.20)], {0: 0, 1: 1}) == {}


def test_kinds_are_the_same_for_outlines_that_a_turn_lays_over_each_other():
    def placed(shape, turn, x, y):
        return Polygon.from_points(RigidTransform2D(turn, x, y).apply(np.array(shape, float)))

    mirrored = [(-x, y) for x, y in L_SHAPE]
    split = [(0, 0), (40, 0), (80, 0), (80, 40), (0, 40)]  # the rectangle, one point more on an edge
    slots = [
        placed(L_SHAPE, 0, 0, 0),
        placed(L_SHAPE, 77, 300, 5),
        placed(mirrored, 0, 600, 0),
        placed(RECTANGLE, 0, 0, 300),
        placed(split, 90, 300, 300),
        placed(SQUARE, 0, 600, 300),
        placed(KITE, 0, 0, 600),
        placed([(0, 0), (80.6, 0), (80.6, 40), (0, 40)], 0, 300, 600),
    ]
    assert kinds_of(slots, 0.05) == (0, 0, 1, 2, 2, 3, 4, 5)
