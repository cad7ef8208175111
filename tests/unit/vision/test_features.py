from typing import get_args

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from slabcell.recipe import BlobFeature, BlobFilter, BlobParameters
from slabcell.vision.features import BlobFeatures, fails, measure_blob, order_of
from slabcell.vision.plane import PlaneView

from .pictures import calibration

pytestmark = pytest.mark.unit

# Half a millimetre a pixel, no distortion: 1 mm on the table is 2 px.
PLANE = PlaneView(calibration(k1=0.0), 0.0)


def measured(outline: list[tuple[float, float]], holes: list[list[tuple[float, float]]] | None = None) -> BlobFeatures:
    """Features of a polygon on the table, drawn into a mask."""
    points = np.array(outline, float)
    mask = np.zeros((600, 800), np.uint8)
    contour = PLANE.to_pixels(points)
    cv2.fillPoly(mask, [np.rint(contour).astype(np.int32)], 255)
    for hole in holes or []:
        cv2.fillPoly(mask, [np.rint(PLANE.to_pixels(np.array(hole, float))).astype(np.int32)], 0)
    return measure_blob(points, contour, mask, PLANE, touches_border=False)


def turned(outline: list[tuple[float, float]], degrees: float, x: float = 0.0, y: float = 0.0):
    angle = np.deg2rad(degrees)
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return [(float(a + x), float(b + y)) for a, b in np.array(outline) @ matrix.T]


RECTANGLE = [(-40.0, -15.0), (40.0, -15.0), (40.0, 15.0), (-40.0, 15.0)]
L_SHAPE = [(0.0, 0.0), (60.0, 0.0), (60.0, 20.0), (20.0, 20.0), (20.0, 50.0), (0.0, 50.0)]


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, -65.0, 179.0])
def test_a_rectangle_is_measured_wherever_it_lies(degrees: float):
    found = measured(turned(RECTANGLE, degrees, 20.0, -35.0))
    assert found.area_mm2 == pytest.approx(2400)
    assert found.perimeter_mm == pytest.approx(220)
    assert (found.x_mm, found.y_mm) == pytest.approx((20, -35), abs=1e-3)
    apart = (found.orientation_deg - degrees) / 180
    assert abs(apart - round(apart)) * 180 < 1e-3
    assert -90 < found.orientation_deg <= 90
    assert (found.length_mm, found.width_mm) == pytest.approx((80, 30), abs=1e-3)
    assert found.rectangularity == pytest.approx(1, abs=1e-4)
    assert found.convexity == pytest.approx(1, abs=1e-4)
    assert found.roundness == pytest.approx(4 * np.pi * 2400 / 220**2)
    # Second moments of a rectangle: b·h³/12.
    assert found.inertia_major_mm4 == pytest.approx(30 * 80**3 / 12, rel=1e-4)
    assert found.inertia_minor_mm4 == pytest.approx(80 * 30**3 / 12, rel=1e-4)
    assert found.inertia == pytest.approx((80**2 + 30**2) / 12 / 2400, rel=1e-4)
    assert found.elongation == pytest.approx(80 / 30, rel=1e-3)


def test_the_bounding_box_lies_along_the_tables_axes():
    found = measured(turned(RECTANGLE, 90.0, 10.0, 5.0))
    assert (found.x_min_mm, found.y_min_mm, found.x_max_mm, found.y_max_mm) == pytest.approx(
        (-5, -35, 25, 45), abs=1e-4
    )


def test_the_centroid_is_given_in_the_picture_too():
    found = measured(turned(RECTANGLE, 0.0, 50.0, 25.0))
    assert (found.u, found.v) == pytest.approx((399.5 + 100, 299.5 - 50), abs=1e-3)


def test_a_concave_outline_is_less_than_its_hull_and_its_box():
    found = measured(L_SHAPE)
    assert found.area_mm2 == pytest.approx(1800)
    assert found.convexity == pytest.approx(1800 / 2400)
    assert found.rectangularity < 0.7


def test_hu_moments_stay_when_the_blob_turns_and_the_seventh_tells_its_mirror_image():
    first = measured(L_SHAPE).hu
    again = measured(turned(L_SHAPE, 73.0, 11.0, -4.0)).hu
    mirror = measured([(-x, y) for x, y in L_SHAPE]).hu
    assert again == pytest.approx(first, rel=1e-3, abs=1e-10)
    assert mirror[:6] == pytest.approx(first[:6], rel=1e-3)
    assert mirror[6] == pytest.approx(-first[6], rel=1e-3)
    # The fourth is a sum of two squares: (η30 + η12)² + (η21 + η03)².
    assert first[3] > 0


def test_a_disc_is_round():
    angle = np.arange(360) * np.pi / 180
    found = measured([(30 * np.cos(a), 30 * np.sin(a)) for a in angle])
    assert found.roundness == pytest.approx(1, abs=1e-3)
    assert found.inertia == pytest.approx(1 / (2 * np.pi), rel=1e-3)


def test_holes_are_counted_and_measured_and_specks_are_not():
    square = [(-10.0, -5.0), (0.0, -5.0), (0.0, 5.0), (-10.0, 5.0)]
    other = [(10.0, -5.0), (20.0, -5.0), (20.0, 5.0), (10.0, 5.0)]
    speck = [(30.0, 0.0), (30.6, 0.0), (30.6, 0.6), (30.0, 0.6)]
    found = measured(RECTANGLE, [square, other, speck])
    assert found.holes == 2
    assert found.hole_area_mm2 == pytest.approx(200, rel=0.15)
    assert found.area_mm2 == pytest.approx(2400)
    assert measured(RECTANGLE).holes == 0


def test_holes_of_a_neighbour_in_the_same_box_do_not_count():
    mask = np.zeros((200, 200), np.uint8)
    contour = np.array([(10, 10), (150, 10), (150, 30), (30, 30), (30, 150), (10, 150)], float)
    cv2.fillPoly(mask, [contour.astype(np.int32)], 255)
    cv2.rectangle(mask, (60, 60), (120, 120), 255, cv2.FILLED)
    cv2.rectangle(mask, (80, 80), (100, 100), 0, cv2.FILLED)
    assert measure_blob(contour, contour, mask, PLANE, touches_border=False).holes == 0


FEATURES = [measured(turned(RECTANGLE, 10.0)), measured(L_SHAPE), measured([(0, 0), (20, 0), (10, 30)])]


@pytest.mark.parametrize("feature", get_args(BlobFeature))
def test_every_feature_can_be_filtered_and_sorted_by(feature: str):
    values = [item.value(feature) for item in FEATURES]
    order = order_of(FEATURES, BlobParameters(sort_by=feature, sort_order="ascending"))
    assert [values[index] for index in order] == sorted(values)
    down = order_of(FEATURES, BlobParameters(sort_by=feature))
    assert [values[index] for index in down] == sorted(values, reverse=True)
    middle = sorted(values)[1]
    for index, item in enumerate(FEATURES):
        assert bool(fails(item, [BlobFilter(feature=feature, min=middle)])) == (values[index] < middle)
        assert bool(fails(item, [BlobFilter(feature=feature, max=middle)])) == (values[index] > middle)


def test_a_filter_says_what_was_measured_and_what_it_wants():
    text = fails(FEATURES[2], [BlobFilter(feature="area_mm2", min=500)])
    assert text == "area_mm2 is 300, the recipe's filter wants at least 500"


@pytest.mark.parametrize(
    "keys", [{"feature": "area_mm2"}, {"feature": "area_mm2", "min": 5, "max": 4}, {"feature": "weight", "min": 1}]
)
def test_a_filter_that_says_nothing_is_refused(keys: dict[str, object]):
    with pytest.raises(ValidationError):
        BlobFilter.model_validate(keys)


def test_the_document_holds_every_feature():
    document = FEATURES[0].to_document()
    assert len(document["hu"]) == 7
    assert {"area_mm2", "perimeter_mm", "x_mm", "orientation_deg", "convexity", "holes", "image"} <= set(document)
