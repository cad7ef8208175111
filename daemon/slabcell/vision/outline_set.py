"""What outlines can lie in a picture?  Their measurable pieces, all together, made once for many pictures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points, Polygon
from slabcell.vision.edge_projection import Outlines
from slabcell.vision.edges import EdgePieces

__all__ = ["OutlineSet"]


@dataclass(frozen=True, eq=False)
class OutlineSet:
    """Outlines in their own frames: ``pieces`` of each, and ``pivots`` (n, 2), the middle of each, mm."""

    pieces: tuple[EdgePieces, ...]
    pivots: Points

    @classmethod
    def of(cls, polygons: Sequence[Polygon], pieces: Sequence[EdgePieces]) -> "OutlineSet":
        """Return polygons, each turned about its centroid."""
        return cls(tuple(pieces), np.array([polygon.centroid for polygon in polygons]).reshape(-1, 2))

    def __len__(self) -> int:
        return len(self.pieces)

    @cached_property
    def whole(self) -> Outlines:
        """All pieces."""
        return Outlines.of(self.pieces)

    @cached_property
    def few(self) -> Outlines:
        """Some pieces of each."""
        return Outlines.of([item.few for item in self.pieces])

    @cached_property
    def probes(self) -> Outlines:
        """The pieces of each that the picture is asked at."""
        return Outlines.of([item.probes for item in self.pieces])

    @cached_property
    def counts(self) -> npt.NDArray[np.int64]:
        """How many pieces each has, (n,)."""
        return np.diff(self.whole.starts)

    @cached_property
    def reaches_mm(self) -> npt.NDArray[np.float64]:
        """How far from its pivot each outline reaches, (n,)."""
        # The mean of the pieces is not the pivot: allow for the distance between both.
        return np.array(
            [
                item.reach_mm + math.dist(item.mean, pivot) if len(item) else 0.0
                for item, pivot in zip(self.pieces, self.pivots.tolist(), strict=True)
            ]
        )
