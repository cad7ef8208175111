"""How does a page become HTML?  Jinja2 with escaping, strict about what is missing."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

import jinja2
from markupsafe import Markup

from slabcell.hmi.static_files import static_files

if TYPE_CHECKING:
    from slabcell.hmi.visit import Visit

__all__ = ["ROOM", "render"]

ROOM: Final = Path(__file__).parent


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(ROOM),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    cast("dict[str, object]", environment.globals)["static"] = static_url
    environment.filters["json"] = _json
    return environment


def static_url(name: str) -> str:
    """Return the address of a static file."""
    return static_files().url(name)


def _json(value: object) -> Markup:
    """Return a value as JSON that may stand in HTML."""
    text = json.dumps(value, ensure_ascii=True)
    for sign in "<>&'":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)  # noqa: S704 - escaped above


def render(visit: Visit, template: str, values: Mapping[str, object]) -> str:
    """Return the HTML of a template; ``template`` is relative to this folder."""
    return _environment().get_template(template).render({**visit.globals(), **values})
