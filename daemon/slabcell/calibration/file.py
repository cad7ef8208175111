"""How is a calibration kept in a file?  JSON, schema ``slabcell.calibration/1``, written atomically, read strictly.

What is read is never trusted: every number must be finite and within limits that a real camera cannot leave, and
rotations must be rotations.  The reference page is ``docs/reference/calibration-file.md``.
"""

import json
import os
import tempfile
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from slabcell.calibration.model import Calibration, CameraIdentity, HandEye, Lens, TablePlane
from slabcell.errors import CalibrationError
from slabcell.geometry import Points

__all__ = ["SCHEMA", "from_document", "load_calibration", "save_calibration", "to_document"]

SCHEMA = "slabcell.calibration/1"
MAX_BYTES = 4 << 20
MAX_SIDE = 65_536
MAX_FOCAL_PX = 1e7
MAX_COEFFICIENT = 1e6
MAX_DISTANCE_MM = 1e6
MAX_RESIDUAL_PX = 1000.0
MAX_VARIANCE = 1e60  # what the views do not tell at all
ROTATION_TOLERANCE = 1e-6
REMEDY = "make it again with `slabcell calibrate`, or restore the file from a backup"

_LENGTHS = {"brown": (4, 5, 8, 12, 14), "fisheye": (4,)}
_KEYS = {"schema", "created", "camera", "lens", "plane", "hand_eye", "diagnostics"}


def save_calibration(path: Path, calibration: Calibration) -> None:
    """Write the calibration; the file appears complete or not at all.  Raises CalibrationError."""
    document = to_document(calibration)
    from_document(document, str(path))  # nothing is written that could not be read again
    try:
        text = json.dumps(document, indent=1, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{path}: the diagnostics hold what JSON cannot: {error}") from error
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                stream.write(text)
                stream.flush()
                os.fsync(stream.fileno())
            Path(temporary).chmod(0o644)
            Path(temporary).replace(path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be written: {error.strerror}") from error


def load_calibration(path: Path) -> Calibration:
    """Return the calibration of a file.  Raises CalibrationError that names file, key, value and remedy."""
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}; {REMEDY}") from error
    if len(raw) > MAX_BYTES:
        raise CalibrationError(f"{path}: is larger than {MAX_BYTES} bytes, which no calibration is; {REMEDY}")
    try:
        document = json.loads(raw.decode("utf-8"), parse_constant=_refuse_constant)
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise CalibrationError(f"{path}: is not JSON ({error}); {REMEDY}") from error
    return from_document(document, str(path))


def _refuse_constant(text: str) -> None:
    raise ValueError(f"{text} is not a number")


def to_document(calibration: Calibration) -> dict[str, object]:
    """Return the ``slabcell.calibration/1`` object."""
    camera, lens, plane, hand_eye = calibration.camera, calibration.lens, calibration.plane, calibration.hand_eye
    return {
        "schema": SCHEMA,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "camera": {
            "serial": camera.serial,
            "width": camera.width,
            "height": camera.height,
            "offset_x": camera.offset_x,
            "offset_y": camera.offset_y,
            "binning": camera.binning,
        },
        "lens": {"model": lens.model, "matrix": lens.matrix.tolist(), "distortion": lens.distortion.ravel().tolist()},
        "plane": None
        if plane is None
        else {
            "rotation": plane.rotation.tolist(),
            "translation_mm": plane.translation.ravel().tolist(),
            "adjustment": plane.adjustment.tolist(),
        },
        "hand_eye": None
        if hand_eye is None
        else {
            "mount": hand_eye.mount,
            "rotation": hand_eye.rotation.tolist(),
            "translation_mm": hand_eye.translation.ravel().tolist(),
        },
        "diagnostics": calibration.diagnostics,
    }


class _Table:
    """One JSON object of the file; every reading of it is checked and names its key."""

    def __init__(self, value: object, where: str, source: str) -> None:
        self.source = source
        self.where = where
        if not isinstance(value, dict):
            raise self.wrong("", value, "an object")
        self.values: Mapping[str, object] = value  # pyright: ignore[reportUnknownVariableType]  # JSON objects have str keys

    def wrong(self, key: str, value: object, wanted: str) -> CalibrationError:
        name = ".".join(part for part in (self.where, key) if part) or "the file"
        return CalibrationError(f"{self.source}: {name} = {repr(value)[:120]} is not {wanted}; {REMEDY}")

    def get(self, key: str) -> object:
        if key not in self.values:
            name = ".".join(part for part in (self.where, key) if part)
            raise CalibrationError(f"{self.source}: key {name!r} is missing; {REMEDY}")
        return self.values[key]

    def table(self, key: str) -> "_Table":
        return _Table(self.get(key), ".".join(part for part in (self.where, key) if part), self.source)

    def integer(self, key: str, low: int, high: int) -> int:
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.wrong(key, value, f"a whole number from {low} to {high}")
        return value

    def number(self, key: str, low: float, high: float) -> float:
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise self.wrong(key, value, f"a number from {low:g} to {high:g}")
        return float(value)

    def text(self, key: str, limit: int) -> str:
        value = self.get(key)
        if not isinstance(value, str) or len(value) > limit:
            raise self.wrong(key, value, f"a text of at most {limit} characters")
        return value

    def array(self, key: str, shapes: tuple[tuple[int, ...], ...], limit: float) -> Points:
        value = self.get(key)
        wanted = f"numbers within ±{limit:g} in the shape {' or '.join('x'.join(map(str, s)) for s in shapes)}"
        if not _numbers(value):
            raise self.wrong(key, value, wanted)
        try:
            array = np.array(value, dtype=np.float64)
        except (ValueError, OverflowError) as error:
            raise self.wrong(key, value, wanted) from error
        if array.shape not in shapes or not np.isfinite(array).all() or (np.abs(array) > limit).any():
            raise self.wrong(key, value, wanted)
        return array

    def rotation(self, key: str) -> Points:
        matrix = self.array(key, ((3, 3),), 1.0 + ROTATION_TOLERANCE)
        if np.abs(matrix @ matrix.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(matrix) < 0.0:
            raise self.wrong(key, self.get(key), "a rotation (orthonormal, determinant +1)")
        return matrix


def _numbers(value: object, depth: int = 0) -> bool:
    """Return whether ``value`` is numbers in at most two levels of lists, short enough to be a matrix of ours."""
    if isinstance(value, list):
        return depth < 2 and len(value) <= 64 and all(_numbers(v, depth + 1) for v in value)  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]  # JSON
    return isinstance(value, int | float) and not isinstance(value, bool)


def from_document(document: object, source: str) -> Calibration:
    """Return the calibration of a ``slabcell.calibration/1`` object; ``source`` names it.  Raises CalibrationError."""
    top = _Table(document, "", source)
    schema = top.get("schema")
    if schema != SCHEMA:
        raise top.wrong("schema", schema, f"{SCHEMA!r}, the one this version reads")
    unknown = sorted(set(top.values) - _KEYS)
    if unknown:
        raise CalibrationError(
            f"{source}: unknown key {unknown[0][:80]!r}; known are {', '.join(sorted(_KEYS))}; {REMEDY}"
        )
    plane = _plane(top.table("plane")) if top.values.get("plane") is not None else None
    hand_eye = _hand_eye(top.table("hand_eye")) if top.values.get("hand_eye") is not None else None
    identity = _identity(top.table("camera"))
    lens = _lens(top.table("lens"), identity)
    if "created" in top.values:
        top.text("created", 100)
    diagnostics = _diagnostics(top.table("diagnostics"), lens) if "diagnostics" in top.values else {}
    return Calibration(identity, lens, plane, diagnostics, hand_eye)


def _diagnostics(table: _Table, lens: Lens) -> dict[str, object]:
    """Return the diagnostics; of them only those are checked that later steps compute with."""
    for key in ("noise_px", "rms_px"):
        if key in table.values:
            table.number(key, 0.0, MAX_RESIDUAL_PX)
    if "covariance" in table.values:
        size = 4 + lens.distortion.size
        covariance = table.array("covariance", ((size, size),), MAX_VARIANCE)
        if (np.diag(covariance) < 0.0).any() or not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-12):
            raise table.wrong("covariance", table.get("covariance"), "symmetric with a diagonal that is not negative")
    return dict(table.values)


def _identity(table: _Table) -> CameraIdentity:
    return CameraIdentity(
        table.integer("width", 1, MAX_SIDE),
        table.integer("height", 1, MAX_SIDE),
        table.text("serial", 200),
        table.integer("offset_x", 0, MAX_SIDE),
        table.integer("offset_y", 0, MAX_SIDE),
        table.integer("binning", 1, 64),
    )


def _lens(table: _Table, identity: CameraIdentity) -> Lens:
    model = table.get("model")
    if model not in ("brown", "fisheye"):
        raise table.wrong("model", model, "'brown' or 'fisheye'")
    matrix = table.array("matrix", ((3, 3),), MAX_FOCAL_PX)
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    shape = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if min(fx, fy) < 1.0 or not 0.2 < fx / fy < 5.0 or not np.array_equal(matrix, shape):
        raise table.wrong(
            "matrix", table.get("matrix"), "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths"
        )
    if abs(cx) > 10 * identity.width or abs(cy) > 10 * identity.height:
        raise table.wrong("matrix", table.get("matrix"), "a matrix with its principal point near the picture")
    lengths = tuple((n,) for n in _LENGTHS["fisheye" if model == "fisheye" else "brown"])
    distortion = table.array("distortion", lengths, MAX_COEFFICIENT)
    return Lens(matrix, distortion, "fisheye" if model == "fisheye" else "brown")


def _plane(table: _Table) -> TablePlane:
    rotation = table.rotation("rotation")
    translation = table.array("translation_mm", ((3,),), MAX_DISTANCE_MM)
    if translation[2] <= 0.0 and (rotation.T @ translation)[2] >= 0.0:
        raise table.wrong("translation_mm", table.get("translation_mm"), "in front of the camera")
    adjustment = table.array("adjustment", ((2, 3),), MAX_DISTANCE_MM) if "adjustment" in table.values else np.eye(2, 3)
    determinant = float(np.linalg.det(adjustment[:, :2]))
    if not 0.5 < determinant < 2.0 or np.abs(adjustment[:, :2] - np.eye(2)).max() > 0.5:
        raise table.wrong("adjustment", table.get("adjustment"), "close to the identity")
    return TablePlane(rotation, translation, adjustment)


def _hand_eye(table: _Table) -> HandEye:
    mount = table.get("mount")
    if mount not in ("eye-to-hand", "eye-in-hand"):
        raise table.wrong("mount", mount, "'eye-to-hand' or 'eye-in-hand'")
    rotation = table.rotation("rotation")
    translation = table.array("translation_mm", ((3,),), MAX_DISTANCE_MM)
    return HandEye("eye-to-hand" if mount == "eye-to-hand" else "eye-in-hand", rotation, translation)
