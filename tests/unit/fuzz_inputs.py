"""One run of a fuzz of what comes from outside, in a process of its own with bounded memory and processor time.

    python tests/unit/fuzz_inputs.py KIND CASES SEED

Prints a JSON object: cases that ran, how many were accepted and refused, memory and processor time used.  Ends with a
traceback and hypothesis' falsifying example where something else than a typed error happened.
"""

import json
import resource
import signal
import sys
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any, get_args

import cv2
import numpy as np
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from slabcell.calibration import (
    Calibration,
    CameraIdentity,
    HandEye,
    Lens,
    TablePlane,
    calibration_to_document,
    load_calibration,
    load_marks,
    load_poses,
    load_touch,
)
from slabcell.calibration.file import from_document
from slabcell.errors import CalibrationError, ImageError, RecipeError, SlabcellError, TemplateError
from slabcell.geometry import Polygon
from slabcell.images import decode_image
from slabcell.recipe import BlobFeature, Recipe, RecipeFile, load_recipe
from slabcell.template import Template, parse_template
from slabcell.vision import locate

# What one case may use.  Memory: a picture of 100 megapixels in 16-bit colour has 600 MB, and is turned once.
ADDRESS_SPACE = 3 << 30
CASE_CPU_S = 20.0

Case = Callable[[Any], str]


# --- Bytes -----------------------------------------------------------------------------------------------------------

NASTY = (
    *(b"nan", b"inf", b"-1", b"0", b"1e308", b"1e-320", b"9" * 40, b"\0", b"\xff\xff\xff\xff", b"\x00\x00\x00\x00"),
    *(
        b'"',
        b"[[",
        b"{}",
        b",,,,",
        b"\n\n",
        b"\r",
        b"\xef\xbb\xbf",
        b"true",
        b"null",
        b"\xe2\x80\xa8",
        b"=",
        b"#",
        b"'''",
    ),
)
pieces = st.binary(max_size=6) | st.sampled_from(NASTY)
edits = st.lists(
    st.tuples(st.sampled_from(["delete", "insert", "replace", "repeat", "cut"]), st.floats(0, 1), pieces), max_size=6
)


def edited(raw: bytes, changes: list[tuple[str, float, bytes]]) -> bytes:
    """Return the bytes with pieces deleted, inserted, replaced, repeated, or the end cut off."""
    for kind, share, piece in changes:
        at = int(share * len(raw))
        if kind == "delete":
            raw = raw[:at] + raw[at + len(piece) + 1 :]
        elif kind == "insert":
            raw = raw[:at] + piece + raw[at:]
        elif kind == "replace":
            raw = raw[:at] + piece + raw[at + len(piece) :]
        elif kind == "repeat":
            raw = raw[:at] + raw[max(at - 40, 0) : at] + raw[at:]
        elif share > 0.5:
            raw = raw[:at]
    return raw


def damaged(*good: bytes) -> st.SearchStrategy[bytes]:
    """Return bytes that were good, and such as never were."""
    return st.builds(edited, st.sampled_from(good), edits) | st.binary(max_size=200)


# --- Pictures --------------------------------------------------------------------------------------------------------

GREY = np.add.outer(np.arange(24) * 7, np.arange(36) * 3).astype(np.uint8)
COLOUR = np.dstack([GREY, GREY[::-1], GREY[:, ::-1]])
PICTURES = [
    cv2.imencode(suffix, picture)[1].tobytes()
    for suffix in (".png", ".tiff")
    for picture in (GREY, GREY.astype(np.uint16) * 200, COLOUR, COLOUR.astype(np.uint16) * 200)
] + [cv2.imencode(".jpg", picture)[1].tobytes() for picture in (GREY, COLOUR)]


def mended(raw: bytes) -> bytes:
    """Return a PNG whose checksums are right again, so that what stands in its chunks reaches the decoder."""
    if not raw.startswith(b"\x89PNG\r\n\x1a\n"):
        return raw
    out, position = raw[:8], 8
    while position + 12 <= len(raw):
        length = int.from_bytes(raw[position : position + 4], "big")
        body = raw[position + 4 : position + 8 + length]
        if position + 12 + length > len(raw):
            break
        out += raw[position : position + 4] + body + zlib.crc32(body).to_bytes(4, "big")
        position += 12 + length
    return out + raw[position:]


def picture_case(raw: bytes) -> str:
    for content in {raw, mended(raw)}:
        try:
            picture = decode_image(content, "fuzz.png")
        except ImageError as error:
            said(error, "fuzz.png")
            continue
        assert picture.ndim in (2, 3)
        assert picture.dtype in (np.uint8, np.uint16)
        return "accepted"
    return "refused"


# --- Lists and templates ---------------------------------------------------------------------------------------------

TEMPLATE = b"# five slabs\n0,0,50,0,50,50,0,50\n60,0,110,0,110,50\n120.5,0,170,1e1,150,40,130,55.25\n"
LISTS = {
    load_poses: b"image,X,Y,Z,A,B,C\na.png,1,2,3,-170.5,0,1\nb.png,4,5,6,7,8,9\n",
    load_touch: b"image,column,row,x,y\na.png,0,0,1.5,-2\na.png,11,8,3,4e1\n",
    load_marks: b"u,v\n10.5,20\n30,40\n",
}
cells = st.floats().map(repr) | st.integers(-300, 300).map(str) | st.text(max_size=5) | st.just("")
lines = (
    st.lists(st.lists(cells, max_size=14).map(",".join), max_size=8)
    .map("\n".join)
    .map(lambda text: text.encode("utf-8", "surrogatepass"))
)


def template_case(raw: bytes) -> str:
    try:
        template = parse_template(raw, "fuzz.csv")
    except TemplateError as error:
        assert error.problems  # noqa: PT017 - either end is right, and both are checked
        said(error, "fuzz.csv", 50 * 400)
        return "refused"
    assert all(np.isfinite(slot.vertices).all() and slot.area_mm2 > 0 for slot in template.slots)
    return "accepted"


def list_case(given_: tuple[Callable[[Path], object], bytes]) -> str:
    load, raw = given_
    FILE.write_bytes(raw)
    try:
        load(FILE)
    except CalibrationError as error:
        said(error, str(FILE))
        return "refused"
    return "accepted"


# --- Recipes ---------------------------------------------------------------------------------------------------------

RECIPE = b"""[template]
file = "t.csv"
thickness_mm = 10.0
[segmentation]
method = "fixed"
threshold = 120
roi = [[0, 0], [30.5, 0], [30, 20]]
[[segmentation.morphology]]
operation = "open"
size_px = 3
[matching]
method = "hu"
[[blobs.filters]]
feature = "area_mm2"
min = 3
[grasp]
cups_mm = [[0, 0], [20, 0]]
[[grasp.forbidden]]
polygon = [[0, 0], [1, 0], [1, 1]]
[gates]
rim_mm = [[0, 0], [300, 0], [300, 200]]
"""


def recipe_case(raw: bytes) -> str:
    FILE.write_bytes(raw)
    FILE.with_name("t.csv").write_bytes(b"0,0,50,0,50,50,0,50\n")
    try:
        load_recipe(FILE)
    except (RecipeError, TemplateError) as error:
        said(error, str(FILE.parent), 20_000)
        return "refused"
    return "accepted"


# --- Calibrations ----------------------------------------------------------------------------------------------------

TURN = np.diag([1.0, -1.0, -1.0])
CAMERA = Calibration(
    CameraIdentity(240, 180, "C-1"),
    Lens(np.array([[500.0, 0, 120], [0, 501.0, 88], [0, 0, 1]]), np.array([-0.05, 0.02, 0.001, -0.002, 0.0])),
    TablePlane(TURN, np.array([0.0, 0.0, 500.0])),
    {"rms_px": 0.03, "noise_px": 0.02, "covariance": np.eye(9).tolist()},
    HandEye("eye-to-hand", TURN, np.array([290.0, -45.0, 1040.0])),
)
CALIBRATION = json.dumps(calibration_to_document(CAMERA)).encode()
any_json = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


def calibration_case(raw: bytes) -> str:
    FILE.write_bytes(raw)
    try:
        found = load_calibration(FILE)
    except CalibrationError as error:
        said(error, str(FILE))
        return "refused"
    if found.plane is not None:
        assert found.image_from_table(np.array([[10.0, 20.0]])).shape == (1, 2)
    return "accepted"


# --- The vision ------------------------------------------------------------------------------------------------------

METHODS = ("auto", "fixed", "otsu", "dynamic_hard", "dynamic_soft", "local", "multi_otsu", "kmeans")
numbers = st.floats(-1, 1)
wild = st.floats(-1e6, 1e6) | numbers


@st.composite
def calibrations(draw: st.DrawFn) -> Calibration:
    """Return calibrations that a file may hold, most of them of no real camera."""
    turn, _ = cv2.Rodrigues(np.array([draw(st.floats(-4, 4)) for _ in range(3)]))
    document = calibration_to_document(CAMERA)
    focal = draw(st.floats(1, 1e7) | st.floats(100, 400))
    fisheye = draw(st.booleans())
    size = 4 if fisheye else draw(st.sampled_from([4, 5, 8, 12, 14]))
    document["lens"] = {
        "model": "fisheye" if fisheye else "brown",
        "matrix": [[focal, 0, draw(st.floats(-900, 900))], [0, focal, draw(st.floats(-900, 900))], [0, 0, 1]],
        "distortion": [draw(wild) for _ in range(size)],
    }
    document["plane"] = {
        "rotation": np.asarray(turn, float).tolist() if draw(st.booleans()) else TURN.tolist(),
        "translation_mm": [draw(wild), draw(wild), draw(st.floats(-1e6, 1e6) | st.floats(100, 900))],
        "adjustment": [[1 + 0.2 * draw(numbers), 0.2 * draw(numbers), draw(wild)], [0.0, 1.0, draw(wild)]],
    }
    document["diagnostics"] = {}
    try:
        return from_document(document, "fuzz.json")
    except CalibrationError:
        return CAMERA


@st.composite
def recipes(draw: st.DrawFn) -> Recipe:
    """Return recipes whose every parameter is allowed."""
    choose = st.sampled_from
    classes = draw(st.integers(2, 5))
    low = draw(st.floats(0, 99))
    document: dict[str, Any] = {
        "template": {"file": "t.csv", "thickness_mm": draw(st.floats(0, 500) | st.just(0.0))},
        "segmentation": {
            "method": draw(choose(METHODS)),
            "polarity": draw(choose(["auto", "light", "dark"])),
            "threshold": draw(st.integers(0, 65535)),
            "low_tail_percent": low,
            "high_tail_percent": draw(st.floats(0, max(0.0, 99.9 - low))),
            "level_percent": draw(st.floats(0, 100)),
            "softness_percent": draw(st.floats(0, 100)),
            "classes": classes,
            "slab_classes": draw(st.integers(1, classes - 1)),
            "window_px": draw(st.integers(0, 10000)),
            "roi": draw(st.none() | st.lists(st.tuples(wild, wild), min_size=3, max_size=8)),
            "min_area_mm2": draw(st.floats(1e-300, 1e6) | st.just(1.0)),
            "border": draw(choose(["reject", "keep"])),
            "morphology": [
                {
                    "operation": draw(choose(["open", "close", "erode", "dilate", "fill"])),
                    "size_px": draw(st.integers(1, 99)),
                }
                for _ in range(draw(st.integers(0, 3)))
            ],
        },
        "blobs": {
            "report": draw(st.booleans()),
            "sort_by": draw(st.none() | choose(get_args(BlobFeature))),
            "sort_order": draw(choose(["ascending", "descending"])),
            "filters": [
                {"feature": draw(choose(get_args(BlobFeature))), "min": draw(wild)}
                for _ in range(draw(st.integers(0, 2)))
            ],
        },
        "matching": {
            "method": draw(choose(["registration", "hu", "polygon"])),
            "area_tolerance": draw(st.floats(1e-3, 0.5)),
            "max_residual_mm": draw(st.floats(1e-3, 50)),
            "min_coverage": draw(st.floats(0.3, 1)),
            "min_score": draw(st.floats(0, 1)),
            "alike_mm": draw(st.floats(0, 50)),
            "min_lead_mm": draw(st.floats(0, 50)),
        },
        "grasp": {
            "cup_radius_mm": draw(st.floats(0, 20)),
            "cups_mm": draw(st.lists(st.tuples(numbers, wild), min_size=1, max_size=2)),
            "forbidden": [
                {"polygon": draw(st.lists(st.tuples(wild, wild), min_size=3, max_size=5))}
                for _ in range(draw(st.integers(0, 1)))
            ],
        },
        "gates": {
            "min_brightness_percent": 0,
            "max_overexposed_percent": 100,
            "max_blur_px": 100,
            "rim_mm": draw(st.none() | st.lists(st.tuples(wild, wild), min_size=3, max_size=6)),
            "marks": [
                {"x_mm": draw(wild), "y_mm": draw(wild), "diameter_mm": draw(st.floats(1e-3, 1000))}
                for _ in range(draw(st.integers(0, 1)))
            ],
            "min_reference_percent": 0,
            "max_reference_shift_mm": 100,
        },
    }
    # Most keys at their defaults: that much must be right for anything to be located at all.
    kept = {section for section in document if section != "template" and draw(st.integers(0, 3)) == 0}
    document = {key: value for key, value in document.items() if key in kept or key == "template"}
    document["template"]["thickness_mm"] = draw(st.sampled_from([0.0, 0.0, document["template"]["thickness_mm"]]))
    file = RecipeFile.model_validate(document)
    slots = tuple(Polygon.from_points(points) for points in draw(st.just(SHAPES[:4]) | some_slots))
    plain = Recipe.from_template(Template("fuzz", slots, ""), file.template.thickness_mm)
    return replace(
        plain,
        segmentation=file.segmentation,
        blobs=file.blobs,
        matching=file.matching,
        grasp=file.grasp,
        gates=file.gates,
    )


SHAPES = [
    [(0, 0), (50, 0), (50, 50), (0, 50)],
    [(0, 0), (80, 0), (80, 40), (0, 40)],
    [(0, 0), (70, 0), (70, 25), (30, 25), (30, 60), (0, 60)],
    [(0, 0), (60, -10), (85, 35), (20, 50)],
    [(0, 0), (1e-3, 0), (0, 1e-3)],
    [(0, 0), (4e4, 0), (4e4, 1)],
]
slots_ = st.sampled_from([*SHAPES[:4], *SHAPES])
some_slots = st.lists(slots_, min_size=1, max_size=4)


@st.composite
def pictures(draw: st.DrawFn) -> np.ndarray:
    """Return pictures of the size of the calibration: slabs, noise, ramps, stripes, in every depth."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    grey_level = st.integers(0, 255)
    table, slab = draw(st.sampled_from([(30, 180), (200, 60)]) | st.tuples(grey_level, grey_level))
    picture = np.full((180, 240), float(table))
    kind = draw(st.sampled_from(["slabs", "slabs", "slabs", "noise", "ramp", "stripes", "blank"]))
    if kind == "slabs":
        fine = np.full((720, 960), float(table))
        for _ in range(draw(st.integers(1, 6))):
            # One pixel is one millimetre: what is drawn at its true size fits its slot.
            shape = np.array(draw(slots_), float) * draw(st.just(1.0) | st.floats(0.2, 1.5))
            angle = random.uniform(0, 2 * np.pi)
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            corners = 4.0 * (np.clip(shape @ turn.T, -500, 500) + random.uniform(0, (200, 150)))
            cv2.fillPoly(fine, [np.rint(corners).astype(np.int32)], float(slab))
        picture = cv2.resize(fine, (240, 180), interpolation=cv2.INTER_AREA)
        picture = cv2.GaussianBlur(picture, (0, 0), draw(st.just(0.7) | st.floats(0.2, 3)))
    elif kind == "noise":
        picture = random.uniform(min(table, slab), max(table, slab) + 1, picture.shape)
    elif kind == "ramp":
        picture = np.tile(np.linspace(table, slab, 240), (180, 1))
    elif kind == "stripes":
        picture[:: draw(st.integers(2, 9))] = slab
    picture = picture + random.normal(0, draw(st.just(1.0) | st.floats(0, 20)), picture.shape)
    grey = np.clip(picture, 0, 255)
    deep = draw(st.booleans())
    result = (grey * 257).astype(np.uint16) if deep else grey.astype(np.uint8)
    return np.dstack([result] * 3) if draw(st.booleans()) else result


def vision_case(given_: tuple[np.ndarray, Calibration, Recipe]) -> str:
    picture, calibration, recipe = given_
    try:
        result = locate(picture, calibration, recipe)
    except SlabcellError as error:
        said(error, "")
        return "refused"
    document = json.dumps(result.to_document("fuzz.png"), allow_nan=False)
    assert len(document) < 10 << 20
    return "located" if result.parts else "nothing"


def said(error: Exception, name: str, limit: int = 2000) -> None:
    """Check that an error speaks of its file, and not endlessly."""
    assert name in str(error), f"{error!r} does not name {name}"
    assert 0 < len(str(error)) < limit, f"{len(str(error))} characters"


KINDS: dict[str, tuple[st.SearchStrategy[Any], Case]] = {
    "pictures": (damaged(*PICTURES), picture_case),
    "templates": (damaged(TEMPLATE) | lines, template_case),
    "lists": (
        st.sampled_from(list(LISTS)).flatmap(lambda load: st.tuples(st.just(load), damaged(LISTS[load]) | lines)),
        list_case,
    ),
    "recipes": (damaged(RECIPE), recipe_case),
    "calibrations": (
        damaged(CALIBRATION) | any_json.map(lambda value: json.dumps(value).encode()),
        calibration_case,
    ),
    "vision": (st.tuples(pictures(), st.just(CAMERA) | st.just(CAMERA) | calibrations(), recipes()), vision_case),
}
FILE = Path()


def too_long(number: int, frame: FrameType | None) -> None:
    raise AssertionError(f"one case used {CASE_CPU_S:g} s of processor time")


def main(kind: str, cases: int, number: int) -> None:
    """Run so many cases of a kind."""
    global FILE  # noqa: PLW0603 - one process, one folder
    strategy, case = KINDS[kind]
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    signal.signal(signal.SIGPROF, too_long)
    outcomes: Counter[str] = Counter()
    largest = (0, "")

    @seed(number)
    @settings(max_examples=cases, suppress_health_check=list(HealthCheck), deadline=None, database=None)
    @given(item=strategy)
    def run(item: Any) -> None:
        nonlocal largest
        peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        signal.setitimer(signal.ITIMER_PROF, CASE_CPU_S)
        try:
            outcomes[case(item)] += 1
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        step = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak_kib) >> 10
        if step > largest[0]:
            largest = (step, repr(item)[:300])

    with tempfile.TemporaryDirectory() as folder:
        FILE = Path(folder) / "file"
        run()
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(
        json.dumps(
            {
                "kind": kind,
                "seed": number,
                "cases": sum(outcomes.values()),
                "outcomes": outcomes,
                "peak_mib": used.ru_maxrss >> 10,
                "largest_case_mib": largest,
                "grown_mib": (used.ru_maxrss - before_kib) >> 10,
                "cpu_s": round(used.ru_utime + used.ru_stime, 1),
            }
        )
    )


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
