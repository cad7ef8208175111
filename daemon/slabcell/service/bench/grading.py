"""Does a recipe find again what a person has graded?  One picture after the other, on the bench."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from slabcell.service.bench.wire import Message
from slabcell.service.bench.work import Work
from slabcell.service.recipes import verify

__all__ = ["grade"]


def grade(work: Work) -> Message:
    """Return what `verify` returns of the recipe's file and its graded set, as JSON."""
    said = work.arguments
    done = verify(
        Path(said["recipe"]),
        tolerance_mm=said["tolerance_mm"],
        tolerance_deg=said["tolerance_deg"],
        graded=[Path(folder) for folder in said["graded"]],
        done=lambda at, total, name: work.progress({"done": at, "total": total, "doing": name}),
    )
    return Message({**asdict(done), "passed": done.passed})
