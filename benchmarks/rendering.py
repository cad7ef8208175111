"""How exact and how fast are the simulation's pictures?  Its coverage beside OpenCV's polygon filling.

    python benchmarks/rendering.py

A convex polygon of about 250 pixels is drawn 200 times at random places.  For each way of drawing: by how much its
centroid and its area are off (the area as the width of a rim all around), and how long it takes.  Then the time of
whole pictures of the shipped scenes and of a calibration board.
"""

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from slabcell_drivers.simulation import World, camera_views, load_scene, render_board, render_world
from slabcell_drivers.simulation.coverage import Window, cover

Points = npt.NDArray[np.float64]
Field = npt.NDArray[np.float32]
SIZE = 320
SHIFT = 8  # binary digits of OpenCV's fixed-point coordinates


def exact(points: Points) -> Field:
    """Draw with the simulation's own coverage."""
    return cover([points], Window(0, 0, SIZE, SIZE))


def filled(points: Points) -> Field:
    """Draw with fillPoly and anti-aliased lines, fixed-point coordinates."""
    image = np.zeros((SIZE, SIZE), np.uint8)
    cv2.fillPoly(image, [np.int32(np.rint(points * (1 << SHIFT)))], 255, cv2.LINE_AA, SHIFT)
    return image.astype(np.float32) / 255


def supersampled(points: Points) -> Field:
    """Draw with fillPoly on a grid eight times as fine, and average."""
    image = np.zeros((SIZE * 8, SIZE * 8), np.uint8)
    cv2.fillPoly(image, [np.int32(np.rint(((points + 0.5) * 8 - 0.5) * (1 << SHIFT)))], 255, cv2.LINE_8, SHIFT)
    return cv2.resize(image, (SIZE, SIZE), interpolation=cv2.INTER_AREA).astype(np.float32) / 255


def measure(draw: Callable[[Points], Field], shapes: list[Points]) -> tuple[float, float, float]:
    """Return the RMS error of the centroid and of the rim, in pixels, and the time a polygon takes, in ms."""
    v, u = np.mgrid[0:SIZE, 0:SIZE]
    off, rim, spent = [], [], 0.0
    for points in shapes:
        began = time.perf_counter()
        share = draw(points).astype(np.float64)
        spent += time.perf_counter() - began
        truth = shapely.Polygon(points)
        off.append(np.sum(share * u) / share.sum() - truth.centroid.x)
        off.append(np.sum(share * v) / share.sum() - truth.centroid.y)
        rim.append((share.sum() - truth.area) / truth.length)
    return float(np.sqrt(np.mean(np.square(off)))), float(np.sqrt(np.mean(np.square(rim)))), 1e3 * spent / len(shapes)


def main() -> None:
    """Print both tables."""
    random = np.random.default_rng(1)
    shapes = []
    for _ in range(200):
        angles = np.sort(random.uniform(0, 2 * np.pi, 9))
        circle = np.column_stack([np.cos(angles), np.sin(angles)]) * random.uniform(90, 125)
        shapes.append(SIZE / 2 + random.uniform(-20, 20, 2) + circle)
    print(f"{'drawn by':26} {'centroid px':>12} {'rim px':>10} {'ms':>7}")
    for name, draw in (
        ("exact coverage", exact),
        ("fillPoly, anti-aliased", filled),
        ("fillPoly, 8 x finer", supersampled),
    ):
        centroid, rim, spent = measure(draw, shapes)
        print(f"{name:26} {centroid:12.6f} {rim:10.6f} {spent:7.2f}")

    config = Path(__file__).parents[1] / "config" / "scenes"
    print(f"\n{'picture, 1920 x 1200':26} {'ms':>7}")
    for file in sorted(config.glob("*.toml")):
        scene = load_scene(file)
        world = World(scene, 1)
        render_world(world)
        print(f"{file.stem:26} {_best(lambda: render_world(world, 1)):7.0f}")  # noqa: B023  called at once
    board = camera_views(scene)[0]
    print(f"{scene.board.name:26} {_best(lambda: render_board(scene.camera, scene.optics, scene.board, board)):7.0f}")


def _best(call: Callable[[], object]) -> float:
    times = []
    for _ in range(5):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1e3 * min(times)


if __name__ == "__main__":
    main()
