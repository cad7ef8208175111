"""How was it laid?  The as-built report of one job: each slab against its slot, as JSON, CSV and picture.

Placed minus nominal, in the assembly frame.  The gap of a slab is the distance to the nearest other one as they lie;
touching and overlapping slabs have the gap 0.
"""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from slabcell.cell.records import PlacementRecord
from slabcell.cell.settings import CellSettings
from slabcell.geometry import Polygon, RigidTransform2D

__all__ = ["SCHEMA", "AsBuilt", "SlabAsBuilt"]

SCHEMA = "slabcell.as-built/1"
COLUMNS = ("slot", "verdict", "dx_mm", "dy_mm", "da_deg", "residual_mm", "gap_mm")
EXAGGERATION = 20.0
"""The picture shows deviations enlarged: a tenth of a millimetre could not be seen otherwise."""


@dataclass(frozen=True, slots=True)
class SlabAsBuilt:
    """One slot: what was measured, what that means (``ok``, ``out_of_tolerance``, ``missing``, ``not_measured``)."""

    placement: PlacementRecord
    verdict: str
    gap_mm: float | None


@dataclass(frozen=True, slots=True)
class AsBuilt:
    """The whole job, slot by slot."""

    slots: tuple[Polygon, ...]
    slabs: tuple[SlabAsBuilt, ...]
    tolerance_mm: float
    tolerance_deg: float

    @classmethod
    def of(cls, slots: Sequence[Polygon], placements: Sequence[PlacementRecord], settings: CellSettings) -> "AsBuilt":
        """Return the report of what was measured."""
        lying = {item.slot: _as_laid(slots[item.slot], item).shape for item in placements if item.is_measured}
        slabs: list[SlabAsBuilt] = []
        for item in sorted(placements, key=lambda placement: placement.slot):
            others = [shape for slot, shape in lying.items() if slot != item.slot]
            gap = None
            if item.slot in lying and others:
                gap = float(min(lying[item.slot].distance(other) for other in others))
            slabs.append(SlabAsBuilt(item, _verdict(item, settings), gap))
        return cls(tuple(slots), tuple(slabs), settings.tolerance_mm, settings.tolerance_deg)

    @property
    def mean_shift_mm(self) -> tuple[float, float] | None:
        """The mean of dx and of dy, which is what a base that is taught wrongly shows; None if nothing is measured."""
        measured = [slab.placement for slab in self.slabs if slab.placement.is_measured]
        if not measured:
            return None
        return float(np.mean([item.dx_mm for item in measured])), float(np.mean([item.dy_mm for item in measured]))

    def to_document(self, job_id: int, recipe: str) -> dict[str, object]:
        """Return the ``slabcell.as-built/1`` object."""
        return {
            "schema": SCHEMA,
            "job": job_id,
            "recipe": recipe,
            "tolerance_mm": self.tolerance_mm,
            "tolerance_deg": self.tolerance_deg,
            "ok": all(slab.verdict == "ok" for slab in self.slabs) and len(self.slabs) == len(self.slots),
            "mean_shift_mm": self.mean_shift_mm,
            "slots": [dict(zip(COLUMNS, self._row(slab), strict=True)) for slab in self.slabs],
        }

    def to_csv(self) -> str:
        """Return a table with one line a slot."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for slab in self.slabs:
            writer.writerow(["" if value is None else value for value in self._row(slab)])
        return stream.getvalue()

    def to_svg(self) -> str:
        """Return a picture: slots in grey, slabs as they lie with their deviation enlarged, X to the right, Y up.

        What is drawn lies within the picture, however far a slab is off; words tell what is not in order.
        """
        drawn = {
            slab.placement.slot: self._enlarged(slab.placement) for slab in self.slabs if slab.placement.is_measured
        }
        x0, y0, x1, y1 = shapely.MultiPolygon([slot.shape for slot in self.slots]).bounds
        size = 0.03 * max(x1 - x0, y1 - y0)
        around = shapely.GeometryCollection([slot.shape for slot in (*self.slots, *drawn.values())]).bounds
        left, bottom, right, top = (
            around[0] - 2.0 * size,
            around[1] - 3.0 * size,
            around[2] + 2.0 * size,
            around[3] + size,
        )
        words = f"As built; deviations enlarged {EXAGGERATION:.0f} times"
        box = f"{left:.2f} {-top:.2f} {right - left:.2f} {top - bottom:.2f}"
        font = f'font-family="sans-serif" font-size="{size:.2f}"'
        lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" {font}>',
            f"<title>{words}</title>",
            f'<text x="{left + size:.2f}" y="{-bottom - size:.2f}">{words}</text>',
        ]
        lines += [_path(slot, "#e4e4e4", "#b0b0b0") for slot in self.slots]
        for slab in self.slabs:
            slot = slab.placement.slot
            if slot in drawn:
                lines.append(_path(drawn[slot], "none", "#202020" if slab.verdict == "ok" else "#c00000"))
            lines += _label(self.slots[slot], slab, size)
        return "\n".join([*lines, "</svg>", ""])

    def _enlarged(self, item: PlacementRecord) -> Polygon:
        """Return the slab's outline with its deviation enlarged."""
        shift = (EXAGGERATION * item.dx_mm, EXAGGERATION * item.dy_mm, EXAGGERATION * item.da_deg)
        return _as_laid(self.slots[item.slot], PlacementRecord(item.slot, item.found, *shift, item.residual_mm))

    def _row(self, slab: SlabAsBuilt) -> list[object]:
        item = slab.placement
        numbers = (item.dx_mm, item.dy_mm, item.da_deg, item.residual_mm, slab.gap_mm)
        rounded = [None if value is None or not math.isfinite(value) else round(value, 4) for value in numbers]
        return [item.slot, slab.verdict, *rounded]


def _label(slot: Polygon, slab: SlabAsBuilt, size: float) -> list[str]:
    """Return the number of a slot, and below it what is wrong there, in its middle."""
    item, (x, y) = slab.placement, slot.centroid
    words = [str(item.slot)]
    if slab.verdict == "out_of_tolerance":
        words += [f"{item.dx_mm:+.2f} {item.dy_mm:+.2f} mm", f"{item.da_deg:+.2f}°"]
    elif slab.verdict != "ok":
        words.append(slab.verdict.replace("_", " "))
    step = 1.1 * size
    first = 0.35 * size - y - step * (len(words) - 1) / 2  # a letter's middle is a third of its height above its line
    return [
        f'<text x="{x:.2f}" y="{first + step * line:.2f}" text-anchor="middle">{word}</text>'
        for line, word in enumerate(words)
    ]


def _verdict(item: PlacementRecord, settings: CellSettings) -> str:
    if not item.found:
        return "missing"
    if not item.is_measured:
        return "not_measured"
    inside = (
        max(abs(item.dx_mm), abs(item.dy_mm)) <= settings.tolerance_mm and abs(item.da_deg) <= settings.tolerance_deg
    )
    return "ok" if inside else "out_of_tolerance"


def _as_laid(slot: Polygon, item: PlacementRecord) -> Polygon:
    """Return the slab's outline: turned about the middle of its slot, then shifted."""
    middle = slot.centroid
    x, y = middle + np.array([item.dx_mm, item.dy_mm]) - RigidTransform2D(item.da_deg, 0.0, 0.0).apply(middle)
    return slot.transformed(RigidTransform2D(item.da_deg, float(x), float(y)))


def _path(polygon: Polygon, fill: str, stroke: str) -> str:
    points = " ".join(f"{x:.3f},{-y:.3f}" for x, y in polygon.vertices)
    return f'<polygon points="{points}" fill="{fill}" stroke="{stroke}" vector-effect="non-scaling-stroke"/>'
