from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from slabcell_drivers.robot import Frame
from slabcell_drivers.simulation import Slab, World, broken, chipped, load_scene, strewn_slabs, touching

pytestmark = pytest.mark.unit

SCENE = load_scene(Path(__file__).parents[3] / "config" / "scenes" / "irregular.toml")


@pytest.mark.parametrize("seed", range(5))
def test_a_chipped_slab_has_lost_a_corner_and_keeps_its_place_and_its_nominal_shape(seed: int) -> None:
    slab = strewn_slabs(SCENE, seed)[seed]

    worse = chipped(slab, np.random.default_rng(seed), size_mm=12.0)

    whole, rest = shapely.Polygon(slab.body), shapely.Polygon(worse.body)
    assert rest.is_valid
    assert whole.buffer(1e-9).contains(rest)
    assert 1.0 < whole.area - rest.area < 12.0 * 12.0
    assert worse.frame == slab.frame
    assert np.array_equal(worse.nominal, slab.body)


@pytest.mark.parametrize("share", [0.1, 0.35])
def test_a_broken_slab_has_lost_the_share_that_was_asked_for(share: float) -> None:
    body = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 40.0], [0.0, 40.0]])
    slab = Slab(0, "s", body, 10.0, Frame(300.0, 0.0))

    worse = broken(slab, np.random.default_rng(1), share=share)

    assert shapely.Polygon(worse.body).area == pytest.approx((1 - share) * 2400.0)


def test_a_slab_that_would_lose_most_of_itself_is_refused() -> None:
    body = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 40.0], [0.0, 40.0]])

    with pytest.raises(ValueError, match="lose more than half"):
        broken(Slab(0, "s", body, 10.0, Frame()), np.random.default_rng(1), share=0.6)


def test_a_slab_pushed_against_another_touches_it_without_running_into_it() -> None:
    slabs = strewn_slabs(SCENE, 0)
    mover = 3
    fixed = min(
        (index for index in range(12) if index != mover),
        key=lambda index: slabs[index].shape.distance(slabs[mover].shape),
    )

    pushed = touching(slabs, mover, fixed, gap_mm=0.05)

    assert pushed[mover].shape.distance(pushed[fixed].shape) == pytest.approx(0.05, abs=1e-6)
    assert [slab.frame for slab in pushed if slab.number != mover] == [
        slab.frame for slab in slabs if slab.number != mover
    ]


def test_a_slab_in_the_way_is_named() -> None:
    body = np.array([[-10.0, -10.0], [10.0, -10.0], [10.0, 10.0], [-10.0, 10.0]])
    row = [Slab(index, "s", body, 10.0, Frame(50.0 * index, 0.0)) for index in range(3)]
    wide = replace(row[0], body=body * (1.0, 1.0))

    with pytest.raises(ValueError, match="slab 2 lies between slabs 0 and 1"):
        touching([wide, replace(row[1], frame=Frame(50.0)), replace(row[2], frame=Frame(25.0))], 0, 1)


def test_a_world_of_given_slabs_holds_just_those() -> None:
    slabs = strewn_slabs(SCENE, 0)[:3]

    assert World(SCENE, slabs=slabs).slabs == slabs
    with pytest.raises(ValueError, match="numbered 0 to 1"):
        World(SCENE, slabs=slabs[1:])


def test_a_chipped_slab_is_still_measured_against_the_slot_of_its_nominal_shape() -> None:
    slabs = strewn_slabs(SCENE, 0)
    slot = np.array(SCENE.outlines[4].outline)
    centre = shapely.Polygon(slot).centroid
    worse = replace(
        chipped(slabs[4], np.random.default_rng(0), size_mm=10.0),
        frame=SCENE.assembly.frame @ Frame(centre.x + 0.1, centre.y, 0.0, 0.0),
    )

    (placement,) = World(SCENE, slabs=(*slabs[:4], worse, *slabs[5:])).placements([slot])

    assert placement.slab == 4
    assert placement.dx_mm == pytest.approx(0.1)
