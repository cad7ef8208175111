"""How fast is the vision?  Full frames with 5, 20 and 100 slabs, one thread, beside what one writes with OpenCV first.

    python benchmarks/vision_speed.py [--repeat N] [--slabs 5 20 100 400] [--scenes dresden irregular] [--numpy]

The slabs of the full frames are flat.  Those of ``--scenes`` are the demo's, 10 mm thick: the camera sees their walls.
Every pipeline runs in this process on the same pictures, by turns; the figures are median and least CPU time, which
other load on the machine disturbs least.  Peers: the naive OpenCV pipeline (undistort the whole picture,
Otsu, contours, matchShapes of all pairs, centroid and principal axis: no registration, no reject), once with maps for
the undistortion made beforehand and once with cv2.undistort (``undistort``); and scikit-image (label and regionprops:
no matching at all) where it is installed.  `memcpy` copies the frame once.
"""

import argparse
import importlib.util
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.integration.test_cell_simulated import CONFIG, true_calibration

from shapes import irregular
from slabcell.calibration.model import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.geometry import Points, Polygon, RigidTransform2D
from slabcell.recipe import Recipe, load_recipe
from slabcell.template import Template
from slabcell.vision import Locator, kernel
from slabcell_drivers.simulation import World, load_scene, render_world

Picture = npt.NDArray[np.uint8]
WIDTH, HEIGHT = 1920, 1200
MM_PER_PX = 0.5
OVERSAMPLING = 4


def camera() -> Calibration:
    """Return a camera that looks straight down, with a lens."""
    distance = 1200.0
    focal = distance / MM_PER_PX
    matrix = np.array([[focal, 0, WIDTH / 2 - 0.5], [0, focal, HEIGHT / 2 - 0.5], [0, 0, 1.0]])
    plane = TablePlane(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, distance]))
    return Calibration(CameraIdentity(WIDTH, HEIGHT), Lens(matrix, np.array([-0.1, 0.04, 0.0003, -0.0002, 0.0])), plane)


def scene(calibration: Calibration, count: int, seed: int) -> tuple[Picture, Recipe]:
    """Return a picture of so many irregular slabs on a grid, and its recipe."""
    random = np.random.default_rng(seed)
    columns = int(np.ceil(np.sqrt(count * WIDTH / HEIGHT)))
    rows = int(np.ceil(count / columns))
    cell = 0.94 * min(WIDTH / columns, HEIGHT / rows)
    slots, outlines = [], []
    for index in range(count):
        shape = irregular(random)
        size = min(330.0, 0.66 * cell) * random.uniform(0.85, 1.0) * MM_PER_PX
        slot = shape * size + np.array([500.0 * index, 0.0])
        place = np.array([index % columns + 0.5 - columns / 2, index // columns + 0.5 - rows / 2]) * 0.97
        middle = place * np.array([WIDTH / columns, HEIGHT / rows]) * MM_PER_PX
        turn = RigidTransform2D(float(random.uniform(-180, 180)), 0.0, 0.0)
        centre = Polygon.from_points(slot).centroid
        slots.append(Polygon.from_points(slot))
        outlines.append(turn.apply(slot - centre) + middle)
    return draw(calibration, outlines, random), Recipe.from_template(Template("speed", tuple(slots), ""), 0.0)


def demo(name: str) -> tuple[str, Calibration, Picture, Recipe]:
    """Return a scene of the demo as its camera sees it, and its recipe."""
    world = World(load_scene(CONFIG / "scenes" / f"{name}.toml"), 7)
    recipe = load_recipe(CONFIG / "recipes" / f"{name}.toml")
    return f"scene {name}", true_calibration(world), render_world(world, 1), recipe


def draw(calibration: Calibration, outlines: list[Points], random: np.random.Generator) -> Picture:
    """Return a noisy, blurred picture of these outlines."""
    fine = np.zeros((HEIGHT * OVERSAMPLING, WIDTH * OVERSAMPLING), np.uint8)
    for outline in outlines:
        dense = np.concatenate(
            [
                start + (stop - start) * np.linspace(0, 1, 30, endpoint=False)[:, None]
                for start, stop in zip(outline, np.roll(outline, -1, axis=0), strict=True)
            ]
        )
        corners = (calibration.image_from_table(dense) + 0.5) * OVERSAMPLING - 0.5
        cv2.fillPoly(fine, [np.rint(corners * 256).astype(np.int32)], 255, lineType=cv2.LINE_AA, shift=8)
    coverage = cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float32)
    picture = 28 + 0.58 * cv2.GaussianBlur(coverage, (0, 0), 0.8)
    picture += random.normal(0, 1.8, picture.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def naive(calibration: Calibration, recipe: Recipe, *, prepared: bool) -> Callable[[Picture], int]:
    """Return what an integrator writes first; ``prepared``: maps for the undistortion are made beforehand."""
    lens = calibration.lens
    maps = cv2.initUndistortRectifyMap(
        lens.matrix, lens.distortion, np.eye(3), lens.matrix, (WIDTH, HEIGHT), cv2.CV_16SC2
    )
    templates = [slot.vertices.astype(np.float32).reshape(-1, 1, 2) for slot in recipe.template.slots]

    def run(picture: Picture) -> int:
        if prepared:
            flat = cv2.remap(picture, maps[0], maps[1], cv2.INTER_LINEAR)
        else:
            flat = cv2.undistort(picture, lens.matrix, lens.distortion)
        _, mask = cv2.threshold(flat, 0, 255, cv2.THRESH_OTSU)
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        matched = 0
        for contour in contours:
            if cv2.contourArea(contour) < 100:
                continue
            scores = [cv2.matchShapes(contour, template, cv2.CONTOURS_MATCH_I1, 0) for template in templates]
            moments = cv2.moments(contour)
            _ = (moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])
            _ = 0.5 * np.arctan2(2 * moments["mu11"], moments["mu20"] - moments["mu02"])
            matched += int(np.argmin(scores)) >= 0
        return matched

    return run


def skimage_peer() -> Callable[[Picture], int] | None:
    """Return scikit-image's blob analysis, or None where it is not installed."""
    if importlib.util.find_spec("skimage") is None:
        return None
    from skimage.filters import threshold_otsu  # noqa: PLC0415 - a peer that need not be there
    from skimage.measure import label, regionprops  # noqa: PLC0415

    def run(picture: Picture) -> int:
        found = regionprops(label(picture > threshold_otsu(picture)))
        return sum(region.area > 100 and region.orientation is not None for region in found)

    return run


def measure(work: dict[str, Callable[[], object]], repeat: int) -> dict[str, tuple[float, float]]:
    """Return median and least CPU time in ms of each, run by turns."""
    times: dict[str, list[float]] = {name: [] for name in work}
    for name, run in work.items():
        run()
        del name
    for _ in range(repeat):
        for name, run in work.items():
            begin = time.thread_time()
            run()
            times[name].append(1e3 * (time.thread_time() - begin))
    return {name: (float(np.median(values)), min(values)) for name, values in times.items()}


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=30)
    parser.add_argument("--slabs", type=int, nargs="*", default=[5, 20, 100])
    parser.add_argument("--scenes", nargs="*", default=[])
    parser.add_argument("--numpy", action="store_true", help="use the reference implementation instead of the kernel")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if options.numpy:
        kernel.engine = kernel.NumpyEngine
    print(f"edges are measured by: {kernel.engine().name}; {WIDTH}x{HEIGHT}, one thread")
    flat = camera()
    frames = [(f"{count} slabs", flat, *scene(flat, count, seed=count)) for count in options.slabs]
    for title, calibration, picture, recipe in frames + [demo(name) for name in options.scenes]:
        locator = Locator(calibration, recipe)
        target = np.empty_like(picture)
        quick, plain = naive(calibration, recipe, prepared=True), naive(calibration, recipe, prepared=False)
        work: dict[str, Callable[[], object]] = {
            "memcpy": lambda picture=picture, target=target: np.copyto(target, picture),
            "slabcell": lambda locator=locator, picture=picture: locator.locate(picture),
            "naive": lambda run=quick, picture=picture: run(picture),
            "undistort": lambda run=plain, picture=picture: run(picture),
        }
        peer = skimage_peer()
        if peer is not None:
            work["skimage"] = lambda run=peer, picture=picture: run(picture)
        found = measure(work, options.repeat)
        result = locator.locate(picture)
        print(f"{title}, {len(result.parts)} located:")
        ours = found["slabcell"][0]
        for name, (median, least) in found.items():
            ratio = (
                f"{median / ours:8.2f} x slabcell"
                if name != "slabcell"
                else f"{ours / found['memcpy'][0]:8.1f} x memcpy"
            )
            print(f"  {name:10} {median:8.3f} ms  (least {least:8.3f})  {ratio}")
        stages = [locator.locate(picture).timing_ms for _ in range(10)]
        shown = ", ".join(f"{name} {np.min([stage[name] for stage in stages]):.2f}" for name in stages[0])
        print(f"  stages, least wall ms: {shown}")


if __name__ == "__main__":
    main()
