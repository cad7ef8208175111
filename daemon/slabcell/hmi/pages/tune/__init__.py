"""Parameters of the vision: try them on pictures, see what every stage makes of them, and apply what passes."""

from __future__ import annotations

from starlette.responses import Response

from slabcell.hmi.pages.tune import recipes, trying
from slabcell.hmi.pages.tune.form import TABLES, form_document, form_fields, option_words
from slabcell.hmi.pages.tune.stages import STAGES
from slabcell.hmi.route import Page, get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Visit

__all__ = ["PAGE"]

BUFFERS = ("input", "undistorted", "mask", "blobs", "contours", "residuals")
WORDS = (
    *("busy", "running", "none_yet", "refused_picture", "found_line", "time_line", "problem", "not_reached"),
    *(
        "add",
        "remove",
        "reset",
        "add_point",
        "draw",
        "drawing",
        "clear_points",
        "corner",
        "whole_picture",
        "range",
        "from",
    ),
    *("to", "above", "unset", "yes", "no", "changed", "active_value", "handle.threshold", "handle.low", "handle.high"),
    *("handle.level", "handle.soft_low", "handle.soft_high", "level_found", "no_level", "take_level", "grey", "pixels"),
    *("no_changes", "template_changed", "checking", "passed", "passed_nothing", "not_passed", "check_again", "applied"),
    *(
        "is_active",
        "undo",
        "set.stored",
        "set.graded",
        "set.cycles",
        "empty_set",
        "kept",
        "whiskers",
        "no_edge",
        "point",
    ),
    *("points", "row.found", "row.refused", "no_parts", "gate.brightness"),
    *("gate.overexposed", "gate.blur", "gate.reference_seen", "gate.reference_shift"),
)
"""What the scripts of the page say."""


async def _page(visit: Visit) -> Response:
    api = visit.hmi.api
    schema = (await api.get("/v1/recipes/schema"))["json_schema"]
    found = (await api.get("/v1/recipes"))["recipes"]
    reasons = (
        "too_small",
        "touches_border",
        "no_slot_fits",
        "slot_taken",
        "touching",
        "unsure",
        "no_grasp",
        "filtered",
    )
    language = visit.words.language
    fields = [field for table in TABLES for field in form_fields(schema, table, language)]
    return visit.page(
        "tune.html",
        form=form_document(schema, language),
        recipes=[item for item in found if not item["problem"]],
        active=next((item["name"] for item in found if item["active"]), ""),
        stages=STAGES,
        tables=TABLES,
        buffers=BUFFERS,
        script_words={key: visit.words(key) for key in WORDS}
        | {f"reason.{name}": visit.words(f"reason.{name}") for name in reasons}
        | {f"option.{name}": text for name, text in option_words(fields, language).items()},
    )


PAGE = Page("tune", "/tune", Role.ENGINEER, 30, (get("/tune", _page, Role.ENGINEER), *trying.ROUTES, *recipes.ROUTES))
