"""What is fixed about one cell?  Bases, tool, areas, tolerances and deadlines; part of the cell's configuration."""

from dataclasses import dataclass

import numpy as np

from slabcell.errors import ConfigurationError
from slabcell.geometry import Polygon, RigidTransform2D
from slabcell_drivers.robot.frame import Frame

__all__ = ["CellSettings"]

LEVEL_TOLERANCE_DEG = 0.05  # over 500 mm this is less than half a millimetre of height


@dataclass(frozen=True, slots=True)
class CellSettings:
    """The cell as it is built.

    ``pick_base`` (the table frame) and ``place_base`` (the assembly frame) lie in the robot's root frame, ``tool`` is
    the tool centre point in the flange's frame.  ``pick_area`` and the ``forbidden`` zones are in table coordinates:
    outside of the one nothing is picked, into the others neither tool nor slab is lowered.  A pose is approached and
    left straight from ``approach_mm`` above.  Before a job begins, its slots are looked at: nothing is laid onto slabs
    that lie there still (``check_assembly_is_empty``).  With ``correct_systematic`` a job is laid the other way by what
    the last one of its template was off as a whole, at most by the tolerance.
    """

    pick_base: Frame
    place_base: Frame
    tool: Frame
    pick_area: Polygon
    forbidden: tuple[Polygon, ...] = ()
    gripper_radius_mm: float = 10.0
    approach_mm: float = 80.0
    tolerance_mm: float = 0.5
    tolerance_deg: float = 0.5
    attempts_per_slot: int = 3
    check_assembly_is_empty: bool = True
    correct_systematic: bool = False
    camera_timeout_s: float = 2.0
    vision_timeout_s: float = 10.0
    busy_timeout_s: float = 5.0

    def __post_init__(self) -> None:
        """Raise ConfigurationError unless table and assembly are level with each other."""
        tilt = self._assembly_in_pick_base()
        if max(abs(tilt.b_deg), abs(tilt.c_deg)) > LEVEL_TOLERANCE_DEG:
            msg = (
                f"pick base and place base are tilted against each other by B {tilt.b_deg:.3f}°, C {tilt.c_deg:.3f}°;"
                f" at most {LEVEL_TOLERANCE_DEG}° are allowed: measure the bases again"
            )
            raise ConfigurationError(msg)

    def _assembly_in_pick_base(self) -> Frame:
        return self.pick_base.inverse() @ self.place_base

    @property
    def assembly_in_table(self) -> RigidTransform2D:
        """Takes assembly coordinates to table coordinates."""
        frame = self._assembly_in_pick_base()
        return RigidTransform2D(frame.a_deg, frame.x_mm, frame.y_mm)

    @property
    def assembly_height_mm(self) -> float:
        """How far the assembly's plane lies above the table's."""
        height = self._assembly_in_pick_base().z_mm
        return 0.0 if abs(height) < 1e-9 else float(np.float64(height))
