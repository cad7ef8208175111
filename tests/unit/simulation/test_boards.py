from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from slabcell_drivers.simulation import board_corners, camera_views, load_scene, plane_views, render_board
from slabcell_drivers.simulation.projection import Projector

pytestmark = pytest.mark.unit

SCENE = load_scene(Path(__file__).parents[3] / "config" / "scenes" / "irregular.toml")
BOARD = SCENE.board


def test_the_views_for_the_lens_are_all_in_the_picture_tilted_and_cover_most_of_it() -> None:
    views = camera_views(SCENE, 3)
    corners = [board_corners(SCENE.camera, BOARD, view) for view in views]
    towards = [
        np.degrees(np.arccos((np.linalg.inv(SCENE.camera.frame.matrix) @ view.matrix)[2, 2] * -1)) for view in views
    ]
    points = np.concatenate(corners)
    hull = cv2.contourArea(cv2.convexHull(points.astype(np.float32))) / (SCENE.camera.width * SCENE.camera.height)

    assert len(views) == 15
    assert np.all(points > 0)
    assert np.all(points < (SCENE.camera.width, SCENE.camera.height))
    assert min(towards) > 5
    assert max(towards) < 45
    assert hull > 0.64


def test_the_first_view_on_the_table_has_the_table_frames_origin_and_axes() -> None:
    views = plane_views(SCENE)
    first = SCENE.table.frame.inverse() @ views[0]

    assert len(views) == 5
    assert first.as_tuple() == pytest.approx((0, 0, BOARD.thickness_mm, 0, 0, 0), abs=1e-9)
    assert all(view.z_mm == pytest.approx(BOARD.thickness_mm) for view in views)
    assert plane_views(SCENE, thickness_mm=0.5)[2].z_mm == pytest.approx(0.5)


def test_the_corners_of_a_rendered_board_are_where_the_truth_says() -> None:
    view = camera_views(SCENE, 1)[4]

    picture = render_board(SCENE.camera, SCENE.optics, BOARD, view, seed=2)

    truth = board_corners(SCENE.camera, BOARD, view).astype(np.float32).reshape(-1, 1, 2)
    start = truth + np.float32([0.8, -0.6])
    found = cv2.cornerSubPix(
        picture, start, (8, 8), (-1, -1), (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-5)
    )
    error = (found - truth).reshape(-1, 2)
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert np.all(np.abs(error.mean(axis=0)) < 0.01)


def test_the_square_outward_of_the_first_inner_corner_is_black_and_its_opposite_white() -> None:
    view = plane_views(SCENE)[0]
    quiet = replace(SCENE.optics, noise_dn=0.0, shot_dn=0.0)

    picture = render_board(SCENE.camera, quiet, BOARD, view)

    def level(i: float, j: float) -> int:
        flat = np.array([[i * BOARD.pitch_mm, j * BOARD.pitch_mm, 0.0, 1.0]])
        u, v = Projector(SCENE.camera).pixels((flat @ view.matrix.T)[:, :3])[0]
        return int(picture[round(v), round(u)])

    assert level(-0.5, -0.5) < 50
    assert level(0.5, -0.5) > 120
    assert level(0.5, 0.5) < 50
    assert level(BOARD.columns - 0.5, BOARD.rows - 0.5) > 120
    assert level(-1.5, 3.0) > 120  # the margin
