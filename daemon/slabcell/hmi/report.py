"""How does a person read what a run laid?  One self-contained HTML page made from its result document.

The page follows high-performance HMI rules: grey where all is well, colour only for what is not, and never colour
alone.
"""

import base64
from collections.abc import Mapping
from importlib.resources import files

import jinja2

__all__ = ["render_report"]


def render_report(document: Mapping[str, object], pictures: Mapping[str, bytes]) -> str:
    """Return the page of a ``slabcell.demo/1`` document; ``pictures`` maps a caption to PNG or JPEG bytes."""
    room = files("slabcell.hmi")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    page = environment.from_string((room / "report.html").read_text(encoding="utf-8"))
    style = (room / "static" / "report.css").read_text(encoding="utf-8")
    return page.render(run=document, style=style, pictures={name: _data_url(raw) for name, raw in pictures.items()})


def _data_url(raw: bytes) -> str:
    kind = "png" if raw.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(raw).decode('ascii')}"
