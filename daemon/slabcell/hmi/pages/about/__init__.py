"""Which versions run here, and under which licences?"""

from __future__ import annotations

import platform
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageMetadata, distributions

from starlette.responses import Response

from slabcell import __version__
from slabcell.hmi.route import Page, get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Visit

__all__ = ["PAGE"]

VENDORED = (("htmx", "2.0.11", "0BSD"),)


@dataclass(frozen=True, slots=True, order=True)
class Component:
    """One package that runs here."""

    name: str
    version: str
    licence: str


@cache
def components() -> tuple[Component, ...]:
    """Return every package of this installation, by name."""
    found = {Component(*vendored) for vendored in VENDORED}
    for item in distributions():
        metadata = item.metadata
        found.add(Component(metadata["Name"], item.version, _licence(metadata)))
    return tuple(sorted(found, key=lambda component: component.name.lower()))


def _licence(metadata: PackageMetadata) -> str:
    """Return the licence as the package names it: an SPDX expression, a classifier, or its own short words."""
    named = metadata.get_all("License-Expression") or []
    if named:
        return str(named[0])
    classes = [
        line.rpartition("::")[2].strip()
        for line in metadata.get_all("Classifier") or []
        if line.startswith("License ::") and line.count("::") > 1
    ]
    if classes:
        return ", ".join(classes)
    words = str((metadata.get_all("License") or [""])[0]).strip().partition("\n")[0]
    return words[:60] or "–"


async def _page(visit: Visit) -> Response:
    return visit.page(
        "about.html",
        version=__version__,
        python=platform.python_version(),
        system=f"{platform.system()} {platform.release()} ({platform.machine()})",
        components=components(),
    )


PAGE = Page("about", "/about", Role.VIEWER, 100, (get("/about", _page, Role.VIEWER),))
