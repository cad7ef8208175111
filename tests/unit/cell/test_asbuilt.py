"""Does the report say how each slab lies?"""

import csv
import io
import json
import xml.etree.ElementTree as ET

import pytest

from slabcell.cell.asbuilt import AsBuilt
from slabcell.cell.records import PlacementRecord
from slabcell.cell.settings import CellSettings
from slabcell.geometry import Polygon
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

NAN = float("nan")
SVG = "{http://www.w3.org/2000/svg}"
SLOTS = [Polygon.from_points([(x, 0), (x + 40, 0), (x + 40, 30), (x, 30)]) for x in (0, 40.5, 81)]
SETTINGS = CellSettings(Frame(), Frame(), Frame(), SLOTS[0], tolerance_mm=0.3, tolerance_deg=0.2)


def lying(slot, dx=0.0, dy=0.0, da=0.0, *, found=True):
    return PlacementRecord(slot, found, dx, dy, da, 0.02)


def test_each_slab_has_its_verdict():
    cases = [lying(0, 0.1, -0.2, 0.1), lying(1, 0.31), lying(2, found=False)]
    assert [slab.verdict for slab in AsBuilt.of(SLOTS, cases, SETTINGS).slabs] == ["ok", "out_of_tolerance", "missing"]
    assert AsBuilt.of(SLOTS, [lying(0, da=-0.21)], SETTINGS).slabs[0].verdict == "out_of_tolerance"
    assert AsBuilt.of(SLOTS, [lying(0, NAN, NAN, NAN)], SETTINGS).slabs[0].verdict == "not_measured"


def test_the_gap_is_that_between_the_slabs_as_they_lie():
    first, second, third = AsBuilt.of(SLOTS, [lying(0, dx=0.1), lying(1), lying(2, dx=0.2)], SETTINGS).slabs
    assert first.gap_mm == pytest.approx(0.4)
    assert second.gap_mm == pytest.approx(0.4)
    assert third.gap_mm == pytest.approx(0.7)


def test_a_turn_is_about_the_middle_of_the_slot():
    # A quarter turn takes the slab of 40 by 30 mm about (20, 15): it then ends at x = 35, 5.5 mm before its neighbour.
    first, _ = AsBuilt.of(SLOTS, [lying(0, da=90.0), lying(1)], SETTINGS).slabs
    assert first.gap_mm == pytest.approx(5.5)


def test_slabs_that_overlap_have_no_gap():
    assert AsBuilt.of(SLOTS, [lying(0, dx=0.3), lying(1, dx=-0.3)], SETTINGS).slabs[0].gap_mm == 0.0


def test_the_mean_shift_is_over_what_was_measured():
    report = AsBuilt.of(SLOTS, [lying(0, 0.1, 0.2), lying(1, 0.3, 0.0), lying(2, found=False)], SETTINGS)
    assert report.mean_shift_mm == pytest.approx((0.2, 0.1))
    assert AsBuilt.of(SLOTS, [lying(0, found=False)], SETTINGS).mean_shift_mm is None


def test_json_csv_and_picture_agree():
    report = AsBuilt.of(SLOTS, [lying(0, 0.1), lying(1, NAN, NAN, NAN), lying(2, found=False)], SETTINGS)
    document = json.loads(json.dumps(report.to_document(7, "squares"), allow_nan=False))
    rows = list(csv.DictReader(io.StringIO(report.to_csv())))
    assert [row["verdict"] for row in rows] == [slot["verdict"] for slot in document["slots"]]
    assert document["slots"][1]["dx_mm"] is None
    assert rows[1]["dx_mm"] == ""
    assert document["ok"] is False
    caption, *texts = _texts(report)
    assert "enlarged 20 times" in caption
    assert texts == ["0", "1", "not measured", "2", "missing"]


def test_the_picture_shows_whatever_is_drawn_and_says_by_how_much_it_is_off():
    report = AsBuilt.of(SLOTS, [lying(0, -2.0), lying(1, 0.0, 3.0), lying(2, 9.0, da=4.0)], SETTINGS)
    assert _texts(report)[1:] == [
        "0",
        "-2.00 +0.00 mm",
        "+0.00°",
        "1",
        "+0.00 +3.00 mm",
        "+0.00°",
        "2",
        "+9.00 +0.00 mm",
        "+4.00°",
    ]
    root = ET.fromstring(report.to_svg())  # noqa: S314 - our own
    left, top, width, height = (float(word) for word in root.attrib["viewBox"].split())
    corners = [corner.split(",") for shape in root.iter(f"{SVG}polygon") for corner in shape.attrib["points"].split()]
    assert len(corners) == 24
    assert all(left <= float(x) <= left + width and top <= float(y) <= top + height for x, y in corners)


def _texts(report):
    return [element.text for element in ET.fromstring(report.to_svg()).iter(f"{SVG}text")]  # noqa: S314 - our own


def test_a_job_is_ok_only_if_every_slot_was_measured():
    assert AsBuilt.of(SLOTS, [lying(i) for i in range(3)], SETTINGS).to_document(1, "r")["ok"] is True
    assert AsBuilt.of(SLOTS, [lying(i) for i in range(2)], SETTINGS).to_document(1, "r")["ok"] is False
