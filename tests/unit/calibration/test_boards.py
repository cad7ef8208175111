"""Boards are written in one line, and wrong lines are refused with what is wrong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slabcell.calibration import Board
from slabcell.errors import UsageError

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(
    "text",
    [
        "checkerboard:12x9:25",
        "checkerboard:9x6:0.5",
        "charuco:12x9:25:18:4X4_250",
        "charuco:8x11:15:11:5X5_1000:legacy",
        "circles:4x11:20",
        "circles:4x11:20:14",
    ],
)
def test_a_board_prints_as_it_was_written(text):
    assert str(Board.parse(text)) == text


def test_points_are_numbered_row_by_row_from_the_origin():
    points = Board.parse("checkerboard:12x9:25").points
    assert points.shape == (108, 3)
    assert points[0].tolist() == [0, 0, 0]
    assert points[1].tolist() == [25, 0, 0]
    assert points[12].tolist() == [0, 25, 0]


def test_charuco_counts_squares_and_has_the_corners_between_them():
    assert Board.parse("charuco:12x9:25:18").grid == (11, 8)


def test_every_second_row_of_circles_is_shifted_by_half_a_step():
    points = Board.parse("circles:4x11:20").points
    assert len(points) == 44
    assert points[:5].tolist() == [[0, 0, 0], [40, 0, 0], [80, 0, 0], [120, 0, 0], [20, 20, 0]]


@pytest.mark.parametrize(
    ("text", "about"),
    [
        ("", "is not one of"),
        ("chess:12x9:25", "is not one of"),
        ("checkerboard:12x9", "is not one of"),
        ("checkerboard:12:25", "COLUMNSxROWS"),
        ("checkerboard:12x9x3:25", "COLUMNSxROWS"),
        ("checkerboard:2x9:25", "outside 3 to 200"),
        ("checkerboard:12x9000:25", "outside 3 to 200"),
        ("checkerboard:-12x9:25", "outside 3 to 200"),
        ("checkerboard:12x9:0", "outside 0.05 mm to 1000 mm"),
        ("checkerboard:12x9:nan", "outside 0.05 mm to 1000 mm"),
        ("checkerboard:12x9:25:18", "too much"),
        ("charuco:12x9:25", "needs the marker's size"),
        ("charuco:12x9:25:25", "does not fit"),
        ("charuco:12x9:25:18:9X9_1", "unknown dictionary"),
        ("charuco:40x40:25:18:4X4_50", "has 800 markers, dictionary 4X4_50 only 50"),
        ("charuco:3x9:25:18", "outside 4 to 200"),
        ("circles:4x11:20:30", "touch each other"),
        ("checkerboard:12x9:25" + "0" * 300, "is not one of"),
    ],
)
def test_a_wrong_board_is_refused_with_what_is_wrong(text, about):
    with pytest.raises(UsageError, match=about):
        Board.parse(text)


@given(st.text(max_size=60) | st.from_regex(r"(checkerboard|charuco|circles):[0-9x:.\-]{0,20}", fullmatch=True))
def test_any_text_is_a_board_or_a_usage_error(text):
    try:
        board = Board.parse(text)
    except UsageError:
        return
    assert np.isfinite(board.points).all()
    assert Board.parse(str(board)).grid == board.grid
