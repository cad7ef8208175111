"""How well does a slab lie in its slot?  Measured geometrically on the truth, never through the camera."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import shapely

from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.simulation.slab import Slab

__all__ = ["Placement", "congruences", "measure_placements"]

Points = npt.NDArray[np.float64]
Motion = npt.NDArray[np.float64]
"""A rigid motion of the plane as a homogeneous matrix, shape (3, 3)."""


@dataclass(frozen=True, slots=True)
class Placement:
    """One slot, and the slab of its shape that lies in or near it.

    ``dx_mm`` and ``dy_mm`` say how far the slab's matter is from where it should be at the slot's centroid, along the
    assembly frame's axes; ``dtheta_deg`` is its excess rotation.  Without a slab they are nan.  ``filled`` is true if
    the slab lies level on the table and no corner of it is further than the limit from its nominal place.
    """

    slot: int
    slab: int | None
    dx_mm: float
    dy_mm: float
    dtheta_deg: float
    filled: bool


def measure_placements(
    slabs: Sequence[Slab],
    slots: Sequence[Points],
    assembly: Frame,
    *,
    limit_mm: float = 5.0,
    tolerance_mm: float = 0.05,
) -> tuple[Placement, ...]:
    """Return one placement for each slot, in order; a slab is counted for one slot only.

    ``slots`` are vertices, shape (n, 2), in the assembly frame; ``assembly`` is that frame in the root.  A slab suits a
    slot if a rigid motion (no mirror image) takes its nominal corners to the slot's within ``tolerance_mm``.
    """
    to_assembly = _planar(assembly.inverse())
    found: list[tuple[float, int, int, Placement]] = []
    for slot, vertices in enumerate(slots):
        wanted = np.asarray(vertices, np.float64)
        centre = np.asarray(shapely.Polygon(wanted).centroid.coords)[0]
        for slab in slabs:
            nominal = slab.nominal if len(slab.nominal) else slab.body
            actual = to_assembly @ _planar(slab.frame)
            for ideal in congruences(nominal, wanted, tolerance_mm):
                error = actual @ np.linalg.inv(ideal)
                worst = float(np.max(np.linalg.norm(_apply(error, wanted) - wanted, axis=1)))
                dx, dy = _apply(error, centre[None])[0] - centre
                turn = float(np.rad2deg(np.arctan2(error[1, 0], error[0, 0])))
                filled = worst <= limit_mm and abs(slab.bottom_mm) <= 1.0
                found.append(
                    (worst, slot, slab.number, Placement(slot, slab.number, float(dx), float(dy), turn, filled))
                )
    found.sort(key=lambda item: item[:3])
    chosen: dict[int, Placement] = {}
    used: set[int] = set()
    for _, slot, number, placement in found:
        if slot not in chosen and number not in used:
            chosen[slot] = placement
            used.add(number)
    empty = float("nan")
    return tuple(
        chosen.get(slot, Placement(slot, None, empty, empty, empty, filled=False)) for slot in range(len(slots))
    )


def congruences(body: Points, target: Points, tolerance_mm: float) -> list[Motion]:
    """Return every rigid motion that takes the corners of ``body`` to those of ``target`` within the tolerance."""
    if len(body) != len(target):
        return []
    found: list[Motion] = []
    target = _counter_clockwise(target)
    body = _counter_clockwise(body)
    for shift in range(len(body)):
        motion = _fit(np.roll(body, shift, axis=0), target)
        if np.max(np.abs(_apply(motion, np.roll(body, shift, axis=0)) - target)) <= tolerance_mm:
            found.append(motion)
    return found


def _fit(source: Points, target: Points) -> Motion:
    """Return the rotation and translation with the least squared error from points to points."""
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    one, other = _complex(source - middle), _complex(target - goal)
    angle = float(np.angle(complex(np.vdot(one, other))))
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    motion = np.eye(3)
    motion[:2, :2] = rotation
    motion[:2, 2] = goal - rotation @ middle
    return motion


def _complex(points: Points) -> npt.NDArray[np.complex128]:
    return points[:, 0] + 1j * points[:, 1]


def _planar(frame: Frame) -> Motion:
    angle = np.deg2rad(frame.a_deg)
    return np.array(
        [
            [np.cos(angle), -np.sin(angle), frame.x_mm],
            [np.sin(angle), np.cos(angle), frame.y_mm],
            [0.0, 0.0, 1.0],
        ]
    )


def _apply(motion: Motion, points: Points) -> Points:
    return points @ motion[:2, :2].T + motion[:2, 2]


def _counter_clockwise(points: Points) -> Points:
    x, y = points.T
    return points if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) > 0 else points[::-1]
