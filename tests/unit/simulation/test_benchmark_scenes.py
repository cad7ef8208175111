"""The scenes that accuracy is measured on must themselves be right."""

import importlib
import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import shapely

from slabcell.calibration.model import Calibration

pytestmark = pytest.mark.unit


@pytest.fixture
def scenes(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "benchmarks"))
    yield importlib.import_module("scenes")
    for name in ("scenes", "shapes"):
        monkeypatch.delitem(sys.modules, name, raising=False)


def test_the_truth_of_a_scene_lays_its_slots_onto_the_slabs_in_the_picture(scenes: ModuleType) -> None:
    scene = scenes.make_scene("thick", 11, unknowns=2)
    calibration: Calibration = scene.calibration

    assert len(scene.slabs) == 14
    assert sum(slab.slot is None for slab in scene.slabs) == 2
    for slab in scene.slabs:
        pixels = calibration.image_from_table(slab.outline, scene.thickness_mm)
        u, v = np.asarray(shapely.Polygon(pixels).representative_point().coords)[0]
        assert scene.image[round(v), round(u)] > 110
        if slab.slot is not None:
            laid = slab.table_from_assembly.apply(scene.template[slab.slot])
            assert np.allclose(laid, slab.outline, atol=1e-9)


def test_slabs_keep_apart_except_where_they_are_pushed_together(scenes: ModuleType) -> None:
    def nearest(condition: str) -> float:
        shapes = [shapely.Polygon(slab.outline) for slab in scenes.make_scene(condition, 3).slabs]
        return min(a.distance(b) for a, b in itertools.combinations(shapes, 2))

    assert nearest("contrast") > 10.0
    assert nearest("touching") < 0.01


def test_the_same_seed_gives_the_same_scene_and_another_does_not(scenes: ModuleType) -> None:
    first, again, other = (scenes.make_scene("harsh", seed, slabs=4, pool="irregular") for seed in (1, 1, 2))

    assert np.array_equal(first.image, again.image)
    assert not np.array_equal(first.image, other.image)


def test_the_slots_of_a_pool_are_all_different_and_one_has_its_mirror_image_beside_it(scenes: ModuleType) -> None:
    slots = scenes.make_scene("clean", 5, slabs=1).template
    fits = scenes.congruences

    for one, other in itertools.combinations(slots, 2):
        assert not fits(one, other, 1.0)
    mirrored = [slot * (-1.0, 1.0) for slot in slots]
    assert any(fits(slots[a], mirrored[b], 1e-6) for a, b in itertools.permutations(range(16), 2))


def test_kerf_makes_the_slots_larger_than_the_slabs_all_around(scenes: ModuleType) -> None:
    scene = scenes.make_scene("kerf", 4, slabs=3)

    for slab in scene.slabs:
        if slab.slot is not None:
            slot = shapely.Polygon(slab.table_from_assembly.apply(scene.template[slab.slot]))
            body = shapely.Polygon(slab.outline)
            assert slot.exterior.distance(body.exterior) == pytest.approx(0.2, abs=1e-6)
            assert slot.contains(body)
