"""How are the axes of many poses found in one call?  By compiled C, where the machine could compile it.

Planning asks for every slab of a picture while the robot waits.  Each call in Python takes some tens of microseconds,
and half as much again when the processor has just done something else.
"""

import ctypes
from collections.abc import Sequence
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, Final

from slabcell_drivers.robot.arm import ArmModel, Axes

__all__ = ["LIBRARY", "NativeDescent", "native_library"]

LIBRARY: Final = Path(__file__).with_name("_descent.so")
VERSION: Final = 1
"""As in descent.c: a library of another version is not used."""


@cache
def native_library() -> ctypes.CDLL | None:
    """Return the compiled library; None where there is none, or one of another version."""
    try:
        library = ctypes.CDLL(str(LIBRARY))
        if library.slabcell_descent_version() != VERSION:
            return None
    except (OSError, AttributeError):
        return None
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    library.slabcell_descend.argtypes = (pointer, pointer, integer, integer, pointer, pointer, pointer)
    library.slabcell_descend.restype = integer
    return library


ANY: Final = -1
"""No configuration, in descent.c."""


class NativeDescent:
    """Ways straight down to poses in one base, for one arm and one tool.

    ``flange_in_tool`` are the four columns of that frame, ``base`` the rows of the base in the root frame, ``up`` the
    way from a pose to the one above it in the root frame; lengths in mm.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        arm: ArmModel,
        *,
        flange_in_tool: Sequence[Sequence[float]],
        base: Sequence[Sequence[float]],
        up: Sequence[float],
    ) -> None:
        d = arm.dimensions
        lengths = (d.base_height_mm, d.shoulder_mm, d.upper_arm_mm, d.forearm_x_mm, d.forearm_z_mm, d.flange_mm)
        self._descend: Any = library.slabcell_descend
        self._arm = _doubles([*lengths, *arm.axis_min_deg, *arm.axis_max_deg, *arm.axis_speed_deg_s])
        self._path = _doubles([*chain(*flange_in_tool), *chain(*base), *up])

    def axes(
        self, poses: Sequence[tuple[float, float, float, float]], status: int | None
    ) -> tuple[list[Axes | None], int | None]:
        """Return for each pose the axes at it, got straight down to in the configuration ``status``; and the status.

        A pose is X, Y (mm), A (degrees) and height (mm) of a tool that looks down.  Without a status it is the quickest
        for the first pose that is reached.  None: not reached so.
        """
        number = len(poses)
        axes, reached = (ctypes.c_double * (6 * number))(), (ctypes.c_byte * number)()
        given = ANY if status is None else status
        used: int = self._descend(self._arm, self._path, given, number, _doubles([*chain(*poses)]), axes, reached)
        found = iter(axes[:])
        each = [
            (a1, a2, a3, a4, a5, a6) if got else None
            for got, a1, a2, a3, a4, a5, a6 in zip(reached, *[found] * 6, strict=True)
        ]
        return each, None if used == ANY else used


def _doubles(values: Sequence[float]) -> Any:
    return (ctypes.c_double * len(values))(*values)
