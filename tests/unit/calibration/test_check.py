"""A check on one new picture tells whether lens, height, tilt or place of the camera have changed, and how much."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from slabcell.calibration import (
    Calibration,
    CameraIdentity,
    Lens,
    TablePlane,
    check_board,
    drift_of_board,
    drift_of_marks,
    load_marks,
)
from slabcell.errors import CalibrationError

pytestmark = pytest.mark.unit


@pytest.fixture(scope="module")
def calibration(lab):
    """Exact lens, and a table that is the plane of a board at 0, 0."""
    view = lab.looking_down(0.0, 0.0)
    return Calibration(
        CameraIdentity(*lab.SIZE),
        Lens(lab.MATRIX, lab.DISTORTION),
        TablePlane(view.rotation, view.translation),
        {"rms_px": 0.04},
    )


def test_a_calibration_that_holds_has_no_problems(lab, calibration):
    check = check_board(calibration, lab.seen(lab.looking_down(80.0, -40.0, 33.0), "new.png"), lab.BOARD)
    assert check.problems == ()
    assert abs(check.lift_mm) < 0.3
    assert check.tilt_deg < 0.1
    assert check.lens_rms_px < 0.06


def test_a_board_of_known_thickness_lies_on_the_table(lab, calibration):
    detection = lab.seen(lab.looking_down(80.0, -40.0, 33.0, height_mm=1034.0), "new.png")
    assert check_board(calibration, detection, lab.BOARD, board_thickness_mm=6.0).problems == ()
    assert any("height has changed" in p for p in check_board(calibration, detection, lab.BOARD).problems)


def test_a_camera_that_was_tilted_is_noticed(lab, calibration):
    detection = lab.seen(lab.looking_down(0.0, 0.0, 5.0, (1.5, 0.0)), "new.png")
    check = check_board(calibration, detection, lab.BOARD)
    assert check.tilt_deg == pytest.approx(1.5, abs=0.1)
    assert any("was turned" in p for p in check.problems)


def test_a_lens_that_was_changed_is_noticed(lab, calibration):
    view = replace(lab.looking_down(0.0, 0.0, 5.0, (20.0, 15.0), 700.0), distortion=np.array([-0.4, 0.15, 0, 0, 0.0]))
    check = check_board(calibration, lab.seen(view, "new.png"), lab.BOARD)
    assert any("focus or lens" in p for p in check.problems)


def test_a_calibration_without_a_table_is_checked_for_its_lens_only(lab, calibration):
    check = check_board(replace(calibration, plane=None), lab.seen(lab.looking_down(0, 0, 0, (20, 9)), "n"), lab.BOARD)
    assert check.problems == ()
    assert check.lift_mm is None


def test_the_movement_of_a_fixed_board_is_measured(lab, calibration):
    before = lab.seen(lab.looking_down(20.0, 10.0, 10.0), "old.png", seed=1)
    now = lab.seen(lab.looking_down(20.6, 10.0, 10.2), "new.png", seed=2)
    drift = drift_of_board(calibration, before, now)
    assert np.hypot(drift.x_mm, drift.y_mm) == pytest.approx(0.6, abs=0.02)
    assert abs(drift.turn_deg) == pytest.approx(0.2, abs=0.02)
    assert drift.worst_mm > drift.mean_mm > 0.5
    assert drift.residual_mm < 0.05
    assert drift_of_board(calibration, before, before).worst_mm == 0.0


def marked(lab, shift=(0.0, 0.0), seed=0):
    """A dark table with light discs; the second number of each pixel pair is where it is after the shift."""
    fine = np.full((lab.SIZE[1] * 4, lab.SIZE[0] * 4), 60.0, np.float32)
    marks = [(120.0, 90.0), (840.0, 100.0), (830.0, 500.0), (110.0, 510.0), (480.0, 300.0)]
    for u, v in marks:
        centre = (round((u + shift[0] + 0.375) * 4 * 16), round((v + shift[1] + 0.375) * 4 * 16))
        cv2.circle(fine, centre, 7 * 4 * 16, 190.0, cv2.FILLED, cv2.LINE_8, 4)
    small = cv2.GaussianBlur(cv2.resize(fine, lab.SIZE, interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    noise = np.random.default_rng(seed).normal(0.0, 1.5, small.shape)
    return np.clip((small + noise).round(), 0, 255).astype(np.uint8), marks


def test_the_movement_of_marks_is_measured_to_a_part_of_a_pixel(lab, calibration):
    before, marks = marked(lab)
    now, _ = marked(lab, (2.25, -1.5), seed=1)
    drift, failures = drift_of_marks(calibration, before, now, marks)
    assert failures == []
    assert drift.points == 5
    pixels = np.array(marks)
    moved = calibration.table_from_image(pixels + np.array([2.25, -1.5])) - calibration.table_from_image(pixels)
    assert np.array([drift.x_mm, drift.y_mm]) == pytest.approx(moved.mean(axis=0), abs=0.02)


def test_marks_that_are_not_found_again_are_named(lab, calibration):
    before, marks = marked(lab)
    covered = before.copy()
    covered[40:140, 70:170] = 60
    _, failures = drift_of_marks(calibration, before, covered, [*marks, (3.0, 3.0), (300.0, 200.0)])
    assert any("120,90: is not found" in line for line in failures)
    assert any("3,3: is within 24 px" in line for line in failures)
    assert any("300,200: has no contrast" in line for line in failures)
    with pytest.raises(CalibrationError, match="fewer than two marks"):
        drift_of_marks(calibration, before, np.zeros_like(before), marks)


def test_pictures_of_another_size_are_refused(lab, calibration):
    before, marks = marked(lab)
    with pytest.raises(CalibrationError, match="has 400x300 pixels"):
        drift_of_marks(calibration, before, before[:300, :400], marks)


def test_a_file_of_marks_is_read(tmp_path):
    path = tmp_path / "marks.csv"
    path.write_text("u,v\n10.5,20\n")
    assert load_marks(path) == [(10.5, 20.0)]
