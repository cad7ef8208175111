from dataclasses import replace

import numpy as np
import pytest

from slabcell.recipe import MatchingParameters, MorphologyStep, SegmentationParameters
from slabcell.vision import locate, morphology
from slabcell.vision.morphology import apply_morphology, net_erosion_px
from slabcell.vision.segmentation import segment

from .pictures import KITE, RECTANGLE, calibration, moved, recipe, render, scatter

pytestmark = pytest.mark.unit

CAMERA = calibration()
PRODUCT = recipe()
OUTLINES = [m.apply(s.vertices) for m, s in zip(scatter(PRODUCT), PRODUCT.template.slots, strict=True)]
PICTURE = render(CAMERA, OUTLINES)
TRUTH = render(CAMERA, OUTLINES, light=255, dark=0, noise=0, blur_px=0.01) > 127


def agreement(mask: np.ndarray) -> float:
    """Return intersection over union with the slabs."""
    found = mask > 0
    return np.count_nonzero(found & TRUTH) / max(np.count_nonzero(found | TRUTH), 1)


@pytest.mark.parametrize(
    "parameters",
    [
        {"method": "auto"},
        {"method": "fixed", "threshold": 100},
        {"method": "otsu"},
        {"method": "local"},
        {"method": "local", "window_px": 200},
        {"method": "dynamic_hard"},
        {"method": "dynamic_soft"},
        {"method": "multi_otsu", "classes": 2},
        {"method": "kmeans", "classes": 2},
        {"method": "kmeans", "classes": 4},
    ],
    ids=str,
)
@pytest.mark.parametrize("inverted", [False, True], ids=["light slabs", "dark slabs"])
def test_every_method_finds_the_slabs_and_says_what_it_did(parameters: dict[str, object], inverted: bool):
    picture = 255 - PICTURE if inverted else PICTURE
    if parameters["method"] == "fixed" and inverted:
        parameters = {**parameters, "threshold": 155}
    found = segment(picture, SegmentationParameters.model_validate(parameters))
    assert agreement(found.mask) > 0.97
    assert found.description


def test_multi_otsu_tells_three_greys_apart():
    picture = PICTURE.copy()
    picture[400:, :] = 85  # a grey strip that is neither table nor slab
    truth = TRUTH.copy()
    truth[400:, :] = False
    found = segment(picture, SegmentationParameters(method="multi_otsu", classes=3, polarity="light")).mask > 0
    assert np.count_nonzero(found & truth) / np.count_nonzero(found | truth) > 0.97


def test_colour_tells_slabs_apart_that_are_as_bright_as_the_table():
    colours = np.where(TRUTH[:, :, None], np.array([60, 60, 171]), np.array([60, 120, 60])).astype(np.uint8)
    import cv2

    grey = cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY)
    assert abs(int(grey[TRUTH].mean()) - int(grey[~TRUTH].mean())) < 12
    found = segment(grey, SegmentationParameters(method="kmeans", classes=2), colours)
    assert agreement(found.mask) > 0.97


def test_uneven_light_makes_auto_follow_it():
    light = np.linspace(0.15, 1.0, 800)[None, :]
    picture = np.clip(PICTURE * light + 2, 0, 255).astype(np.uint8)
    found = segment(picture, SegmentationParameters())
    assert "local" in found.description
    assert agreement(found.mask) > 0.9


def test_only_the_region_of_interest_counts():
    roi = [(0.0, 0.0), (400.0, 0.0), (400.0, 600.0), (0.0, 600.0)]
    mask = segment(PICTURE, SegmentationParameters(roi=roi)).mask
    assert mask[:, :400].any()
    assert not mask[:, 402:].any()


def test_morphology_closes_cracks_and_removes_specks():
    picture = PICTURE.copy()
    picture[::40, ::40] = 255
    picture[:, 400:402] = 30
    plain = segment(picture, SegmentationParameters(method="fixed", threshold=100)).mask
    steps = [MorphologyStep(operation="open", size_px=5), MorphologyStep(operation="fill")]
    cleaned = segment(picture, SegmentationParameters(method="fixed", threshold=100, morphology=steps)).mask
    assert plain[40, 40] == 255
    assert cleaned[40, 40] == 0
    assert agreement(cleaned) > agreement(plain)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"method": "fixed"}, "threshold"),
        ({"low_tail_percent": 60, "high_tail_percent": 40}, "leave no pixel"),
        ({"classes": 2, "slab_classes": 2}, "leaves no class"),
    ],
)
def test_parameters_that_contradict_each_other_are_refused(parameters: dict[str, object], message: str):
    with pytest.raises(ValueError, match=message):
        SegmentationParameters.model_validate(parameters)


@pytest.mark.parametrize("operation", ["erode", "dilate", "open", "close"])
def test_large_neighbourhoods_do_the_same_as_small_ones_whatever_the_way(operation: str, monkeypatch):
    step = MorphologyStep.model_validate({"operation": operation, "size_px": 21})
    fast = apply_morphology(TRUTH.astype(np.uint8) * 255, [step]) > 0
    monkeypatch.setattr(morphology, "LARGE_PX", 100)
    plain = apply_morphology(TRUTH.astype(np.uint8) * 255, [step]) > 0
    assert not np.array_equal(plain, TRUTH)
    # OpenCV's discs of pixels are a little larger than round: half a pixel along the outlines.
    assert np.count_nonzero(fast & plain) / np.count_nonzero(fast | plain) > 0.98


def test_an_eroded_outline_is_put_back_before_it_is_compared():
    first, second = moved(RECTANGLE, -90, -20), moved(KITE, 10, -15)
    bridge = [(-15.0, -1.0), (25.0, -1.0), (25.0, 1.5), (-15.0, 1.5)]
    picture = render(CAMERA, [first, second, np.array(bridge)])
    product = replace(recipe([RECTANGLE, KITE]), matching=MatchingParameters(split_touching=False))
    assert locate(picture, CAMERA, product).parts == ()
    eroded = SegmentationParameters(morphology=[MorphologyStep(operation="erode", size_px=11)])
    result = locate(picture, CAMERA, replace(product, segmentation=eroded))
    assert [part.slot for part in result.parts] == [0, 1]
    assert net_erosion_px(eroded.morphology) == 5.0


def test_a_colour_picture_is_clustered_as_its_pixels_would_be_one_by_one():
    random = np.random.default_rng(5)
    colours = np.where(TRUTH[:, :, None], np.array([40, 60, 190]), np.array([70, 110, 70]))
    picture = np.clip(colours + random.normal(0, 6, colours.shape), 0, 255).astype(np.uint8)
    found = segment(picture[:, :, 1], SegmentationParameters(method="kmeans", classes=2), picture)
    assert agreement(found.mask) > 0.995
