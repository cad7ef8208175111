from dataclasses import replace

import cv2
import numpy as np
import pytest

from slabcell.recipe import GateParameters, Mark, Recipe, SegmentationParameters
from slabcell.vision import locate
from slabcell.vision.gates import UnusableImageError

from .pictures import calibration, recipe, render, scatter

pytestmark = pytest.mark.unit

CAMERA = calibration()
PRODUCT = recipe()
OUTLINES = [m.apply(s.vertices) for m, s in zip(scatter(PRODUCT), PRODUCT.template.slots, strict=True)]
MARKS = [(-180.0, 130.0), (180.0, 130.0), (-180.0, -130.0), (180.0, -130.0)]


def disc(x: float, y: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    return np.array([x, y]) + 6.0 * np.column_stack([np.cos(angle), np.sin(angle)])


PICTURE = render(CAMERA, [*OUTLINES, *(disc(x, y) for x, y in MARKS)])


def gated(**limits: object) -> Recipe:
    return replace(PRODUCT, gates=GateParameters.model_validate(limits))


WITH_MARKS = gated(marks=[Mark(x_mm=x, y_mm=y, diameter_mm=12.0) for x, y in MARKS])


def refusal(picture: np.ndarray, product: Recipe) -> UnusableImageError:
    with pytest.raises(UnusableImageError) as caught:
        locate(picture, CAMERA, product)
    assert caught.value.number == 1501
    return caught.value


def test_a_good_picture_passes_every_gate_and_the_readings_are_kept():
    result = locate(PICTURE, CAMERA, WITH_MARKS)
    assert len(result.parts) == 5
    assert {gate.gate for gate in result.gates} == {
        "brightness", "overexposed", "blur", "reference_seen", "reference_shift"
    }  # fmt: skip
    assert all(gate.passed for gate in result.gates)


def test_a_dark_picture_names_what_it_reaches_and_what_is_needed():
    error = refusal((PICTURE // 60).astype(np.uint8), PRODUCT)
    assert "too dark" in str(error)
    assert "2 % are needed" in str(error)


def test_an_overexposed_picture_is_refused():
    assert "over-exposed" in str(refusal(np.clip(PICTURE.astype(int) * 9, 0, 255).astype(np.uint8), PRODUCT))


def test_a_blurred_picture_is_refused_with_the_width_of_its_edges():
    error = refusal(cv2.GaussianBlur(PICTURE, (0, 0), 9.0), gated(max_blur_px=5.0))
    (blur,) = [item for item in error.readings if not item.passed]
    assert blur.gate == "blur"
    assert blur.value == pytest.approx(9.0, rel=0.35)


def test_a_hand_over_the_marks_is_an_obstructed_view():
    hidden = PICTURE.copy()
    hidden[:, :100] = 30
    hidden[:, 700:] = 30
    assert "obstructs the view" in str(refusal(hidden, WITH_MARKS))


def test_a_camera_that_moved_is_told_by_how_much():
    shifted = np.roll(PICTURE, (3, 4), axis=(0, 1))  # 2.5 mm
    error = refusal(shifted, WITH_MARKS)
    assert "the camera has moved" in str(error)
    (moved,) = [item for item in error.readings if item.gate == "reference_shift"]
    assert moved.value == pytest.approx(2.5, abs=0.2)


def test_the_rim_of_the_table_serves_as_reference_too():
    board = np.array([(-190, -140), (190, -140), (190, 140), (-190, 140)], float)
    picture = np.maximum(render(CAMERA, [board], light=60, dark=10), render(CAMERA, OUTLINES, dark=0))
    fixed = SegmentationParameters(method="fixed", threshold=120)
    product = replace(gated(rim_mm=[tuple(point) for point in board]), segmentation=fixed)
    result = locate(picture, CAMERA, product)
    assert len(result.parts) == 5
    (shift,) = [gate for gate in result.gates if gate.gate == "reference_shift"]
    assert shift.value < 0.2
