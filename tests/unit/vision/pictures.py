"""Small pictures of slabs with known poses, for the tests of the vision."""

from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration.model import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.geometry import Points, Polygon, RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.template import Template

# Five outlines (mm) that differ in every way that matching has to tell apart.
L_SHAPE = [(0, 0), (70, 0), (70, 25), (30, 25), (30, 60), (0, 60)]
RECTANGLE = [(0, 0), (80, 0), (80, 40), (0, 40)]
SQUARE = [(0, 0), (45, 0), (45, 45), (0, 45)]
KITE = [(0, 0), (60, -10), (85, 35), (20, 50)]
TRIANGLE = [(0, 0), (70, 5), (25, 55)]
SHAPES = [L_SHAPE, RECTANGLE, SQUARE, KITE, TRIANGLE]

OVERSAMPLING = 4


def calibration(width: int = 800, height: int = 600, mm_per_px: float = 0.5, k1: float = -0.08) -> Calibration:
    """A camera that looks straight down, the table's origin below the picture's centre, X to the right, Y up."""
    distance = 900.0
    focal = distance / mm_per_px
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    rotation = np.diag([1.0, -1.0, -1.0])
    lens = Lens(matrix, np.array([k1, 0.0, 0.0, 0.0, 0.0]))
    return Calibration(CameraIdentity(width, height), lens, TablePlane(rotation, np.array([0.0, 0.0, distance])))


def moved(shape: npt.ArrayLike, x: float, y: float) -> Points:
    """Return an outline shifted by x and y."""
    return np.asarray(shape, float) + np.array([x, y])


def recipe(shapes: list[list[tuple[float, float]]] | None = None, thickness_mm: float = 0.0) -> Recipe:
    """The smallest recipe of these slots, laid out beside each other."""
    slots = tuple(
        Polygon.from_points(moved(shape, 100.0 * index, 10.0)) for index, shape in enumerate(shapes or SHAPES)
    )
    return Recipe.from_template(Template("test", slots, ""), thickness_mm)


def render(
    camera: Calibration,
    outlines: list[Points],
    *,
    light: float = 180.0,
    dark: float = 30.0,
    blur_px: float = 0.8,
    noise: float = 2.0,
    seed: int = 1,
    height_mm: float = 0.0,
) -> npt.NDArray[np.uint8]:
    """Return the picture of flat slabs with these outlines (mm, table)."""
    width, height = camera.camera.width, camera.camera.height
    fine = np.zeros((height * OVERSAMPLING, width * OVERSAMPLING), np.uint8)
    for outline in outlines:
        closed = np.vstack([outline, outline[:1]])
        dense = np.concatenate(
            [start + (end - start) * np.linspace(0, 1, 40, endpoint=False)[:, None] for start, end in pairwise(closed)]
        )
        pixels = camera.image_from_table(dense, height_mm)
        corners = (pixels + 0.5) * OVERSAMPLING - 0.5
        cv2.fillPoly(fine, [np.rint(corners * 256).astype(np.int32)], 255, lineType=cv2.LINE_AA, shift=8)
    coverage = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA).astype(np.float64) / 255
    coverage = cv2.GaussianBlur(coverage, (0, 0), blur_px)
    picture = dark + (light - dark) * coverage + np.random.default_rng(seed).normal(0, noise, coverage.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def scatter(product: Recipe, seed: int = 3) -> list[RigidTransform2D]:
    """Return for each slot where its slab lies on the table: table = motion·assembly, none near another."""
    random = np.random.default_rng(seed)
    places = [(-120.0, 80.0), (0.0, 80.0), (120.0, 80.0), (-80.0, -70.0), (70.0, -70.0), (0.0, -10.0)]
    motions: list[RigidTransform2D] = []
    for slot, (x, y) in zip(product.template.slots, places, strict=False):
        turn = RigidTransform2D(float(random.uniform(-180, 180)), 0.0, 0.0)
        shift = np.array([x, y]) + random.uniform(-4, 4, 2) - turn.apply(slot.centroid)
        motions.append(RigidTransform2D(turn.rotation_deg, float(shift[0]), float(shift[1])))
    return motions
