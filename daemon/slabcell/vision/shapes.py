"""What does an outline look like in numbers?  Samples, moments and spectra of several outlines in one frame.

This holds the reference implementation, in NumPy; `kernel` runs the same in C where that was compiled.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.outline import Rings
from slabcell.vision.plane import PixelTable

__all__ = ["ENOUGH", "HARMONICS", "SAMPLES", "Shapes", "Spectra", "describe", "describe_pixels", "spectra_of"]

Floats = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
Index = npt.NDArray[np.int64]

SAMPLES = 128
# Harmonics whose magnitudes are compared first: half of them on either side.
HARMONICS = 24
# Points of an outline in pixels that are enough to describe it: of a longer one every second or third is taken.
ENOUGH = 128


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """Fourier transforms of outlines.

    ``values`` (n, SAMPLES) complex; ``energy`` (n,): sum of their squares; ``magnitudes`` (n, HARMONICS): those of the
    first harmonics, which neither a rotation nor another starting point changes.
    """

    values: Complex
    energy: Floats
    magnitudes: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Several outlines in one frame.

    ``samples`` (n, SAMPLES) complex, x + iy in mm, counter-clockwise at equal arc lengths, minus ``middle``; ``middle``
    (n,) complex mean of the samples; ``area_mm2``, ``inertia`` (n,): area, and polar second moment over area squared;
    ``centroid`` (n, 2); ``spectra`` of the samples; ``normals`` (n, SAMPLES) complex, outward at each sample, or None.
    """

    samples: Complex
    middle: Complex
    area_mm2: Floats
    inertia: Floats
    centroid: Points
    spectra: Spectra
    normals: Complex | None = None

    def __len__(self) -> int:
        return len(self.middle)

    def with_normals(self, normals: Complex) -> Self:
        """Return the same with the normals of the samples."""
        return replace(self, normals=normals)


def describe(rings: Rings) -> Shapes:
    """Return the features of polygons in mm, whichever way they turn."""
    rings = rings.counter_clockwise()
    area, centroid, inertia = rings.moments
    points = rings.resampled(SAMPLES)
    samples = points[:, :, 0] + 1j * points[:, :, 1]
    middle = samples.mean(axis=1)
    samples = samples - middle[:, None]
    return Shapes(samples, middle, np.abs(area), inertia, centroid, spectra_of(samples))


def describe_pixels(table: PixelTable, pixels: Points, begins: Index, ends: Index) -> Shapes:
    """Return what `describe` returns of outlines in pixels, taken to the plane.

    ``pixels`` (n, 2) hold all; outline i is ``begins[i]`` to ``ends[i]``.
    """
    outlines = [pixels[begin:end] for begin, end in zip(begins, ends, strict=True)]
    rings = Rings.of([outline[:: max(1, len(outline) // ENOUGH)] for outline in outlines])
    return describe(rings.moved(table.at(rings.points)))


def spectra_of(samples: Complex) -> Spectra:
    """Return the Fourier transforms of samples (n, SAMPLES)."""
    values = np.fft.fft(samples, axis=1)
    near = np.arange(1, HARMONICS // 2 + 1)
    low = np.stack([np.abs(values[:, near]), np.abs(values[:, -near])], axis=-1)
    energy = np.sum(values.real**2 + values.imag**2, axis=1)
    return Spectra(values, energy, low.reshape(-1, HARMONICS))
