"""Whatever stands in a calibration file or a list of points, it is read or refused in words: nothing else happens."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
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
from slabcell.errors import CalibrationError

SLOW_CASES = 15_000

TURN = np.diag([1.0, -1.0, -1.0])
GOOD = json.dumps(
    calibration_to_document(
        Calibration(
            CameraIdentity(960, 600, "C-1"),
            Lens(np.array([[1666.0, 0, 481], [0, 1665.0, 303], [0, 0, 1]]), np.array([-0.1, 0.2, 0.001, -0.002, 0.0])),
            TablePlane(TURN, np.array([10.0, -20.0, 1040.0])),
            {"rms_px": 0.03, "noise_px": 0.02, "covariance": np.eye(9).tolist()},
            HandEye("eye-to-hand", TURN, np.array([290.0, -45.0, 1040.0])),
        )
    )
).encode()

LISTS = {
    load_poses: b"image,X,Y,Z,A,B,C\na.png,1,2,3,-170.5,0,1\nb.png,4,5,6,7,8,9\n",
    load_touch: b"image,column,row,x,y\na.png,0,0,1.5,-2\na.png,11,8,3,4e1\n",
    load_marks: b"u,v\n10.5,20\n30,40\n",
}

edits = st.lists(
    st.tuples(st.sampled_from(["delete", "insert", "replace", "repeat"]), st.floats(0, 1), st.binary(max_size=6)),
    max_size=6,
)


def edited(raw: bytes, changes) -> bytes:
    """Return the bytes with pieces deleted, inserted, replaced or repeated."""
    for kind, share, piece in changes:
        at = int(share * len(raw))
        if kind == "delete":
            raw = raw[:at] + raw[at + len(piece) + 1 :]
        elif kind == "insert":
            raw = raw[:at] + piece + raw[at:]
        elif kind == "replace":
            raw = raw[:at] + piece + raw[at + len(piece) :]
        else:
            raw = raw[:at] + raw[max(at - 40, 0) : at] + raw[at:]
    return raw


def reads_or_refuses(path: Path, raw: bytes, load) -> None:
    path.write_bytes(raw)
    try:
        found = load(path)
    except CalibrationError as error:
        assert str(path) in str(error)  # noqa: PT017  either end is right, and both are checked
        assert len(str(error)) < 2000  # noqa: PT017
        return
    if isinstance(found, Calibration) and found.plane is not None:
        pixels = found.image_from_table(np.array([[10.0, 20.0]]))
        assert pixels.shape == (1, 2)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz") / "file"


def check(path, load, good, cases):
    @settings(max_examples=cases, suppress_health_check=[HealthCheck.too_slow], deadline=None, database=None)
    @given(raw=st.binary(max_size=200) | st.builds(edited, st.just(good), edits))
    def run(raw):
        reads_or_refuses(path, raw, load)

    return run


@pytest.mark.unit
@pytest.mark.parametrize("load", [load_calibration, *LISTS], ids=lambda f: f.__name__)
def test_a_damaged_file_is_read_or_refused(path, load):
    check(path, load, LISTS.get(load, GOOD), 100)()


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("load", [load_calibration, *LISTS], ids=lambda f: f.__name__)
def test_many_damaged_files_are_read_or_refused(path, load):
    check(path, load, LISTS.get(load, GOOD), SLOW_CASES)()
