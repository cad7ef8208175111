import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slabcell.vision import edge_profile, kernel
from slabcell.vision.edge_profile import EdgeLines, ProfileModel

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
    lines = EdgeLines(middle[None], outward[None], np.array([12.0]), np.zeros(1), np.zeros(1))
    return picture, lines


def many_lines(seed: int, count: int = 200) -> EdgeLines:
    random = np.random.default_rng(seed)
    angle = random.uniform(0, 2 * np.pi, count)
    middle = np.column_stack([random.uniform(-20, WIDTH + 20, count), random.uniform(-20, HEIGHT + 20, count)])
    wall = np.where(random.random(count) < 0.5, 0.0, random.uniform(0, 25, count))
    return EdgeLines(
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
@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("top", [1, 200], ids=["8 bit", "16 bit"])
def test_the_kernel_gives_the_numbers_of_the_reference(near: bool, top: int):
    picture, _ = step_edge(33, 0.4, top=top)
    lines = many_lines(4)
    model = ProfileModel(0.9, 6.0, 0.6, 0.1, near=near)
    reference = edge_profile.measure_edges(picture, lines, model)
    native = kernel.measure_edges(picture, lines, model)
    assert np.array_equal(reference.valid, native.valid)
    assert np.count_nonzero(reference.valid) > 5
    both = reference.valid
    assert native.shift[both] == pytest.approx(reference.shift[both], abs=1e-4)
    assert native.sigma[both] == pytest.approx(reference.sigma[both], rel=1e-3, abs=1e-5)
    assert native.inside[both] == pytest.approx(reference.inside[both], rel=1e-3)


@compiled
def test_the_kernel_survives_lines_that_are_no_lines():
    picture, _ = step_edge(33, 0.4)
    bad = np.array([np.nan, np.inf, -np.inf, 1e300, 0.0])
    grid = np.array(np.meshgrid(bad, bad, bad)).reshape(3, -1).T
    count = len(grid)
    lines = EdgeLines(grid[:, :2], np.tile([1.0, 0.0], (count, 1)), grid[:, 2], np.zeros(count), np.zeros(count))
    assert not kernel.measure_edges(picture, lines, MODEL).valid.any()
    lines = EdgeLines(np.tile([50.0, 50.0], (count, 1)), grid[:, :2], np.full(count, 9.0), grid[:, 2], np.zeros(count))
    assert kernel.measure_edges(picture, lines, MODEL).valid.shape == (count,)
    lines = EdgeLines(
        np.tile([50.0, 50.0], (count, 1)),
        np.tile([1.0, 0.0], (count, 1)),
        np.full(count, 9.0),
        np.zeros(count),
        grid[:, 0],
    )
    assert kernel.measure_edges(picture, lines, MODEL).valid.shape == (count,)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")
def test_the_kernel_compiles_without_a_warning(tmp_path: Path):
    source = Path(kernel.__file__).with_name("_kernel.c")
    command = ["cc", "-std=c11", "-O2", "-fPIC", "-shared", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([*command, "-o", str(tmp_path / "k.so"), str(source), "-lm"], check=True, timeout=60)


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
