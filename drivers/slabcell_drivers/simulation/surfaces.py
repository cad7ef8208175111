"""How do light, grain and sensor vary over a picture?  Seeded smooth fields and noise."""

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

__all__ = ["grain_tile", "light_field", "sensor_noise", "smooth_noise"]

Field = npt.NDArray[np.float32]


def light_field(width: int, height: int, unevenness: float, seed: int) -> Field:
    """Return the light over a picture relative to its mean, shape (height, width); peak deviation ``unevenness``."""
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
    return (1.0 + unevenness * field).astype(np.float32)


def smooth_noise(width: int, height: int, seed: int, cells_px: tuple[float, ...] = (4.0, 16.0, 64.0)) -> Field:
    """Return noise of unit standard deviation with the given sizes of grain, shape (height, width)."""
    random = np.random.default_rng([seed, 2])
    total = np.zeros((height, width), np.float32)
    for cell in cells_px:
        coarse = random.standard_normal((int(height / cell) + 4, int(width / cell) + 4), dtype=np.float32)
        total += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    total -= total.mean()
    return total / max(float(total.std()), 1e-6)


@lru_cache(maxsize=64)
def grain_tile(grain: int) -> Field:
    """Return the surface texture number ``grain``: 512 x 512 cells, unit standard deviation, read-only."""
    tile = smooth_noise(512, 512, grain, (2.0, 6.0, 30.0))
    tile.setflags(write=False)
    return tile


def sensor_noise(image: Field, read_dn: float, shot_dn: float, seed: tuple[int, ...]) -> Field:
    """Return the picture with the sensor's noise: variance read_dn² + shot_dn·level."""
    random = np.random.default_rng([*seed, 3])
    spread = np.sqrt(np.maximum(image, 0.0) * np.float32(shot_dn) + np.float32(read_dn**2))
    return image + spread * random.standard_normal(image.shape, dtype=np.float32)
