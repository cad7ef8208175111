"""The table plane comes from boards lying on it, and its frame from the first board or from touched points."""

from dataclasses import replace

import numpy as np
import pytest

from slabcell.calibration import Calibration, CameraIdentity, Lens, Touch, calibrate_camera, calibrate_plane
from slabcell.calibration.touch import load_touch
from slabcell.errors import CalibrationError

pytestmark = pytest.mark.unit


@pytest.fixture(scope="module")
def lens(lab):
    views = [lab.seen(view, f"v{n}", seed=n) for n, view in enumerate(lab.tilted_views())]
    return calibrate_camera(views, lab.BOARD).calibration


@pytest.fixture(scope="module")
def lying(lab):
    return [lab.seen(view, f"p{n}.png", seed=50 + n) for n, view in enumerate(lab.flat_views())]


def table_errors(lab, calibration, height_mm=0.0, lift_mm=0.0):
    """Errors over the whole picture, in the frame of the first flat view's board moved down by ``lift_mm``."""
    view = lab.flat_views()[0]
    grid = np.stack(np.meshgrid(np.arange(-180.0, 360.0, 15.0), np.arange(-90.0, 220.0, 15.0)), axis=-1).reshape(-1, 2)
    pixels = view.project(np.column_stack([grid, np.full(len(grid), height_mm - lift_mm)]))
    inside = ((pixels > 0) & (pixels < lab.SIZE)).all(axis=1)
    assert inside.sum() > 200
    return np.linalg.norm(calibration.table_from_image(pixels[inside], height_mm) - grid[inside], axis=1)


def test_five_positions_give_the_table_to_hundredths_of_a_millimetre(lab, lens, lying):
    result = calibrate_plane(lens, lying, lab.BOARD)
    errors = table_errors(lab, result.calibration)
    assert np.median(errors) < 0.02
    assert np.percentile(errors, 95) < 0.08
    assert result.warnings == ()


def test_several_positions_are_better_than_one(lab, lens, lying):
    one = table_errors(lab, calibrate_plane(lens, lying[:1], lab.BOARD).calibration)
    five = table_errors(lab, calibrate_plane(lens, lying, lab.BOARD).calibration)
    assert np.percentile(five, 95) < 0.6 * np.percentile(one, 95)


def test_the_table_is_a_board_thickness_below_the_printed_face(lab, lens, lying):
    result = calibrate_plane(lens, lying, lab.BOARD, board_thickness_mm=6.0)
    assert np.median(table_errors(lab, result.calibration, height_mm=6.0, lift_mm=6.0)) < 0.02
    assert np.median(table_errors(lab, result.calibration, height_mm=0.0, lift_mm=6.0)) < 0.03


def test_z_points_up_to_the_camera(lab, lens, lying):
    plane = calibrate_plane(lens, lying, lab.BOARD).calibration.require_plane()
    assert np.linalg.det(plane.rotation) == pytest.approx(1.0)
    assert (plane.rotation.T @ -plane.translation)[2] == pytest.approx(1040.0, abs=1.0)


def test_image_and_table_are_inverse_to_each_other(lab, lens, lying):
    calibration = calibrate_plane(lens, lying, lab.BOARD).calibration
    pixels = np.random.default_rng(0).uniform((0, 0), lab.SIZE, (50, 2))
    again = calibration.image_from_table(calibration.table_from_image(pixels, 12.0), 12.0)
    assert np.abs(again - pixels).max() < 1e-5


def test_a_board_that_does_not_lie_in_the_plane_is_named_and_left_out(lab, lens, lying):
    raised = lab.seen(lab.looking_down(60.0, 20.0, 40.0, height_mm=1030.0), "raised.png", seed=9)
    result = calibrate_plane(lens, [*lying, raised], lab.BOARD)
    assert any("raised.png was left out" in line and "+10" in line for line in result.warnings)
    assert len(result.views) == 5
    assert np.percentile(table_errors(lab, result.calibration), 95) < 0.08


def test_a_first_board_that_does_not_lie_in_the_plane_is_named_but_stays_the_frame(lab, lens, lying):
    raised = lab.seen(lab.looking_down(60.0, 20.0, 40.0, height_mm=1030.0), "raised.png", seed=9)
    result = calibrate_plane(lens, [raised, *lying], lab.BOARD)
    assert [v.name for v in result.views] == ["raised.png", *(d.name for d in lying)]
    assert any("does not lie in the plane" in line for line in result.warnings)


def test_a_calibration_without_knowledge_of_its_own_uncertainty_serves_as_well(lab, lying):
    bare = Calibration(CameraIdentity(*lab.SIZE), Lens(lab.MATRIX, lab.DISTORTION))
    assert np.percentile(table_errors(lab, calibrate_plane(bare, lying, lab.BOARD).calibration), 95) < 0.05


def test_pictures_of_another_size_are_refused(lab, lens, lying):
    with pytest.raises(CalibrationError, match=r"p0.png has 640x480 pixels, the calibration is of 960x600"):
        calibrate_plane(lens, [replace(lying[0], width=640, height=480)], lab.BOARD)


def touches(lab, motion, noise_mm, seed=0, corners=None):
    """The robot touches board corners of the first picture; ``motion`` takes board x, y to the robot's."""
    random = np.random.default_rng(seed)
    corners = corners or [(i, j) for i in (0, 5, 11) for j in (0, 4, 8)]
    found = []
    for n, (i, j) in enumerate(corners):
        x, y = motion @ (16.0 * i, 16.0 * j, 1.0) + random.normal(0.0, noise_mm, 2)
        found.append(Touch(f"point {n + 1}", x, y, "", (i, j)))
    return found


def turned(degrees, x, y, stretch=None):
    a = np.deg2rad(degrees)
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    return np.column_stack([(np.eye(2) if stretch is None else stretch) @ turn, (x, y)])


def test_touched_corners_give_the_robots_frame(lab, lens, lying):
    motion = turned(-88.0, 190.0, -120.0)
    result = calibrate_plane(lens, lying, lab.BOARD, touch=touches(lab, motion, 0.02), affine=False)
    view = lab.flat_views()[0]
    spots = np.array([[0.0, 0.0], [150.0, 90.0], [-60.0, 40.0]])
    pixels = view.project(np.column_stack([spots, np.zeros(3)]))
    wanted = spots @ motion[:, :2].T + motion[:, 2]
    assert np.abs(result.calibration.table_from_image(pixels) - wanted).max() < 0.08
    assert result.touch is not None
    assert result.touch.kind == "rigid"
    assert result.touch.holdout_mm < 0.06


def test_a_robot_whose_axes_are_skewed_gets_an_affine_frame(lab, lens, lying):
    motion = turned(30.0, 190.0, -120.0, stretch=np.array([[1.004, 0.003], [0.0, 0.997]]))
    result = calibrate_plane(lens, lying, lab.BOARD, touch=touches(lab, motion, 0.02))
    assert result.touch is not None
    assert result.touch.kind == "affine"
    view = lab.flat_views()[0]
    spots = np.array([[0.0, 0.0], [150.0, 90.0], [-60.0, 40.0]])
    pixels = view.project(np.column_stack([spots, np.zeros(3)]))
    wanted = spots @ motion[:, :2].T + motion[:, 2]
    seen = result.calibration.table_from_image(pixels)
    assert np.abs(seen - wanted).max() < 0.1
    assert np.abs(result.calibration.image_from_table(seen) - pixels).max() < 1e-5


def test_a_true_robot_keeps_a_rigid_frame(lab, lens, lying):
    result = calibrate_plane(lens, lying, lab.BOARD, touch=touches(lab, turned(30.0, 190.0, -120.0), 0.1, seed=3))
    assert result.touch is not None
    assert result.touch.kind == "rigid"


def test_a_touched_point_that_disagrees_is_named(lab, lens, lying):
    points = touches(lab, turned(30.0, 190.0, -120.0), 0.02)
    points[4] = replace(points[4], x_mm=points[4].x_mm + 3.0)
    result = calibrate_plane(lens, lying, lab.BOARD, touch=points)
    assert any("point 5" in line for line in result.warnings)


@pytest.mark.parametrize(
    ("corners", "about"),
    [
        ([(0, 0), (11, 8)], "at least 3"),
        ([(0, 0), (5, 0), (11, 0)], "one line"),
        ([(0, 0), (12, 0), (11, 8)], "corner 12,0 is outside 12x9"),
    ],
)
def test_touched_points_that_give_no_frame_are_refused(lab, lens, lying, corners, about):
    with pytest.raises(CalibrationError, match=about):
        calibrate_plane(lens, lying, lab.BOARD, touch=touches(lab, turned(0, 0, 0), 0.0, corners=corners))


def test_swapped_axes_are_noticed(lab, lens, lying):
    swapped = [replace(t, x_mm=t.y_mm, y_mm=t.x_mm) for t in touches(lab, turned(10, 5, 5), 0.02)]
    with pytest.raises(CalibrationError, match="swapped"):
        calibrate_plane(lens, lying, lab.BOARD, touch=swapped)


def test_marks_given_by_pixel_serve_as_touched_points(lab, lens, lying):
    view = lab.flat_views()[0]
    spots = np.array([[-100.0, -60.0], [250.0, -60.0], [250.0, 180.0], [-100.0, 180.0]])
    pixels = view.project(np.column_stack([spots, np.zeros(4)]))
    marks = [
        Touch(f"point {n}", x + 100.0, y, pixel=(u, v))
        for n, ((x, y), (u, v)) in enumerate(zip(spots, pixels, strict=True))
    ]
    calibration = calibrate_plane(lens, lying, lab.BOARD, touch=marks).calibration
    assert np.abs(calibration.table_from_image(pixels) - (spots + np.array([100.0, 0.0]))).max() < 0.05


def test_a_touch_file_is_read_with_corners_or_marks(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("\ufeffImage;Column;Row;X_mm;Y_mm\n# by hand\np0.png;0;0;1.5;-2\n\np0.png;11;8;3;4e1\n", "utf-8")
    first, second = load_touch(path)
    assert (first.image, first.corner, first.x_mm, first.y_mm) == ("p0.png", (0, 0), 1.5, -2.0)
    assert second.corner == (11, 8)
    path.write_text("u,v,x,y\n10.5,20,1,2\n")
    assert load_touch(path)[0].pixel == (10.5, 20.0)


@pytest.mark.parametrize(
    ("text", "about"),
    [
        ("", "holds 0 lines"),
        ("u,v,x,y\n", "holds 1 lines"),
        ("a,b,c\n1,2,3\n", "the header is"),
        ("column,row,u,v,x,y\n1,2,3,4,5,6\n", "the header is"),
        ("column,row,x,y\n1.5,2,3,4\n", "column = '1.5' is not a whole number"),
        ("column,row,x,y\n-1,2,3,4\n", "column = '-1' is not a whole number"),
        ("u,v,x,y\n1,2,3\n", "line 2 has 3 values, the header 4"),
        ("u,v,x,y\n1,2,3,nan\n", "y = 'nan' is not a number"),
        ("u,v,x,y\n1,2,3,1e9\n", "is not a number within"),
    ],
)
def test_a_wrong_touch_file_is_refused_with_the_place(tmp_path, text, about):
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=about) as caught:
        load_touch(path)
    assert str(path) in str(caught.value)


def test_a_missing_touch_file_is_refused(tmp_path):
    with pytest.raises(CalibrationError, match="cannot be read"):
        load_touch(tmp_path / "none.csv")
