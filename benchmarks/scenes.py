"""Pictures of slabs with exact truth: what the accuracy of the vision is measured on.

A scene is made from a condition, a pool and a seed alone.  The same call gives the same scene on every machine with the
same libraries.  Poses come from the simulation's geometry; nothing of the vision is used here.

    from scenes import make_scene
    scene = make_scene("typical", seed=7)
    scene.image, scene.calibration, scene.recipe, scene.slabs

``python benchmarks/scenes.py OUT [SEED]`` writes one picture of each condition to the folder OUT.
"""

import sys
import zlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from shapes import irregular, irregular_pool, mirrored, mixed_pool, near_duplicate
from slabcell.calibration.model import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.geometry import Polygon, RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.template import Template
from slabcell_drivers.robot import Frame
from slabcell_drivers.simulation.boards import board_corners, camera_views, plane_views, render_board
from slabcell_drivers.simulation.defects import chipped, touching
from slabcell_drivers.simulation.formats import digitise
from slabcell_drivers.simulation.layout import strew
from slabcell_drivers.simulation.placement import congruences
from slabcell_drivers.simulation.projection import Projector
from slabcell_drivers.simulation.rendering import irradiance
from slabcell_drivers.simulation.scene import AssemblySpec, BoardSpec, CameraSpec, Optics, Scene, TableSpec
from slabcell_drivers.simulation.slab import Slab
from slabcell_drivers.simulation.surfaces import Surface

__all__ = ["CONDITIONS", "BenchmarkScene", "Condition", "TrueSlab", "make_crowd", "make_scene"]

Points = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
Range = tuple[float, float]

MM_PER_PX = 0.88
HEIGHT_MM = 1200.0
SLOTS = 16
CELL_MM = 600.0  # grid of the template's slots
CLEARANCE_PX = 16.0


@dataclass(frozen=True)
class Condition:
    """How a picture comes about; ranges are drawn from anew in each scene."""

    blur_sigma_px: Range = (0.75, 0.85)
    noise_dn: Range = (1.2, 1.5)
    shot_dn: float = 0.01
    table_dn: float = 28.0
    slab_dn: float = 175.0
    slab_spread: float = 0.03
    unevenness: float = 0.15
    contact_shadow: float = 0.3
    cast_shadow: float = 0.0
    slab_texture: Range = (0.01, 0.05)
    table_texture: Range = (0.01, 0.05)
    thickness_mm: float = 0.0
    size_px: Range = (180.0, 330.0)
    dust: int = 0
    kerf_mm: float = 0.0  # the template's polygons are larger than the slabs by this, all around half of it
    stone: bool = False  # granite, marble or slate
    chips: int = 0  # so many known slabs have lost a corner of 4 to 9 % of their size
    pairs: int = 0  # so many slabs are pushed against their neighbour


TYPICAL = Condition()
CONDITIONS = {
    "clean": replace(
        TYPICAL,
        noise_dn=(0.8, 1.0),
        unevenness=0.0,
        contact_shadow=0.0,
        slab_texture=(0.0, 0.0),
        table_texture=(0.0, 0.0),
        slab_spread=0.0,
    ),
    "typical": TYPICAL,
    "harsh": replace(
        TYPICAL,
        blur_sigma_px=(1.1, 1.3),
        noise_dn=(2.0, 2.5),
        shot_dn=0.045,
        unevenness=0.35,
        cast_shadow=0.45,
        contact_shadow=0.6,
        slab_texture=(0.06, 0.12),
        table_texture=(0.1, 0.25),
        slab_spread=0.06,
        dust=40,
    ),
    "thick": replace(TYPICAL, thickness_mm=10.0, cast_shadow=0.15),
    "contrast": replace(TYPICAL, table_dn=45.0, slab_dn=90.0),
    "blur": replace(TYPICAL, blur_sigma_px=(1.4, 1.6)),
    "kerf": replace(TYPICAL, kerf_mm=0.4),
    "small": replace(TYPICAL, size_px=(90.0, 160.0)),
    "stone": replace(TYPICAL, stone=True, slab_texture=(0.06, 0.1)),
    "dark": replace(TYPICAL, table_dn=180.0, slab_dn=60.0),
    "chipped": replace(TYPICAL, chips=4),
    "touching": replace(TYPICAL, pairs=3),
}


@dataclass(frozen=True)
class TrueSlab:
    """One slab of a scene.

    ``slot`` is None for a slab that belongs to no slot; ``kind`` says what it is (``known``, ``stranger``, ``mirror``,
    ``lookalike``; ``chipped`` and ``touching`` have a slot, and may be located right or refused).
    ``table_from_assembly`` takes the slot to where the slab lies; it and its rotations by 360°/symmetry_order about the
    slab's centre are equally true.  ``outline`` is the upper face on the table, (n, 2).
    """

    slot: int | None
    kind: str
    table_from_assembly: RigidTransform2D | None
    symmetry_order: int
    outline: Points


@dataclass(frozen=True)
class BenchmarkScene:
    """A picture, what it takes to locate the slabs in it, and the truth."""

    name: str
    image: Image
    template: tuple[Points, ...]
    thickness_mm: float
    slabs: tuple[TrueSlab, ...]
    camera: CameraSpec
    optics: Optics
    seed: int
    mm_per_px: float = MM_PER_PX

    @cached_property
    def calibration(self) -> Calibration:
        """The camera as it truly is."""
        root_to_camera = np.linalg.inv(self.camera.frame.matrix)
        return Calibration(
            CameraIdentity(self.camera.width, self.camera.height, self.camera.serial),
            Lens(Projector(self.camera).matrix, np.array(self.camera.distortion)),
            TablePlane(root_to_camera[:3, :3], root_to_camera[:3, 3]),
        )

    @cached_property
    def recipe(self) -> Recipe:
        """The smallest recipe: the template and the thickness."""
        slots = tuple(Polygon.from_points(slot) for slot in self.template)
        return Recipe.from_template(Template(self.name, slots, ""), self.thickness_mm)

    @property
    def board(self) -> BoardSpec:
        """A board for this camera."""
        return BoardSpec(columns=12, rows=9, pitch_mm=45.0, margin_mm=45.0, thickness_mm=0.0)

    def boards(self, tilted: int = 15, lying: int = 5) -> tuple[list[Image], list[Image]]:
        """Return pictures of the board that calibrate this camera: tilted ones, and ones on the table.

        The first on the table has the table frame's origin and axes.
        """
        table = TableSpec(Frame(), ((-1.0, -1.0), (1.0, -1.0), (0.0, 1.0)))
        cell = Scene(self.name, table, AssemblySpec(Frame()), self.camera, (), self.optics, board=self.board)
        views = camera_views(cell, self.seed, tilted), plane_views(cell, lying)
        pictures = [
            [
                render_board(
                    self.camera, self.optics, self.board, pose, seed=self.seed, frame_number=1000 * kind + index
                )
                for index, pose in enumerate(poses)
            ]
            for kind, poses in enumerate(views)
        ]
        return pictures[0], pictures[1]

    def corners(self, pose: Frame) -> Points:
        """Return the true pixels of the board's inner corners at a pose in the table frame."""
        return board_corners(self.camera, self.board, pose)


def make_scene(condition: str, seed: int, *, pool: str = "mixed", slabs: int = 12, unknowns: int = 1) -> BenchmarkScene:
    """Return a scene of so many known slabs and so many that fit no slot.

    ``condition`` is a key of `CONDITIONS`, ``pool`` is ``mixed`` or ``irregular``; at most 16 slabs are known.
    """
    how = CONDITIONS[condition]
    name = f"{condition}-{pool}-{seed}"
    random = np.random.default_rng([seed, zlib.crc32(f"{condition}/{pool}".encode())])
    shapes = {"mixed": mixed_pool, "irregular": irregular_pool}[pool](random)
    low, high = how.size_px
    sizes = random.uniform(low, high, SLOTS) * MM_PER_PX
    if pool == "mixed":
        sizes[5:8] = sizes[5]  # a family keeps its ratios, look-alikes their size
        sizes[8:10], sizes[10:12] = sizes[8], sizes[10]
    nominal = [shape * size for shape, size in zip(shapes, sizes, strict=True)]
    camera = _camera(random)
    optics = _optics(how, random)

    chosen = sorted(random.permutation(SLOTS)[:slabs].tolist())
    bodies: list[tuple[int | None, str, Points]] = [(slot, "known", nominal[slot]) for slot in chosen]
    for _ in range(unknowns):
        kind = str(random.choice(["stranger", "mirror", "lookalike"]))
        bodies.append((None, kind, _unknown(kind, nominal, shapes, sizes, random)))
    cut = [_smaller(body, how.kerf_mm / 2) for _, _, body in bodies]
    area = _view(camera, how.thickness_mm)
    clearance = CLEARANCE_PX * MM_PER_PX + how.thickness_mm
    poses = strew(cut, area, clearance, random)
    tones = 1.0 + how.slab_spread * random.uniform(-2.0, 2.0, len(cut))
    solids = [
        Slab(
            index,
            kind,
            body,
            how.thickness_mm,
            Frame(pose[0], pose[1], 0.0, pose[2]),
            tone=float(tone),
            grain=seed * 100 + index,
        )
        for index, ((_, kind, _), body, pose, tone) in enumerate(zip(bodies, cut, poses, tones, strict=True))
    ]
    solids = _damaged(solids, how, random)
    brightness = irradiance(camera, optics, solids, seed=seed)
    if how.dust:
        brightness += _dust(how, camera, [slab.shape for slab in solids], random)
    image = digitise(brightness, optics, (seed, 0))

    template, from_slot = _template(nominal, random)
    truth = tuple(
        TrueSlab(
            slot,
            solid.name,
            None if slot is None else _motion(solid.frame) @ from_slot[slot],
            len(congruences(body, body, 0.02)),
            solid.outline,
        )
        for (slot, _, body), solid in zip(bodies, solids, strict=True)
    )
    return BenchmarkScene(name, image, template, how.thickness_mm, truth, camera, optics, seed)


def make_crowd(count: int, seed: int, condition: str = "typical") -> BenchmarkScene:
    """Return a scene of ``count`` irregular slabs, one for each slot, in a grid that fills the picture.

    For measuring time: 5 to 400 slabs of a size that leaves about a third of each cell free.
    """
    how = CONDITIONS[condition]
    random = np.random.default_rng([seed, count])
    camera, optics = _camera(random), _optics(how, random)
    left, low, right, high = _view(camera, how.thickness_mm, 60.0).bounds
    columns = int(np.ceil(np.sqrt(count * (right - left) / (high - low))))
    rows = -(-count // columns)
    pitch = min((right - left) / columns, (high - low) / rows, 330.0 * MM_PER_PX)
    cells = random.permutation(columns * rows)[:count]
    nominal = [irregular(random) * pitch * float(random.uniform(0.7, 0.85)) for _ in range(count)]
    solids = [
        Slab(
            index,
            "known",
            body,
            how.thickness_mm,
            Frame(
                float((left + right) / 2 + pitch * (cell % columns - (columns - 1) / 2)),
                float((low + high) / 2 + pitch * (cell // columns - (rows - 1) / 2)),
                0.0,
                float(random.uniform(-180, 180)),
            ),
            grain=index,
        )
        for index, (body, cell) in enumerate(zip(nominal, cells.tolist(), strict=True))
    ]
    image = digitise(irradiance(camera, optics, solids, seed=seed), optics, (seed, 0))
    template, from_slot = _template(nominal, random)
    truth = tuple(
        TrueSlab(index, "known", _motion(solid.frame) @ from_slot[index], 1, solid.outline)
        for index, solid in enumerate(solids)
    )
    return BenchmarkScene(f"crowd-{count}-{seed}", image, template, how.thickness_mm, truth, camera, optics, seed)


def _motion(frame: Frame) -> RigidTransform2D:
    return RigidTransform2D(frame.a_deg, frame.x_mm, frame.y_mm)


def _damaged(solids: list[Slab], how: Condition, random: np.random.Generator) -> list[Slab]:
    """Return the slabs with some chipped and some pushed against their neighbour; their names say so."""
    known = [slab.number for slab in solids if slab.name == "known"]
    for number in random.permutation(known)[: how.chips].tolist():
        size = float(random.uniform(0.04, 0.09)) * float(np.ptp(solids[number].body, axis=0).max())
        solids[number] = replace(chipped(solids[number], random, size_mm=size), name="chipped")
    for number in random.permutation(known)[: how.pairs].tolist():
        neighbours = sorted(
            (slab.number for slab in solids if slab.number != number),
            key=lambda other: solids[other].shape.distance(solids[number].shape),
        )
        try:
            pushed = touching(solids, number, neighbours[0])
        except ValueError:
            continue  # another slab is in the way: one pair less
        solids = [replace(slab, name="touching") if slab.number in (number, neighbours[0]) else slab for slab in pushed]
    return solids


def _camera(random: np.random.Generator) -> CameraSpec:
    focal = HEIGHT_MM / MM_PER_PX
    tilt = random.uniform(-1.5, 1.5, 3)
    return CameraSpec(
        width=1920,
        height=1200,
        fx_px=focal,
        fy_px=focal * float(random.uniform(0.999, 1.001)),
        cx_px=959.5 + float(random.uniform(-12, 12)),
        cy_px=599.5 + float(random.uniform(-12, 12)),
        distortion=(
            float(random.uniform(-0.14, -0.06)),
            float(random.uniform(0.02, 0.08)),
            float(random.uniform(-6e-4, 6e-4)),
            float(random.uniform(-6e-4, 6e-4)),
            0.0,
        ),
        frame=Frame(0.0, 0.0, HEIGHT_MM, float(tilt[0]), float(tilt[1]), 180.0 + float(tilt[2])),
        serial="BENCH",
    )


def _optics(how: Condition, random: np.random.Generator) -> Optics:
    return Optics(
        table_dn=how.table_dn,
        slab_dn=how.slab_dn,
        wall_dn=how.table_dn + 0.4 * (how.slab_dn - how.table_dn),
        blur_sigma_px=float(random.uniform(*how.blur_sigma_px)),
        noise_dn=float(random.uniform(*how.noise_dn)),
        shot_dn=how.shot_dn,
        unevenness=how.unevenness,
        contact_shadow=how.contact_shadow,
        contact_reach_mm=float(random.uniform(2.5, 4.5)) * MM_PER_PX,
        cast_shadow=how.cast_shadow,
        light_tilt_deg=float(random.uniform(15, 35)),
        light_from_deg=float(random.uniform(0, 360)),
        slab_texture=float(random.uniform(*how.slab_texture)),
        table_texture=float(random.uniform(*how.table_texture)),
        surface=Surface.PLAIN if not how.stone else list(Surface)[int(random.integers(1, 4))],
    )


def _unknown(
    kind: str, nominal: list[Points], shapes: list[Points], sizes: Points, random: np.random.Generator
) -> Points:
    """Return a slab that fits no slot: a shape of its own, or the mirror image or look-alike of one."""
    if kind == "stranger":
        return irregular(random) * float(random.choice(sizes))
    slot = int(random.integers(5))  # the irregular ones, whose mirror image is no slot
    if kind == "lookalike":
        return near_duplicate(random, shapes[slot], 0.08) * sizes[slot]
    image = mirrored(nominal[slot])
    shape, other = shapely.Polygon(nominal[slot]), shapely.Polygon(image)
    best = min(
        shapely.affinity.rotate(other, angle, origin=other.centroid).symmetric_difference(shape).area
        for angle in range(0, 360, 5)
    )
    return image if best > 0.06 * shape.area else irregular(random) * float(sizes[slot])


def _smaller(body: Points, inset_mm: float) -> Points:
    """Return the outline moved inwards by a distance, corner for corner."""
    if inset_mm == 0.0:
        return body
    before, after = body - np.roll(body, 1, axis=0), np.roll(body, -1, axis=0) - body
    first, second = (
        np.column_stack([-edge[:, 1], edge[:, 0]]) / np.linalg.norm(edge, axis=1)[:, None] for edge in (before, after)
    )
    middle = first + second
    return body + inset_mm * middle * (2.0 / np.sum(middle**2, axis=1))[:, None]


def _view(camera: CameraSpec, thickness_mm: float, rim_px: float = 30.0) -> shapely.Polygon:
    """Return the part of the table, in mm, on which slabs are wholly in the picture."""
    u = np.linspace(rim_px, camera.width - 1 - rim_px, 12)
    v = np.linspace(rim_px, camera.height - 1 - rim_px, 8)
    rim = np.concatenate(
        [
            np.column_stack([u, np.full(12, v[0])]),
            np.column_stack([np.full(8, u[-1]), v]),
            np.column_stack([u[::-1], np.full(12, v[-1])]),
            np.column_stack([np.full(8, u[0]), v[::-1]]),
        ]
    )
    projector = Projector(camera)
    ideal = cv2.undistortPoints(rim.reshape(-1, 1, 2), projector.matrix, np.array(camera.distortion)).reshape(-1, 2)
    rays = np.column_stack([ideal, np.ones(len(ideal))]) @ camera.frame.matrix[:3, :3].T
    depth = (thickness_mm - projector.centre[2]) / rays[:, 2]
    return shapely.Polygon((projector.centre + rays * depth[:, None])[:, :2]).buffer(-2.0)


def _dust(
    how: Condition, camera: CameraSpec, slabs: list[shapely.Polygon], random: np.random.Generator
) -> npt.NDArray[np.float32]:
    """Return specks on the table, apart from the slabs: what they add to the picture."""
    specks = np.zeros((camera.height, camera.width), np.float32)
    projector = Projector(camera)
    near = shapely.union_all(slabs).buffer(8.0 * MM_PER_PX)
    area = _view(camera, 0.0)
    left, low, right, high = area.bounds
    for _ in range(how.dust):
        x, y = random.uniform((left, low), (right, high)).tolist()
        if near.contains(shapely.Point(x, y)):
            continue
        u, v = projector.pixels(np.array([[x, y, 0.0]]))[0]
        radii = tuple(int(value) for value in random.uniform(0.5, 5.0, 2) * 16)
        level = float(random.uniform(20.0, 0.7 * how.slab_dn))
        speck = np.zeros_like(specks[:32, :32])
        cv2.ellipse(speck, (16 * 16, 16 * 16), radii, float(random.uniform(0, 180)), 0, 360, level, -1, cv2.LINE_AA, 4)
        top, start = round(v) - 16, round(u) - 16
        if 0 <= top < camera.height - 32 and 0 <= start < camera.width - 32:
            specks[top : top + 32, start : start + 32] += speck
    return np.asarray(cv2.GaussianBlur(specks, (0, 0), float(np.mean(how.blur_sigma_px))), np.float32)


def _template(nominal: list[Points], random: np.random.Generator) -> tuple[tuple[Points, ...], list[RigidTransform2D]]:
    """Return the slots, each turned at random in its cell of a grid, and the motions from slot to slab."""
    slots: list[Points] = []
    motions: list[RigidTransform2D] = []
    wide = max(4, round(len(nominal) ** 0.5))
    for index, body in enumerate(nominal):
        motion = RigidTransform2D(
            float(random.uniform(-180, 180)), CELL_MM * (index % wide + 0.5), CELL_MM * (index // wide + 0.5)
        )
        slots.append(motion.apply(body))
        motions.append(motion.inverse())
    return tuple(slots), motions


def main() -> None:
    """Write one picture of each condition."""
    folder, seed = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1
    folder.mkdir(parents=True, exist_ok=True)
    for condition in CONDITIONS:
        scene = make_scene(condition, seed)
        cv2.imwrite(str(folder / f"{scene.name}.png"), scene.image)
        kinds = ", ".join(f"{slab.kind} {slab.slot}" for slab in scene.slabs)
        print(f"{scene.name}: {kinds}")


if __name__ == "__main__":
    main()
