"""May tool and slab be where a part is picked and laid?  The pick area and the forbidden zones of the configuration."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from slabcell.catalogue import Fault
from slabcell.cell.settings import CellSettings
from slabcell.geometry import Polygon
from slabcell.vision.result import LocatedPart

__all__ = ["Refusal", "Workspace"]


@dataclass(frozen=True, slots=True)
class Refusal:
    """A part that was located and is not laid, and why."""

    slot: int
    fault: Fault
    detail: str


class Workspace:
    """The areas of one cell and one template; what does not change from picture to picture is computed once."""

    def __init__(self, slots: Sequence[Polygon], settings: CellSettings) -> None:
        self._pick_area = settings.pick_area.shape
        shapely.prepare(self._pick_area)
        self._to_table = settings.assembly_in_table
        self._zones = [(zone.shape, zone.shape.buffer(settings.gripper_radius_mm)) for zone in settings.forbidden]
        for zone, grown in self._zones:
            shapely.prepare(zone)
            shapely.prepare(grown)
        self._outlines = [slot.transformed(self._to_table).shape for slot in slots] if self._zones else []

    def refusals(self, parts: Sequence[LocatedPart]) -> list[Refusal | None]:
        """Return for each part why tool or slab would be where they must not, or None."""
        x = np.array([part.pick.x_mm for part in parts])
        y = np.array([part.pick.y_mm for part in parts])
        inside = shapely.intersects_xy(self._pick_area, x, y).tolist()
        return [
            self._in_zone(part) if within else self._outside(part) for part, within in zip(parts, inside, strict=True)
        ]

    def _outside(self, part: LocatedPart) -> Refusal:
        detail = f"the grasp point at {_where(part)} is outside of the pick area"
        return Refusal(part.slot, Fault.OUTSIDE_WORKSPACE, detail)

    def _in_zone(self, part: LocatedPart) -> Refusal | None:
        if not self._zones:
            return None
        x, y = part.pick.x_mm, part.pick.y_mm
        u, v = (float(value) for value in self._to_table.apply(np.array([part.place.x_mm, part.place.y_mm])))
        for number, (zone, grown) in enumerate(self._zones, start=1):
            if shapely.contains_xy(grown, x, y):
                detail = f"the tool at {_where(part)} is in forbidden zone {number}"
                return Refusal(part.slot, Fault.OUTSIDE_WORKSPACE, detail)
            if shapely.contains_xy(grown, u, v) or zone.intersects(self._outlines[part.slot]):
                return Refusal(part.slot, Fault.COLLISION, f"slot {part.slot} lies in forbidden zone {number}")
        return None


def _where(part: LocatedPart) -> str:
    return f"X {part.pick.x_mm:.1f} Y {part.pick.y_mm:.1f} of the table"
