"""Which pixels belong to slabs by their colour?  Clusters of colour; the one of the picture's rim is the table.

Source: S. Lloyd, "Least squares quantization in PCM", IEEE Information Theory 28(2), 1982 (k-means), on CIE L*a*b*.
"""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

__all__ = ["cluster"]

Mask = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]

SAMPLES = 20_000
ITERATIONS = 12
# A cluster is slab when it is at least this share of the way from the table's colour to the farthest colour.
SLAB_SHARE = 0.5
# Colours nearer to each other than this (of L*a*b*, where 100 is from black to white) are one.
MIN_DISTANCE = 6.0


def cluster(image: npt.NDArray[Any], classes: int) -> tuple[Mask, str]:
    """Return the mask of what differs from the table in colour, and a description.

    ``image``: (h, w) or (h, w, 3) uint8.  Colour is sampled evenly and clustered from fixed beginnings, so that the
    same picture gives the same mask.
    """
    colours = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    lab = cv2.cvtColor(colours.astype(np.float32) / 255.0, cv2.COLOR_BGR2LAB)
    step = max(1, int(np.sqrt(lab.shape[0] * lab.shape[1] / SAMPLES)))
    sample = lab[::step, ::step].reshape(-1, 3).astype(np.float64)
    centres = _lloyd(sample, classes)
    rim = np.concatenate([lab[0], lab[-1], lab[:, 0], lab[:, -1]]).astype(np.float64)
    table = int(np.argmax(np.bincount(_nearest(rim, centres), minlength=len(centres))))
    away: Floats = np.sqrt(np.sum((centres - centres[table]) ** 2, axis=1))
    if float(away.max()) < MIN_DISTANCE:
        text = f"no slabs: all colours are within {away.max():.1f} of the table's, {MIN_DISTANCE:g} are needed"
        return np.zeros(colours.shape[:2], np.uint8), text
    slab = away >= SLAB_SHARE * away.max()
    best = np.full(colours.shape[:2], np.inf, np.float32)
    mask = np.zeros(colours.shape[:2], np.uint8)
    for centre, is_slab in zip(centres, slab, strict=True):
        distance = np.sum((lab - centre.astype(np.float32)) ** 2, axis=2, dtype=np.float32)
        nearer = distance < best
        best = np.where(nearer, distance, best)
        mask[nearer] = 255 if is_slab else 0
    return mask, f"kmeans: {int(slab.sum())} of {len(centres)} colours are slab, {away.max():.0f} from the table's"


def _lloyd(sample: Floats, classes: int) -> Floats:
    order = np.argsort(sample[:, 0], kind="stable")
    starts = sample[order[((np.arange(classes) + 0.5) / classes * len(order)).astype(np.intp)]]
    # The extremes as well: a small slab is not in any quantile.
    centres = np.vstack(
        [starts[: classes - 1], sample[np.argmax(np.linalg.norm(sample - sample.mean(axis=0), axis=1))]]
    )
    for _ in range(ITERATIONS):
        nearest = _nearest(sample, centres)
        counts = np.bincount(nearest, minlength=len(centres))
        sums = np.stack([np.bincount(nearest, sample[:, axis], minlength=len(centres)) for axis in range(3)], axis=1)
        moved = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], centres)
        if np.allclose(moved, centres, atol=0.01):
            break
        centres = moved
    return centres


def _nearest(points: Floats, centres: Floats) -> npt.NDArray[np.intp]:
    return np.argmin(((points[:, None, :] - centres[None, :, :]) ** 2).sum(axis=2), axis=1)
