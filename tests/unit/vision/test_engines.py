"""The compiled kernel and the references see the same in a picture, stage by stage and as a whole."""

import cv2
import numpy as np
import pytest

from slabcell.geometry import RigidTransform2D
from slabcell.vision import contours, kernel, matching, native, part_poses, registration, shapes, survey, walls
from slabcell.vision.describe import describe_polygons
from slabcell.vision.kernel import NumpyEngine
from slabcell.vision.matching import MatchLimits
from slabcell.vision.native import FAST_LIBRARY, LIBRARY, NativeEngine
from slabcell.vision.outline import Rings
from slabcell.vision.plane import PlaneView
from slabcell.vision.prepared import Prepared

from .pictures import calibration, recipe, render, scatter

pytestmark = [
    pytest.mark.unit,
    pytest.mark.skipif(kernel.implementation() != "native", reason="no C compiler was there at installation"),
]


@pytest.fixture(params=[LIBRARY, FAST_LIBRARY], ids=["every processor", "this processor"])
def engine(request: pytest.FixtureRequest) -> NativeEngine:
    if not request.param.exists() or (request.param == FAST_LIBRARY and native.NativeEngine(LIBRARY).level < 3):
        pytest.skip("this processor or compiler has no faster instructions")
    return NativeEngine(request.param)


def noise(seed: int, shape: tuple[int, int] = (61, 83), smooth: float = 0.0) -> np.ndarray:
    picture = np.random.default_rng(seed).normal(100, 40, shape)
    if smooth:
        picture = 100 + 6 * smooth * (cv2.GaussianBlur(picture, (0, 0), smooth) - 100)
    return np.clip(picture, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (61, 83), (130, 64), (1100, 1000)])
def test_the_surveys_agree(engine: NativeEngine, shape: tuple[int, int]):
    picture = noise(1, shape)
    found, expected = engine.survey(picture), survey.survey(picture)
    assert np.array_equal(found.grey, expected.grey)
    assert np.array_equal(found.rim, expected.rim)
    assert (found.noise, found.sharpest, found.lightest) == (expected.noise, expected.sharpest, expected.lightest)


@pytest.mark.parametrize("seed", range(4))
def test_the_splits_agree(engine: NativeEngine, seed: int):
    picture = noise(seed, smooth=seed)
    found, expected = engine.survey(picture).split, survey.survey(picture).split
    assert found is not None
    assert expected is not None
    assert (found.level, found.valley_share) == (expected.level, pytest.approx(expected.valley_share))
    assert (found.dark, found.light) == (pytest.approx(expected.dark), pytest.approx(expected.light))


def test_a_picture_of_one_grey_has_no_split(engine: NativeEngine):
    assert engine.survey(np.full((50, 50), 7, np.uint8)).split is None


@pytest.mark.parametrize("smooth", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("shape", [(61, 83), (64, 64), (9, 300), (1, 70), (70, 1)])
@pytest.mark.parametrize("dark", [False, True])
def test_the_outlines_agree(engine: NativeEngine, smooth: float, shape: tuple[int, int], dark: bool):
    picture = noise(7, shape, smooth)
    for level, least in ((100.5, 0.0), (80.5, 5.0), (254.5, 0.0), (-1.0, 0.0)):
        found = engine.trace(picture, level, dark=dark, interpolate=True, min_area_px=least)
        expected = contours.trace(picture, level, dark=dark, interpolate=True, min_area_px=least)
        assert np.array_equal(found.starts, expected.starts)
        assert np.allclose(found.points, expected.points)
        assert np.allclose(found.area_px, expected.area_px)
        assert np.array_equal(found.touches_rim, expected.touches_rim)
        assert found.left_out == expected.left_out
        sparse = engine.trace(picture, level, dark=dark, interpolate=True, min_area_px=least, row_shift=2)
        wanted = contours.trace(picture, level, dark=dark, interpolate=True, min_area_px=least, row_shift=2)
        assert np.allclose(sparse.points, wanted.points)
        assert (len(sparse), sparse.left_out) == (len(wanted), wanted.left_out)


def test_outlines_are_those_of_an_independent_implementation(engine: NativeEngine):
    mask = (noise(3, (90, 120), 2.0) > 100).astype(np.uint8) * np.uint8(255)
    found = engine.trace(mask, 127.0, dark=False, interpolate=False, min_area_px=0.0)
    theirs, family = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outer = [contour for contour, (*_, parent) in zip(theirs, family[0], strict=True) if parent < 0]
    assert len(found) == len(outer)
    boxes = [found.points[begin:end] for begin, end in zip(found.starts[:-1], found.starts[1:], strict=True)]
    ours = sorted((*box.min(axis=0), *box.max(axis=0)) for box in boxes)
    # Theirs run through the centres of pixels, ours half a pixel outside of them.
    half = np.array([-0.5, -0.5, 0.5, 0.5])
    expected = sorted(tuple(np.array([*c[:, 0].min(axis=0), *c[:, 0].max(axis=0)]) + half) for c in outer)
    assert np.allclose(ours, expected)


def test_many_and_long_outlines_are_not_cut_off(engine: NativeEngine):
    rows = np.zeros((700, 1000), np.uint8)
    rows[::2, ::2] = 255
    assert len(engine.trace(rows, 127.0, dark=False, interpolate=False, min_area_px=0.0)) == 350 * 500
    comb = np.zeros((700, 1000), np.uint8)
    comb[::2] = comb[:, 0] = 255
    found = engine.trace(comb, 127.0, dark=False, interpolate=False, min_area_px=9.0)
    assert len(found) == 1
    assert len(found.points) > 1 << 19


def stars(seed: int, count: int) -> list[np.ndarray]:
    """Return outlines of many corners about the origin, in mm."""
    random = np.random.default_rng(seed)
    angle = np.sort(random.uniform(0, 2 * np.pi, (count, 40)), axis=1)
    radius = 40 + 10 * np.cos(3 * angle + seed) + random.normal(0, 2, angle.shape)
    return [np.column_stack([r * np.cos(a), r * np.sin(a)]) for a, r in zip(angle, radius, strict=True)]


@pytest.mark.parametrize("height_mm", [0.0, 2.0, 20.0])
def test_the_outlines_without_walls_agree(engine: NativeEngine, height_mm: float):
    plane = PlaneView(calibration(), height_mm)
    random = np.random.default_rng(4)
    camera = plane.calibration.camera
    middles = random.uniform(150, [camera.width - 150, camera.height - 150], (6, 2))
    outlines = [2.5 * star + middle for star, middle in zip(stars(2, 6), middles, strict=True)]
    outlines[1] = outlines[1][::-1]
    outlines += [np.array([[300.0, 300.0], [420.0, 310.0], [350.0, 420.0]]), np.full((1, 2), 333.0)]
    seen = Rings.of(outlines)
    assert plane.forward is not None
    found, expected = engine.strip_walls(plane, seen), walls.strip_walls(plane, seen)
    assert np.array_equal(found.starts, expected.starts)
    assert np.allclose(found.points, expected.points, atol=1e-3)
    whole = seen.moved(plane.from_pixels(seen.points)).counter_clockwise().resampled(walls.WALL_SAMPLES)
    moved = np.hypot(*(expected.points - whole.reshape(-1, 2)).T)
    assert (moved.max() > 0.3) == (height_mm > 10.0)  # a low wall is less than a pixel


def test_where_the_table_does_not_reach_the_reference_strips_the_walls(engine: NativeEngine):
    plane = PlaneView(calibration(), 20.0)
    far = Rings.of([np.array([[-9e3, 0.0], [-8e3, 0.0], [-8e3, 900.0]])])
    found, expected = engine.strip_walls(plane, far), walls.strip_walls(plane, far)
    assert np.array_equal(found.points, expected.points)
    nothing = engine.strip_walls(plane, Rings.of([]))
    assert (len(nothing), len(nothing.points)) == (0, 0)


def test_the_descriptions_agree(engine: NativeEngine):
    polygons = [*stars(1, 5), np.array([[0, 0], [0, 9], [20, 0.0]]), np.array([[1, 1], [1, 1], [1, 1.0]])]
    rings = Rings.of(polygons)
    found, expected = engine.describe(rings), shapes.describe(rings)
    for name in ("samples", "middle", "area_mm2", "inertia", "centroid"):
        assert np.allclose(getattr(found, name), getattr(expected, name), atol=1e-7), name
    for name in ("values", "energy", "magnitudes"):
        assert np.allclose(getattr(found.spectra, name), getattr(expected.spectra, name), atol=1e-6), name


def test_the_descriptions_of_outlines_in_pixels_agree(engine: NativeEngine):
    plane = PlaneView(calibration(), 0.0)
    angle = np.arange(1700) * (2 * np.pi / 1700)
    circle = np.column_stack([200 + 90 * np.cos(angle), 150 + 40 * np.sin(angle)])
    pixels = np.concatenate([circle, circle[::9], circle[::-2]])
    # Not in the order in which they lie, as blobs are sorted by their size.
    begins, ends = np.array([1889, 0, 1700]), np.array([2739, 1700, 1889])
    found = engine.describe_pixels(plane.grid, pixels, begins, ends)
    expected = shapes.describe_pixels(plane.grid, pixels, begins, ends)
    for name in ("samples", "middle", "area_mm2", "inertia", "centroid"):
        assert np.allclose(getattr(found, name), getattr(expected, name), atol=1e-7), name
    assert np.allclose(found.spectra.values, expected.spectra.values, atol=1e-6)


@pytest.mark.parametrize("height_mm", [0.0, 10.0])
def test_the_tables_of_the_plane_agree_with_the_lens_model(engine: NativeEngine, height_mm: float):
    plane = PlaneView(calibration(), height_mm)
    width, height = plane.calibration.camera.width, plane.calibration.camera.height
    pixels = np.random.default_rng(2).uniform((0, 0), (width - 1, height - 1), (300, 2))
    exact = plane.calibration.table_from_image(pixels, height_mm)
    mm = engine.to_plane(plane.grid, pixels)
    assert np.allclose(mm, plane.grid.at(pixels))
    assert np.abs(mm - exact).max() < 0.1 * plane.mm_per_px
    assert plane.forward is not None
    assert np.allclose(engine.to_pixels(plane, exact), pixels, atol=1e-3)
    size = np.full(300, 30.0 * plane.mm_per_px)
    maps, expected = engine.map_locally(plane, exact, size), NumpyEngine().map_locally(plane, exact, size)
    assert np.allclose(maps.top[:, 0], expected.top[:, 0], atol=1e-3)
    assert np.allclose(maps.foot[:, 0], expected.foot[:, 0], atol=1e-3)
    assert np.allclose(maps.top, expected.top, atol=4e-3)


@pytest.mark.parametrize("seed", range(3))
def test_the_candidates_agree(engine: NativeEngine, seed: int):
    templates = stars(seed, 12)
    random = np.random.default_rng(seed)
    turns = random.uniform(-np.pi, np.pi, 12)
    laid = [
        shape @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
        + random.normal(0, 0.2, shape.shape)
        + (300, -40)
        for shape, a in zip(templates, turns, strict=True)
    ]
    blobs, slots = describe_polygons(laid), describe_polygons(templates)
    limits = MatchLimits(np.full(12, 3.0), [1, 2] * 6, 0.5, 0.05, 0.3)
    for allowed in (None, random.random((12, 12)) < 0.5):
        found = engine.find_candidates(blobs, slots, limits, allowed)
        expected = matching.find_candidates(blobs, slots, limits, allowed)
        assert len(found) == len(expected)
        assert allowed is not None or len(found) >= 12
        for ours, theirs in zip(sorted(found), sorted(expected), strict=True):
            assert ours[:2] == theirs[:2]
            assert np.allclose(np.exp(1j * ours.rotation), np.exp(1j * theirs.rotation), atol=1e-6)
            assert ours[3:] == pytest.approx(theirs[3:], abs=1e-5)


@pytest.mark.parametrize("height_mm", [0.0, 12.0])
@pytest.mark.parametrize("bits", [8, 16])
def test_the_registrations_agree(engine: NativeEngine, height_mm: float, bits: int):
    prepared = Prepared(calibration(), recipe(thickness_mm=height_mm))
    poses = scatter(prepared.recipe)
    outlines = [pose.apply(slot.vertices) for pose, slot in zip(poses, prepared.slots, strict=True)]
    picture = render(prepared.calibration, outlines, height_mm=height_mm)
    grey = picture if bits == 8 else picture.astype(np.uint16) * np.uint16(200)
    candidates: list[matching.Candidate] = []
    for index, (pose, slot) in enumerate(zip(poses, prepared.slots, strict=True)):
        turned = RigidTransform2D(pose.rotation_deg + 0.2, 0.0, 0.0)
        x, y = pose.apply(slot.centroid) - turned.apply(slot.centroid) + (0.2, -0.1)
        candidates.append(matching.Candidate(index, index, np.deg2rad(turned.rotation_deg), x, y, 0.0))
    rough = height_mm > 0
    found = engine.register(grey, prepared.plane, prepared.outlines, candidates, rough=rough)
    expected = registration.register(grey, prepared.plane, prepared.outlines, candidates, rough=rough)
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.candidate == theirs.candidate
        assert ours.rotation == pytest.approx(theirs.rotation, abs=1e-5)
        assert ours[2:5] == pytest.approx(theirs[2:5], abs=4e-3 * prepared.plane.mm_per_px)
        assert ours[5:8] == pytest.approx(theirs[5:8], rel=0.15, abs=1e-3)
        # A bin at the limit of an edge's side counts here and not there: the picture's grain differs by some percent.
        assert np.allclose(ours.covariance, theirs.covariance, rtol=0.2, atol=1e-9)


@pytest.mark.parametrize("height_mm", [0.0, 12.0])
def test_the_poses_of_parts_agree(engine: NativeEngine, height_mm: float):
    prepared = Prepared(calibration(), recipe(thickness_mm=height_mm))
    random = np.random.default_rng(4)
    chosen: list[registration.Registration] = []
    for index, pose in enumerate(scatter(prepared.recipe)):
        half = random.normal(0, 0.01, (3, 3))
        rotation = np.deg2rad(pose.rotation_deg) + 4 * np.pi * index
        candidate = matching.Candidate(index, index, rotation, 0.0, 0.0, 0.0)
        numbers = (0.0, 0.01, 1.0, 0.01)
        covariance = (half @ half.T).reshape(-1).tolist()
        chosen.append(
            registration.Registration(candidate, rotation, pose.x_mm, pose.y_mm, *numbers, covariance=covariance)
        )
    chosen.append(chosen[0]._replace(x_mm=1e5))  # far out of the table that the kernel has
    for some in (chosen[:-1], chosen, []):
        found = engine.part_poses(prepared.plane, prepared.slot_table, some)
        expected = part_poses.part_poses(prepared.plane, prepared.slot_table, some)
        assert np.allclose(np.array(found.numbers)[..., :7], np.array(expected.numbers)[..., :7])
        assert np.allclose(np.array(found.numbers)[..., 7:], np.array(expected.numbers)[..., 7:], atol=2e-2)
        for ours, theirs in zip(found.outlines, expected.outlines, strict=True):
            assert np.allclose(ours, theirs, atol=2e-3)


def test_no_candidates_give_no_registrations(engine: NativeEngine):
    prepared = Prepared(calibration(), recipe())
    blank = np.zeros((calibration().camera.height, calibration().camera.width), np.uint8)
    assert engine.register(blank, prepared.plane, prepared.outlines, [], rough=False) == []
