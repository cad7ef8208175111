"""How far off is a point on the table, after a calibration made from rendered boards?

Run ``python benchmarks/calibration_endtoend.py [--seeds 6]``.  For each seed the simulated cell shows its board 15
times tilted and five times lying on the table; every millimetre is then compared with the world's truth, over the whole
picture, on the table and on top of slabs 10 mm thick.  Beside the project's own way run: one board position on the
table instead of five, the usual OpenCV recipe (window of 11 px, calibrateCamera, solvePnP on one position), and a
homography without lens ("linear"), all from the same pictures.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration import Board, Calibration, calibrate_camera, calibrate_plane, detect_boards
from slabcell.calibration.detection import Detection
from slabcell_drivers.simulation import Scene, camera_views, load_scene, plane_views, render_board
from slabcell_drivers.simulation.projection import Projector

Array = npt.NDArray[np.float64]
SCENE = Path(__file__).parents[1] / "config" / "scenes" / "dresden.toml"


def truth(scene: Scene, height_mm: float) -> tuple[Array, Array]:
    """Return pixels all over the picture, and where on the table (at this height) they truly are."""
    table = scene.table.frame.matrix
    grid = np.stack(np.meshgrid(np.arange(-150.0, 500.0, 10.0), np.arange(-300.0, 800.0, 10.0)), axis=-1).reshape(-1, 2)
    solid = np.column_stack([grid, np.full(len(grid), height_mm)]) @ table[:3, :3].T + table[:3, 3]
    pixels = Projector(scene.camera).pixels(solid)
    inside = ((pixels > 0.0) & (pixels < (scene.camera.width - 1, scene.camera.height - 1))).all(axis=1)
    return pixels[inside], grid[inside]


def opencv_recipe(pictures: list[npt.NDArray[np.uint8]], flat: npt.NDArray[np.uint8], board: Board):
    """Return the function from pixels to the table that a short OpenCV script makes (board face as its plane)."""
    size = (board.columns, board.rows)

    def corners(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        found, points = cv2.findChessboardCorners(picture, size)
        assert found
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-3)
        return cv2.cornerSubPix(picture, points, (11, 11), (-1, -1), stop)

    object_points = board.points.astype(np.float32)
    seen = [corners(p) for p in pictures]
    _, matrix, distortion, _, _ = cv2.calibrateCamera(
        [object_points] * len(seen), seen, pictures[0].shape[::-1], np.eye(3), np.zeros(5)
    )
    lying = corners(flat)
    _, turn, shift = cv2.solvePnP(object_points, lying, matrix, distortion)
    rotation, _ = cv2.Rodrigues(turn)

    def to_plane(pixels: Array, below_mm: float) -> Array:
        ideal = cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, distortion).reshape(-1, 2)
        rays = np.column_stack([ideal, np.ones(len(ideal))]) @ rotation
        origin = (-rotation.T @ shift).ravel()
        # solvePnP's board has Z away from the camera or towards it, as OpenCV happened to number the corners.
        level = -below_mm * np.sign(origin[2])
        return (origin + rays * ((level - origin[2]) / rays[:, 2])[:, None])[:, :2]

    return to_plane


def aligned(found: Array, wanted: Array) -> Array:
    """Return ``found`` in the frame of ``wanted``: peers have no convention for it, so any rigid one is granted."""
    a, b = found - found.mean(axis=0), wanted - wanted.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    return a @ (u @ vt).T + wanted.mean(axis=0)


def main() -> None:
    """Print the table of errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    seeds = parser.parse_args().seeds
    scene = load_scene(SCENE)
    board = Board.parse(scene.board.name)
    thick = scene.board.thickness_mm
    errors: dict[str, list[Array]] = {}
    seconds: list[float] = []

    def note(way: str, error: Array) -> None:
        errors.setdefault(way, []).append(np.linalg.norm(error, axis=1))

    for seed in range(seeds):
        tilted = [
            render_board(scene.camera, scene.optics, scene.board, pose, seed=1000 * seed + n)
            for n, pose in enumerate(camera_views(scene, seed))
        ]
        flat = [
            render_board(scene.camera, scene.optics, scene.board, pose, seed=1000 * seed + 500 + n)
            for n, pose in enumerate(plane_views(scene))
        ]
        began = time.perf_counter()
        seen = named(tilted, board)
        lying = named(flat, board)
        lens = calibrate_camera(seen, board, holdout=False).calibration
        five = calibrate_plane(lens, lying, board, board_thickness_mm=thick).calibration
        seconds.append(time.perf_counter() - began)
        one = calibrate_plane(lens, lying[:1], board, board_thickness_mm=thick).calibration
        recipe = opencv_recipe(tilted, flat[0], board)
        homography, _ = cv2.findHomography(lying[0].pixels, lying[0].points_mm[:, :2])
        for height_mm in (0.0, 10.0):
            pixels, wanted = truth(scene, height_mm)
            note("slabcell, 15 views + 5 positions on the table", at(five, pixels, height_mm) - wanted)
            note("slabcell, 15 views + 1 position", at(one, pixels, height_mm) - wanted)
            note(
                "slabcell, 15 views + 1 position (frame granted)",
                aligned(at(one, pixels, height_mm), wanted) - wanted,
            )
            note(
                "OpenCV recipe, 15 views + 1 position (frame granted)",
                aligned(recipe(pixels, thick - height_mm), wanted) - wanted,
            )
            if height_mm == 0.0:
                linear = cv2.perspectiveTransform(pixels.reshape(-1, 1, 2), homography).reshape(-1, 2)
                note("homography of 1 position, no lens (frame and scale granted)", similar(linear, wanted) - wanted)
    print(f"{'way':62}{'median mm':>10}{'95 % mm':>10}{'worst mm':>10}")
    for way, found in errors.items():
        every = np.concatenate(found)
        print(f"{way:62}{np.median(every):10.4f}{np.percentile(every, 95):10.4f}{every.max():10.4f}")
    print(f"detection, lens and table of 20 pictures: {np.median(seconds):.2f} s (median of {seeds})")


def at(calibration: Calibration, pixels: Array, height_mm: float) -> Array:
    """Return the table points of pixels."""
    return calibration.table_from_image(pixels, height_mm)


def similar(found: Array, wanted: Array) -> Array:
    """Return ``found`` scaled and moved onto ``wanted`` as well as a similarity can."""
    spread = np.sqrt(np.sum((wanted - wanted.mean(axis=0)) ** 2) / np.sum((found - found.mean(axis=0)) ** 2))
    return aligned(found * spread, wanted)


def named(pictures: list[npt.NDArray[np.uint8]], board: Board) -> list[Detection]:
    """Return the detections; every picture must show the board."""
    detections, failures = detect_boards([(str(n), p) for n, p in enumerate(pictures)], board)
    assert not failures, failures
    return detections


if __name__ == "__main__":
    main()
