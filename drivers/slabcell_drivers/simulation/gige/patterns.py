"""Which picture proves that a frame is whole and its own?  A pattern in which every byte depends on the frame's number.

Every byte differs between one frame and the next 250, so a packet that is missing, misplaced or left over from an
earlier frame cannot go unseen.
"""

import numpy as np
import numpy.typing as npt

__all__ = ["CheckedPattern"]

_STAMP_BYTES = 8
_PERIOD = 251


class CheckedPattern:
    """Renders numbered pictures of one size, and says of a picture which number it is, if it is whole."""

    def __init__(self, width: int = 1920, height: int = 1200) -> None:
        if width < _STAMP_BYTES or height < 1:
            raise ValueError(f"{width}x{height} pixels cannot hold a number of {_STAMP_BYTES} bytes")
        self._base = np.random.default_rng(1).integers(0, 256, (height, width), np.uint8)

    def __call__(self, number: int) -> npt.NDArray[np.uint8]:
        """Return picture ``number``, shape (height, width) uint8."""
        picture = self._base + np.uint8(number % _PERIOD)
        picture[0, :_STAMP_BYTES] = np.frombuffer(number.to_bytes(_STAMP_BYTES, "big"), np.uint8)
        return picture

    def number_of(self, picture: npt.NDArray[np.generic]) -> int | None:
        """Return the number of a picture, None if any byte of it is wrong."""
        if picture.shape != self._base.shape or picture.dtype != np.uint8:
            return None
        number = int.from_bytes(picture[0, :_STAMP_BYTES].tobytes(), "big")
        return number if np.array_equal(picture, self(number)) else None
