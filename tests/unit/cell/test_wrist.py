"""Does the search find what trying every way finds?"""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slabcell.cell.planning import TOOL_TURNS_DEG
from slabcell.cell.wrist import least_turn

pytestmark = pytest.mark.unit

ANGLES = st.floats(-180, 180) | st.sampled_from([0.0, 90.0, 180.0, -90.0, 1e-9])


def whole_turns(angle, low, high):
    first, last = math.ceil((low - angle) / 360.0), math.floor((high - angle) / 360.0)
    return [angle + 360.0 * k for k in range(first, last + 1)]


def one_after_the_other(at_pick, at_places, turns, limits, before):
    low, high = limits
    ways = []
    for way, at_place in enumerate(at_places):
        for number, turn in enumerate(turns):
            for pick in whole_turns(at_pick + turn, low, high):
                for move in whole_turns(at_place - at_pick, low - high, high - low):
                    if low <= pick + move <= high:
                        travel = abs(pick - (pick if before is None else before)) + abs(move)
                        ways.append((travel, abs(turn), way, number, pick + move))
    _, _, way, number, last = min(ways)
    return way, number, last


@given(
    ANGLES,
    st.lists(ANGLES, min_size=1, max_size=12),
    st.sampled_from([TOOL_TURNS_DEG, (0.0,), (0.0, 180.0, 90.0, -90.0)]),
    st.sampled_from([(-350.0, 350.0), (-358.0, 358.0), (-180.0, 180.0), (-1000.0, 400.0)]),
    st.none() | st.floats(-350, 350),
)
def test_the_least_turn_is_the_one_that_trying_every_way_finds(at_pick, at_places, turns, limits, before):
    found = least_turn(at_pick, at_places, turns, limits, before)
    assert found == one_after_the_other(at_pick, at_places, turns, limits, before)
