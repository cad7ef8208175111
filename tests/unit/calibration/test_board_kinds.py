"""ChArUco boards and circle grids are found in the numbering of their own frame, as exactly as checkerboards."""

import cv2
import numpy as np
import pytest

from slabcell.calibration import Board, calibrate_camera, detect_board
from slabcell.calibration.circles import disc_shift
from slabcell.calibration.model import Lens
from slabcell.errors import ImageError

pytestmark = pytest.mark.unit

CHARUCO = Board.parse("charuco:12x9:16:12:5X5_250")
CIRCLES = Board.parse("circles:5x11:14:16")


def charuco_print(board, dots_per_mm=12):
    """The board as OpenCV prints it, without margin: (rows·pitch, columns·pitch) in dots."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
    shape = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_mm, board.marker_mm, dictionary)
    shape.setLegacyPattern(board.legacy)
    size = (round(board.columns * board.pitch_mm * dots_per_mm), round(board.rows * board.pitch_mm * dots_per_mm))
    return shape.generateImage(size)


def render_charuco(lab, board, view, seed=0):
    printed = cv2.copyMakeBorder(charuco_print(board), 192, 192, 192, 192, cv2.BORDER_CONSTANT, value=255)
    at = view.board_at_pixels()
    # The frame begins at the lower left inner corner, one square from the edge of the print.
    left = (at[..., 0] + board.pitch_mm) * 12.0 - 0.5 + 192
    top = (board.rows * board.pitch_mm - board.pitch_mm - at[..., 1]) * 12.0 - 0.5 + 192
    fine = cv2.remap(printed, left, top, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=110)
    return expose(lab, np.where(fine == 110, 110.0, 35.0 + fine * (180.0 / 255.0)), view, seed)


def render_circles(lab, board, view, seed=0):
    at = view.board_at_pixels()
    grey = np.full(at.shape[:2], 210.0, np.float32)
    for (x, y, _), (u, v) in zip(board.points, view.project(board.points) * 3.0 + 1.0, strict=True):
        near = np.s_[max(int(v) - 90, 0) : max(int(v) + 90, 0), max(int(u) - 90, 0) : max(int(u) + 90, 0)]
        grey[near][np.hypot(at[near][..., 0] - x, at[near][..., 1] - y) <= board.diameter_mm / 2.0] = 40.0
    return expose(lab, grey, view, seed)


def expose(lab, fine, view, seed):
    small = cv2.resize(fine.astype(np.float32), view.size, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 0.7) + np.random.default_rng(seed).normal(0.0, 1.5, view.size[::-1])
    return np.clip(small.round(), 0, 255).astype(np.uint8)


def errors(detection, view):
    return np.linalg.norm(detection.pixels - view.project(detection.points_mm), axis=1)


@pytest.mark.parametrize("turn_deg", [5.0, 100.0, -160.0])
def test_a_charuco_board_is_found_however_it_is_turned(lab, turn_deg):
    view = lab.looking_down(0.0, 5.0, turn_deg, (15.0, -10.0), 800.0)
    detection = detect_board(render_charuco(lab, CHARUCO, view), CHARUCO, "view")
    off = errors(detection, view)
    assert len(off) > 80
    assert np.sqrt(np.mean(off**2)) < 0.1


def test_a_part_of_a_charuco_board_is_enough(lab):
    view = lab.looking_down(200.0, 110.0, 20.0, (10.0, 10.0), 800.0)
    detection = detect_board(render_charuco(lab, CHARUCO, view), CHARUCO, "view")
    assert 6 <= len(detection.pixels) < 70
    assert np.median(errors(detection, view)) < 0.1


def test_the_older_charuco_pattern_is_another_board(lab):
    # The two patterns differ where the number of rows is even.
    new, old = Board.parse("charuco:12x8:16:12:5X5_250"), Board.parse("charuco:12x8:16:12:5X5_250:legacy")
    view = lab.looking_down(0.0, 5.0, 5.0, (15.0, -10.0), 800.0)
    picture = render_charuco(lab, old, view)
    assert np.median(errors(detect_board(picture, old, "view"), view)) < 0.1
    with pytest.raises(ImageError, match="no charuco"):
        detect_board(picture, new, "view")


@pytest.mark.parametrize("turn_deg", [5.0, 100.0, -160.0])
def test_circles_are_found_and_their_centres_are_right_once_perspective_is_taken_off(lab, turn_deg):
    view = lab.looking_down(20.0, 5.0, turn_deg, (20.0, -15.0), 850.0)
    detection = detect_board(render_circles(lab, CIRCLES, view), CIRCLES, "view")
    assert len(detection.pixels) == 55
    raw = errors(detection, view)
    centred = errors(detection.centred(Lens(lab.MATRIX, lab.DISTORTION)), view)
    assert np.sqrt(np.mean(centred**2)) < 0.05
    assert np.sqrt(np.mean(centred**2)) < np.sqrt(np.mean(raw**2))


def test_the_shift_of_a_disc_is_that_of_its_picture(lab):
    view = lab.looking_down(0.0, 0.0, 0.0, (30.0, 20.0), 500.0)
    turn, _ = cv2.Rodrigues(view.rotation)
    pose = np.concatenate([turn.ravel(), view.translation])
    points = CIRCLES.points[:3]
    shift = disc_shift(points, 20.0, pose, Lens(lab.MATRIX, lab.DISTORTION))
    for point, moved in zip(points, shift, strict=True):
        # The mean of many points of the picture of the disc, each weighted by how much picture it stands for.
        grid = np.stack(np.meshgrid(np.linspace(-10, 10, 301), np.linspace(-10, 10, 301)), axis=-1).reshape(-1, 2)
        inside = grid[np.hypot(*grid.T) <= 10.0]
        pixels = view.project(point + np.column_stack([inside, np.zeros(len(inside))]))
        near = point + np.column_stack([inside + 1e-4, np.zeros(len(inside))])
        stretch = np.abs(
            np.cross(
                np.column_stack([view.project(near - [0, 1e-4, 0]) - pixels, np.zeros(len(pixels))]),
                np.column_stack([view.project(near - [1e-4, 0, 0]) - pixels, np.zeros(len(pixels))]),
            )[:, 2]
        )
        centre = (pixels * stretch[:, None]).sum(axis=0) / stretch.sum()
        assert np.abs(centre - view.project(point[None])[0] - moved).max() < 0.1 * np.abs(moved).max()


def test_discs_give_the_lens_without_the_bias_that_perspective_puts_on_their_centres(lab):
    points = CIRCLES.points
    detections = []
    for n, view in enumerate(lab.tilted_views()):
        turn, _ = cv2.Rodrigues(view.rotation)
        pose = np.concatenate([turn.ravel(), view.translation])
        seen = lab.seen(view, f"{n}", CIRCLES, noise_px=0.02, seed=n)
        moved = seen.pixels + disc_shift(points, 16.0, pose, Lens(lab.MATRIX, lab.DISTORTION))
        detections.append(type(seen)(f"{n}", *view.size, seen.indices, points, moved, disc_mm=16.0))
    result = calibrate_camera(detections, CIRCLES)
    assert abs(result.calibration.lens.matrix[0, 0] - lab.MATRIX[0, 0]) < 4.0 * result.std["fx"]
    assert result.rms_px < 0.035


def test_a_faint_or_inverted_charuco_board_is_found_as_well(lab):
    view = lab.looking_down(0.0, 5.0, 10.0, (15.0, -10.0), 800.0)
    picture = render_charuco(lab, CHARUCO, view)
    faint = np.round(100.0 + (picture.astype(float) - 100.0) * 0.12).astype(np.uint8)
    for shown in (faint, 255 - picture):
        detection = detect_board(shown, CHARUCO, "view")
        assert len(detection.pixels) > 80
        assert np.median(errors(detection, view)) < 0.1


def test_light_circles_on_a_dark_board_are_found_as_well(lab):
    view = lab.looking_down(0.0, 5.0, 10.0, (15.0, -10.0), 800.0)
    picture = render_circles(lab, CIRCLES, view)
    dark, light = detect_board(picture, CIRCLES, "dark"), detect_board(255 - picture, CIRCLES, "light")
    assert np.abs(dark.pixels - light.pixels).max() < 0.02
