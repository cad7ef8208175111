"""How do blobs match slots by the methods of the literature?  Hu moments, and sides and angles of simplified polygons.

Both only say which pairs are alike and how much; how a blob lies in its slot is registered afterwards as always, and
the same limits reject what does not fit.  They are here to compare with: they confuse sizes and mirror images, which
the whole-outline registration does not.

Sources: M.-K. Hu, "Visual pattern recognition by moment invariants", IRE Information Theory 8(2), 1962; D. Douglas,
T. Peucker, "Algorithms for the reduction of the number of points", Cartographica 10(2), 1973.
"""

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.recipe import MatchingParameters
from slabcell.vision.shapes import Shapes

__all__ = ["classic_distances", "hu_moments"]

Floats = npt.NDArray[np.float64]


def classic_distances(blobs: Shapes, slots: Shapes, parameters: MatchingParameters) -> Floats:
    """Return how unlike each blob and slot are, as a share of the limit: shape (blobs, slots), infinite beyond it."""
    if parameters.method == "hu":
        first, second = hu_moments(blobs), hu_moments(slots)
        distance = np.linalg.norm(first[:, None, :] - second[None, :, :], axis=2) / parameters.max_hu_distance
    else:
        epsilon = parameters.polygon_epsilon_percent
        ours, theirs = _sides_and_angles(blobs, epsilon), _sides_and_angles(slots, epsilon)
        limits = np.array([[parameters.max_side_difference_mm], [parameters.max_angle_difference_deg]])
        distance = np.full((len(blobs), len(slots)), np.inf)
        for row, polygon in enumerate(ours):
            for column, other in enumerate(theirs):
                if polygon.shape == other.shape:
                    distance[row, column] = np.max(np.abs(polygon - other) / limits)
    return np.where(distance <= 1.0, distance, np.inf)


def hu_moments(shapes: Shapes) -> Floats:
    """Return the seven invariants of the area of each outline: shape (n, 7)."""
    result = np.zeros((len(shapes), 7))
    for index, samples in enumerate(shapes.samples):
        outline = np.column_stack([samples.real, samples.imag]).astype(np.float32)
        result[index] = cv2.HuMoments(cv2.moments(outline)).reshape(-1)
    return result


def _sides_and_angles(shapes: Shapes, epsilon_percent: float) -> list[Floats]:
    """Return (2, corners) for each simplified outline: side lengths in mm and interior angles in degrees, ascending."""
    result: list[Floats] = []
    for samples in shapes.samples:
        outline = np.column_stack([samples.real, samples.imag]).astype(np.float32).reshape(-1, 1, 2)
        epsilon = epsilon_percent / 100.0 * cv2.arcLength(outline, closed=True)
        corners = cv2.approxPolyDP(outline, epsilon, closed=True).reshape(-1, 2).astype(np.float64)
        sides = np.roll(corners, -1, axis=0) - corners
        heading = np.arctan2(sides[:, 1], sides[:, 0])
        # Outlines run counter-clockwise: what a corner turns by is what it lacks to a straight line.
        angles = (180.0 - np.rad2deg(heading - np.roll(heading, 1))) % 360.0
        result.append(np.sort([np.hypot(sides[:, 0], sides[:, 1]), angles], axis=1))
    return result
