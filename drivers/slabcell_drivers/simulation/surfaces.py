"""How do light, grain and sensor vary over a picture?  Seeded smooth fields and noise."""

from enum import StrEnum
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

__all__ = ["Surface", "grain_tile", "light_field", "sensor_noise", "smooth_noise", "table_grain"]

Field = npt.NDArray[np.float32]


@lru_cache(maxsize=4)
def light_field(width: int, height: int, unevenness: float, seed: int) -> Field:
    """Return the light relative to its mean, peak deviation ``unevenness``: shape (height, width), read-only."""
    random = np.random.default_rng([seed, 1])
    x = np.linspace(-1, 1, width, dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)
    direction = random.uniform(0, 2 * np.pi)
    hot = random.uniform(-0.4, 0.4, 2)
    slope = np.cos(direction) * x[None, :] + np.sin(direction) * y[:, None]
    falloff = -0.6 * ((x[None, :] - hot[0]) ** 2 + (y[:, None] - hot[1]) ** 2)
    field = slope + falloff
    field -= field.mean()
    field /= np.abs(field).max()
    field = (1.0 + unevenness * field).astype(np.float32)
    field.setflags(write=False)
    return field


@lru_cache(maxsize=4)
def table_grain(width: int, height: int, seed: int) -> Field:
    """Return the table's own texture: shape (height, width), unit standard deviation, read-only."""
    field = smooth_noise(width, height, seed)
    field.setflags(write=False)
    return field


def smooth_noise(width: int, height: int, seed: int, cells_px: tuple[float, ...] = (4.0, 16.0, 64.0)) -> Field:
    """Return noise of unit standard deviation with the given sizes of grain, shape (height, width)."""
    random = np.random.default_rng([seed, 2])
    total = np.zeros((height, width), np.float32)
    for cell in cells_px:
        coarse = random.standard_normal((int(height / cell) + 4, int(width / cell) + 4), dtype=np.float32)
        total += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    total -= total.mean()
    return total / max(float(total.std()), 1e-6)


class Surface(StrEnum):
    """What the slabs are made of, as far as it can be seen."""

    PLAIN = "plain"  # card, concrete: cloudy
    GRANITE = "granite"  # dark and light speckles
    MARBLE = "marble"  # winding dark veins
    SLATE = "slate"  # fine layers


@lru_cache(maxsize=64)
def grain_tile(grain: int, surface: Surface) -> Field:
    """Return the surface texture number ``grain``: 512 x 512 cells, unit standard deviation, read-only."""
    size = 512
    clouds = smooth_noise(size, size, grain, (2.0, 6.0, 30.0))
    if surface is Surface.GRANITE:
        specks = smooth_noise(size, size, grain + 1, (2.0, 3.5))
        clouds = 0.5 * clouds - 2.5 * (specks > 1.3) + 1.5 * (specks < -1.5)
    elif surface is Surface.MARBLE:
        bend = smooth_noise(size, size, grain + 1, (40.0, 120.0))
        across = np.linspace(0, 9, size, dtype=np.float32)[None, :] + 0.9 * bend
        clouds = 0.4 * clouds - 3.0 * np.exp(-((np.sin(np.pi * across) / 0.12) ** 2))
    elif surface is Surface.SLATE:
        layers = smooth_noise(size // 8, size, grain + 1, (1.5, 5.0))
        clouds = 0.3 * clouds + cv2.resize(layers, (size, size), interpolation=cv2.INTER_CUBIC)
    tile = np.asarray(clouds, np.float32)
    tile -= tile.mean()
    tile /= max(float(tile.std()), 1e-6)
    tile.setflags(write=False)
    return tile


def sensor_noise(image: Field, read_dn: float, shot_dn: float, seed: tuple[int, ...]) -> Field:
    """Return the picture with the sensor's noise: variance read_dn² + shot_dn·level."""
    random = np.random.default_rng([*seed, 3])
    spread = np.sqrt(np.maximum(image, 0.0) * np.float32(shot_dn) + np.float32(read_dn**2))
    return image + spread * random.standard_normal(image.shape, dtype=np.float32)
