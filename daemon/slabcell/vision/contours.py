"""Where do the outlines of the light or dark regions of a picture run, to a fraction of a pixel?

The border of a region is followed from pixel to pixel, along the cracks between a pixel inside and one outside.  Each
crack gives one point: where the grey level between both centres passes the threshold.  Regions that touch by a corner
are one.  Borders of holes are left out.

This is the reference implementation, in plain Python; `kernel` runs the same in C where that was compiled.

Source of the walk along cracks: A. Rosenfeld, A. Kak, "Digital Picture Processing", 1982, section 11.1.3; of the
interpolation: W. Lorensen, H. Cline, "Marching cubes", SIGGRAPH 1987, in two dimensions.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points

__all__ = ["Contours", "trace"]

Picture = npt.NDArray[np.uint8]

# Outside of a crack, seen from its pixel: left, up, right, down; the walk goes on to the next, clockwise as seen.
SIDES = ((-1, 0), (0, -1), (1, 0), (0, 1))


@dataclass(frozen=True, slots=True, eq=False)
class Contours:
    """Borders of regions, clockwise as the picture is seen.

    ``points`` (n, 2): u and v of all, one border after the other; ``starts`` (borders + 1,): where each begins;
    ``area_px`` (borders,): what each encloses; ``touches_rim`` (borders,): the picture's rim cuts it; ``left_out``: how
    many smaller ones there were, of those that were found.
    """

    points: Points
    starts: npt.NDArray[np.int64]
    area_px: npt.NDArray[np.float64]
    touches_rim: npt.NDArray[np.bool_]
    left_out: int

    def __len__(self) -> int:
        return len(self.area_px)


def trace(
    picture: Picture, level: float, *, dark: bool, interpolate: bool, min_area_px: float, row_shift: int = 0
) -> Contours:
    """Return the borders of the regions above ``level``, or not above it if ``dark``, of at least this area.

    ``picture`` (h, w).  ``interpolate``: place the points by the grey levels, else half way between pixels (a mask).
    ``row_shift``: regions are found on every 2^row_shift-th row of the picture; what lies between two of them is not.
    """
    height, width = picture.shape
    if not 0 <= np.floor(level) <= 254:
        return Contours(np.zeros((0, 2)), np.zeros(1, np.int64), np.zeros(0), np.zeros(0, np.bool_), 0)
    inside = np.zeros((height + 2, width + 2), np.bool_)
    inside[1:-1, 1:-1] = (picture > np.floor(level)) != dark
    borders: list[Points] = []
    areas: list[float] = []
    rims: list[bool] = []
    seen: set[tuple[int, int]] = set()
    left_out = 0
    for v, u in np.argwhere(inside[1:-1, 1:-1] & ~inside[1:-1, :-2]).tolist():
        if v % (1 << row_shift) or (u, v) in seen:
            continue
        points, touches = _follow(picture, inside, level, u, v, seen, interpolate=interpolate)
        if (len(points) / 4.0) ** 2 < min_area_px:
            left_out += 1
            continue
        following = np.roll(points, -1, axis=0)
        area = 0.5 * float(np.sum(points[:, 0] * following[:, 1] - following[:, 0] * points[:, 1]))
        if area >= min_area_px:
            borders.append(points)
            areas.append(area)
            rims.append(touches)
        elif area > 0.0:
            left_out += 1
    starts = np.cumsum([0, *(len(border) for border in borders)]).astype(np.int64)
    joined = np.concatenate([*borders, np.zeros((0, 2))])
    return Contours(joined, starts, np.array(areas), np.array(rims, np.bool_), left_out)


def _follow(
    picture: Picture,
    inside: npt.NDArray[np.bool_],
    level: float,
    u: int,
    v: int,
    seen: set[tuple[int, int]],
    *,
    interpolate: bool,
) -> tuple[Points, bool]:
    """Return one border from the left side of a pixel on; ``inside`` has a rim of one pixel around the picture."""
    height, width = picture.shape
    start, side, touches = (u, v), 0, False
    points: list[tuple[float, float]] = []
    while True:
        if side == 0:
            seen.add((u, v))
        du, dv = SIDES[side]
        share = 0.5
        if not (0 <= u + du < width and 0 <= v + dv < height):
            touches = True
        elif interpolate:
            mine, other = float(picture[v, u]), float(picture[v + dv, u + du])
            share = (mine - level) / (mine - other)
        points.append((u + share * du, v + share * dv))
        ahead = (side + 1) % 4
        eu, ev = SIDES[ahead]
        if inside[v + dv + ev + 1, u + du + eu + 1]:
            u, v, side = u + du + eu, v + dv + ev, (side + 3) % 4
        elif inside[v + ev + 1, u + eu + 1]:
            u, v = u + eu, v + ev
        else:
            side = ahead
        if (u, v) == start and side == 0:
            return np.array(points), touches
