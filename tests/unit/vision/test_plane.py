from dataclasses import replace

import numpy as np
import pytest

from slabcell.calibration.model import Calibration, Lens, TablePlane
from slabcell.errors import CalibrationError
from slabcell.vision import locate
from slabcell.vision.plane import GRID_PX, PlaneView

from .pictures import calibration, moved, recipe, render

pytestmark = pytest.mark.unit

CAMERA = calibration(k1=-0.08)
# A principal point so far beside the picture that all of it lies where that lens folds over.
ASIDE = CAMERA.lens.matrix.copy()
ASIDE[0, 2] = 3400.0


def with_lens(camera: Calibration, *distortion: float) -> Calibration:
    return replace(camera, lens=Lens(camera.lens.matrix, np.array(distortion)))


def test_a_usual_lens_sees_the_table_everywhere():
    assert PlaneView(CAMERA, 0.0).usable is None
    assert PlaneView(CAMERA, 10.0).usable is None


def test_where_a_lens_model_folds_over_is_no_place():
    # r·(1 + k1·r²) turns back at r = √(-1/(3·k1)): 0.167 here, 300 px from the middle.
    usable = PlaneView(with_lens(CAMERA, -12.0, 0.0, 0.0, 0.0, 0.0), 0.0).usable
    assert usable is not None
    v, u = np.nonzero(usable)
    far = np.hypot((u + 0.5) * GRID_PX - 399.5, (v + 0.5) * GRID_PX - 299.5)
    assert far.max() < 230
    assert not usable[0, 0]
    assert usable[12, 16]


def test_beyond_the_horizon_is_no_place():
    turn = np.deg2rad(80.0)
    tilt = np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]])
    rotation = tilt @ np.diag([1.0, -1.0, -1.0])
    tilted = replace(CAMERA, plane=TablePlane(rotation, np.array([0.0, 0.0, 900.0])))
    usable = PlaneView(with_lens(tilted, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0).usable
    assert usable is not None
    # The horizon is 10° above the view, f·tan 10° = 317 px from the middle, or where pixels grow too large before it.
    assert not usable[0].any() or not usable[-1].any()
    assert usable.any()


def test_blobs_are_looked_for_only_where_there_is_a_table():
    square = [(0, 0), (45, 0), (45, 45), (0, 45)]
    picture = render(with_lens(CAMERA, 0.0, 0.0, 0.0, 0.0, 0.0), [moved(square, -20, -20), moved(square, 120, 80)])
    result = locate(picture, with_lens(CAMERA, -12.0, 0.0, 0.0, 0.0, 0.0), recipe([square]))
    assert "see no table" in result.segmentation
    assert len(result.parts) + len(result.rejected) == 1


@pytest.mark.parametrize(
    "camera",
    [
        replace(CAMERA, lens=Lens(ASIDE, np.array([-12.0, 0.0, 0.0, 0.0]))),
        replace(CAMERA, plane=TablePlane(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 5e5]))),
        replace(CAMERA, plane=TablePlane(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))),
        replace(CAMERA, plane=TablePlane(np.eye(3)[[0, 2, 1]] * [1, 1, -1], np.array([0.0, 100.0, -1e-9]))),
    ],
    ids=["lens", "far", "near", "edge on"],
)
def test_a_calibration_by_which_the_picture_sees_no_table_is_refused(camera: Calibration):
    picture = np.full((600, 800), 60, np.uint8)
    with pytest.raises(CalibrationError, match=r"middle of the picture.*calibrate again"):
        locate(picture, camera, recipe())
