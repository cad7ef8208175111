"""Is every slab laid where it can still give way?"""

import itertools

import numpy as np
import pytest

from slabcell.cell.laying import LayingOrder
from slabcell.geometry import Polygon, RigidTransform2D

pytestmark = pytest.mark.unit


def tile(x: float, y: float, w: float = 40.0, h: float = 30.0) -> Polygon:
    return Polygon.from_points([(x, y), (x + w, y), (x + w, y + h), (x, y + h)])


def grid(columns: int, rows: int) -> list[Polygon]:
    return [tile(40.0 * i, 30.0 * j) for i, j in itertools.product(range(columns), range(rows))]


def never_pinched(order: LayingOrder, sequence: list[int], laid: set[int]) -> bool:
    lies = set(laid)
    for slot in sequence:
        if order.pinched(slot, lies):
            return False
        lies.add(slot)
    return True


@pytest.mark.parametrize(("columns", "rows"), [(1, 5), (5, 1), (3, 3), (6, 4)])
def test_no_slab_of_a_grid_is_ever_pinched(columns, rows):
    order = LayingOrder(grid(columns, rows))
    sequence = order.order(range(columns * rows), ())
    assert sorted(sequence) == list(range(columns * rows))
    assert never_pinched(order, sequence, set())


def test_it_goes_on_from_what_lies_already():
    order = LayingOrder(grid(5, 1))
    assert order.order([0, 3, 4], {1, 2}) in ([0, 3, 4], [3, 0, 4], [3, 4, 0])
    assert order.pinched(1, {0, 2})


def test_a_gap_between_two_is_seen_as_pinched_whichever_way_the_template_is_turned():
    for angle in range(0, 360, 17):
        slots = [slot.transformed(RigidTransform2D(angle, 3.0, -7.0)) for slot in grid(3, 1)]
        order = LayingOrder(slots)
        assert order.pinched(1, {0, 2})
        assert not order.pinched(1, {0})
        assert not order.pinched(0, {1, 2})


def test_slots_that_are_apart_do_not_hinder_each_other():
    order = LayingOrder([tile(0, 0), tile(50, 0), tile(100, 0)])
    assert not order.pinched(1, {0, 2})
    assert order.order([2, 0, 1], ()) == [0, 1, 2]


def test_slots_that_meet_at_a_corner_only_are_no_neighbours():
    order = LayingOrder([tile(0, 0), tile(40, 30), tile(80, 60)])
    assert not order.pinched(1, {0, 2})


def test_the_shipped_templates_can_be_laid_without_pinching():
    from importlib.resources import files

    from slabcell.template import parse_template

    for item in sorted((files("slabcell") / "data" / "config" / "templates").iterdir(), key=lambda entry: entry.name):
        slots = parse_template(item.read_bytes(), item.name).slots
        order = LayingOrder(slots)
        sequence = order.order(range(len(slots)), ())
        pinched = sum(order.pinched(slot, set(sequence[:index])) for index, slot in enumerate(sequence))
        assert pinched <= np.floor(0.1 * len(slots)), item.name
