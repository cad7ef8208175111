"""Zhang's method finds the lens, says how sure it is, and names the views that do not fit."""

from dataclasses import replace

import numpy as np
import pytest

from slabcell.calibration import calibrate_camera
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
    for trial in range(30):
        result = calibrate_camera([lab.seen(v, str(n), seed=1000 * trial + n) for n, v in enumerate(placed)], lab.BOARD)
        found.append(result.calibration.lens.matrix[0, 0])
        claimed.append(result.std["fx"])
    assert 0.6 < np.std(found) / np.mean(claimed) < 1.6


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
