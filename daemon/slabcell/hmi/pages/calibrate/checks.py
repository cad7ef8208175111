"""Does it still hold?  One picture of the board tells; many of them over time are the drift chart."""

from __future__ import annotations

import csv
import io
from typing import Any, Final

from starlette.responses import Response

from slabcell.hmi.cell_api import Json
from slabcell.hmi.pages.calibrate.wizard import numbers, simulated, usual_board
from slabcell.hmi.route import get, post
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Visit

__all__ = ["ROUTES"]

SHOWN: Final = 200
EXPORTED: Final = 2000
WIDTH, HEIGHT = 600.0, 100.0
SERIES: Final = {
    "corners": ("board", "lens_rms_px", "px", 3),
    "scale": ("board", "scale_ppm", "ppm", 0),
    "lift": ("board", "lift_mm", "mm", 3),
    "tilt": ("board", "tilt_deg", "°", 3),
    "sideways": ("drift", "worst_mm", "mm", 3),
}
COLUMNS: Final = ("check", "at", "calibration", "board_name", "picture", "ok", "fixed", "limit_mm")


def _value(check: Json, name: str) -> float | None:
    part, key, _, _ = SERIES[name]
    return None if check[part] is None else check[part][key]


def _chart(checks: list[Json], name: str) -> dict[str, Any]:
    """Return one series as SVG has it; a check that did not hold, and a change of the calibration, are marked."""
    values = [_value(check, name) for check in checks]
    known = [value for value in values if value is not None]
    _, _, unit, digits = SERIES[name]
    if not known:
        return {"name": name, "unit": unit, "digits": digits, "points": ()}
    low, high = min(0.0, *known), max(0.0, *known)
    if name == "sideways":
        high = max(high, *(check["limit_mm"] for check in checks if check["drift"] is not None))
    span = (high - low) or 1.0
    low, high = low - 0.08 * span, high + 0.08 * span
    step = WIDTH / max(len(values), 1)
    dots = [
        {
            "x": round((n + 0.5) * step, 1),
            "y": round(HEIGHT * (high - value) / (high - low), 1),
            "ok": checks[n]["ok"],
            "value": value,
            "at": checks[n]["at"],
        }
        for n, value in enumerate(values)
        if value is not None
    ]
    changes = [
        round(n * step, 1) for n in range(1, len(checks)) if checks[n]["calibration"] != checks[n - 1]["calibration"]
    ]
    limit = max((check["limit_mm"] for check in checks if check["drift"] is not None), default=None)
    return {
        "name": name,
        "unit": unit,
        "digits": digits,
        "points": dots,
        "line": " ".join(f"{dot['x']},{dot['y']}" for dot in dots),
        "low": low,
        "high": high,
        "last": known[-1],
        "zero": round(HEIGHT * high / (high - low), 1),
        "changes": changes,
        "limit": round(HEIGHT * (high - limit) / (high - low), 1) if name == "sideways" and limit is not None else None,
    }


async def _values(visit: Visit) -> dict[str, Any]:
    checks = (await visit.hmi.api.get("/v1/calibration/checks", limit=SHOWN))["checks"]
    return {"checks": checks, "charts": [_chart(checks, name) for name in SERIES], "tab": "drift"}


async def _page(visit: Visit) -> Response:
    shown = await simulated(visit)
    board, thickness_mm = await usual_board(visit, shown)
    values = {"board": board, "thickness_mm": thickness_mm, "shown": shown, "place": "table", "kind": "plane"}
    return visit.page("drift.html", **values, **await _values(visit))


async def _charts(visit: Visit) -> Response:
    return visit.fragment("charts.html", **await _values(visit))


async def _check(visit: Visit) -> Response:
    api, user = visit.hmi.api, visit.user.name
    body = {
        "board": visit.text("board"),
        "board_thickness_mm": (numbers(visit, "thickness", 1) or [0.0])[0],
        "limit_mm": (numbers(visit, "limit", 1) or [0.2])[0],
        "fixed": visit.text("fixed") == "on",
    }
    await api.post("/v1/frames/take", user=user, key=visit.key())
    done = await api.post("/v1/calibration/check", body, user=user, key=visit.key())
    text = visit.words("holds") if done["ok"] else " ".join(map(visit.words.said, done["problems"]))
    return visit.done(text, "calibration")


async def _export(visit: Visit) -> Response:
    checks = (await visit.hmi.api.get("/v1/calibration/checks", limit=EXPORTED))["checks"]
    out = io.StringIO()
    table = csv.writer(out)
    table.writerow([*COLUMNS, *(f"{name}_{SERIES[name][2]}" for name in SERIES), "problems"])
    for check in checks:
        figures = [_value(check, name) for name in SERIES]
        table.writerow([*(check[name] for name in COLUMNS), *figures, " ".join(check["problems"])])
    headers = {"content-disposition": 'attachment; filename="calibration-checks.csv"'}
    return Response(out.getvalue(), media_type="text/csv", headers=headers)


ROUTES = (
    get("/calibrate/drift", _page, Role.VIEWER),
    get("/calibrate/charts", _charts, Role.VIEWER),
    get("/calibrate/checks.csv", _export, Role.VIEWER),
    post("/calibrate/check", _check, Role.OPERATOR),
)
