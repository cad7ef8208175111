"""What does the camera see?  Pictures of slabs on a table: edges placed exactly, light, shadows, blur and noise."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from slabcell_drivers.camera.protocol import Pixels
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.simulation.areas import Area
from slabcell_drivers.simulation.coverage import Window, cover
from slabcell_drivers.simulation.exposure import FINE, add_blurred, cover_fine, cover_part, fine_window
from slabcell_drivers.simulation.formats import digitise
from slabcell_drivers.simulation.projection import Projector, rings
from slabcell_drivers.simulation.scene import CameraSpec, Optics, TableSpec
from slabcell_drivers.simulation.slab import Slab
from slabcell_drivers.simulation.surfaces import grain_tile, light_field, table_grain
from slabcell_drivers.simulation.visibility import Face, cast_shadows, footprints, seams, visible_faces
from slabcell_drivers.simulation.world import World

__all__ = ["bare_table", "irradiance", "render_slabs", "render_world"]

GROUND = np.eye(4)
GRAIN_MM = 0.5  # size of a texture cell on the slab
SEAM_MM = 0.25  # width of the dark joint between slabs that touch

Field = npt.NDArray[np.float32]


def render_slabs(
    camera: CameraSpec,
    optics: Optics,
    slabs: Sequence[Slab],
    *,
    seed: int = 0,
    frame_number: int = 0,
    table: TableSpec | None = None,
    bits: int = 8,
    colour: bool = False,
) -> Pixels:
    """Return the picture of slabs on the table z = 0 of the root frame, with pixels as `digitise` makes them.

    The shape is (height, width), or (height, width, 3), in the order blue, green, red, for ``colour``.  ``seed``
    chooses light and grain, ``frame_number`` the noise; ``table`` gives the board's rim and its marks.  Raises
    ValueError if a slab is above the camera.
    """
    if colour:
        tinted = [_tinted(optics, channel) for channel in range(3)]
        image = np.dstack([irradiance(camera, each, slabs, seed=seed, table=table) for each in tinted])
    else:
        image = irradiance(camera, optics, slabs, seed=seed, table=table)
    return digitise(image, optics, (seed, frame_number), bits)


def render_world(world: World, frame_number: int = 0, *, bits: int = 8, colour: bool = False) -> Pixels:
    """Return what the scene's camera sees of a world now, whatever stands in its way included."""
    scene = world.scene
    return render_slabs(
        scene.camera,
        scene.optics,
        (*world.slabs, *world.obstructions),
        seed=world.seed,
        frame_number=frame_number,
        table=scene.table,
        bits=bits,
        colour=colour,
    )


def irradiance(
    camera: CameraSpec, optics: Optics, slabs: Sequence[Slab], *, seed: int = 0, table: TableSpec | None = None
) -> Field:
    """Return what falls on the pixels before the sensor adds noise, shape (height, width), in grey levels."""
    projector = Projector(camera, FINE)
    under = bare_table(camera, optics, slabs, seed, table)
    image = under.copy()
    if optics.blur_sigma_px > 0:
        cv2.GaussianBlur(image, (0, 0), max(optics.blur_sigma_px, 0.3), dst=image)
    bodies = (*slabs, *_marks(table, optics))
    for slab, faces in _by_slab(visible_faces(bodies, projector.centre)):
        _add_slab(image, under, slab, faces, projector, optics)
    if optics.seam_shadow > 0:
        _darken_seams(image, slabs, projector, optics)
    image *= light_field(camera.width, camera.height, optics.unevenness, seed)
    return image


def bare_table(
    camera: CameraSpec, optics: Optics, slabs: Sequence[Slab], seed: int, table: TableSpec | None = None
) -> Field:
    """Return the table's brightness in the shadows of slabs but without the slabs, shape (height, width)."""
    projector = Projector(camera)
    width, height = camera.width, camera.height
    level = np.full((height, width), optics.table_dn, np.float32)
    if table is not None and table.board:
        board = _in_root(np.array(table.board), table.frame)
        level += (optics.floor_dn - optics.table_dn) * (1.0 - _soft(shapely.Polygon(board), projector, 0.0))
    if optics.table_texture > 0:
        level *= 1.0 + optics.table_texture * table_grain(width, height, seed)
    pixel_mm = projector.centre[2] / camera.fx_px
    if optics.cast_shadow > 0 and slabs:
        tilt, origin = np.tan(np.deg2rad(optics.light_tilt_deg)), np.deg2rad(optics.light_from_deg)
        away = (float(-tilt * np.cos(origin)), float(-tilt * np.sin(origin)))
        level *= 1.0 - optics.cast_shadow * _soft(cast_shadows(slabs, away), projector, 1.0 / pixel_mm)
    if optics.contact_shadow > 0 and slabs:
        near = _soft(footprints(slabs), projector, optics.contact_reach_mm / pixel_mm)
        level *= 1.0 - optics.contact_shadow * np.minimum(2.0 * near, 1.0)
    return level


def _tinted(optics: Optics, channel: int) -> Optics:
    slab, table = optics.slab_tint[channel], optics.table_tint[channel]
    return replace(
        optics,
        slab_dn=optics.slab_dn * slab,
        wall_dn=optics.wall_dn * slab,
        table_dn=optics.table_dn * table,
        floor_dn=optics.floor_dn * table,
    )


def _marks(table: TableSpec | None, optics: Optics) -> list[Slab]:
    """Return the table's marks as slabs without thickness."""
    if table is None:
        return []
    turn = np.linspace(0, 2 * np.pi, 65)[:-1]
    disc = np.column_stack([np.cos(turn), np.sin(turn)]) * table.mark_radius_mm
    tone = optics.mark_dn / optics.slab_dn
    return [
        Slab(-100 - index, "mark", disc, 0.0, table.frame @ Frame(x, y), tone=tone)
        for index, (x, y) in enumerate(table.marks)
    ]


def _in_root(points: npt.NDArray[np.float64], frame: Frame) -> npt.NDArray[np.float64]:
    matrix = frame.matrix
    return points @ matrix[:2, :2].T + matrix[:2, 3]


def _soft(area: Area, projector: Projector, sigma_px: float) -> Field:
    """Return the blurred coverage of an area of the table, shape (height, width)."""
    camera = projector.camera
    contours = [projector.contour(ring, GROUND, 16.0) for ring in rings(area)]
    share = np.zeros((camera.height, camera.width), np.float32)
    window = Window.around(contours, camera.width, camera.height, round(4.0 * sigma_px) + 2)
    if window is not None:
        share[window.slices] = cover(contours, window)
        if sigma_px > 0.3:
            share[window.slices] = cv2.GaussianBlur(share[window.slices], (0, 0), sigma_px)
    return share


def _by_slab(faces: Sequence[Face]) -> list[tuple[Slab, list[Face]]]:
    grouped: dict[int, tuple[Slab, list[Face]]] = {}
    for face in faces:
        grouped.setdefault(id(face.slab), (face.slab, []))[1].append(face)
    return list(grouped.values())


def _add_slab(
    image: Field, table: Field, slab: Slab, faces: Sequence[Face], projector: Projector, optics: Optics
) -> None:
    """Let the visible faces of one slab take the table's place in the picture."""
    camera = projector.camera
    outlines = [[projector.contour(ring, GROUND) for ring in rings(face.area)] for face in faces]
    window = fine_window(
        (contour for contours in outlines for contour in contours), camera.width, camera.height, optics.blur_sigma_px
    )
    if window is None:
        return
    under = _magnified(table, window)
    fine = np.zeros_like(under)
    for face, contours in zip(faces, outlines, strict=True):
        part, share = cover_part(contours, window)
        if share.size == 0:
            continue
        if face.facing is None:
            share *= _upper_face(slab, window, part, projector, optics) - under[part.slices]
        else:
            share *= _wall_level(face.facing, slab, optics) - under[part.slices]
        fine[part.slices] += share
    add_blurred(image, window, fine, optics.blur_sigma_px)


def _magnified(table: Field, window: Window) -> Field:
    """Return a window of the table on the fine grid; beyond the picture it goes on as at its rim."""
    rows = np.clip(np.arange(window.top, window.top + window.height), 0, table.shape[0] - 1)
    columns = np.clip(np.arange(window.left, window.left + window.width), 0, table.shape[1] - 1)
    size = (window.width * FINE, window.height * FINE)
    return np.asarray(cv2.resize(table[np.ix_(rows, columns)], size, interpolation=cv2.INTER_LINEAR), np.float32)


def _wall_level(facing: tuple[float, float], slab: Slab, optics: Optics) -> float:
    origin = np.deg2rad(optics.light_from_deg)
    lit = facing[0] * np.cos(origin) + facing[1] * np.sin(origin)
    return float(optics.wall_dn * slab.tone * (1.0 + 0.35 * lit))


def _upper_face(slab: Slab, window: Window, part: Window, projector: Projector, optics: Optics) -> Field | float:
    level = optics.slab_dn * slab.tone
    if optics.slab_texture <= 0:
        return level
    grain = cv2.warpAffine(
        grain_tile(slab.grain, optics.surface),
        _tile_from_part(slab, window, part, projector),
        (part.width, part.height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_WRAP,
    )
    return np.asarray(level * (1.0 + optics.slab_texture * grain), np.float32)


def _tile_from_part(slab: Slab, window: Window, part: Window, projector: Projector) -> npt.NDArray[np.float64]:
    """Return the affine map (2, 3) from a part's sub-pixels to the slab's texture, which is fixed to its body."""
    reach = 20.0
    body = np.array([[0.0, 0.0, 0.0], [reach, 0.0, 0.0], [0.0, reach, 0.0]])
    tilt = np.deg2rad(slab.frame.a_deg)
    turn = np.array([[np.cos(tilt), -np.sin(tilt), 0.0], [np.sin(tilt), np.cos(tilt), 0.0], [0.0, 0.0, 1.0]])
    seen = projector.pixels(body @ turn.T + (slab.frame.x_mm, slab.frame.y_mm, slab.top_mm))
    tile = body[:, :2] / GRAIN_MM + 256.0
    to_tile = np.asarray(cv2.getAffineTransform(seen.astype(np.float32), tile.astype(np.float32)), np.float64)
    to_tile[:, 2] += to_tile[:, :2] @ (window.left * FINE + part.left, window.top * FINE + part.top)
    return to_tile


def _darken_seams(image: Field, slabs: Sequence[Slab], projector: Projector, optics: Optics) -> None:
    """Draw the dark joint between slabs that lie against each other."""
    camera = projector.camera
    for area, height in seams(slabs, SEAM_MM):
        plane = np.eye(4)
        plane[2, 3] = height
        contours = [projector.contour(ring, plane) for ring in rings(area)]
        window = fine_window(contours, camera.width, camera.height, optics.blur_sigma_px)
        if window is not None:
            dark = cover_fine(contours, window) * np.float32(-optics.seam_shadow * optics.slab_dn)
            add_blurred(image, window, dark, optics.blur_sigma_px)
