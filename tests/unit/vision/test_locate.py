from dataclasses import replace

import numpy as np
import pytest

from slabcell.errors import CalibrationError, ImageError
from slabcell.geometry import Polygon, RigidTransform2D
from slabcell.recipe import MatchingParameters
from slabcell.vision import Locator, locate
from slabcell.vision.result import LocateResult, RejectionReason

from .pictures import KITE, L_SHAPE, RECTANGLE, SHAPES, SQUARE, calibration, moved, recipe, render, scatter

pytestmark = pytest.mark.unit

CAMERA = calibration()
PRODUCT = recipe()
MOTIONS = scatter(PRODUCT)
OUTLINES = [motion.apply(slot.vertices) for motion, slot in zip(MOTIONS, PRODUCT.template.slots, strict=True)]
PICTURE = render(CAMERA, OUTLINES)


@pytest.fixture(scope="module")
def found() -> LocateResult:
    return locate(PICTURE, CAMERA, PRODUCT)


def test_every_slab_gets_its_own_slot(found: LocateResult):
    assert [part.slot for part in found.parts] == [0, 1, 2, 3, 4]
    assert found.rejected == ()
    assert found.empty_slots == ()


def test_poses_agree_with_the_truth_to_a_twentieth_of_a_pixel(found: LocateResult):
    for part in found.parts:
        truth = MOTIONS[part.slot]
        centre = PRODUCT.template.slots[part.slot].centroid
        error = part.table_to_assembly.inverse().apply(centre) - truth.apply(centre)
        assert np.hypot(*error) < 0.025  # mm, at 0.5 mm a pixel
        turn = (part.table_to_assembly.inverse().rotation_deg - truth.rotation_deg) * part.symmetry_order / 360
        assert abs(turn - round(turn)) * 360 / part.symmetry_order < 0.05


def test_pick_and_place_are_the_same_point_of_the_slab(found: LocateResult):
    for part in found.parts:
        moved = part.table_to_assembly.apply_pose(part.pick)
        assert (moved.x_mm, moved.y_mm) == pytest.approx((part.place.x_mm, part.place.y_mm), abs=1e-9)
        assert moved.a_deg == pytest.approx(part.place.a_deg, abs=1e-9)
        assert part.place.a_deg - part.pick.a_deg == pytest.approx(part.table_to_assembly.rotation_deg)


def test_the_image_pose_is_where_the_pick_point_is_seen_and_turns_as_the_picture_is_seen(found: LocateResult):
    for part in found.parts:
        u, v = CAMERA.image_from_table(np.array([[part.pick.x_mm, part.pick.y_mm]]))[0]
        assert (part.image.u, part.image.v) == pytest.approx((u, v))
        # This camera looks straight down with u along X, so but for the lens both angles agree.
        assert abs((part.image.angle_deg - part.pick.a_deg + 180) % 360 - 180) < 0.5


def test_symmetry_is_declared(found: LocateResult):
    assert [part.symmetry_order for part in found.parts] == [1, 2, 4, 1, 1]


def test_a_symmetric_slab_is_turned_as_little_as_possible(found: LocateResult):
    for part in found.parts:
        assert abs(part.table_to_assembly.rotation_deg) <= 180 / part.symmetry_order + 1e-6


def test_a_mirrored_slab_is_refused():
    mirrored = OUTLINES[0] * (-1.0, 1.0)
    result = locate(render(CAMERA, [mirrored]), CAMERA, recipe([L_SHAPE]))
    assert result.parts == ()
    assert [blob.reason for blob in result.rejected] == [RejectionReason.NO_SLOT_FITS]


def test_a_second_slab_for_a_filled_slot_is_refused_as_taken():
    result = locate(render(CAMERA, [moved(SQUARE, -100, -20), moved(SQUARE, 60, -20)]), CAMERA, recipe([SQUARE]))
    assert [part.slot for part in result.parts] == [0]
    assert [blob.reason for blob in result.rejected] == [RejectionReason.SLOT_TAKEN]


def test_only_free_slots_are_filled():
    result = locate(PICTURE, CAMERA, PRODUCT, free_slots={1, 3})
    assert [part.slot for part in result.parts] == [1, 3]
    assert [blob.reason for blob in result.rejected] == [RejectionReason.SLOT_TAKEN] * 3
    assert locate(PICTURE, CAMERA, PRODUCT, free_slots=()).parts == ()


def test_only_blobs_inside_the_area_count():
    left = Polygon.from_points([(-200, 0), (-60, 0), (-60, 150), (-200, 150)])
    result = locate(PICTURE, CAMERA, PRODUCT, area_mm=left)
    assert [part.slot for part in result.parts] == [0]
    assert result.empty_slots == (1, 2, 3, 4)


def test_slabs_that_touch_are_reported_and_not_picked():
    first = moved(RECTANGLE, -80, -20)
    second = moved(RECTANGLE, 0, -20)
    result = locate(render(CAMERA, [first, second]), CAMERA, recipe([RECTANGLE, SQUARE]))
    assert result.parts == ()
    assert [blob.reason for blob in result.rejected] == [RejectionReason.TOUCHING]


def test_a_slab_at_the_rim_is_refused():
    result = locate(render(CAMERA, [moved(RECTANGLE, 160, 0)]), CAMERA, PRODUCT)
    assert result.parts == ()
    assert [blob.reason for blob in result.rejected] == [RejectionReason.TOUCHES_BORDER]


def test_a_chipped_slab_is_refused_with_the_share_that_is_missing():
    whole = np.array([(0, 0), (80, 0), (80, 40), (0, 40)], float)
    chipped = np.array([(0, 0), (80, 0), (80, 20), (62, 24), (58, 40), (0, 40)], float)
    result = locate(render(CAMERA, [chipped]), CAMERA, recipe([[tuple(point) for point in whole]]))
    assert result.parts == ()
    assert result.rejected[0].reason in (RejectionReason.NO_SLOT_FITS, RejectionReason.UNSURE)


def test_a_slab_too_small_for_the_cup_is_refused_with_both_radii():
    narrow = recipe([[(0, 0), (90, 0), (90, 9), (0, 9)]])
    picture = render(CAMERA, [np.array([(0, 0), (90, 0), (90, 9), (0, 9)], float)])
    result = locate(picture, CAMERA, narrow)
    assert result.parts == ()
    assert result.rejected[0].reason == RejectionReason.NO_GRASP
    assert "4.5 mm" in result.rejected[0].detail


def test_dark_slabs_on_a_light_table_are_found_too():
    result = locate(255 - PICTURE, CAMERA, PRODUCT)
    assert len(result.parts) == 5


def test_sixteen_bits_give_the_same_poses_as_eight(found: LocateResult):
    deep = locate(PICTURE.astype(np.uint16) * 16, CAMERA, PRODUCT)
    assert [part.slot for part in deep.parts] == [0, 1, 2, 3, 4]
    for part, other in zip(deep.parts, found.parts, strict=True):
        assert part.pick.x_mm == pytest.approx(other.pick.x_mm, abs=0.01)


def test_a_colour_picture_is_located_in_grey():
    assert len(locate(np.dstack([PICTURE] * 3), CAMERA, PRODUCT).parts) == 5


@pytest.mark.parametrize("seed", range(3))
def test_slabs_in_strong_noise_are_found_on_a_smoothed_picture_and_measured_on_the_raw_one(seed: int):
    result = locate(render(CAMERA, OUTLINES, noise=30.0, seed=seed), CAMERA, PRODUCT)
    assert "smoothed" in result.segmentation
    assert [part.slot for part in result.parts] == [0, 1, 2, 3, 4]
    for part in result.parts:
        centre = PRODUCT.template.slots[part.slot].centroid
        error = part.table_to_assembly.inverse().apply(centre) - MOTIONS[part.slot].apply(centre)
        assert np.hypot(*error) < 0.2  # mm, at 0.5 mm a pixel
        assert abs(error[0]) < 5.0 * part.sigma.x_mm
        assert abs(error[1]) < 5.0 * part.sigma.y_mm


@pytest.mark.parametrize(
    "picture",
    [
        np.full((600, 800), 60, np.uint8),
        np.full((600, 800, 3), 128, np.uint8),
        np.random.default_rng(0).integers(0, 256, (600, 800), np.uint8),
        np.random.default_rng(0).integers(90, 110, (600, 800, 3), np.uint8),
    ],
    ids=["grey", "grey in colour", "noise", "faint noise"],
)
def test_a_picture_without_slabs_gives_no_pose(picture: np.ndarray):
    result = locate(picture, CAMERA, PRODUCT)
    assert result.parts == ()
    assert result.empty_slots == (0, 1, 2, 3, 4)
    assert result.segmentation


@pytest.mark.parametrize(
    ("picture", "why"),
    [
        (np.zeros((600, 800), np.uint8), "too dark"),
        (np.full((600, 800), 255, np.uint8), "over-exposed"),
        (np.full((600, 800), 65535, np.uint16), "over-exposed"),
        (np.tile(np.linspace(0, 255, 800).astype(np.uint8), (600, 1)), "blurred"),
    ],
    ids=["black", "white", "white in 16 bits", "a ramp"],
)
def test_an_unusable_picture_is_refused_with_the_reason(picture: np.ndarray, why: str):
    with pytest.raises(ImageError, match=why):
        locate(picture, CAMERA, PRODUCT)


def test_a_picture_of_another_size_is_refused():
    with pytest.raises(CalibrationError, match="1x1"):
        locate(np.zeros((1, 1), np.uint8), CAMERA, PRODUCT)


def test_a_picture_of_one_pixel_gives_no_pose():
    assert locate(np.full((1, 1), 99, np.uint8), calibration(1, 1), PRODUCT).parts == ()


@pytest.mark.parametrize(
    "array",
    [np.zeros((600, 800)), np.zeros((600, 800, 4), np.uint8), np.zeros((0, 0), np.uint8), np.zeros(5, np.uint8)],
)
def test_an_array_that_is_no_picture_is_refused(array: np.ndarray):
    with pytest.raises(ImageError):
        locate(array, CAMERA, PRODUCT)


def test_a_template_of_another_product_gives_no_pose():
    other = recipe([[(0, 0), (120, 0), (90, 20), (120, 90), (10, 70)], [(0, 0), (30, 0), (15, 28)]])
    result = locate(PICTURE, CAMERA, other)
    assert result.parts == ()
    assert len(result.rejected) == len(SHAPES)
    assert all(blob.detail for blob in result.rejected)


def test_one_locator_serves_many_pictures(found: LocateResult):
    locator = Locator(CAMERA, PRODUCT)
    again = [locator.locate(PICTURE) for _ in range(2)]
    assert [part.pick for part in again[0].parts] == [part.pick for part in again[1].parts]
    assert [part.pick for part in again[0].parts] == [part.pick for part in found.parts]


def test_the_stages_are_timed_and_add_up(found: LocateResult):
    stages = dict(found.timing_ms)
    total = stages.pop("total")
    assert set(stages) == {"segment", "blobs", "match", "register", "decide"}
    assert sum(stages.values()) == pytest.approx(total)


@pytest.mark.parametrize("method", ["hu", "polygon"])
def test_the_classic_matching_methods_locate_too(method: str):
    parameters = MatchingParameters.model_validate({"method": method})
    result = locate(PICTURE, CAMERA, replace(PRODUCT, matching=parameters))
    assert [part.slot for part in result.parts] == [0, 1, 2, 3, 4]


def test_a_light_floor_around_a_dark_table_does_not_hide_light_slabs():
    board = np.array([(-190, -140), (190, -140), (190, 140), (-190, 140)], float)
    floor = render(CAMERA, [board], light=28, dark=95)
    picture = np.where(PICTURE > 100, PICTURE, floor).astype(np.uint8)
    result = locate(picture, CAMERA, PRODUCT)
    assert [part.slot for part in result.parts] == [0, 1, 2, 3, 4]
    assert "tried because" in result.segmentation


def test_touching_slabs_are_taken_apart_where_slots_explain_them():
    first = RigidTransform2D(20.0, 0.0, 0.0).apply(moved(RECTANGLE, -80, -20))
    second = RigidTransform2D(20.0, 0.0, 0.0).apply(moved(KITE, 0.0, -18))
    result = locate(render(CAMERA, [first, second]), CAMERA, recipe([RECTANGLE, KITE, L_SHAPE]))
    assert [part.slot for part in result.parts] == [0, 1]
    for part, outline in zip(result.parts, (first, second), strict=True):
        slot = recipe([RECTANGLE, KITE, L_SHAPE]).template.slots[part.slot]
        error = part.table_to_assembly.inverse().apply(slot.centroid) - Polygon.from_points(outline).centroid
        assert np.hypot(*error) < 0.2


def test_touching_slabs_stay_together_where_the_recipe_says_so():
    first, second = moved(RECTANGLE, -80, -20), moved(KITE, 0.0, -18)
    kept = replace(recipe([RECTANGLE, KITE]), matching=MatchingParameters(split_touching=False))
    result = locate(render(CAMERA, [first, second]), CAMERA, kept)
    assert result.parts == ()
    assert [blob.reason for blob in result.rejected] == [RejectionReason.TOUCHING]


def test_slabs_that_touch_a_stranger_are_not_picked():
    stranger = [(0, 0), (45, -20), (90, 0), (70, 45), (15, 30)]
    result = locate(
        render(CAMERA, [moved(RECTANGLE, -80, -20), moved(stranger, -1, -10)]), CAMERA, recipe([RECTANGLE, KITE])
    )
    assert result.parts == ()
    assert [blob.reason for blob in result.rejected] == [RejectionReason.TOUCHING]
