"""How good is a calibration?  The figures that its file has kept from the day it was made."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import cast

from pydantic import Field

from slabcell.calibration import Calibration
from slabcell.service.api.documents import Document

__all__ = ["FiguresDocument", "figures_of"]


class FiguresDocument(Document):
    """What is known of a calibration; null for what its file does not say."""

    board: str
    lens_model: str
    views: int | None = Field(description="pictures that the lens was made from, those left out included")
    rms_px: float | None
    holdout_px: float | None = Field(description="residual of views in a lens that was found without them")
    focal_px: float
    focal_std_px: float | None
    covered: float | None = Field(description="part of the picture inside the hull of all points, 0 to 1")
    plane_views: int | None
    plane_rms_px: float | None
    touched: int | None = Field(description="points that the robot touched")
    touch_residual_mm: float | None
    touch_holdout_mm: float | None
    mount: str
    stations: int | None
    hand_eye_holdout_px: float | None
    hand_eye_holdout_mm: float | None
    hand_eye_spread_mm: float | None = Field(description="of the camera's place over resampled stations, 1 std")
    warnings: list[str]


def figures_of(calibration: Calibration) -> FiguresDocument:
    """Return the figures; the diagnostics of a file are anybody's, so nothing is taken for granted."""
    said = calibration.diagnostics
    plane, hand_eye = _table(said, "plane"), _table(said, "hand_eye")
    touch = _table(plane, "touch")
    return FiguresDocument(
        board=_text(said, "board"),
        lens_model=_text(said, "lens_model") or calibration.lens.model,
        views=_count(said, "views"),
        rms_px=_number(said, "rms_px"),
        holdout_px=_number(said, "holdout_px"),
        focal_px=float(calibration.lens.matrix[0, 0]),
        focal_std_px=_number(_table(said, "std"), "fx"),
        covered=_number(_table(said, "coverage"), "hull_fraction"),
        plane_views=_count(plane, "views"),
        plane_rms_px=_number(plane, "rms_px"),
        touched=_count(touch, "points"),
        touch_residual_mm=_number(touch, "residual_mm"),
        touch_holdout_mm=_number(touch, "holdout_mm"),
        mount=calibration.hand_eye.mount if calibration.hand_eye else "",
        stations=_count(hand_eye, "stations"),
        hand_eye_holdout_px=_number(hand_eye, "holdout_px"),
        hand_eye_holdout_mm=_number(hand_eye, "holdout_mm"),
        hand_eye_spread_mm=_number(hand_eye, "spread_mm"),
        warnings=[line for part in (said, plane, hand_eye) for line in _texts(part, "warnings")],
    )


def _table(said: Mapping[str, object], key: str) -> Mapping[str, object]:
    value = said.get(key)
    return cast("Mapping[str, object]", value) if isinstance(value, dict) else {}


def _number(said: Mapping[str, object], key: str) -> float | None:
    value = said.get(key)
    usable = isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
    return float(cast("float", value)) if usable else None


def _text(said: Mapping[str, object], key: str) -> str:
    value = said.get(key)
    return value[:200] if isinstance(value, str) else ""


def _count(said: Mapping[str, object], key: str) -> int | None:
    value = said.get(key)
    return len(cast("list[object]", value)) if isinstance(value, list) else None


def _texts(said: Mapping[str, object], key: str) -> list[str]:
    value = said.get(key)
    items = cast("list[object]", value) if isinstance(value, list) else []
    return [item[:500] for item in items[:100] if isinstance(item, str)]
