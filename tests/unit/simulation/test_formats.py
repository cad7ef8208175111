from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from slabcell_drivers.simulation import PixelFormat, World, load_scene, mosaic, render_world
from slabcell_drivers.simulation.formats import digitise
from slabcell_drivers.simulation.scene import Optics

pytestmark = pytest.mark.unit

SCENE = load_scene(Path(__file__).parents[3] / "config" / "scenes" / "dresden.toml")
SMALL = replace(
    SCENE, camera=replace(SCENE.camera, width=480, height=300, fx_px=833.0, fy_px=833.0, cx_px=240.0, cy_px=149.0)
)
QUIET = Optics(noise_dn=0.0, shot_dn=0.0)


@pytest.mark.parametrize(
    ("pixel_format", "kind", "level", "top"),
    [
        (PixelFormat.MONO8, np.uint8, 100, 255),
        (PixelFormat.MONO10, np.uint16, 401, 1023),
        (PixelFormat.MONO12, np.uint16, 1606, 4095),
        (PixelFormat.MONO16, np.uint16, 25700, 65535),
    ],
)
def test_each_depth_has_its_own_levels_and_saturates_at_its_top(
    pixel_format: PixelFormat, kind: type, level: int, top: int
) -> None:
    image = np.array([[100.0, 300.0, -5.0]], np.float32)

    pixels = digitise(image, QUIET, (0,), pixel_format)

    assert pixels.dtype == kind
    assert pixels.tolist() == [[level, top, 0]]


def test_a_deeper_format_shows_the_same_world_with_finer_steps() -> None:
    world = World(SMALL, 1)

    coarse, fine = render_world(world), render_world(world, pixel_format=PixelFormat.MONO12)

    assert np.abs(fine / (4095 / 255) - coarse).max() <= 0.54  # half a step of each
    assert len(np.unique(fine)) > 4 * len(np.unique(coarse))


def test_a_colour_picture_is_blue_green_red_with_the_tints_of_slabs_and_table() -> None:
    optics = replace(SMALL.optics, slab_tint=(0.5, 0.8, 1.2), table_tint=(1.5, 1.0, 0.5))
    world = World(replace(SMALL, optics=optics), 1)

    colour = render_world(world, pixel_format=PixelFormat.BGR8).astype(float)

    grey = render_world(world)
    slabs, table = colour[grey > 140].mean(axis=0), colour[grey < 40].mean(axis=0)
    assert colour.shape == (300, 480, 3)
    assert slabs[0] / slabs[2] == pytest.approx(0.5 / 1.2, rel=0.05)
    assert table[0] > 2 * table[2]


@pytest.mark.parametrize(
    ("pattern", "code"),
    [
        ("RG", cv2.COLOR_BayerRGGB2BGR),
        ("GR", cv2.COLOR_BayerGRBG2BGR),
        ("GB", cv2.COLOR_BayerGBRG2BGR),
        ("BG", cv2.COLOR_BayerBGGR2BGR),
    ],
)
def test_a_mosaic_is_what_opencv_takes_apart_again(pattern: str, code: int) -> None:
    colour = np.full((16, 16, 3), (30, 120, 200), np.uint8)

    assert np.array_equal(cv2.cvtColor(mosaic(colour, pattern), code)[2:-2, 2:-2], colour[2:-2, 2:-2])


def test_an_unknown_mosaic_is_refused() -> None:
    with pytest.raises(ValueError, match="'RB' is not one of RG, GR, GB, BG"):
        mosaic(np.zeros((4, 4, 3), np.uint8), "RB")
