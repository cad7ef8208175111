import numpy as np
import pytest

from slabcell.vision import locate
from slabcell.vision.overlay import draw_overlay

from .pictures import calibration, recipe, render, scatter

pytestmark = pytest.mark.unit


def scene(width: int = 800, height: int = 600, mm_per_px: float = 0.5):
    camera, product = calibration(width, height, mm_per_px), recipe()
    outlines = [
        motion.apply(slot.vertices) for motion, slot in zip(scatter(product), product.template.slots, strict=True)
    ]
    picture = render(camera, outlines)
    return picture, locate(picture, camera, product)


@pytest.mark.parametrize("kind", ["grey", "colour", "16 bit"])
def test_every_kind_of_picture_becomes_a_colour_picture_with_the_result_on_it(kind: str):
    picture, result = scene()
    given = {"grey": picture, "colour": np.dstack([picture] * 3), "16 bit": picture.astype(np.uint16) * 200}[kind]
    before = given.copy()
    drawn = draw_overlay(given, result)
    assert drawn.dtype == np.uint8
    assert drawn.shape[2] == 3
    assert np.array_equal(given, before)
    factor = drawn.shape[0] // 600
    for part in result.parts:
        u, v = np.rint((np.array([part.image.u, part.image.v]) + 0.5) * factor - 0.5).astype(int)
        around = drawn[v - 20 : v + 20, u - 20 : u + 20].astype(int)
        assert np.ptp(around, axis=2).max() > 60  # the coloured axes begin at the grasp point


def test_small_pictures_are_enlarged_by_a_whole_factor():
    picture, result = scene(320, 240, 1.25)
    drawn = draw_overlay(picture, result)
    assert drawn.shape == (960, 1280, 3)


def test_a_refused_blob_is_named_in_the_list():
    picture, _ = scene()
    result = locate(picture, calibration(), recipe([[(0, 0), (200, 0), (100, 90)]]))
    assert result.rejected
    drawn = draw_overlay(picture, result)
    plain = draw_overlay(picture, locate(np.full_like(picture, 60), calibration(), recipe()))
    assert not np.array_equal(drawn[:60], plain[:60])


@pytest.mark.parametrize("shape", [(1, 1), (1, 700), (700, 1)])
def test_pictures_of_odd_sizes_can_be_drawn_on(shape: tuple[int, int]):
    height, width = shape
    picture = np.full(shape, 60, np.uint8)
    result = locate(picture, calibration(width, height), recipe())
    assert draw_overlay(picture, result).shape[0] >= height
