import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from slabcell_drivers.simulation.coverage import Window, cover

pytestmark = pytest.mark.unit

coordinate = st.floats(-4.0, 14.0).map(lambda value: round(value, 3))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=3))
def test_each_pixel_gets_the_exact_share_that_a_triangle_covers(corners: list[tuple[float, float]]) -> None:
    window = Window(-2, 1, 11, 9)
    triangle = shapely.Polygon(corners)

    shares = cover([np.array(corners)], window)

    boxes = shapely.box(
        *np.broadcast_arrays(
            np.arange(-2, 9)[None, :] - 0.5, np.arange(1, 10)[:, None] - 0.5,
            np.arange(-2, 9)[None, :] + 0.5, np.arange(1, 10)[:, None] + 0.5,
        )
    )  # fmt: skip
    assert np.allclose(shares, shapely.area(shapely.intersection(triangle, boxes)), atol=1e-6)


def test_a_hole_is_left_out_and_disjoint_outlines_add_up() -> None:
    ring = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]])
    hole = np.array([[2.0, 2.0], [2.0, 6.0], [6.0, 6.0], [6.0, 2.0]])
    beside = ring + np.array([8.0, 0.0])

    shares = cover([ring, hole, beside], Window(-1, -1, 20, 12))

    assert shares.sum() == pytest.approx(64 - 16 + 64)
    assert shares.max() == pytest.approx(1.0)
    assert shares[5, 5] == pytest.approx(0.0, abs=1e-9)


def test_what_lies_left_of_the_window_still_counts_for_the_pixels_inside() -> None:
    wide = np.array([[-1000.0, -0.5], [3.0, -0.5], [3.0, 1.5], [-1000.0, 1.5]])

    shares = cover([wide], Window(0, 0, 6, 3))

    assert np.allclose(shares, [[1, 1, 1, 0.5, 0, 0], [1, 1, 1, 0.5, 0, 0], [0, 0, 0, 0, 0, 0]])


def test_a_window_out_of_view_is_none() -> None:
    assert Window.around([np.array([[50.0, 5.0], [60.0, 5.0], [55.0, 9.0]])], 40, 40) is None
    assert Window.around([], 40, 40) is None
