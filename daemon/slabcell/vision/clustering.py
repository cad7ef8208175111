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
# Bits of each channel by which colours are told apart when the whole picture is painted.
BITS = 6


def cluster(image: npt.NDArray[Any], classes: int) -> tuple[Mask, str]:
    """Return the mask of what differs from the table in colour, and a description.

    ``image``: (h, w) or (h, w, 3) uint8.  Colour is sampled evenly and clustered from fixed beginnings, so that the
    same picture gives the same mask.
    """
    sample = _lab(_every(image, max(1, int(np.sqrt(image.shape[0] * image.shape[1] / SAMPLES)))))
    centres = _lloyd(sample, classes)
    rim = _lab(np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]]))
    table = int(np.argmax(np.bincount(_nearest(rim, centres), minlength=len(centres))))
    away: Floats = np.sqrt(np.sum((centres - centres[table]) ** 2, axis=1))
    if float(away.max()) < MIN_DISTANCE:
        text = f"no slabs: all colours are within {away.max():.1f} of the table's, {MIN_DISTANCE:g} are needed"
        return np.zeros(image.shape[:2], np.uint8), text
    slab = away >= SLAB_SHARE * away.max()
    text = f"kmeans: {int(slab.sum())} of {len(centres)} colours are slab, {away.max():.0f} from the table's"
    return _painted(image, centres, slab), text


def _every(image: npt.NDArray[Any], step: int) -> npt.NDArray[Any]:
    """Return every so many pixels of both directions in one row."""
    chosen = image[::step, ::step]
    return chosen.reshape(-1, *chosen.shape[2:])


def _lab(colours: npt.NDArray[Any]) -> Floats:
    """Return (n, 3) L*a*b* of grey (n,) or blue green red (n, 3), uint8."""
    three = colours if colours.ndim == 2 else np.repeat(colours[:, None], 3, axis=1)
    lab: Any = cv2.cvtColor(three[None].astype(np.float32) / 255.0, cv2.COLOR_BGR2LAB)
    return np.asarray(lab, np.float64).reshape(-1, 3)


def _painted(image: npt.NDArray[Any], centres: Floats, slab: npt.NDArray[np.bool_]) -> Mask:
    """Return 255 where the nearest centre is a slab's, by a table of all greys, or of all colours of 6 bits."""
    if image.ndim == 2:
        values = np.where(slab[_nearest(_lab(np.arange(256, dtype=np.uint8)), centres)], 255, 0).astype(np.uint8)
        return np.asarray(cv2.LUT(image, values), np.uint8)
    codes = np.arange(1 << (3 * BITS), dtype=np.uint32)
    channels = np.column_stack([codes >> (2 * BITS), codes >> BITS, codes]) & ((1 << BITS) - 1)
    # The middle of each cell of the table.
    colours = (channels << (8 - BITS)) + (1 << (7 - BITS))
    values = np.where(slab[_nearest(_lab(colours), centres)], 255, 0).astype(np.uint8)
    coarse = (image >> (8 - BITS)).astype(np.uint32)
    return values[(coarse[:, :, 0] << (2 * BITS)) | (coarse[:, :, 1] << BITS) | coarse[:, :, 2]]


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
