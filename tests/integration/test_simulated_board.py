"""A simulated cell shows its board to its own camera: found, and true enough to calibrate everything with."""

import numpy as np
import pytest

from slabcell.calibration import (
    Board,
    Calibration,
    CameraIdentity,
    Lens,
    RobotPose,
    calibrate_hand_eye,
    detect_board,
)
from slabcell.service.demo import read_demo_parts
from slabcell.service.simulated import SimulatedCell
from slabcell.service.simulated_board import BoardStand

pytestmark = [pytest.mark.integration, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def cell() -> SimulatedCell:
    parts = read_demo_parts("dresden")
    return SimulatedCell(parts.scene, 3, parts.arm, parts.config.robot.tool.to_frame())


def test_the_board_is_seen_held_and_on_the_table_until_it_is_taken_away(cell: SimulatedCell) -> None:
    stand = BoardStand(cell, 3)
    board = Board.parse(stand.shown.board)
    slabs = cell.picture(1)
    for place, number in (("held", 0), ("held", 1), ("table", 0), ("table", 7)):
        shown = stand.show(place, number)
        assert (shown.place, shown.number, shown.flange) == (place, number, None)
        assert len(detect_board(cell.picture(1), board, place).indices) == board.columns * board.rows
    stand.show("away", 0)
    assert np.array_equal(cell.picture(1), slabs)


def test_the_flange_says_where_it_holds_the_board(cell: SimulatedCell) -> None:
    stand, spec = BoardStand(cell, 3), cell.scene.camera
    board = Board.parse(stand.shown.board)
    lens = Lens(
        np.array([[spec.fx_px, 0.0, spec.cx_px], [0.0, spec.fy_px, spec.cy_px], [0.0, 0.0, 1.0]]),
        np.array(spec.distortion),
    )
    views, poses = [], []
    for number in range(8):
        shown = stand.show("flange", number)
        assert shown.flange is not None
        views.append(detect_board(cell.picture(number), board, str(number)))
        x, y, z, a, b, c = shown.flange
        poses.append(RobotPose(str(number), (x, y, z, a, b, c)))
    stand.show("away", 0)
    found = calibrate_hand_eye(
        Calibration(CameraIdentity(spec.width, spec.height), lens), views, poses, board, "eye-to-hand"
    )
    assert found.camera[:3] == pytest.approx(spec.frame.as_tuple()[:3], abs=0.5)
    assert found.holdout_mm < 0.5
