"""A slab that two slots, or two rotations, explain alike is refused; one that the picture tells apart is not."""

from dataclasses import replace

import numpy as np
import pytest

from slabcell.geometry import RigidTransform2D
from slabcell.recipe import MatchingParameters
from slabcell.vision import locate
from slabcell.vision.result import LocateResult, RejectionReason

from .pictures import KITE, RECTANGLE, calibration, moved, recipe, render

pytestmark = pytest.mark.unit

# Half a millimetre a pixel: the picture supports some hundredths of a millimetre over a whole outline.
CAMERA = calibration()
# By how much one corner is drawn out, from what nobody could see to what everybody sees.
STEPS_MM = (0.2, 0.3, 0.5, 0.8, 1.2)


def drawn_out(shape: list[tuple[float, float]], by_mm: float) -> list[tuple[float, float]]:
    """Return a shape whose third corner stands out by so much."""
    (x, y) = shape[2]
    return [*shape[:2], (x + by_mm, y + by_mm), *shape[3:]]


def placed(shape: list[tuple[float, float]], seed: int):
    random = np.random.default_rng(seed)
    turn, (x, y) = float(random.uniform(-180, 180)), random.uniform(-60, 60, 2)
    return moved(RigidTransform2D(turn, 0.0, 0.0).apply(np.array(shape, float) - (40.0, 20.0)), x, y), turn


def judge(result: LocateResult, turn: float) -> str:
    """Return what became of the one slab: right, wrong or why it was refused."""
    if not result.parts:
        return result.rejected[0].reason.value
    part = result.parts[0]
    away = part.table_to_assembly.inverse().rotation_deg - turn
    away -= 360 * round(away / 360)
    return "right" if part.slot == 0 and abs(away) < 1 else "wrong"


@pytest.mark.parametrize("seed", range(4))
def test_a_slab_that_is_nearly_symmetric_is_never_turned_the_wrong_way(seed: int):
    found: list[str] = []
    for step in (0.12, *STEPS_MM):
        shape = drawn_out(RECTANGLE, step)
        outline, turn = placed(shape, seed)
        found.append(judge(locate(render(CAMERA, [outline], seed=seed), CAMERA, recipe([shape])), turn))
    assert found[0] == "unsure"
    assert found[-2:] == ["right", "right"]
    assert set(found) == {"unsure", "right"}


@pytest.mark.parametrize("seed", range(4))
def test_a_slab_that_two_slots_nearly_share_never_goes_to_the_wrong_one(seed: int):
    found: list[str] = []
    for step in STEPS_MM:
        slots = [KITE, drawn_out(KITE, step)]
        outline, turn = placed(KITE, seed)
        found.append(judge(locate(render(CAMERA, [outline], seed=seed), CAMERA, recipe(slots)), turn))
    assert found[0] == "unsure"
    assert found[-2:] == ["right", "right"]
    assert set(found) == {"unsure", "right"}


@pytest.mark.parametrize("seed", range(4))
def test_a_slab_that_is_nearly_its_own_mirror_image_never_goes_to_the_mirrored_slot(seed: int):
    found: list[str] = []
    for step in STEPS_MM:
        shape = drawn_out([(0, 0), (80, 10), (80, 30), (0, 40)], step)
        mirrored = [(x, 40 - y) for x, y in reversed(shape)]
        outline, turn = placed(shape, seed)
        found.append(judge(locate(render(CAMERA, [outline], seed=seed), CAMERA, recipe([shape, mirrored])), turn))
    assert found[0] == "unsure"
    assert found[-2:] == ["right", "right"]
    assert set(found) == {"unsure", "right"}


def test_the_refusal_says_what_cannot_be_told_apart_and_how_far_it_is_from_it():
    shape = drawn_out(RECTANGLE, 0.15)
    outline, _ = placed(shape, 1)
    (blob,) = locate(render(CAMERA, [outline]), CAMERA, recipe([shape])).rejected
    assert blob.reason == RejectionReason.UNSURE
    assert "lies in slot 0 as it is or turned by 180° alike" in blob.detail
    assert "0.050 mm are needed" in blob.detail


def test_who_says_that_so_small_a_difference_does_not_matter_gets_a_pose():
    shape = drawn_out(RECTANGLE, 0.15)
    outline, _ = placed(shape, 1)
    coarse = replace(recipe([shape]), matching=MatchingParameters(alike_mm=0.4))
    (part,) = locate(render(CAMERA, [outline]), CAMERA, coarse).parts
    assert part.symmetry_order == 2
    twins = replace(recipe([KITE, drawn_out(KITE, 0.15)]), matching=MatchingParameters(alike_mm=0.4))
    outline, _ = placed(KITE, 1)
    assert len(locate(render(CAMERA, [outline]), CAMERA, twins).parts) == 1


def test_slots_of_the_same_outline_are_filled_whichever_slab_goes_where():
    result = locate(render(CAMERA, [moved(KITE, -120, 0), moved(KITE, 30, 0)]), CAMERA, recipe([KITE, KITE]))
    assert [part.slot for part in result.parts] == [0, 1]


def test_a_slab_taken_out_of_two_that_touch_is_not_guessed_either():
    shape = drawn_out(RECTANGLE, 0.12)
    turn = RigidTransform2D(20.0, 0.0, 0.0)
    first, second = turn.apply(moved(shape, -80, -20)), turn.apply(moved(KITE, 0.5, -18))
    result = locate(render(CAMERA, [first, second]), CAMERA, recipe([shape, KITE]))
    assert [part.slot for part in result.parts] == [1]
    assert [blob.reason for blob in result.rejected] == [RejectionReason.UNSURE]
