from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slabcell_drivers.simulation import World, load_scene, render_world
from slabcell_drivers.simulation.formats import digitise
from slabcell_drivers.simulation.scene import Optics

pytestmark = pytest.mark.unit

SCENE = load_scene(Path(__file__).parents[3] / "config" / "scenes" / "dresden.toml")
SMALL = replace(
    SCENE, camera=replace(SCENE.camera, width=480, height=300, fx_px=833.0, fy_px=833.0, cx_px=240.0, cy_px=149.0)
)
QUIET = Optics(noise_dn=0.0, shot_dn=0.0)


@pytest.mark.parametrize(
    ("bits", "kind", "level", "top"),
    [(8, np.uint8, 100, 255), (10, np.uint16, 401, 1023), (12, np.uint16, 1606, 4095), (16, np.uint16, 25700, 65535)],
)
def test_each_depth_has_its_own_levels_in_the_upper_bits_and_saturates(
    bits: int, kind: type, level: int, top: int
) -> None:
    image = np.array([[100.0, 300.0, -5.0]], np.float32)
    shift = 0 if bits == 8 else 16 - bits

    pixels = digitise(image, QUIET, (0,), bits)

    assert pixels.dtype == kind
    assert pixels.tolist() == [[level << shift, top << shift, 0]]


def test_a_depth_that_no_sensor_has_is_refused() -> None:
    with pytest.raises(ValueError, match="sensor of 9 bits"):
        digitise(np.zeros((2, 2), np.float32), QUIET, (0,), 9)


def test_a_deeper_picture_shows_the_same_world_with_finer_steps() -> None:
    world = World(SMALL, 1)

    coarse, fine = render_world(world), render_world(world, bits=12)

    assert np.abs(fine / (4095 * 16 / 255) - coarse).max() <= 0.54  # half a step of each
    assert len(np.unique(fine)) > 4 * len(np.unique(coarse))


def test_a_colour_picture_is_blue_green_red_with_the_tints_of_slabs_and_table() -> None:
    optics = replace(SMALL.optics, slab_tint=(0.5, 0.8, 1.2), table_tint=(1.5, 1.0, 0.5))
    world = World(replace(SMALL, optics=optics), 1)

    colour = render_world(world, colour=True).astype(float)

    grey = render_world(world)
    slabs, table = colour[grey > 140].mean(axis=0), colour[grey < 40].mean(axis=0)
    assert colour.shape == (300, 480, 3)
    assert slabs[0] / slabs[2] == pytest.approx(0.5 / 1.2, rel=0.05)
    assert table[0] > 2 * table[2]
