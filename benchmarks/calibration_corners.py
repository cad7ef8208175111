"""How exactly are the corners of a checkerboard found, and how fast?

Run ``python benchmarks/calibration_corners.py [--views 15]``.  Rendered boards of the reference cell, tilted; corners
are compared with their true pixels.  The project's own detection is shown with each of its windows, beside OpenCV's
cornerSubPix with the windows of its tutorials and its sector-based detector, which start from a full-size search.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration import Board, detect_board
from slabcell_drivers.simulation import board_corners, camera_views, load_scene, render_board

Picture = npt.NDArray[np.uint8]
Points = npt.NDArray[np.float64]
SCENE = Path(__file__).parents[1] / "config" / "scenes" / "dresden.toml"


def sub_pixel(window: int) -> Callable[[Picture, tuple[int, int]], Points | None]:
    """Return OpenCV's usual way with one fixed window."""

    def find(picture: Picture, size: tuple[int, int]) -> Points | None:
        found, corners = cv2.findChessboardCorners(picture, size)
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-3)
        return cv2.cornerSubPix(picture, corners, (window, window), (-1, -1), stop) if found else None

    return find


def sectors(flags: int) -> Callable[[Picture, tuple[int, int]], Points | None]:
    """Return OpenCV's sector-based detector."""

    def find(picture: Picture, size: tuple[int, int]) -> Points | None:
        found, corners = cv2.findChessboardCornersSB(picture, size, flags=flags)
        return corners if found else None

    return find


PEERS = {
    "OpenCV cornerSubPix 3": sub_pixel(3),
    "OpenCV cornerSubPix 5": sub_pixel(5),
    "OpenCV cornerSubPix 11": sub_pixel(11),
    "OpenCV sector-based": sectors(cv2.CALIB_CB_NORMALIZE_IMAGE),
    "OpenCV sector-based, accurate": sectors(cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE),
}


def nearest(found: Points, truth: Points) -> Points:
    """Return the error of each true corner's nearest found one: peers number corners their own way."""
    apart = found.reshape(-1, 1, 2) - truth[None]
    return apart[np.linalg.norm(apart, axis=2).argmin(axis=0), np.arange(len(truth))]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=15)
    scene = load_scene(SCENE)
    board = Board.parse(scene.board.name)
    size = (board.columns, board.rows)
    errors: dict[str, list[Points]] = {}
    seconds: dict[str, list[float]] = {}
    for n, pose in enumerate(camera_views(scene, 1, parser.parse_args().views)):
        picture = render_board(scene.camera, scene.optics, scene.board, pose, seed=n)
        truth = board_corners(scene.camera, scene.board, pose)
        began = time.perf_counter()
        detection = detect_board(picture, board, str(n))
        took = time.perf_counter() - began
        for rank, (_, pixels) in enumerate(detection.variants):
            name = f"slabcell, {('widest', 'second', 'third', 'fourth')[rank]} window"
            errors.setdefault(name, []).append(pixels - truth)
            seconds.setdefault(name, []).append(took)
        for name, find in PEERS.items():
            began = time.perf_counter()
            found = find(picture, size)
            seconds.setdefault(name, []).append(time.perf_counter() - began)
            if found is not None:
                errors.setdefault(name, []).append(nearest(np.asarray(found, np.float64), truth))
    print(f"{'way':34}{'views':>7}{'rms px':>9}{'median':>9}{'bias px':>9}{'worst px':>10}{'ms a view':>11}")
    for name, found in errors.items():
        every = np.vstack(found)
        length = np.linalg.norm(every, axis=1)
        bias = np.mean([np.linalg.norm(e.mean(axis=0)) for e in found])
        cells = f"{np.sqrt((length**2).mean()):9.4f}{np.median(length):9.4f}{bias:9.4f}{length.max():10.3f}"
        print(f"{name:34}{len(found):7}{cells}{1e3 * np.median(seconds[name]):11.1f}")
    print("(the project's time is for all of its windows together)")


if __name__ == "__main__":
    main()
