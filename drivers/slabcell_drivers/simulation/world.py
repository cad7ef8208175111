"""What is true in the simulated cell?  Where every slab is, and what the gripper holds.

Slabs move only when the gripper carries them.  The world knows nothing of pictures, templates or results; it may be
asked for its truth by whoever measures.  One thread changes it; `slabs` may be read from any.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
import numpy.typing as npt
import shapely

from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.simulation.layout import strew
from slabcell_drivers.simulation.placement import Placement, measure_placements
from slabcell_drivers.simulation.scene import Scene
from slabcell_drivers.simulation.slab import Slab

__all__ = ["Event", "EventKind", "GripperFaults", "World", "strewn_slabs"]

Points = npt.NDArray[np.float64]

FACE_TOLERANCE_MM = 1.0  # how far from the upper face the cup still seals
TILT_TOLERANCE_DEG = 2.0
DROP_MM = 3.0  # released higher than this above what is below, a slab falls and lands anywhere near
OVERLAP_MM = 0.5  # outlines may run into one another this far before one slab lies on the other


class EventKind(StrEnum):
    """What happened to a slab, or did not."""

    GRIPPED = "gripped"
    MISSED = "missed"
    RELEASED = "released"
    DROPPED = "dropped"
    STACKED = "stacked"
    CRUSHED = "crushed"
    COLLIDED = "collided"


@dataclass(frozen=True, slots=True)
class Event:
    """One entry of the world's log; ``slab`` is None if none was concerned."""

    kind: EventKind
    slab: int | None
    tcp: Frame
    detail: str = ""


@dataclass(frozen=True, slots=True)
class GripperFaults:
    """Imperfections of the gripper; all zero is a perfect one.

    ``slip_mm`` and ``twist_deg`` are standard deviations of how the slab shifts on the cup when it is gripped,
    ``miss_rate`` is the share of grips that fail though the cup sits well.
    """

    slip_mm: float = 0.0
    twist_deg: float = 0.0
    miss_rate: float = 0.0


@dataclass(slots=True)
class _Held:
    number: int
    tcp_from_slab: Frame
    struck: set[int] = field(default_factory=set[int])


class World:
    """The truth of one simulated cell.  Poses of the tool are of the cup's tip, in the robot's root frame."""

    def __init__(
        self,
        scene: Scene,
        seed: int = 0,
        *,
        slabs: Sequence[Slab] | None = None,
        faults: GripperFaults | None = None,
    ) -> None:
        """Begin with the scene's slabs strewn by the seed, or with given ones, numbered from 0 in their order."""
        self.scene = scene
        self.seed = seed
        self.faults = faults or GripperFaults()
        self._random = np.random.default_rng([seed, 77])
        self._slabs = strewn_slabs(scene, seed) if slabs is None else _numbered(slabs)
        self._obstructions: tuple[Slab, ...] = ()
        self._held: _Held | None = None
        self._vacuum = False
        self._events: list[Event] = []
        self._pick_counts = [0] * len(self._slabs)

    @property
    def slabs(self) -> tuple[Slab, ...]:
        """Every slab as it is now; an immutable snapshot."""
        return self._slabs

    @property
    def obstructions(self) -> tuple[Slab, ...]:
        """What else is in the camera's view."""
        return self._obstructions

    def obstruct(self, *bodies: Slab) -> None:
        """Bring bodies that are no slabs into the view, in the place of those that were there; none clears it."""
        self._obstructions = bodies

    @property
    def vacuum(self) -> bool:
        """True while the cup holds a slab: what a vacuum switch would say."""
        return self._held is not None

    @property
    def suction(self) -> bool:
        """True while the ejector is on, whether it holds anything or not."""
        return self._vacuum

    @property
    def held(self) -> int | None:
        """Number of the slab on the cup."""
        return None if self._held is None else self._held.number

    @property
    def pick_counts(self) -> tuple[int, ...]:
        """How often each slab has been gripped."""
        return tuple(self._pick_counts)

    @property
    def events(self) -> tuple[Event, ...]:
        """The log, oldest first."""
        return tuple(self._events)

    def grip(self, tcp: Frame) -> bool:
        """Switch the vacuum on; return whether the cup now holds a slab.

        It does if the tool points down and the whole cup lies on one slab's upper face.  A cup that already holds
        keeps its slab.
        """
        self._vacuum = True
        if self._held is not None:
            return True
        slab, detail = self._below(tcp)
        if slab is not None and self._random.random() < self.faults.miss_rate:
            slab, detail = None, "the cup did not seal"
        if slab is None:
            self._events.append(Event(EventKind.MISSED, None, tcp, detail))
            return False
        slip = self._random.standard_normal(3) * (self.faults.slip_mm, self.faults.slip_mm, self.faults.twist_deg)
        slipped = Frame(float(slip[0]), float(slip[1]), 0.0, float(slip[2]), 0.0, 0.0)
        self._held = _Held(slab.number, slipped @ tcp.inverse() @ slab.frame)
        self._pick_counts[slab.number] += 1
        self._events.append(Event(EventKind.GRIPPED, slab.number, tcp))
        self.moved(tcp)
        return True

    def moved(self, tcp: Frame) -> None:
        """Take note that the tool is at ``tcp``: what it holds goes with it, and is recorded if it strikes a slab."""
        held = self._held
        if held is not None:
            self._put(held.number, tcp @ held.tcp_from_slab)
            for number in self._struck_by(self._slabs[held.number]) - held.struck:
                held.struck.add(number)
                self._events.append(Event(EventKind.COLLIDED, held.number, tcp, f"ran into slab {number}"))

    def release(self, tcp: Frame) -> None:
        """Switch the vacuum off at ``tcp``: a held slab comes to rest on what is below it."""
        self._vacuum = False
        held = self._held
        if held is None:
            return
        self.moved(tcp)
        self._held = None
        slab = self._slabs[held.number]
        support, under = self._support(slab)
        gap = slab.bottom_mm - support
        rest = Frame(slab.frame.x_mm, slab.frame.y_mm, support, slab.frame.a_deg)
        kind, detail = EventKind.RELEASED, ""
        if gap > DROP_MM:
            kind, detail = EventKind.DROPPED, f"fell {gap:.1f} mm"
            dx, dy, turn = (self._random.uniform(-1, 1, 3) * (gap, gap, 10.0)).tolist()
            rest = Frame(rest.x_mm + dx, rest.y_mm + dy, support, rest.a_deg + turn)
        elif gap < -FACE_TOLERANCE_MM:
            kind, detail = EventKind.CRUSHED, f"pressed {-gap:.1f} mm into what is below"
        elif under is not None:
            kind, detail = EventKind.STACKED, f"lies on slab {under}"
        self._put(held.number, rest)
        self._events.append(Event(kind, slab.number, tcp, detail))

    def placements(self, slots: Sequence[Points]) -> tuple[Placement, ...]:
        """Return how well each slot, vertices (n, 2) in the assembly frame, is filled; see `measure_placements`."""
        return measure_placements(self._slabs, slots, self.scene.assembly.frame)

    def _below(self, tcp: Frame) -> tuple[Slab | None, str]:
        down = -float(tcp.matrix[2, 2])
        if down < math.cos(math.radians(TILT_TOLERANCE_DEG)):
            return (
                None,
                f"the tool is tilted {math.degrees(math.acos(max(-1.0, min(1.0, down)))):.1f}° from straight down",
            )
        radius = self.scene.gripper.cup_radius_mm
        near = [slab for slab in self._slabs if abs(slab.top_mm - tcp.z_mm) <= FACE_TOLERANCE_MM]
        if not near:
            heights = ", ".join(f"{height:g}" for height in sorted({slab.top_mm for slab in self._slabs}))
            return None, f"no upper face at {tcp.z_mm:.2f} mm; there are faces at {heights}"
        point = shapely.Point(tcp.x_mm, tcp.y_mm)
        for slab in near:
            shape = slab.shape
            if shape.contains(point):
                edge = float(shape.exterior.distance(point))
                covered = any(
                    other.number != slab.number
                    and other.bottom_mm >= slab.top_mm - FACE_TOLERANCE_MM
                    and other.shape.distance(point) < radius
                    for other in self._slabs
                )
                if covered:
                    return None, f"slab {slab.number} is covered by another"
                if edge >= radius:
                    return slab, ""
                return None, f"the cup of radius {radius:g} mm is {edge:.2f} mm from the rim of slab {slab.number}"
        return None, "nothing is under the cup"

    def _struck_by(self, slab: Slab) -> set[int]:
        """Return the slabs at the height of a carried one whose outlines it runs into."""
        level = [
            other
            for other in self._slabs
            if other.number != slab.number
            and other.top_mm > slab.bottom_mm + FACE_TOLERANCE_MM
            and other.bottom_mm < slab.top_mm - FACE_TOLERANCE_MM
        ]
        if not level:
            return set()
        shape = slab.shape.buffer(-OVERLAP_MM)
        return {other.number for other in level if shape.intersects(other.shape.buffer(-OVERLAP_MM))}

    def _support(self, slab: Slab) -> tuple[float, int | None]:
        """Return the height of what is under a slab, and the slab that is there, if any."""
        shape = slab.shape.buffer(-OVERLAP_MM)
        height, under = self.scene.table.frame.z_mm, None
        for other in self._slabs:
            below = other.number != slab.number and other.bottom_mm < slab.top_mm - FACE_TOLERANCE_MM
            if below and other.top_mm > height and shape.intersects(other.shape.buffer(-OVERLAP_MM)):
                height, under = other.top_mm, other.number
        return height, under

    def _put(self, number: int, frame: Frame) -> None:
        slabs = list(self._slabs)
        slabs[number] = replace(slabs[number], frame=frame)
        self._slabs = tuple(slabs)


def _numbered(slabs: Sequence[Slab]) -> tuple[Slab, ...]:
    numbers = [slab.number for slab in slabs]
    if numbers != list(range(len(slabs))):
        msg = f"slabs must be numbered 0 to {len(slabs) - 1} in their order, not {numbers}"
        raise ValueError(msg)
    return tuple(slabs)


def strewn_slabs(scene: Scene, seed: int) -> tuple[Slab, ...]:
    """Return the scene's slabs as a seed strews them over the pick area."""
    random = np.random.default_rng([seed, 1])
    bodies: list[Points] = []
    for spec in scene.outlines:
        points = np.array(shapely.orient_polygons(shapely.Polygon(spec.outline)).exterior.coords)[:-1]
        bodies.append(points - np.asarray(shapely.Polygon(points).centroid.coords)[0])
    poses = strew(bodies, shapely.Polygon(scene.table.pick_area), scene.table.clearance_mm, random)
    tones = 1.0 + scene.optics.slab_spread * random.standard_normal(len(bodies))
    return tuple(
        Slab(
            number,
            spec.name or f"slab-{number:02d}",
            body,
            spec.thickness_mm,
            scene.table.frame @ Frame(pose[0], pose[1], 0.0, pose[2]),
            nominal=body,
            tone=float(tone),
            grain=int(seed % 1_000_003) * 1000 + number,
        )
        for number, (spec, body, pose, tone) in enumerate(zip(scene.outlines, bodies, poses, tones, strict=True))
    )
