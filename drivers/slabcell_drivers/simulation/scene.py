"""What is in the simulated cell?  A scene: table, assembly area, camera, light, slabs, gripper and calibration board.

Scenes are TOML files; `load_scene` reads one.  Lengths are mm, angles degrees, frames relative to the robot's root.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import shapely

from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.simulation.surfaces import Surface
from slabcell_drivers.simulation.tables import Outline, SceneError, read_document, read_table

__all__ = [
    "AssemblySpec",
    "BoardSpec",
    "CameraSpec",
    "GripperSpec",
    "Optics",
    "Scene",
    "SceneError",
    "SlabSpec",
    "TableSpec",
    "load_scene",
]

MAX_SLABS = 2000


def _require(condition: bool, message: str) -> None:  # noqa: FBT001  a condition is what it takes
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True, slots=True)
class TableSpec:
    """Where the slabs lie at first: the robot's pick base.

    ``pick_area`` is a polygon in the table frame; slabs are strewn inside it at least ``clearance_mm`` apart.
    ``marks`` are the centres, in the table frame, of round light marks on the table; ``board`` is the outline of the
    dark board that slabs and assembly lie on, beyond which the floor is seen; without it the board is endless.
    """

    frame: Frame
    pick_area: Outline
    clearance_mm: float = 4.0
    marks: Outline = ()
    mark_radius_mm: float = 2.2
    board: Outline = ()

    def __post_init__(self) -> None:
        _require(shapely.Polygon(self.pick_area).is_valid, "pick_area crosses itself")
        _require(not self.board or shapely.Polygon(self.board).is_valid, "board crosses itself")
        _require(0 < self.mark_radius_mm <= 1000, f"mark_radius_mm = {self.mark_radius_mm} is outside 0 to 1000")
        _require(0 <= self.clearance_mm <= 1000, f"clearance_mm = {self.clearance_mm} is outside 0 to 1000")


@dataclass(frozen=True, slots=True)
class AssemblySpec:
    """Where the slabs are laid: the robot's place base, the template's own coordinates."""

    frame: Frame


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """A camera: sensor, lens (OpenCV's five-parameter model) and its place, Z along the view, X right, Y down."""

    width: int
    height: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...]
    frame: Frame
    vendor: str = "slabcell"
    model: str = "simulated"
    serial: str = "SIM-0001"

    def __post_init__(self) -> None:
        _require(1 <= self.width <= 20_000 and 1 <= self.height <= 20_000, "width and height must be 1 to 20000")
        _require(self.fx_px > 0 and self.fy_px > 0, "fx_px and fy_px must be above 0")
        _require(len(self.distortion) == 5, f"distortion has {len(self.distortion)} numbers, not 5: k1 k2 p1 p2 k3")


@dataclass(frozen=True, slots=True)
class Optics:
    """Light, surfaces, focus and sensor.  Grey levels are of 8 bits; shares are relative.

    The tints are what a colour camera sees of a surface, relative to its grey level: blue, green, red.
    """

    table_dn: float = 28.0
    slab_dn: float = 175.0
    wall_dn: float = 85.0
    slab_spread: float = 0.04
    blur_sigma_px: float = 0.8
    noise_dn: float = 1.2
    shot_dn: float = 0.012
    unevenness: float = 0.15
    contact_shadow: float = 0.3
    contact_reach_mm: float = 3.0
    cast_shadow: float = 0.15
    light_tilt_deg: float = 25.0
    light_from_deg: float = 120.0
    slab_texture: float = 0.02
    table_texture: float = 0.05
    seam_shadow: float = 0.5
    surface: Surface = Surface.PLAIN
    mark_dn: float = 200.0
    floor_dn: float = 95.0
    slab_tint: tuple[float, ...] = (0.9, 0.98, 1.06)
    table_tint: tuple[float, ...] = (1.05, 1.0, 0.96)

    def __post_init__(self) -> None:
        _require(0 <= self.blur_sigma_px <= 20, f"blur_sigma_px = {self.blur_sigma_px} is outside 0 to 20")
        _require(0 <= self.light_tilt_deg <= 80, f"light_tilt_deg = {self.light_tilt_deg} is outside 0 to 80")
        for name, tint in (("slab_tint", self.slab_tint), ("table_tint", self.table_tint)):
            _require(len(tint) == 3 and min(tint) >= 0, f"{name} must be three numbers: blue, green, red")
        _require(self.noise_dn >= 0 and self.shot_dn >= 0, "noise_dn and shot_dn must not be negative")


@dataclass(frozen=True, slots=True)
class GripperSpec:
    """A suction cup."""

    cup_radius_mm: float = 4.0


@dataclass(frozen=True, slots=True)
class BoardSpec:
    """A checkerboard for calibration, by its inner corners.

    Inner corner (i, j) is at (i, j)·pitch of the board's own frame, Z out of the printed face; the square diagonally
    outward of inner corner (0, 0) is black.
    """

    columns: int = 12
    rows: int = 9
    pitch_mm: float = 16.0
    margin_mm: float = 16.0
    thickness_mm: float = 6.0
    white_dn: float = 190.0
    black_dn: float = 25.0

    def __post_init__(self) -> None:
        _require(2 <= self.columns <= 200 and 2 <= self.rows <= 200, "columns and rows must be 2 to 200")
        _require(self.pitch_mm > 0 and self.margin_mm >= 0, "pitch_mm must be above 0 and margin_mm not negative")

    @property
    def name(self) -> str:
        """The board as commands are told it, such as ``checkerboard:12x9:16``."""
        return f"checkerboard:{self.columns}x{self.rows}:{self.pitch_mm:g}"


@dataclass(frozen=True, slots=True)
class SlabSpec:
    """One kind of slab; ``outline`` is in any coordinates, for its body is what counts."""

    outline: Outline
    thickness_mm: float
    name: str = ""
    count: int = 1

    def __post_init__(self) -> None:
        shape = shapely.Polygon(self.outline)
        _require(shape.is_valid and shape.area > 0, "outline crosses itself or encloses nothing")
        _require(0 < self.thickness_mm <= 500, f"thickness_mm = {self.thickness_mm} is outside 0 to 500")
        _require(1 <= self.count <= MAX_SLABS, f"count = {self.count} is outside 1 to {MAX_SLABS}")


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything in the simulated cell, before anything has moved."""

    name: str
    table: TableSpec
    assembly: AssemblySpec
    camera: CameraSpec
    slabs: tuple[SlabSpec, ...]
    optics: Optics = Optics()
    gripper: GripperSpec = GripperSpec()
    board: BoardSpec = BoardSpec()

    @property
    def outlines(self) -> tuple[SlabSpec, ...]:
        """One entry for each slab: kinds with a count above one are repeated."""
        return tuple(replace(kind, count=1) for kind in self.slabs for _ in range(kind.count))


@dataclass(frozen=True, slots=True)
class _Tables:
    """The tables of a file, apart from the slabs."""

    table: TableSpec
    assembly: AssemblySpec
    camera: CameraSpec
    optics: Optics = Optics()
    gripper: GripperSpec = GripperSpec()
    board: BoardSpec = BoardSpec()


def load_scene(path: Path) -> Scene:
    """Return the scene of a TOML file.  Raises SceneError that names file, key and remedy."""
    document = read_document(path)
    written = document.pop("slab", [])
    if not isinstance(written, list) or not written:
        msg = f"{path}: has no slabs: write at least one [[slab]] table"
        raise SceneError(msg)
    slabs = tuple(
        read_table(SlabSpec, table, f"{path}: slab[{index}]")
        for index, table in enumerate(cast("list[object]", written))
    )
    if sum(kind.count for kind in slabs) > MAX_SLABS:
        msg = f"{path}: has more than {MAX_SLABS} slabs"
        raise SceneError(msg)
    tables = read_table(_Tables, document, f"{path}")
    return Scene(
        path.stem, tables.table, tables.assembly, tables.camera, slabs, tables.optics, tables.gripper, tables.board
    )
