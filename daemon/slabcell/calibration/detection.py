"""Where are the board's points in this picture?  Detection of any kind of board, on one picture or many.

The points come back in the board's own numbering (see `boards`), so that two pictures of one board agree on its frame.
"""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from slabcell.calibration.boards import Board
from slabcell.calibration.charuco import find_charuco
from slabcell.calibration.checkerboard import find_checkerboard
from slabcell.calibration.circles import disc_shift, find_circles
from slabcell.calibration.corners import Found
from slabcell.calibration.model import Lens
from slabcell.calibration.projection import Vector, board_pose
from slabcell.errors import ImageError
from slabcell.geometry import Points

__all__ = ["Detection", "Picture", "best_variant", "detect_board", "detect_boards", "to_grey"]

Picture = npt.NDArray[np.generic]
"""A picture: shape (height, width) or (height, width, 3 or 4), 8 or 16 bit."""

MAX_SIDE = 20_000
MIN_SIDE = 32


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """The points of one board found in one picture.

    ``points_mm`` (n, 3) in the board's frame and ``pixels`` (n, 2) belong together row by row; ``indices`` are the
    points' numbers on the board.  ``variants`` are the pixels as windows of several widths refine them, the widest
    first; ``pixels`` is one of them.  ``disc_mm`` is the diameter of the discs whose centres the points are, else 0.
    """

    name: str
    width: int
    height: int
    indices: npt.NDArray[np.int64]
    points_mm: Points
    pixels: Points
    variants: tuple[tuple[int, Points], ...] = ()
    note: str = ""
    disc_mm: float = 0.0

    def centred(self, lens: Lens, pose: Vector | None = None) -> "Detection":
        """Return the detection with the pixels of the discs' centres, not the centres of the discs' pictures."""
        if self.disc_mm <= 0.0:
            return self
        seen = board_pose(self.points_mm, self.pixels, lens) if pose is None else pose
        return replace(self, pixels=self.pixels - disc_shift(self.points_mm, self.disc_mm, seen, lens))

    def variant(self, number: int) -> "Detection":
        """Return the detection with the pixels of another window."""
        return replace(self, pixels=self.variants[min(number, len(self.variants) - 1)][1]) if self.variants else self


def best_variant(detections: Sequence[Detection], residual: Callable[[Sequence[Detection]], float]) -> list[Detection]:
    """Return the detections with the width of window that leaves the smallest residual; at a draw the widest.

    Of a narrower window a residual is believed only if it is smaller by 3 %.
    """
    count = max((len(d.variants) for d in detections), default=0)
    best, least = list(detections), np.inf
    for number in range(count):
        trial = [d.variant(number) for d in detections]
        left = residual(trial)
        if left < 0.97 * least:
            best, least = trial, left
    return best


def to_grey(picture: Picture, name: str) -> npt.NDArray[np.uint8]:
    """Return the picture as 8 bit grey; 16 bit pictures are stretched to their brightest pixel.  Raises ImageError."""
    if picture.ndim not in (2, 3) or not all(MIN_SIDE <= side <= MAX_SIDE for side in picture.shape[:2]):
        raise ImageError(
            f"{name}: a picture of shape {picture.shape} holds no board; sides of {MIN_SIDE} to {MAX_SIDE} pixels can"
        )
    if picture.ndim == 3:
        if picture.shape[2] not in (1, 3, 4):
            raise ImageError(f"{name}: a picture of {picture.shape[2]} channels is neither grey nor colour")
        picture = picture[:, :, 0] if picture.shape[2] == 1 else picture[:, :, :3].mean(axis=2).astype(picture.dtype)
    if picture.dtype == np.uint8:
        return np.ascontiguousarray(picture, dtype=np.uint8)
    if picture.dtype != np.uint16:
        raise ImageError(f"{name}: pixels of type {picture.dtype} are not understood; save it with 8 or 16 bit")
    top = max(int(picture.max()), 1)
    return np.ascontiguousarray((picture.astype(np.float32) * (255.0 / top)).round(), dtype=np.uint8)


def detect_board(picture: Picture, board: Board, name: str) -> Detection:
    """Return the board's points in one picture.  Raises ImageError if the board is not found in it."""
    grey = to_grey(picture, name)
    found = _finder(board)(grey, board)
    if found is None:
        raise ImageError(f"{name}: no {board} found; {_HINTS[board.kind]}, and COLUMNSxROWS must be the board's")
    return Detection(
        name,
        grey.shape[1],
        grey.shape[0],
        found.indices,
        board.points[found.indices],
        found.variants[0][1],
        found.variants,
        found.note,
        board.diameter_mm,
    )


def detect_boards(
    pictures: Iterable[tuple[str, Picture]],
    board: Board,
    *,
    workers: int = 2,
    done: Callable[[str], None] | None = None,
) -> tuple[list[Detection], list[str]]:
    """Return the detections in the order of the pictures, and one line for every picture that has none.

    ``done`` is called with the name of each finished picture, in order.
    """
    detections: list[Detection] = []
    failures: list[str] = []
    running: deque[tuple[str, Future[Detection]]] = deque()

    def finish() -> None:
        name, future = running.popleft()
        try:
            detections.append(future.result())
        except ImageError as error:
            failures.append(str(error))
        if done is not None:
            done(name)

    with ThreadPoolExecutor(workers) as pool:
        for name, picture in pictures:
            running.append((name, pool.submit(detect_board, picture, board, name)))
            if len(running) > 2 * workers:  # so that a long list of large pictures is never in memory at once
                finish()
        while running:
            finish()
    return detections, failures


_HINTS = {
    "checkerboard": "the whole board must be visible and sharp, best with a light margin of one square around it",
    "charuco": "at least six of its corners must be visible and sharp, and dictionary and marker size must be right",
    "circles": "all circles must be visible and sharp",
}


def _finder(board: Board) -> Callable[[npt.NDArray[np.uint8], Board], Found | None]:
    if board.kind == "checkerboard":
        return find_checkerboard
    return find_charuco if board.kind == "charuco" else find_circles
