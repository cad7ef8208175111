"""Zhang's method finds the lens, says how sure it is, and names the views that do not fit."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from slabcell.calibration import CameraIdentity, Detection, calibrate_camera
from slabcell.calibration.coverage import draw_coverage
from slabcell.errors import CalibrationError

pytestmark = pytest.mark.unit


@pytest.fixture(scope="module")
def views(lab):
    return [lab.seen(view, f"v{n}.png", seed=n) for n, view in enumerate(lab.tilted_views())]


def test_the_lens_is_found_within_its_own_standard_deviations(lab, views):
    result = calibrate_camera(views, lab.BOARD, serial="C-1")
    matrix = result.calibration.lens.matrix
    truth = dict(zip(("fx", "fy", "cx", "cy"), lab.MATRIX[[0, 1, 0, 1], [0, 1, 2, 2]], strict=True))
    found = dict(zip(truth, matrix[[0, 1, 0, 1], [0, 1, 2, 2]], strict=True))
    for name, value in truth.items():
        assert abs(found[name] - value) < 4.0 * result.std[name] < 4.0, name
    assert 0.025 < result.rms_px / np.sqrt(2.0) < 0.035
    assert result.calibration.camera.serial == "C-1"
    assert (result.calibration.camera.width, result.calibration.camera.height) == lab.SIZE
    assert result.calibration.plane is None


def test_standard_deviations_are_those_of_repeated_calibrations(lab):
    placed = lab.tilted_views()
    found, claimed = [], []
    for trial in range(16):
        seen = [lab.seen(v, str(n), seed=1000 * trial + n) for n, v in enumerate(placed)]
        result = calibrate_camera(seen, lab.BOARD, holdout=False)
        found.append(result.calibration.lens.matrix[0, 0])
        claimed.append(result.std["fx"])
    assert 0.55 < np.std(found, ddof=1) / np.mean(claimed) < 1.6


def test_a_view_that_disagrees_with_the_others_is_named_and_left_out(lab, views):
    bent = views[4]
    wave = 2.0 * np.sin(bent.points_mm[:, :1] / 30.0)
    spoilt = [*views[:4], replace(bent, pixels=bent.pixels + wave), *views[5:]]
    result = calibrate_camera(spoilt, lab.BOARD)
    assert [v.name for v in result.views if not v.used] == ["v4.png"]
    assert any("v4.png was left out" in line for line in result.warnings)
    assert abs(result.calibration.lens.matrix[0, 0] - lab.MATRIX[0, 0]) < 4.0 * result.std["fx"]


def test_flat_views_alone_are_warned_about(lab):
    flat = [lab.seen(view, f"{n}", seed=n) for n, view in enumerate(lab.flat_views())]
    try:
        result = calibrate_camera(flat, lab.BOARD)
    except CalibrationError as error:
        assert "tilted" in str(error)  # noqa: PT017  both ends are right, and both must say what to do
    else:
        assert any("tilt" in line for line in result.warnings)


def test_views_in_the_middle_only_are_warned_about(lab):
    placed = [lab.looking_down(0, 0, 40.0 * n, (20.0 * (-1) ** n, 15.0), 1500.0) for n in range(8)]
    result = calibrate_camera([lab.seen(v, f"{n}", seed=n) for n, v in enumerate(placed)], lab.BOARD)
    assert any("of the picture" in line for line in result.warnings)


def test_too_few_views_are_refused(lab, views):
    with pytest.raises(CalibrationError, match="3 pictures show the board, at least 4"):
        calibrate_camera(views[:3], lab.BOARD)


def test_pictures_of_different_size_are_refused_by_name(lab, views):
    with pytest.raises(CalibrationError, match=r"differ in size.*v1.png 640x480"):
        calibrate_camera([views[0], replace(views[1], width=640, height=480), *views[2:]], lab.BOARD)


def test_the_same_view_four_times_determines_no_lens_and_says_so(lab):
    flat = [lab.seen(lab.looking_down(0, 0, 0), f"{n}", noise_px=0.0) for n in range(4)]
    with pytest.raises(CalibrationError, match="tilted"):
        calibrate_camera(flat, lab.BOARD)


def test_the_holdout_residual_is_that_of_views_the_lens_has_not_seen(lab, views):
    result = calibrate_camera(views, lab.BOARD)
    assert result.rms_px < result.holdout_px < 1.2 * result.rms_px
    assert 0.0 < result.focal_distance_correlation < 1.0


@pytest.mark.parametrize("model", ["brown4", "brown5", "brown8", "brown14"])
def test_every_distortion_model_explains_the_views_and_projects_alike(lab, views, model):
    result = calibrate_camera(views, lab.BOARD, model=model)
    lens = result.calibration.lens
    assert len(lens.distortion) == int(model.removeprefix("brown"))
    assert set(result.std) >= {"fx", "k1", "p2"}
    assert 0.025 < result.rms_px / np.sqrt(2.0) < 0.035


def test_a_fisheye_is_found(lab):
    matrix = np.array([[420.0, 0, 481], [0, 421.0, 303], [0, 0, 1]])
    coefficients = np.array([-0.02, 0.005, -0.002, 0.0003])
    random = np.random.default_rng(5)
    detections = []
    for n in range(14):
        view = lab.looking_down(
            130.0 * (n % 3 - 1),
            70.0 * (n // 3 % 3 - 1),
            random.uniform(-180, 180),
            tuple(random.uniform(-35, 35, 2)),
            190.0,
        )
        points = lab.BOARD.points
        turn, _ = cv2.Rodrigues(view.rotation)
        pixels, _ = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), turn, view.translation, matrix, coefficients)
        pixels = pixels.reshape(-1, 2) + random.normal(0, 0.03, (len(points), 2))
        detections.append(Detection(f"{n}", *lab.SIZE, np.arange(len(points)), points, pixels))
    result = calibrate_camera(detections, lab.BOARD, model="fisheye", holdout=False)
    assert result.calibration.lens.model == "fisheye"
    assert abs(result.calibration.lens.matrix[0, 0] - 420.0) < 4.0 * result.std["fx"] < 2.0


def test_the_calibration_is_bound_to_region_and_binning(lab, views):
    calibration = calibrate_camera(views, lab.BOARD, serial="C-1", offset=(8, 16), binning=2).calibration
    here = calibration.camera
    assert here == CameraIdentity(*lab.SIZE, "C-1", 8, 16, 2)
    calibration.require_camera(here, "camera A")
    calibration.require_camera(replace(here, serial=""), "camera A")
    for other, about in (
        (replace(here, serial="C-2"), "serial number C-2 instead of C-1"),
        (replace(here, offset_x=0), "region offset x 0 instead of 8"),
        (replace(here, binning=1), "binning 1 instead of 2"),
        (replace(here, width=100), "has 100x600 pixels"),
    ):
        with pytest.raises(CalibrationError, match=about):
            calibration.require_camera(other, "camera A")


def test_the_coverage_is_drawn(lab, views):
    result = calibrate_camera(views, lab.BOARD)
    picture = draw_coverage(result.coverage, result.residuals, 600)
    assert picture.shape == (375, 600, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3
