"""Features, filters and order of blobs, as the result of `locate` shows them."""

from dataclasses import replace

import numpy as np
import pytest

from slabcell.recipe import BlobFilter, BlobParameters
from slabcell.vision import locate
from slabcell.vision.result import LocateResult, RejectionReason

from .pictures import SHAPES, calibration, moved, recipe, render, scatter

pytestmark = pytest.mark.unit

CAMERA = calibration()
PRODUCT = recipe()
OUTLINES = [motion.apply(slot.vertices) for motion, slot in zip(scatter(PRODUCT), PRODUCT.template.slots, strict=True)]
DUST = moved([(0, 0), (9, 0), (9, 9), (0, 9)], 150, -120)
PICTURE = render(CAMERA, [*OUTLINES, DUST])


def found(**blobs: object) -> LocateResult:
    return locate(PICTURE, CAMERA, replace(PRODUCT, blobs=BlobParameters.model_validate(blobs)))


def test_nothing_is_measured_that_was_not_asked_for():
    result = found()
    assert result.blobs is None
    assert "blobs" not in result.to_document("x.png")
    assert found(filters=[{"feature": "area_mm2", "min": 1.0}]).blobs is None


def test_the_features_of_every_blob_are_reported_with_what_became_of_it():
    result = found(report=True)
    assert result.blobs is not None
    assert len(result.blobs) == 6
    for part in result.parts:
        assert part.blob is not None
        slot = PRODUCT.template.slots[part.slot]
        blob = result.blobs[part.blob]
        assert blob.area_mm2 == pytest.approx(slot.area_mm2 + part.kerf_mm * slot.perimeter_mm, rel=4e-3)
        assert blob.perimeter_mm == pytest.approx(slot.perimeter_mm, rel=0.015)
        middle = part.table_to_assembly.inverse().apply(slot.centroid)
        assert (blob.x_mm, blob.y_mm) == pytest.approx(tuple(middle), abs=0.02)
    document = result.to_document("x.png")["blobs"]
    assert isinstance(document, list)
    assert [entry["slot"] for entry in document] == [
        next((part.slot for part in result.parts if part.blob == index), None) for index in range(6)
    ]
    assert [entry["reason"] for entry in document if entry["slot"] is None] == ["too_small"]


def test_more_blobs_than_opencv_remaps_at_once_are_reported():
    places = [(-180.0 + 24.0 * column, -130.0 + 24.0 * row) for column in range(15) for row in range(10)]
    crumbs = [moved([(0, 0), (9, 0), (9, 9), (0, 9)], *place) for place in places]
    crumbs_only = locate(render(CAMERA, crumbs), CAMERA, replace(PRODUCT, blobs=BlobParameters(report=True)))
    assert crumbs_only.blobs is not None
    assert len(crumbs_only.blobs) == 150
    assert all(blob.area_mm2 == pytest.approx(81.0, rel=0.1) for blob in crumbs_only.blobs)


def test_a_blob_that_fails_a_filter_is_refused_with_feature_value_and_limit():
    result = found(filters=[{"feature": "convexity", "min": 0.95}])
    assert [part.slot for part in result.parts] == [1, 2, 3, 4]  # slot 0 is L-shaped
    (refused,) = [blob for blob in result.rejected if blob.reason == RejectionReason.FILTERED]
    assert refused.detail.startswith("convexity is 0.8")
    assert refused.detail.endswith("wants at least 0.95")
    assert 0 in result.empty_slots


@pytest.mark.parametrize(("feature", "order"), [("x_mm", "ascending"), ("area_mm2", "descending"), ("v", "ascending")])
def test_blobs_parts_and_refused_ones_come_in_the_recipes_order(feature: str, order: str):
    result = found(report=True, sort_by=feature, sort_order=order, filters=[{"feature": "y_mm", "min": -60.0}])
    assert result.blobs is not None
    assert len(result.rejected) > 1
    for indices in (
        range(len(result.blobs)),
        [part.blob for part in result.parts],
        [blob.blob for blob in result.rejected],
    ):
        values = [result.blobs[index].value(feature) for index in indices if index is not None]
        assert values == sorted(values, reverse=order == "descending")
        assert len(values) == len(indices)


def test_slabs_taken_out_of_several_that_touch_are_sorted_by_their_own_outline():
    left, right = moved(SHAPES[1], -80, -20), moved(SHAPES[3], 0.5, -18)
    picture = render(CAMERA, [left, right, moved(SHAPES[2], 110, 60)])
    for order, slots in (("ascending", [1, 3, 2]), ("descending", [2, 3, 1])):
        blobs = BlobParameters.model_validate({"sort_by": "x_mm", "sort_order": order, "report": True})
        result = locate(picture, CAMERA, replace(PRODUCT, blobs=blobs))
        assert [part.slot for part in result.parts] == slots
        assert [part.blob is None for part in result.parts] == [slot in (1, 3) for slot in slots]


def test_a_picture_without_blobs_has_no_features():
    blobs = BlobParameters(report=True, sort_by="u", filters=[BlobFilter(feature="holes", max=0)])
    result = locate(np.full((600, 800), 60, np.uint8), CAMERA, replace(PRODUCT, blobs=blobs))
    assert result.blobs == ()
