"""What does the camera see?  Pictures of slabs on a table, with edges placed exactly, light, shadows, blur and noise.

The picture is composed on a grid twice as fine as the sensor's: coverage of disjoint faces by exact area, brightness of
faces and table, then the lens's Gaussian blur, then the mean over each pixel.  On that grid the blur is band-limiting,
so that edges lie where geometry puts them to within some 1e-3 px.
"""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from slabcell_drivers.simulation.areas import Area
from slabcell_drivers.simulation.coverage import Window, cover
from slabcell_drivers.simulation.projection import Projector, rings
from slabcell_drivers.simulation.scene import CameraSpec, Optics
from slabcell_drivers.simulation.slab import Slab
from slabcell_drivers.simulation.surfaces import grain_tile, light_field, sensor_noise, smooth_noise
from slabcell_drivers.simulation.visibility import Face, cast_shadows, footprints, seams, visible_faces
from slabcell_drivers.simulation.world import World

__all__ = ["FINE", "expose", "render_slabs", "render_world"]

FINE = 2  # sub-pixels per pixel and axis
GROUND = np.eye(4)
GRAIN_MM = 0.5  # size of a texture cell on the slab
SEAM_MM = 0.25  # width of the dark joint between slabs that touch

Image = npt.NDArray[np.uint8]
Field = npt.NDArray[np.float32]


def render_slabs(
    camera: CameraSpec, optics: Optics, slabs: Sequence[Slab], *, seed: int = 0, frame_number: int = 0
) -> Image:
    """Return the picture of slabs on the table z = 0 of the root frame, shape (height, width) uint8.

    ``seed`` chooses light and grain, ``frame_number`` the noise.  Raises ValueError if a slab is above the camera.
    """
    projector = Projector(camera, FINE)
    table = _table(camera, optics, slabs, seed)
    canvas = table.copy()
    for face in visible_faces(slabs, projector.centre):
        _paint(canvas, table, face, projector, optics)
    if optics.seam_shadow > 0:
        _darken_seams(canvas, slabs, projector, optics)
    return expose(canvas, camera, optics, seed=seed, frame_number=frame_number)


def render_world(world: World, frame_number: int = 0) -> Image:
    """Return what the scene's camera sees of a world now, shape (height, width) uint8."""
    scene = world.scene
    return render_slabs(scene.camera, scene.optics, world.slabs, seed=world.seed, frame_number=frame_number)


def expose(canvas: Field, camera: CameraSpec, optics: Optics, *, seed: int, frame_number: int) -> Image:
    """Return what the sensor makes of a brightness on the fine grid: uneven light, blur, pixels, noise, 8 bits."""
    if optics.blur_sigma_px > 0:
        cv2.GaussianBlur(canvas, (0, 0), optics.blur_sigma_px * FINE, dst=canvas, borderType=cv2.BORDER_REPLICATE)
    image = cv2.resize(canvas, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    image *= light_field(camera.width, camera.height, optics.unevenness, seed)
    image = sensor_noise(np.asarray(image, np.float32), optics.noise_dn, optics.shot_dn, (seed, frame_number))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _table(camera: CameraSpec, optics: Optics, slabs: Sequence[Slab], seed: int) -> Field:
    """Return the bare table's brightness on the fine grid, in the shadows of the slabs."""
    half = Projector(camera)
    width, height = camera.width, camera.height
    level = np.full((height, width), optics.table_dn, np.float32)
    if optics.table_texture > 0:
        level *= 1.0 + optics.table_texture * smooth_noise(width, height, seed)
    pixel_mm = half.centre[2] / camera.fx_px
    if optics.cast_shadow > 0 and slabs:
        tilt, origin = np.tan(np.deg2rad(optics.light_tilt_deg)), np.deg2rad(optics.light_from_deg)
        away = (float(-tilt * np.cos(origin)), float(-tilt * np.sin(origin)))
        level *= 1.0 - optics.cast_shadow * _soft(cast_shadows(slabs, away), half, 1.0 / pixel_mm)
    if optics.contact_shadow > 0 and slabs:
        near = _soft(footprints(slabs), half, optics.contact_reach_mm / pixel_mm)
        level *= 1.0 - optics.contact_shadow * np.minimum(2.0 * near, 1.0)
    return np.asarray(cv2.resize(level, (width * FINE, height * FINE), interpolation=cv2.INTER_LINEAR), np.float32)


def _soft(area: Area, projector: Projector, sigma_px: float) -> Field:
    """Return the blurred coverage of an area of the table, shape (height, width)."""
    camera = projector.camera
    contours = [projector.contour(ring, GROUND, 16.0) for ring in rings(area)]
    share = cover(contours, Window(0, 0, camera.width, camera.height))
    return np.asarray(cv2.GaussianBlur(share, (0, 0), max(sigma_px, 0.3)), np.float32)


def _paint(canvas: Field, table: Field, face: Face, projector: Projector, optics: Optics) -> None:
    """Let the face take the table's place on the canvas, as far as the face covers each sub-pixel."""
    contours = [projector.contour(ring, GROUND) for ring in rings(face.area)]
    window = Window.around(contours, canvas.shape[1], canvas.shape[0])
    if window is None:
        return
    share = cover(contours, window)
    share *= _brightness(face, window, projector, optics) - table[window.slices]
    canvas[window.slices] += share


def _brightness(face: Face, window: Window, projector: Projector, optics: Optics) -> Field | float:
    if face.facing is not None:
        origin = np.deg2rad(optics.light_from_deg)
        lit = face.facing[0] * np.cos(origin) + face.facing[1] * np.sin(origin)
        return float(optics.wall_dn * face.slab.tone * (1.0 + 0.35 * lit))
    level = optics.slab_dn * face.slab.tone
    if optics.slab_texture <= 0:
        return level
    grain = cv2.warpAffine(
        grain_tile(face.slab.grain),
        _tile_from_window(face.slab, window, projector),
        (window.width, window.height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_WRAP,
    )
    return np.asarray(level * (1.0 + optics.slab_texture * grain), np.float32)


def _tile_from_window(slab: Slab, window: Window, projector: Projector) -> npt.NDArray[np.float64]:
    """Return the affine map (2, 3) from pixels of a window to the slab's texture, which is fixed to its body."""
    reach = 20.0
    body = np.array([[0.0, 0.0, 0.0], [reach, 0.0, 0.0], [0.0, reach, 0.0]])
    tilt = np.deg2rad(slab.frame.a_deg)
    turn = np.array([[np.cos(tilt), -np.sin(tilt), 0.0], [np.sin(tilt), np.cos(tilt), 0.0], [0.0, 0.0, 1.0]])
    seen = projector.pixels(body @ turn.T + (slab.frame.x_mm, slab.frame.y_mm, slab.top_mm))
    tile = body[:, :2] / GRAIN_MM + 256.0
    to_tile = np.asarray(cv2.getAffineTransform(seen.astype(np.float32), tile.astype(np.float32)), np.float64)
    to_tile[:, 2] += to_tile[:, :2] @ (window.left, window.top)
    return to_tile


def _darken_seams(canvas: Field, slabs: Sequence[Slab], projector: Projector, optics: Optics) -> None:
    """Draw the dark joint between slabs that lie against each other."""
    for area, height in seams(slabs, SEAM_MM):
        plane = np.eye(4)
        plane[2, 3] = height
        contours = [projector.contour(ring, plane) for ring in rings(area)]
        window = Window.around(contours, canvas.shape[1], canvas.shape[0])
        if window is not None:
            canvas[window.slices] *= 1.0 - optics.seam_shadow * cover(contours, window)
