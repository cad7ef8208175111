import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slabcell.vision import edge_profile, edge_projection, kernel, native, pose_solver
from slabcell.vision.edge_profile import EdgeLines, ProfileModel
from slabcell.vision.edge_projection import Outlines, Poses
from slabcell.vision.edges import cut_edges
from slabcell.vision.kernel import engine
from slabcell.vision.local_map import LocalMaps, map_locally
from slabcell.vision.native import NativeEngine
from slabcell.vision.outline_set import OutlineSet
from slabcell.vision.plane import PlaneView
from slabcell.vision.pose_solver import Measured
from slabcell_drivers.simulation.surfaces import smooth_noise

from .pictures import calibration, recipe

pytestmark = pytest.mark.unit

MODEL = ProfileModel(0.9, 6.0, 0.6, 0.1)
WIDTH, HEIGHT = 220, 160
compiled = pytest.mark.skipif(kernel.implementation() != "native", reason="no C compiler was there at installation")


def step_edge(angle_deg: float, offset_px: float, *, top: int = 1) -> tuple[np.ndarray, EdgeLines]:
    """Return the picture of a half plane, and the line where its edge would be if it were not ``offset_px`` outward."""
    angle = np.deg2rad(angle_deg)
    outward = np.array([np.cos(angle), np.sin(angle)])
    middle = np.array([110.3, 80.7])
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    depth = offset_px - ((u - middle[0]) * outward[0] + (v - middle[1]) * outward[1])
    from scipy.special import ndtr

    grey = 30 + 140 * ndtr(depth / 0.9) + np.random.default_rng(2).normal(0, 1.5, depth.shape)
    picture = np.clip(np.rint(grey * top), 0, 65535).astype(np.uint8 if top == 1 else np.uint16)
    lines = EdgeLines.of(middle[None], outward[None], np.array([12.0]), np.zeros(1), np.zeros(1))
    return picture, lines


def many_lines(seed: int, count: int = 200) -> EdgeLines:
    random = np.random.default_rng(seed)
    angle = random.uniform(0, 2 * np.pi, count)
    middle = np.column_stack([random.uniform(-20, WIDTH + 20, count), random.uniform(-20, HEIGHT + 20, count)])
    wall = np.where(random.random(count) < 0.5, 0.0, random.uniform(0, 25, count))
    return EdgeLines.of(
        middle,
        np.column_stack([np.cos(angle), np.sin(angle)]),
        random.uniform(2, 14, count),
        random.normal(0, 0.003, count),
        wall,
    )


@pytest.mark.parametrize("angle_deg", [0, 17, 45, 90, 133, 180, 271])
@pytest.mark.parametrize("offset_px", [-2.3, 0.0, 0.37, 3.1])
def test_the_reference_finds_a_step_to_a_few_hundredths_of_a_pixel(angle_deg: float, offset_px: float):
    picture, lines = step_edge(angle_deg, offset_px)
    found = edge_profile.measure_edges(picture, lines, MODEL)
    assert found.valid[0]
    assert found.shift[0] == pytest.approx(offset_px, abs=0.03)
    assert found.sigma[0] < 0.03
    assert (found.inside[0], found.outside[0]) == pytest.approx((170, 30), abs=6)


def test_a_flat_picture_has_no_edge():
    _, lines = step_edge(0, 0)
    found = edge_profile.measure_edges(np.full((HEIGHT, WIDTH), 90, np.uint8), lines, MODEL)
    assert not found.valid[0]


@compiled
@pytest.mark.parametrize(
    "model",
    [
        MODEL,
        ProfileModel(0.9, 6.0, 0.6, 0.1, near=True),
        ProfileModel(0.7, 6.0, 0.6, 0.1, fit_blur=True),
        ProfileModel(
            0.9,
            7.0,
            0.5,
            0.1,
            near=True,
            noise=2.0,
            grain_inside=9.0,
            grain_outside=3.0,
            wall_light_u=0.1,
            wall_light_v=-0.2,
        ),
        ProfileModel(
            *(0.9, 6.0, 0.6, 0.1, True),
            slope_inside=0.3,
            slope_inside_sigma=0.2,
            slope_outside=-0.1,
            slope_outside_sigma=0.05,
        ),
    ],
    ids=["far", "near", "blur", "grain", "slopes known"],
)
@pytest.mark.parametrize("top", [1, 200], ids=["8 bit", "16 bit"])
def test_the_kernel_gives_the_numbers_of_the_reference(model: ProfileModel, top: int):
    picture, _ = step_edge(33, 0.4, top=top)
    lines = many_lines(4)
    reference = edge_profile.measure_edges(picture, lines, model)
    found = NativeEngine().measure_edges(picture, lines, model)
    assert np.array_equal(reference.valid, found.valid)
    assert np.count_nonzero(reference.valid) > 5
    both = reference.valid & (reference.sigma < (np.inf if top == 1 else 0.1))
    # The places of pixels are rounded, more coarsely where levels of 16 bits need the room: far below their sigma.
    allowed = 1e-4 if top == 1 else 5e-4 + 0.05 * reference.sigma[both]
    assert np.all(np.abs(found.shift[both] - reference.shift[both]) <= allowed)
    assert found.sigma[both] == pytest.approx(reference.sigma[both], rel=1e-3 if top == 1 else 1e-2, abs=1e-5)
    assert found.inside[both] == pytest.approx(reference.inside[both], rel=1e-3 if top == 1 else 5e-3)
    assert found.scatter[both] == pytest.approx(reference.scatter[both], rel=3e-2, abs=1e-3)
    # Whether a bin at the limit of a side counts is a matter of the last digit.
    assert found.scatter_inside[both] == pytest.approx(reference.scatter_inside[both], rel=0.1, abs=1e-3)
    assert found.scatter_outside[both] == pytest.approx(reference.scatter_outside[both], rel=0.1, abs=1e-3)
    assert found.blur[both] == pytest.approx(reference.blur[both], abs=1e-4 if top == 1 else 1e-3)
    for name in ("slope_inside", "slope_outside"):
        mine, theirs = getattr(found, name)[both], getattr(reference, name)[both]
        mine_var, theirs_var = getattr(found, f"{name}_variance")[both], getattr(reference, f"{name}_variance")[both]
        assert mine_var == pytest.approx(theirs_var, rel=0.1)
        assert np.all(np.abs(mine - theirs) <= (0.02 if top == 1 else 0.1) * np.sqrt(theirs_var) + 1e-3)


def test_an_edge_is_found_more_exactly_where_the_slopes_beside_it_are_known():
    """Grain of long waves looks like a slope: known slopes keep it from passing for the edge."""
    random = np.random.default_rng(8)
    known = ProfileModel(0.9, 4.5, 0.6, 0.1, near=True, slope_inside_sigma=0.3, slope_outside_sigma=0.3)
    free = ProfileModel(0.9, 4.5, 0.6, 0.1, near=True)
    shifts: dict[str, list[float]] = {"known": [], "free": []}
    for _ in range(30):
        picture, lines = step_edge(random.uniform(0, 360), 0.0)
        grain = np.asarray(smooth_noise(WIDTH, HEIGHT, int(random.integers(1 << 30)), (6.0,)))
        grainy = np.clip(np.rint(picture + 3.0 * grain), 0, 255).astype(np.uint8)
        for name, model in (("known", known), ("free", free)):
            shifts[name].append(float(edge_profile.measure_edges(grainy, lines, model).shift[0]))
    assert np.std(shifts["known"]) < 0.85 * np.std(shifts["free"])


@compiled
def test_the_kernel_survives_lines_that_are_no_lines():
    picture, _ = step_edge(33, 0.4)
    bad = np.array([np.nan, np.inf, -np.inf, 1e300, 0.0])
    grid = np.array(np.meshgrid(bad, bad, bad)).reshape(3, -1).T
    count = len(grid)
    lines = EdgeLines.of(grid[:, :2], np.tile([1.0, 0.0], (count, 1)), grid[:, 2], np.zeros(count), np.zeros(count))
    assert not engine().measure_edges(picture, lines, MODEL).valid.any()
    lines = EdgeLines.of(
        np.tile([50.0, 50.0], (count, 1)), grid[:, :2], np.full(count, 9.0), grid[:, 2], np.zeros(count)
    )
    assert engine().measure_edges(picture, lines, MODEL).valid.shape == (count,)
    lines = EdgeLines.of(
        np.tile([50.0, 50.0], (count, 1)),
        np.tile([1.0, 0.0], (count, 1)),
        np.full(count, 9.0),
        np.zeros(count),
        grid[:, 0],
    )
    assert engine().measure_edges(picture, lines, MODEL).valid.shape == (count,)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")
def test_the_kernel_compiles_without_a_warning(tmp_path: Path):
    sources = [str(path) for path in Path(native.__file__).parent.glob("*.c")]
    command = ["cc", "-std=c11", "-O2", "-fPIC", "-shared", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([*command, "-o", str(tmp_path / "k.so"), *sources, "-lm"], check=True, timeout=60)


def placed(seed: int, *, height_mm: float) -> tuple[Outlines, LocalMaps, Poses, PlaneView]:
    plane = PlaneView(calibration(), height_mm)
    product = recipe()
    outlines = [cut_edges(slot, plane.mm_per_px) for slot in product.template.slots]
    pivots = np.array([slot.centroid for slot in product.template.slots])
    random = np.random.default_rng(seed)
    count = len(pivots)
    poses = Poses(
        random.uniform(-3, 3, count), random.uniform(-120, 120, (count, 2)), pivots, random.normal(0, 0.3, count)
    )
    reaches = OutlineSet(tuple(outlines), pivots).reaches_mm + 12.0 * plane.mm_per_px
    return Outlines.of(outlines), map_locally(plane, poses.position, reaches), poses, plane


@pytest.mark.parametrize("height_mm", [0.0, 12.0])
def test_the_maps_of_small_parts_agree_with_the_lens_model(height_mm: float):
    outlines, maps, poses, plane = placed(3, height_mm=height_mm)
    edges = edge_projection.project(outlines, maps, poses, mirrored=plane.mirrored)
    assert edges.lines.middle == pytest.approx(plane.to_pixels(edges.on_table), abs=1e-3)
    beside = plane.to_pixels(edges.on_table + 0.01 * edges.outward) - plane.to_pixels(edges.on_table)
    assert np.sum(beside * edges.lines.outward, axis=1) / 0.01 == pytest.approx(edges.px_per_mm, rel=1e-3)
    foot = plane.calibration.image_from_table(edges.on_table, 0.0)
    width = np.maximum(np.sum((foot - edges.lines.middle) * edges.lines.outward, axis=1), 0.0)
    assert edges.lines.wall == pytest.approx(width, abs=2e-3)


@compiled
@pytest.mark.parametrize("mirrored", [False, True])
def test_the_kernel_projects_as_the_reference_does(mirrored: bool):
    outlines, maps, poses, _ = placed(4, height_mm=12.0)
    reference = edge_projection.project(outlines, maps, poses, mirrored=mirrored)
    found = NativeEngine().project(outlines, maps, poses, mirrored=mirrored)
    assert found.lines.table == pytest.approx(reference.lines.table, abs=1e-8)
    assert found.extras == pytest.approx(reference.extras, abs=1e-8)


def measured(seed: int, *, lost: float) -> Measured:
    """Return pieces that a known motion explains, with noise, gross errors and lost ones."""
    outlines, maps, poses, plane = placed(seed, height_mm=0.0)
    extras = edge_projection.project(outlines, maps, poses, mirrored=plane.mirrored).extras
    random = np.random.default_rng(seed)
    motion = np.array([0.3, -0.2, 0.004, 0.1])
    distance = extras[:, :4] @ motion + random.normal(0, 0.01, len(extras))
    wrong = random.random(len(extras)) < 0.1
    distance[wrong] += random.uniform(1, 4, np.count_nonzero(wrong))
    valid = random.random(len(extras)) >= lost
    return Measured(outlines.starts, extras, distance, np.full(len(extras), 0.01), valid)


def test_the_solver_finds_a_motion_among_gross_errors():
    solution = pose_solver.solve(measured(5, lost=0.1), 0.01)
    assert solution.change == pytest.approx(np.tile([0.3, -0.2, 0.004, 0.1], (5, 1)), abs=0.015)


@compiled
@pytest.mark.parametrize("lost", [0.0, 0.3, 1.0])
def test_the_kernel_solves_as_the_reference_does(lost: float):
    given = measured(6, lost=lost)
    reference, found = pose_solver.solve(given, 0.04), NativeEngine().solve(given, 0.04)
    assert found.change == pytest.approx(reference.change, abs=1e-9)
    assert found.remains == pytest.approx(reference.remains, abs=1e-9)
    assert found.spread == pytest.approx(reference.spread, abs=1e-9)
    assert found.covariance == pytest.approx(reference.covariance, rel=1e-6, abs=1e-12)


def test_a_library_that_is_no_kernel_is_refused(tmp_path: Path):
    (tmp_path / "k.so").write_bytes(b"not a library")
    with pytest.raises(OSError, match=r"k\.so"):
        NativeEngine(tmp_path / "k.so")


def test_without_the_kernel_the_reference_is_used_and_said(tmp_path: Path):
    package = Path(kernel.__file__).parents[1]
    copy = tmp_path / "slabcell"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("*.so", "__pycache__", "data"))
    done = subprocess.run(
        [sys.executable, "-c", "from slabcell.vision import kernel; print(kernel.implementation(), kernel.__file__)"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    implementation, where = done.stdout.split()
    assert implementation == "numpy"
    assert where.startswith(str(tmp_path))
