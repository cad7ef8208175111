import itertools

import numpy as np
import pytest
import shapely

from slabcell_drivers.simulation.layout import LayoutError, posed, strew

pytestmark = pytest.mark.unit

SQUARE = np.array([[-10.0, -10.0], [10.0, -10.0], [10.0, 10.0], [-10.0, 10.0]])


def test_slabs_that_hardly_fit_are_laid_out_in_shelves_and_still_keep_their_distance() -> None:
    area = shapely.box(0, 0, 100, 100)
    bodies = [SQUARE] * 14  # in rows of 4, 4 mm apart

    poses = strew(bodies, area, 4.0, np.random.default_rng(0))

    shapes = [posed(body, pose) for body, pose in zip(bodies, poses, strict=True)]
    assert all(area.contains(shape) for shape in shapes)
    assert min(a.distance(b) for a, b in itertools.combinations(shapes, 2)) >= 4.0
    assert len({round(pose[2], 3) for pose in poses}) > 1  # shaken, not just set out


@pytest.mark.parametrize("count", [17, 30])  # too many for the rows, too many for the area
def test_slabs_that_cannot_fit_are_refused_with_what_to_change(count: int) -> None:
    with pytest.raises(
        LayoutError, match=r"mm², 4 mm apart, do not fit into the pick area of 10000 mm²: make it larger"
    ):
        strew([SQUARE] * count, shapely.box(0, 0, 100, 100), 4.0, np.random.default_rng(0))


def test_no_slab_at_all_is_laid_out_too() -> None:
    assert strew([], shapely.box(0, 0, 10, 10), 4.0, np.random.default_rng(0)) == []
