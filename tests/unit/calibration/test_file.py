"""A calibration file is written whole, read strictly, and a damaged one is refused with the key that is wrong."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slabcell.calibration import (
    Calibration,
    CameraIdentity,
    Lens,
    TablePlane,
    calibration_from_document,
    calibration_to_document,
    load_calibration,
    save_calibration,
)
from slabcell.errors import CalibrationError

pytestmark = pytest.mark.unit


def example() -> Calibration:
    rotation = np.diag([1.0, -1.0, -1.0])
    return Calibration(
        CameraIdentity(960, 600, "C-1", 8, 16, 2),
        Lens(np.array([[1666.0, 0, 481], [0, 1665.0, 303], [0, 0, 1]]), np.array([-0.1, 0.2, 0.001, -0.002, 0.0])),
        TablePlane(rotation, np.array([10.0, -20.0, 1040.0]), np.array([[1.001, 0.0, 0.1], [0.0, 0.999, -0.2]])),
        {"rms_px": 0.03},
    )


def test_what_is_saved_is_what_is_loaded(tmp_path):
    path = tmp_path / "new" / "c.json"
    before = example()
    save_calibration(path, before)
    after = load_calibration(path)
    assert after.camera == before.camera
    assert after.diagnostics == before.diagnostics
    pixels = np.array([[10.0, 20.0], [900.0, 500.0]])
    assert np.array_equal(after.table_from_image(pixels, 5.0), before.table_from_image(pixels, 5.0))
    assert [p.name for p in path.parent.iterdir()] == ["c.json"]


def test_nothing_is_left_behind_where_writing_fails(tmp_path):
    target = tmp_path / "c.json"
    target.mkdir()
    with pytest.raises(CalibrationError, match="cannot be written"):
        save_calibration(target, example())
    assert list(tmp_path.iterdir()) == [target]


def test_a_calibration_that_could_not_be_read_again_is_not_written(tmp_path):
    broken = Calibration(CameraIdentity(960, 600), Lens(np.full((3, 3), np.nan), np.zeros(5)))
    with pytest.raises(CalibrationError, match=r"lens\.matrix"):
        save_calibration(tmp_path / "c.json", broken)
    assert list(tmp_path.iterdir()) == []


def damaged(*path_and_value):
    *path, last, value = path_and_value
    document = copy.deepcopy(calibration_to_document(example()))
    place = document
    for key in path:
        place = place[key]
    if value is KeyError:
        del place[last]
    else:
        place[last] = value
    return document


@pytest.mark.parametrize(
    ("change", "about"),
    [
        (("schema", "slabcell.calibration/9"), "schema = 'slabcell.calibration/9'"),
        (("schema", KeyError), "key 'schema' is missing"),
        (("surprise", 1), "unknown key 'surprise'"),
        (("camera", []), "camera = "),
        (("camera", "width", 0), r"camera\.width = 0 "),
        (("camera", "width", 960.5), r"camera\.width = 960\.5"),
        (("camera", "width", True), r"camera\.width = True"),
        (("camera", "serial", "x" * 201), r"camera\.serial"),
        (("camera", "binning", KeyError), r"key 'camera\.binning' is missing"),
        (("lens", "model", "pinhole"), r"lens\.model = 'pinhole'"),
        (("lens", "matrix", [[1666.0, 0, 481], [0, 1665.0, 303]]), r"lens\.matrix"),
        (("lens", "matrix", [[-1666.0, 0, 481], [0, 1665.0, 303], [0, 0, 1]]), r"lens\.matrix"),
        (("lens", "matrix", [[1666.0, 1.0, 481], [0, 1665.0, 303], [0, 0, 1]]), r"lens\.matrix"),
        (("lens", "matrix", [[1666.0, 0, 1e6], [0, 1665.0, 303], [0, 0, 1]]), r"lens\.matrix"),
        (("lens", "matrix", 2, 2, "1"), r"lens\.matrix"),
        (("lens", "distortion", [0.1, 0.2, 0.3]), r"lens\.distortion"),
        (("lens", "distortion", [0.1, 0.2, 0.3, 0.4, float("inf")]), r"lens\.distortion"),
        (("lens", "distortion", 0, None), r"lens\.distortion"),
        (("lens", "distortion", [10**400, 0, 0, 0]), r"lens\.distortion"),
        (("plane", "rotation", np.diag([1.0, 1.0, -1.0]).tolist()), r"plane\.rotation.*determinant"),
        (("plane", "rotation", (1.0001 * np.eye(3)).tolist()), r"plane\.rotation"),
        (("plane", "translation_mm", [0, 0, 1e9]), r"plane\.translation_mm"),
        (("plane", "translation_mm", [0, 0]), r"plane\.translation_mm"),
        (("plane", "adjustment", [[0, 0, 0], [0, 0, 0]]), r"plane\.adjustment"),
        (("diagnostics", 3), "diagnostics = 3"),
        (("diagnostics", "noise_px", "a"), r"diagnostics\.noise_px = 'a' is not a number"),
        (("diagnostics", "rms_px", float("nan")), r"diagnostics\.rms_px = nan"),
        (("diagnostics", "covariance", [[1.0]]), r"diagnostics\.covariance"),
        (("diagnostics", "covariance", (-np.eye(9)).tolist()), r"diagnostics\.covariance"),
        (("diagnostics", "covariance", (np.eye(9) + np.eye(9, k=1)).tolist()), r"diagnostics\.covariance"),
        (("created", 5), "created = 5"),
    ],
)
def test_a_damaged_file_is_refused_with_file_key_and_remedy(change, about):
    with pytest.raises(CalibrationError, match=about) as caught:
        calibration_from_document(damaged(*change), "cell/c.json")
    assert str(caught.value).startswith("cell/c.json: ")
    assert "calibrate" in str(caught.value)


@pytest.mark.parametrize(
    "raw", [b"", b"{", b"\xff\xfe", b"[1]", b"null", b"[" * 100_000, b'{"schema": NaN}', b'{"schema": Infinity}']
)
def test_what_is_no_calibration_is_refused(tmp_path, raw):
    path = tmp_path / "c.json"
    path.write_bytes(raw)
    with pytest.raises(CalibrationError, match=r"c\.json"):
        load_calibration(path)


def test_a_missing_and_an_enormous_file_are_refused(tmp_path):
    with pytest.raises(CalibrationError, match="cannot be read"):
        load_calibration(tmp_path / "none.json")
    (tmp_path / "big.json").write_bytes(b" " * (5 << 20))
    with pytest.raises(CalibrationError, match="larger than"):
        load_calibration(tmp_path / "big.json")


def test_a_file_without_a_plane_or_an_adjustment_is_read():
    document = damaged("plane", None)
    assert calibration_from_document(document, "c").plane is None
    plane = calibration_from_document(damaged("plane", "adjustment", KeyError), "c").require_plane()
    assert np.array_equal(plane.adjustment, np.eye(2, 3))


def test_diagnostics_that_json_cannot_hold_are_refused_and_nothing_is_written(tmp_path):
    for value in (float("inf"), {1, 2}, np.zeros(2)):
        with pytest.raises(CalibrationError, match="what JSON cannot"):
            save_calibration(tmp_path / "c.json", replace(example(), diagnostics={"extra": value}))
    assert list(tmp_path.iterdir()) == []


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=8), inner, max_size=5),
    max_leaves=12,
)


@given(data=st.data())
def test_any_value_in_any_place_is_read_as_a_calibration_or_refused(data):
    document = json.loads(json.dumps(calibration_to_document(example())))
    place, key = document, data.draw(st.sampled_from(sorted(document)))
    while isinstance(place[key], dict | list) and place[key] and data.draw(st.booleans()):
        place = place[key]
        key = data.draw(st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place))))
    place[key] = data.draw(json_values)
    try:
        calibration = calibration_from_document(document, "c.json")
    except CalibrationError as error:
        assert str(error).startswith("c.json: ")  # noqa: PT017  either end is right, and both are checked
        return
    assert np.isfinite(calibration.lens.matrix).all()
