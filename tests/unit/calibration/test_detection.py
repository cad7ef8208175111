"""The points of a board are found to a few hundredths of a pixel, in the board's own numbering."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from slabcell.calibration import Board, detect_board, detect_boards
from slabcell.calibration.corners import refine_corners
from slabcell.calibration.detection import best_variant
from slabcell.errors import ImageError

pytestmark = pytest.mark.unit


def errors(detection, view):
    return np.linalg.norm(detection.pixels - view.project(detection.points_mm), axis=1)


@pytest.mark.parametrize("turn_deg", [-170.0, -80.0, 10.0, 95.0])
def test_corners_are_found_and_numbered_from_the_dark_corner_however_the_board_is_turned(lab, turn_deg):
    view = lab.looking_down(5.0, -10.0, turn_deg, (18.0, -12.0), 800.0)
    detection = detect_board(lab.render_checkerboard(lab.BOARD, view), lab.BOARD, "view")
    off = errors(detection, view)
    assert np.sqrt(np.mean(off**2)) < 0.06
    assert off.max() < 0.2


def test_a_board_that_looks_the_same_after_half_a_turn_starts_at_the_left(lab):
    board = Board.parse("checkerboard:11x9:16")
    picture = lab.render_checkerboard(board, lab.looking_down(5.0, -10.0, 150.0, height_mm=800.0))
    pixels = detect_board(picture, board, "view").pixels
    assert pixels[0, 0] < pixels[-1, 0]
    row, column = pixels[10] - pixels[0], pixels[-11] - pixels[0]
    assert row[0] * column[1] - row[1] * column[0] < 0.0


def test_the_windows_of_the_refinement_follow_the_squares(lab):
    grid = 40 + np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1).reshape(-1, 2)
    grey = np.zeros((200, 200), np.uint8)
    board = np.column_stack([grid, np.zeros(len(grid))])
    widths = [[window for window, _ in refine_corners(grey, board, grid, step)[1]] for step in (6.0, 12.0, 24.0, 60.0)]
    assert widths == [[2], [5, 3, 2], [10, 7, 4, 3], [15, 12, 8]]


def test_covered_corners_are_exact_or_left_out(lab):
    view = lab.looking_down(5.0, -10.0, 10.0, (18.0, -12.0), 800.0)
    picture = lab.render_checkerboard(lab.BOARD, view)
    for u, v in view.project(lab.BOARD.points[[14, 50, 73]]):
        cv2.circle(picture, (round(u) + 5, round(v) - 4), 12, 120, cv2.FILLED)
    detection = detect_board(picture, lab.BOARD, "view")
    assert 100 <= len(detection.indices) <= 108
    assert errors(detection, view).max() < 0.3


@pytest.mark.parametrize("table", [30, 110, 215], ids=["dark", "grey", "light"])
def test_a_board_without_a_margin_is_found_on_any_table(lab, table):
    view = lab.looking_down(5.0, -10.0, 10.0, (18.0, -12.0), 800.0)
    at = view.board_at_pixels() / lab.BOARD.pitch_mm
    i, j = np.floor(at[..., 0]).astype(int), np.floor(at[..., 1]).astype(int)
    grey = np.full(at.shape[:2], table, np.float32)
    on = (i >= -1) & (j >= -1) & (i < lab.BOARD.columns) & (j < lab.BOARD.rows)
    grey[on] = np.where((i + j) % 2 == 0, 35, 215)[on]
    picture = cv2.GaussianBlur(cv2.resize(grey, view.size, interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    detection = detect_board(picture.round().astype(np.uint8), lab.BOARD, "view")
    assert len(detection.indices) == 108
    assert errors(detection, view).max() < 0.2


def test_a_corner_that_jumps_to_the_boards_rim_is_taken_back(lab):
    # Beside the first corner the outer squares are cut to a third: a wide window finds their outer corner instead.
    view = lab.looking_down(5.0, -10.0, 10.0, (18.0, -12.0), 800.0)
    picture = lab.render_checkerboard(lab.BOARD, view)
    at = cv2.resize(view.board_at_pixels() / lab.BOARD.pitch_mm, view.size, interpolation=cv2.INTER_AREA)
    cut = ((at[..., 0] < -0.33) | (at[..., 1] < -0.33)) & (at[..., 0] < 0.9) & (at[..., 1] < 0.9)
    picture[cut] = 215
    step = float(np.hypot(*(view.project(lab.BOARD.points[:2])[0] - view.project(lab.BOARD.points[:2])[1])))
    truth = view.project(lab.BOARD.points)
    (kept, variants), plain = refine_corners(picture, lab.BOARD.points, truth, step), truth.astype(np.float32)
    window = variants[0][0]
    plain = cv2.cornerSubPix(picture, plain.copy(), (window, window), (-1, -1), (3, 40, 1e-3))
    assert np.hypot(*(plain - truth).T).max() > 2.0
    for _, found in variants:
        assert np.hypot(*(found - truth[kept]).T).max() < 0.7


def test_the_window_with_the_smallest_residual_is_taken_and_at_a_draw_the_widest(lab):
    seen = lab.seen(lab.looking_down(0, 0))
    seen = replace(seen, variants=((9, seen.pixels), (5, seen.pixels + 1.0), (3, seen.pixels + 2.0)))
    offset = seen.pixels[0, 0]
    for wanted, residuals in ((0, (1.0, 1.0, 1.0)), (1, (1.0, 0.5, 0.6)), (0, (1.0, 0.98, 0.99)), (2, (3.0, 2.0, 1.0))):
        (best,) = best_variant([seen], lambda trial, r=residuals: r[round(float(trial[0].pixels[0, 0] - offset))])
        assert best.pixels[0, 0] - offset == pytest.approx(wanted)


def test_sixteen_bit_and_colour_pictures_are_read_as_well(lab):
    view = lab.looking_down(0.0, 0.0, 3.0, height_mm=800.0)
    picture = lab.render_checkerboard(lab.BOARD, view)
    deep = picture.astype(np.uint16) * 16
    colour = np.repeat(picture[:, :, None], 3, axis=2)
    for shown in (deep, colour):
        assert errors(detect_board(shown, lab.BOARD, "view"), view).max() < 0.2


@pytest.mark.parametrize(
    ("picture", "about"),
    [
        (np.zeros((400, 500), np.uint8), "no checkerboard:12x9:16 found"),
        (np.full((400, 500), 255, np.uint8), "no checkerboard:12x9:16 found"),
        (np.zeros((1, 1), np.uint8), "holds no board"),
        (np.zeros((400, 500, 2), np.uint8), "neither grey nor colour"),
        (np.zeros((400, 500), np.float64), "type float64"),
        (np.zeros((400,), np.uint8), "holds no board"),
    ],
)
def test_a_picture_without_a_board_is_refused_by_name(lab, picture, about):
    with pytest.raises(ImageError, match=about) as caught:
        detect_board(picture, lab.BOARD, "shot-7.png")
    assert "shot-7.png" in str(caught.value)


def test_many_pictures_keep_their_order_and_the_ones_without_a_board_are_named(lab):
    good = lab.render_checkerboard(lab.BOARD, lab.looking_down(0.0, 0.0, 3.0, height_mm=800.0))
    pictures = [(f"{n}.png", good if n % 2 else np.zeros((64, 64), np.uint8)) for n in range(6)]
    finished: list[str] = []
    detections, failures = detect_boards(iter(pictures), lab.BOARD, done=finished.append)
    assert [d.name for d in detections] == ["1.png", "3.png", "5.png"]
    assert [line.split(":")[0] for line in failures] == ["0.png", "2.png", "4.png"]
    assert finished == [name for name, _ in pictures]
