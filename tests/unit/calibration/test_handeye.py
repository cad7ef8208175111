"""A hand-eye calibration finds where the camera sits, says how sure it is, and notices the usual mistakes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slabcell.calibration import (
    Board,
    Calibration,
    CameraIdentity,
    Lens,
    RobotPose,
    TablePlane,
    calibrate_hand_eye,
    load_poses,
    parse_pose,
)
from slabcell.calibration.handeye import kuka_frame, make_stations, place_camera
from slabcell.calibration.handeye.motion import inverse, kuka_matrix, rigid
from slabcell.errors import CalibrationError, UsageError

pytestmark = pytest.mark.unit

CAMERA_IN_BASE = kuka_matrix(np.array([290.0, -45.0, 1040.0, -90.4, 0.5, 179.4]))[0]
BOARD_ON_FLANGE = kuka_matrix(np.array([-80.0, 60.0, 40.0, 3.0, 2.0, 178.0]))[0]
CAMERA_ON_FLANGE = kuka_matrix(np.array([60.0, 5.0, 90.0, 91.0, 1.0, -2.0]))[0]
BOARD_IN_BASE = kuka_matrix(np.array([250.0, -60.0, 3.0, 20.0, 0.0, 0.0]))[0]


@pytest.fixture(scope="module")
def lens(lab):
    return Calibration(CameraIdentity(*lab.SIZE), Lens(lab.MATRIX, lab.DISTORTION))


def shoot(lab, mount="eye-to-hand", *, count=15, robot_mm=0.15, robot_deg=0.02, seed=0, tilt_deg=30.0, scale=1.0):
    """Detections and robot poses of a robot whose poses are as exact as given."""
    random = np.random.default_rng(seed)
    detections, poses = [], []
    while len(detections) < count:
        turn = (
            np.diag([1.0, -1.0, -1.0])
            @ Rotation.from_rotvec(np.deg2rad(random.uniform(-tilt_deg, tilt_deg, 3))).as_matrix()
        )
        centre = np.array([random.uniform(-150, 150), random.uniform(-80, 80), random.uniform(700, 950)])
        view = lab.View(turn, centre - turn @ (88.0, 64.0, 0.0))
        pixels = view.project(lab.BOARD.points)
        if pixels.min() < 3 or (pixels > np.array(lab.SIZE) - 4).any():
            continue
        board = rigid(view.rotation, view.translation)
        if mount == "eye-to-hand":
            flange = CAMERA_IN_BASE @ board @ inverse(BOARD_ON_FLANGE)
        else:
            flange = BOARD_IN_BASE @ inverse(board) @ inverse(CAMERA_ON_FLANGE)
        flange[:3, :3] = Rotation.from_rotvec(np.deg2rad(random.normal(0, robot_deg, 3))).as_matrix() @ flange[:3, :3]
        flange[:3, 3] = scale * flange[:3, 3] + random.normal(0, robot_mm, 3)
        name = f"s{len(detections)}.png"
        detections.append(lab.seen(view, name, seed=seed * 100 + len(detections)))
        poses.append(RobotPose(name, kuka_frame(flange)))
    return detections, poses


def plane_error_mm(found, truth=CAMERA_IN_BASE):
    """Distance in the work plane between where both put what the camera sees there (rms)."""
    grid = np.stack(np.meshgrid(np.linspace(-280, 280, 7), np.linspace(-170, 170, 5)), axis=-1).reshape(-1, 2)
    seen = np.column_stack([grid, np.full(len(grid), 1040.0), np.ones(len(grid))])
    apart = (seen @ (found - truth).T)[:, :2]
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def camera_of(result):
    return kuka_matrix(np.array(result.camera))[0]


def test_the_joint_estimate_puts_the_plane_right_and_beats_the_closed_forms(lab, lens):
    errors = {"joint": [], "park": [], "shah": []}
    for seed in range(8):
        stations = make_stations(lens, *shoot(lab, seed=seed))
        for method, found in errors.items():
            found.append(plane_error_mm(place_camera(stations, "eye-to-hand", method).camera))
    assert np.median(errors["joint"]) < 0.2
    assert max(errors["joint"]) < 0.45
    assert np.median(errors["joint"]) < 0.9 * min(np.median(errors["park"]), np.median(errors["shah"]))


def test_the_noise_of_the_robot_is_found(lab, lens):
    stations = make_stations(lens, *shoot(lab, count=40, robot_mm=0.3, robot_deg=0.05))
    found = place_camera(stations, "eye-to-hand")
    assert found.robot_mm == pytest.approx(0.3, rel=0.3)
    assert found.robot_deg == pytest.approx(0.05, rel=0.3)


def test_the_covariance_of_the_joint_estimate_is_true(lab, lens):
    ratios = []
    for seed in range(10):
        found = place_camera(make_stations(lens, *shoot(lab, seed=seed)), "eye-to-hand")
        spot = np.array([0.0, 0.0, 1040.0])
        by_twist = np.zeros((3, 6))
        by_twist[:, 3:] = np.eye(3)
        by_twist[:, :3] = -np.array([[0, -spot[2], spot[1]], [spot[2], 0, -spot[0]], [-spot[1], spot[0], 0]])
        sigma = np.sqrt(np.diag(by_twist @ found.covariance[:6, :6] @ by_twist.T))
        error = CAMERA_IN_BASE[:3, :3].T @ ((found.camera - CAMERA_IN_BASE) @ [*spot, 1.0])[:3]
        ratios.append(error / sigma)
    assert 0.7 < np.sqrt(np.mean(np.square(ratios))) < 1.5


@pytest.mark.parametrize("method", ["joint", "tsai", "park", "horaud", "andreff", "daniilidis", "shah", "li"])
def test_every_method_serves_both_mounts(lab, lens, method):
    for mount, truth in (("eye-to-hand", CAMERA_IN_BASE), ("eye-in-hand", CAMERA_ON_FLANGE)):
        detections, poses = shoot(lab, mount, robot_mm=0.0, robot_deg=0.0)
        result = calibrate_hand_eye(lens, detections, poses, lab.BOARD, mount, method=method)
        assert np.abs(camera_of(result)[:3, 3] - truth[:3, 3]).max() < 2.0
        assert result.calibration.hand_eye is not None
        assert result.calibration.hand_eye.mount == mount
        assert result.warnings == ()


def test_the_report_says_how_good_it_is(lab, lens):
    result = calibrate_hand_eye(lens, *shoot(lab), lab.BOARD, "eye-to-hand")
    assert 0.05 < result.holdout_mm < 0.6
    assert 0.1 < result.holdout_px < 2.0
    assert 0.02 < result.spread_mm < 0.4
    assert abs(result.scale - 1.0) < 4.0 * result.scale_std < 0.01
    assert result.angle_disagreement_deg < 0.1
    assert result.axis_disagreement_mm < 0.5
    assert result.warnings == ()
    assert result.table is None


def test_the_table_is_given_in_the_robots_base_where_it_is_known(lab, lens):
    table_in_base = kuka_matrix(np.array([190.0, -290.0, 0.0, 1.5, 0.0, 0.0]))[0]
    seen = inverse(CAMERA_IN_BASE) @ table_in_base
    known = replace(lens, plane=TablePlane(seen[:3, :3], seen[:3, 3]))
    result = calibrate_hand_eye(known, *shoot(lab, robot_mm=0.01, robot_deg=0.001), lab.BOARD, "eye-to-hand")
    assert result.table is not None
    assert np.abs(np.array(result.table) - (190.0, -290.0, 0.0, 1.5, 0.0, 0.0)).max() < 0.1


def test_a_camera_on_the_flange_gives_the_table_for_the_pose_it_looked_from(lab, lens):
    photo = (300.0, -40.0, 600.0, 10.0, -2.0, 179.0)
    table_in_base = kuka_matrix(np.array([190.0, -290.0, 0.0, 1.5, 0.0, 0.0]))[0]
    seen = inverse(kuka_matrix(np.array(photo))[0] @ CAMERA_ON_FLANGE) @ table_in_base
    known = replace(lens, plane=TablePlane(seen[:3, :3], seen[:3, 3]))
    shots = shoot(lab, "eye-in-hand", robot_mm=0.01, robot_deg=0.001)
    pose = parse_pose("300,-40,600,10,-2,179", "--photo-pose")
    result = calibrate_hand_eye(known, *shots, lab.BOARD, "eye-in-hand", photo_pose=pose)
    assert result.table is not None
    assert np.abs(np.array(result.table) - (190.0, -290.0, 0.0, 1.5, 0.0, 0.0)).max() < 0.1
    assert calibrate_hand_eye(known, *shots, lab.BOARD, "eye-in-hand").table is None


@pytest.mark.parametrize("text", ["", "1,2,3", "1,2,3,4,5,x", "1,2,3,4,5,nan", "1e9,0,0,0,0,0", "1,2,3,4,5,6,7"])
def test_a_wrong_pose_is_a_usage_error(text):
    with pytest.raises(UsageError, match="--photo-pose"):
        parse_pose(text, "--photo-pose")


def test_a_pose_that_belongs_to_another_picture_is_named_and_left_out(lab, lens):
    detections, poses = shoot(lab)
    x, y, *rest = poses[6].frame
    poses[6] = replace(poses[6], frame=(x + 15.0, y, *rest))
    result = calibrate_hand_eye(lens, detections, poses, lab.BOARD, "eye-to-hand")
    assert result.left_out == ("s6.png",)
    assert any("s6.png was left out" in line for line in result.warnings)
    assert plane_error_mm(camera_of(result)) < 0.5


def test_the_wrong_mount_is_refused_by_name(lab, lens):
    with pytest.raises(CalibrationError, match="fit --mount eye-to-hand"):
        calibrate_hand_eye(lens, *shoot(lab), lab.BOARD, "eye-in-hand")


def rewritten(poses, change):
    return [replace(p, frame=tuple(float(v) for v in change(np.array(p.frame)))) for p in poses]


@pytest.mark.parametrize(
    ("change", "about"),
    [
        (lambda f: f[[0, 1, 2, 5, 4, 3]], "about X, Y, Z"),
        (lambda f: [*f[:3], *np.deg2rad(f[3:])], "radians"),
        (lambda f: [*f[:3], *Rotation.from_euler("ZYX", f[3:], degrees=True).as_rotvec()], "rotation vector"),
    ],
)
def test_angles_of_another_convention_are_noticed_and_named(lab, lens, change, about):
    detections, poses = shoot(lab)
    with pytest.raises(CalibrationError, match=about):
        calibrate_hand_eye(lens, detections, rewritten(poses, change), lab.BOARD, "eye-to-hand")


def test_poses_of_other_pictures_are_refused(lab, lens):
    detections, poses = shoot(lab)
    shuffled = [replace(p, frame=q.frame) for p, q in zip(poses, [*poses[4:], *poses[:4]], strict=True)]
    with pytest.raises(CalibrationError, match="are these the poses of these pictures"):
        calibrate_hand_eye(lens, detections, shuffled, lab.BOARD, "eye-to-hand")


def test_a_board_printed_in_another_size_is_noticed(lab, lens):
    result = calibrate_hand_eye(lens, *shoot(lab, scale=1.01), lab.BOARD, "eye-to-hand")
    assert result.scale == pytest.approx(1.01, abs=0.003)
    assert any("measure the board's squares" in line for line in result.warnings)


def test_poses_that_hardly_turn_are_refused_and_ones_that_turn_little_are_warned_about(lab, lens):
    with pytest.raises(CalibrationError, match="leave the camera's place open"):
        calibrate_hand_eye(lens, *shoot(lab, tilt_deg=1.0), lab.BOARD, "eye-to-hand")
    result = calibrate_hand_eye(lens, *shoot(lab, tilt_deg=8.0), lab.BOARD, "eye-to-hand")
    assert any("turn the flange by ±30°" in line for line in result.warnings)


def test_poses_that_turn_about_one_axis_only_are_refused(lab, lens):
    detections, poses = [], []
    for n in range(8):
        view = lab.looking_down(20.0 * n - 70.0, 10.0 * (n % 3), 15.0 * n, height_mm=800.0 + 10.0 * n)
        board = rigid(view.rotation, view.translation)
        detections.append(lab.seen(view, f"{n}", seed=n))
        poses.append(RobotPose(f"{n}", kuka_frame(CAMERA_IN_BASE @ board @ inverse(BOARD_ON_FLANGE))))
    with pytest.raises(CalibrationError, match="two different axes"):
        calibrate_hand_eye(lens, detections, poses, lab.BOARD, "eye-to-hand")


def test_a_board_whose_frame_would_jump_is_refused(lab, lens):
    with pytest.raises(CalibrationError, match="looks the same after half a turn"):
        calibrate_hand_eye(lens, *shoot(lab, count=3), Board.parse("checkerboard:11x9:16"), "eye-to-hand")


def test_too_few_stations_are_refused(lab, lens):
    with pytest.raises(CalibrationError, match="at least 4"):
        calibrate_hand_eye(lens, *shoot(lab, count=3), lab.BOARD, "eye-to-hand")


def test_a_picture_without_a_pose_is_refused_by_name(lab, lens):
    detections, poses = shoot(lab, count=4)
    with pytest.raises(CalibrationError, match=r"s2\.png: no robot pose"):
        calibrate_hand_eye(lens, detections, [p for p in poses if p.image != "s2.png"], lab.BOARD, "eye-to-hand")


def test_two_poses_for_one_picture_are_refused(lab, lens):
    detections, poses = shoot(lab, count=4)
    with pytest.raises(CalibrationError, match=r"names s0\.png twice"):
        calibrate_hand_eye(lens, detections, [*poses, poses[0]], lab.BOARD, "eye-to-hand")


def test_a_poses_file_is_read(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text("\ufeffimage; X;Y;Z;A;B;C\n# taught\na.png;1;2;3;-170,5;0;1\n".replace(",5", ".5"), "utf-8")
    assert load_poses(path) == [RobotPose("a.png", (1.0, 2.0, 3.0, -170.5, 0.0, 1.0))]


@pytest.mark.parametrize(
    ("text", "about"),
    [
        ("", "holds 0 lines"),
        ("image,X,Y,Z,RX,RY,RZ\na.png,1,2,3,4,5,6\n", "must be image,X,Y,Z,A,B,C"),
        ("image,X,Y,Z,A,B,C\n\na.png,1,2,3\n", "line 3 has 4 values"),
        ("image,X,Y,Z,A,B,C\na.png,1,2,3,4,5,inf\n", "line 2: C = 'inf'"),
        ("image,X,Y,Z,A,B,C\na.png,1,2,x,4,5,6\n", "line 2: Z = 'x'"),
        ('image,X,Y,Z,A,B,C\n"a.png,1,2,x,4,5,6\n', "is not CSV"),
    ],
)
def test_a_wrong_poses_file_is_refused_with_line_and_column(tmp_path, text, about):
    path = tmp_path / "poses.csv"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=about) as caught:
        load_poses(path)
    assert str(path) in str(caught.value)
