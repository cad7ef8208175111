"""How is a result shown, so that a person can check it at a glance?  Draws it over the picture.

Found slabs: outline, slot number, the grasp point as a ring with the direction of the template's X (red) and Y (green)
axes.  Refused blobs: outline in another colour with its number in a list of the reasons.  Everything scales with the
picture, and every stroke lies on a dark one, so that it shows on light and dark alike.
"""

from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.pixels import as_8_bit, as_grey
from slabcell.vision.result import LocatedPart, LocateResult

__all__ = ["draw_overlay"]

Picture = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]

# Blue, green, red; chosen to be told apart by colour-blind people too (Okabe, Ito 2008).
FOUND: Final[Colour] = (233, 180, 86)
REFUSED: Final[Colour] = (0, 94, 230)
AXIS_X: Final[Colour] = (60, 60, 235)
AXIS_Y: Final[Colour] = (90, 200, 60)
PAPER: Final[Colour] = (255, 255, 255)
INK: Final[Colour] = (20, 20, 20)

FONT = cv2.FONT_HERSHEY_SIMPLEX
# Bits of a pixel's fraction that OpenCV's drawing takes.
SHIFT = 4
MAX_LISTED = 12
# A picture narrower than this is enlarged, but not beyond MAX_ENLARGEMENT times.
LEGIBLE_WIDTH = 1200
MAX_ENLARGEMENT = 6


def draw_overlay(image: npt.NDArray[Any], result: LocateResult) -> Picture:
    """Return the picture with the result drawn on it: (h, w, 3) uint8, blue green red.

    It has the picture's size; a small picture is enlarged by a whole factor, so that the writing can be read.
    """
    canvas = _backdrop(image)
    factor = max(1, min(MAX_ENLARGEMENT, round(LEGIBLE_WIDTH / canvas.shape[1])))
    if factor > 1:
        canvas = np.repeat(np.repeat(canvas, factor, axis=0), factor, axis=1)
    unit = max(min(canvas.shape[0], canvas.shape[1] * 0.625) / 1200.0, 0.3)
    for number, blob in enumerate(result.rejected, start=1):
        _outline(canvas, _enlarged(blob.outline_px, factor), REFUSED, unit)
        middle = _enlarged(np.array([blob.u, blob.v]), factor)
        _text(canvas, _letter(number), middle, 0.9 * unit, centred=True, colour=REFUSED)
    for part in result.parts:
        _outline(canvas, _enlarged(part.outline_px, factor), FOUND, unit)
    for part in result.parts:
        _draw_pose(canvas, part, factor, unit)
    _legend(canvas, result, unit)
    return canvas


def _enlarged(points: Points, factor: int) -> Points:
    """Return points of the picture as points of the canvas; pixel centres have whole coordinates in both."""
    return (points + 0.5) * factor - 0.5


def _backdrop(image: npt.NDArray[Any]) -> Picture:
    if image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8:
        return image.astype(np.uint8, copy=True)
    grey = as_8_bit(as_grey(image))
    return np.repeat(grey[:, :, None], 3, axis=2)


def _letter(number: int) -> str:
    """Return A ... Z, then AA, AB, ... : refused blobs have letters, so that nobody takes them for slots."""
    name = ""
    while number > 0:
        number, rest = divmod(number - 1, 26)
        name = chr(ord("A") + rest) + name
    return name


def _fixed(points: Points) -> npt.NDArray[np.int32]:
    bounded = np.clip(points, -30000, 30000)
    return np.rint(bounded * (1 << SHIFT)).astype(np.int32)


def _outline(canvas: Picture, outline: Points, colour: Colour, unit: float) -> None:
    if len(outline) < 2:
        return
    corners = [_fixed(outline).reshape(-1, 1, 2)]
    width = max(1, round(3 * unit))
    cv2.polylines(
        canvas,
        corners,
        isClosed=True,
        color=INK,
        thickness=width + 2 * max(1, round(unit)),
        lineType=cv2.LINE_AA,
        shift=SHIFT,
    )
    cv2.polylines(canvas, corners, isClosed=True, color=colour, thickness=width, lineType=cv2.LINE_AA, shift=SHIFT)


def _draw_pose(canvas: Picture, part: LocatedPart, factor: int, unit: float) -> None:
    angle = np.deg2rad(part.image.angle_deg)
    origin = _enlarged(np.array([part.image.u, part.image.v]), factor)
    ahead = np.array([np.cos(angle), -np.sin(angle)])
    sideways = np.array([-np.sin(angle), -np.cos(angle)])
    length = 46 * unit
    for direction, colour in ((sideways, AXIS_Y), (ahead, AXIS_X)):
        _arrow(canvas, origin, origin + length * direction, colour, unit)
    centre = _point(origin)
    radius = round(9 * unit * (1 << SHIFT))
    cv2.circle(canvas, centre, radius, INK, max(2, round(5 * unit)), cv2.LINE_AA, SHIFT)
    cv2.circle(canvas, centre, radius, PAPER, max(1, round(2.5 * unit)), cv2.LINE_AA, SHIFT)
    # The number stands where neither axis is.
    place = origin - (ahead + sideways) * 30 * unit
    _text(canvas, f"{part.slot}", place, 1.1 * unit, centred=True)


def _arrow(canvas: Picture, start: Points, stop: Points, colour: Colour, unit: float) -> None:
    for ink, width in ((INK, max(2, round(5 * unit))), (colour, max(1, round(3 * unit)))):
        cv2.arrowedLine(canvas, _whole(start), _whole(stop), ink, width, cv2.LINE_AA, 0, 0.25)


def _legend(canvas: Picture, result: LocateResult, unit: float) -> None:
    lines: list[tuple[str, Colour]] = [
        (f"{len(result.parts)} located: outline, slot number, grasp point, X and Y axis", FOUND)
    ]
    if result.empty_slots:
        shown = ", ".join(str(slot) for slot in result.empty_slots[:20])
        more = " ..." if len(result.empty_slots) > 20 else ""
        lines.append((f"{len(result.empty_slots)} slots without a slab: {shown}{more}", PAPER))
    for number, blob in enumerate(result.rejected[:MAX_LISTED], start=1):
        lines.append((f"{_letter(number)} refused, {blob.reason.value}: {_plain(blob.detail)}", REFUSED))
    if len(result.rejected) > MAX_LISTED:
        lines.append((f"... and {len(result.rejected) - MAX_LISTED} more refused", REFUSED))
    scale = 0.75 * unit
    line_height = max(8, round(34 * unit))
    lines = lines[: max(1, canvas.shape[0] // line_height - 1)]
    texts = [_shorten(text, scale, canvas.shape[1]) for text, _ in lines]
    wide = max(cv2.getTextSize(text, FONT, scale, 1)[0][0] for text in texts)
    strip = canvas[: round((len(lines) + 0.4) * line_height), : wide + round(24 * unit)]
    strip //= 3
    for row, (text, (_, colour)) in enumerate(zip(texts, lines, strict=True), start=1):
        _text(canvas, text, np.array([8 * unit + 1, row * line_height]), scale, colour=colour)


def _plain(text: str) -> str:
    """Return the text in the letters that OpenCV's fonts have."""
    return text.replace("mm²", "mm2").replace("°", " deg").encode("ascii", "replace").decode("ascii")


def _shorten(text: str, scale: float, width: int) -> str:
    (needed, _), _ = cv2.getTextSize(text, FONT, scale, 1)
    if needed <= 0.97 * width:
        return text
    return text[: max(1, int(len(text) * 0.97 * width / needed) - 3)] + "..."


def _text(
    canvas: Picture, text: str, at: Points, scale: float, *, centred: bool = False, colour: Colour = PAPER
) -> None:
    width = max(1, round(2.2 * scale))
    (wide, high), _ = cv2.getTextSize(text, FONT, scale, width)
    u, v = (at[0] - wide / 2, at[1] + high / 2) if centred else (at[0], at[1])
    place = _whole(np.array([u, v]))
    cv2.putText(canvas, text, place, FONT, scale, INK, width + max(2, round(3 * scale)), cv2.LINE_AA)
    cv2.putText(canvas, text, place, FONT, scale, colour, width, cv2.LINE_AA)


def _whole(point: Points) -> tuple[int, int]:
    u, v = np.clip(np.rint(point), -30000, 30000)
    return int(u), int(v)


def _point(point: Points) -> tuple[int, int]:
    u, v = _fixed(point)
    return int(u), int(v)
