"""How does brightness become numbers?  The sensor's noise and its depth, in grey or colour."""

import numpy as np
import numpy.typing as npt

from slabcell_drivers.camera.protocol import Pixels
from slabcell_drivers.simulation.scene import Optics
from slabcell_drivers.simulation.surfaces import sensor_noise

__all__ = ["digitise"]

Field = npt.NDArray[np.float32]


def digitise(image: Field, optics: Optics, seed: tuple[int, ...], bits: int = 8) -> Pixels:
    """Return what a sensor of 8, 10, 12 or 16 bits makes of a brightness in grey levels of 8 bits; the shape stays.

    Eight bits are uint8; more are uint16 with the value in the upper bits, so that full scale is that of 16 bits, as
    the real drivers deliver them.  Raises ValueError for another depth.
    """
    if bits not in (8, 10, 12, 16):
        msg = f"a sensor of {bits} bits is not simulated: 8, 10, 12 or 16"
        raise ValueError(msg)
    noisy = sensor_noise(image, optics.noise_dn, optics.shot_dn, seed)
    if bits == 8:
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    top = (1 << bits) - 1
    levels = np.clip(np.rint(noisy * (top / 255.0)), 0, top)
    return (levels * (1 << (16 - bits))).astype(np.uint16)
