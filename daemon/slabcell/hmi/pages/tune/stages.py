"""Through which stages does a picture go, and what belongs to each?  In the order of the vision."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

__all__ = ["STAGES", "Stage"]


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage: the table of its parameters, the times that it is made of, and the buffer that shows its work."""

    name: str
    table: str
    times: tuple[str, ...]
    buffer: str


STAGES: Final = (
    Stage("picture", "gates", ("measure",), "input"),
    Stage("segment", "segmentation", ("segment",), "mask"),
    Stage("blobs", "blobs", ("blobs",), "blobs"),
    Stage("match", "matching", ("match", "register"), "residuals"),
    Stage("grasp", "grasp", ("decide",), "input"),
    Stage("product", "template", (), "contours"),
)
