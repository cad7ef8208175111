"""Where does the joint between two slabs run that touch, and how wide is it?  Measures a fine line, if one is seen.

The profile across the joint is fitted by two grey levels, one slope and a line as wide as the blur, dark or light.
The position of the line is what is asked; the light that it takes away says how wide a gap shows the table.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.vision.edge_profile import EdgeLines, ProfileModel, collect_profiles
from slabcell.vision.pixels import Grey

__all__ = ["Seams", "measure_seams"]

Floats = npt.NDArray[np.float64]

ITERATIONS = 6
# Share of the grey beside the line by which it must differ.
MIN_DEPTH = 0.03
# Columns: level, slope, step, line, shift of the line.
LINE, SHIFT = 3, 4


@dataclass(frozen=True, slots=True, eq=False)
class Seams:
    """Lines near pieces of edge; arrays over pieces.

    ``shift`` px outward and its standard deviation ``sigma``; ``gap`` px: width of a gap as bright as the table that
    would make the line; ``valid``: whether there is a line.
    """

    shift: Floats
    sigma: Floats
    gap: Floats
    valid: npt.NDArray[np.bool_]


def measure_seams(grey: Grey, lines: EdgeLines, model: ProfileModel, table: float) -> Seams:
    """Return the line near each piece; ``table`` is the grey level of the table."""
    flat = EdgeLines.of(lines.middle, lines.outward, lines.half, lines.bend, np.zeros(len(lines)))
    count, depth, level = collect_profiles(grey, flat, model)
    pieces = len(count)
    width = np.full(pieces, 1.2 * model.sigma_px)
    smooth = _smooth(level, count)
    usual = np.median(smooth, axis=1, keepdims=True)
    strongest = np.argmax(np.where(count > 0, np.abs(smooth - usual), -1.0), axis=1)
    position = -depth[np.arange(pieces), strongest]
    amplitude = np.zeros(pieces)
    normal = np.zeros((pieces, 5, 5))
    variance = np.zeros(pieces)
    base = np.ones(pieces)
    for _ in range(ITERATIONS):
        away = (depth + position[:, None]) / width[:, None]
        bell = np.exp(-0.5 * away * away)
        columns = np.stack(
            [np.ones_like(depth), depth, np.tanh(away), bell, amplitude[:, None] * -away / width[:, None] * bell],
            axis=1,
        )
        weighted = columns * count[:, None, :]
        normal = weighted @ columns.transpose(0, 2, 1) + np.eye(5) * 1e-3
        right = (weighted @ level[:, :, None])[:, :, 0]
        solution: Floats = np.linalg.solve(normal, right[:, :, None])[:, :, 0].astype(np.float64, copy=False)
        error = level - (columns.transpose(0, 2, 1) @ solution[:, :, None])[:, :, 0]
        variance = np.sum(count * error * error, axis=1) / np.maximum((count > 0).sum(axis=1) - 5, 1)
        base, amplitude = solution[:, 0], solution[:, LINE]
        position = np.clip(position + np.clip(solution[:, SHIFT], -1.0, 1.0), -model.reach_px, model.reach_px)
    spread: Floats = np.linalg.inv(normal)[:, SHIFT, SHIFT].astype(np.float64, copy=False)
    sigma = np.sqrt(np.maximum(spread * np.maximum(variance, 0.25), 1e-12))
    noise = np.sqrt(np.maximum(variance, 0.25))
    valid = (np.abs(amplitude) > MIN_DEPTH * np.abs(base)) & (np.abs(amplitude) > 1.5 * noise) & (sigma < 0.3)
    valid &= (np.abs(position) < model.reach_px - 2.0) & (count.sum(axis=1) > 40)
    full = np.where(np.abs(table - base) < 1.0, 1.0, table - base)
    gap = np.clip(amplitude * width * np.sqrt(2.0 * np.pi) / full, 0.0, model.reach_px)
    return Seams(position, sigma, gap, valid)


def _smooth(level: Floats, count: Floats) -> Floats:
    """Return the mean of each bin with its neighbours, so that an empty or noisy bin does not stand out."""
    padded = np.pad(level * count, ((0, 0), (2, 2)))
    weights = np.pad(count, ((0, 0), (2, 2)))
    bins = level.shape[1]
    total = np.sum([padded[:, step : step + bins] for step in range(5)], axis=0)
    weight = np.sum([weights[:, step : step + bins] for step in range(5)], axis=0)
    return np.where(weight > 0, total / np.maximum(weight, 1.0), 0.0)
