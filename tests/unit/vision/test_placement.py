import numpy as np
import pytest

from slabcell.errors import CalibrationError
from slabcell.geometry import Points, RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.vision.placement import SlotPlacement, measure_placement

from .pictures import calibration, recipe, render

pytestmark = pytest.mark.unit

CAMERA = calibration()
# Two by two slabs that touch; the joints are 0.4 mm wide.
GRID = [[(x, y), (x + 60, y), (x + 60, y + 50), (x, y + 50)] for y in (0, 50) for x in (0, 60)]
JOINT_MM = 0.4
IN_TABLE = RigidTransform2D(7.0, -50.0, -40.0)


def product() -> Recipe:
    from slabcell.geometry import Polygon
    from slabcell.template import Template

    return Recipe.from_template(Template("grid", tuple(Polygon.from_points(slot) for slot in GRID), ""), 0.0)


def laid(moves: dict[int, tuple[float, float, float]]) -> list[Points]:
    """Return the outlines on the table of the slabs in these slots, each moved (mm, mm, degrees) from nominal."""
    outlines: list[Points] = []
    for slot, (dx, dy, da) in moves.items():
        body = np.array(GRID[slot], float)
        centre = body.mean(axis=0)
        smaller = centre + (body - centre) * (1 - JOINT_MM / np.array([60.0, 50.0]))
        turn = RigidTransform2D(da, 0.0, 0.0)
        outlines.append(IN_TABLE.apply(turn.apply(smaller - centre) + centre + np.array([dx, dy])))
    return outlines


def measure(moves: dict[int, tuple[float, float, float]]) -> tuple[SlotPlacement, ...]:
    picture = render(CAMERA, laid(moves))
    return measure_placement(picture, CAMERA, product(), assembly_in_table=IN_TABLE, slots=range(4))


def test_every_slab_is_measured_against_its_slot():
    moves = {0: (-0.3, -0.2, 0.1), 1: (0.2, 0.0, -0.1), 2: (0.0, 0.25, 0.0), 3: (0.1, 0.3, 0.2)}
    for found in measure(moves):
        assert found.found
        assert found.measured
        dx, dy, da = moves[found.slot]
        assert (found.dx_mm, found.dy_mm) == pytest.approx((dx, dy), abs=0.06)
        assert found.da_deg == pytest.approx(da, abs=0.08)


def test_an_empty_slot_is_not_found():
    result = measure({0: (0, 0, 0), 1: (0, 0, 0), 3: (0, 0, 0)})
    assert [item.found for item in result] == [True, True, False, True]
    assert result[2].covered < 0.1
    assert np.isnan(result[2].dx_mm)
    assert "0 % of the slot is covered" in result[2].detail


def test_a_single_slab_is_measured_on_its_free_edges():
    (found,) = [item for item in measure({1: (0.4, -0.3, 0.3)}) if item.found]
    assert found.slot == 1
    assert (found.dx_mm, found.dy_mm, found.da_deg) == pytest.approx((0.4, -0.3, 0.3), abs=0.03)


def test_nothing_laid_is_nothing_found():
    picture = np.full((600, 800), 30, np.uint8)
    result = measure_placement(picture, CAMERA, product(), assembly_in_table=IN_TABLE, slots=[3, 0])
    assert [(item.slot, item.found) for item in result] == [(0, False), (3, False)]


def test_a_slab_without_visible_edges_is_covered_but_not_measurable():
    white = render(CAMERA, [np.array([(-190, -140), (190, -140), (190, 140), (-190, 140)], float)])
    for found in measure_placement(white, CAMERA, product(), assembly_in_table=IN_TABLE, slots=range(4)):
        assert found.found
        assert not found.measured
        assert np.isnan(found.dx_mm)
        assert "not measurable" in found.detail


def test_slots_out_of_view_are_not_found():
    picture = render(CAMERA, laid({0: (0, 0, 0)}))
    away = RigidTransform2D(0.0, 5000.0, 0.0)
    result = measure_placement(picture, CAMERA, product(), assembly_in_table=away, slots=range(4))
    assert not any(item.found for item in result)


def test_a_picture_of_another_size_is_refused():
    with pytest.raises(CalibrationError):
        measure_placement(np.zeros((3, 3), np.uint8), CAMERA, recipe(), assembly_in_table=IN_TABLE, slots=[0])
