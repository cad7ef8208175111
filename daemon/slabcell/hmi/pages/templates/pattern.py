"""How is a template drawn with everything that is found about it?  SVG in the assembly's millimetres, Y upwards."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from slabcell.hmi.cell_api import Json
from slabcell.hmi.drawing import Drawing, draw_template
from slabcell.hmi.words import PageWords

__all__ = ["Finding", "Pattern", "draw_pattern"]

Outline = Sequence[Sequence[float]]

_PLACES: Final[tuple[tuple[str, re.Pattern[str]], ...]] = (
    ("entity_point", re.compile(r"entity (?P<entity>\S+) on layer (?P<layer>.*): point (?P<point>\d+)")),
    ("entity", re.compile(r"entity (?P<entity>\S+) on layer (?P<layer>.*)")),
    ("cell", re.compile(r"(?P<line>\d+): column (?P<column>\d+ \(\w+\))")),
    ("column", re.compile(r"column (?P<column>\d+ \(\w+\))")),
    ("line", re.compile(r"(?:line )?(?P<line>\d+)")),
    ("point", re.compile(r"point (?P<point>\d+)")),
)
"""Places in files, as the daemon writes them."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding: its words, and where it is; ``x`` and ``y`` are None where that is not known."""

    number: int
    advice: bool
    place: str
    text: str
    x: float | None
    y: float | None
    outlines: tuple[str, ...]
    box: str
    """The view box around its place; empty if there is none."""


@dataclass(frozen=True, slots=True)
class Pattern:
    """A template and its findings, drawn; without slots there may be outlines of findings alone, or nothing."""

    drawing: Drawing | None
    names: tuple[str, ...]
    findings: tuple[Finding, ...]
    mark: float
    """Radius of a finding's mark, mm."""

    @property
    def faults(self) -> int:
        """How many findings keep it from being used."""
        return sum(not item.advice for item in self.findings)


def draw_pattern(words: PageWords, found: Json) -> Pattern:
    """Return a template's check as it is shown."""
    outlines: list[Outline] = [slot["outline_mm"] for slot in found["slots"]]
    about: list[Outline] = [outline for item in found["findings"] for outline in item["outlines_mm"] if outline]
    everything = [*outlines, *about]
    drawing = draw_template(everything, None, words("pattern")) if everything else None
    if drawing is not None:  # what findings are about widens the picture, but is no slot
        drawing = Drawing(drawing.view_box, drawing.text, drawing.hatch, drawing.slots[: len(outlines)], drawing.label)
    size = max(map(float, drawing.view_box.split()[2:])) if drawing else 1.0
    mark = round(size / 45, 3)
    findings: list[Finding] = []
    taken: dict[tuple[float, float], int] = {}
    for number, item in enumerate(found["findings"], start=1):
        finding = _finding(words, number, item, size)
        if finding.x is not None and finding.y is not None and finding.advice and drawing is not None:
            # The number of a slot stands there already: above it, one mark beside the other.
            beside = taken[finding.x, finding.y] = taken.get((finding.x, finding.y), -1) + 1
            x, y = finding.x + 2.3 * mark * beside, finding.y - 0.75 * drawing.text - mark
            finding = replace(finding, x=round(x, 3), y=round(y, 3))
        findings.append(finding)
    return Pattern(drawing, tuple(slot["name"] for slot in found["slots"]), tuple(findings), mark)


def _finding(words: PageWords, number: int, item: Json, size: float) -> Finding:
    outlines = [outline for outline in item["outlines_mm"] if outline]
    at = item["at_mm"]
    box = ""
    if at is not None:
        points = [at, *(point for outline in outlines for point in outline)]
        xs, ys = [point[0] for point in points], [-point[1] for point in points]
        span = max(max(xs) - min(xs), max(ys) - min(ys), 0.12 * size) * 1.3
        box = f"{(min(xs) + max(xs) - span) / 2:.3f} {(min(ys) + max(ys) - span) / 2:.3f} {span:.3f} {span:.3f}"
    return Finding(
        number,
        bool(item["advice"]),
        _place(words, item["place"]),
        words.maybe(f"finding.{item['kind']}", item["text"].replace("{", "(").replace("}", ")")).format(
            **_values(words, item["values"])
        ),
        at[0] if at else None,
        -at[1] if at else None,
        tuple(" ".join(f"{x:.3f},{-y:.3f}" for x, y in outline) for outline in outlines),
        box,
    )


def _values(words: PageWords, values: Mapping[str, Any]) -> dict[str, str]:
    shown: dict[str, str] = {}
    for name, value in values.items():
        if isinstance(value, float):
            shown[name] = words.number(value, 2).rstrip("0").rstrip(".,") if value else "0"
        elif name.endswith("place"):
            shown[name] = _place(words, value)
        else:
            shown[name] = words.said(str(value)) if name == "detail" else str(value)
    return shown


def _place(words: PageWords, place: str) -> str:
    """Return a place in a file in the page's language."""
    for kind, pattern in _PLACES:
        if found := pattern.fullmatch(place):
            return words(f"place.{kind}", **found.groupdict())
    return place
