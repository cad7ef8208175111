"""Which pictures does a demo come with?  A set to tune on, and graded ones out of jobs that were laid well.

A cell that has worked for a while has both; a demo begins with the first, and gets the others from its own first jobs.
"""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.cell.bundle_file import BundleError
from slabcell.errors import SlabcellError
from slabcell.service.api.context import ApiContext
from slabcell.service.picture_sets import PictureSets
from slabcell.service.recipes import add_graded
from slabcell_drivers.simulation import Scene, World, render_world

__all__ = ["DEMO_SET", "grade_newest", "store_pictures"]

DEMO_SET: Final = "examples"
GRADED: Final = 3
STREWN: Final = 3
DIM: Final = 0.35
"""Of the light that the scene has."""
_SEEDS_AWAY: Final = 1_000_000


def store_pictures(sets: PictureSets, scene: Scene, seed: int) -> None:
    """Keep a few pictures of slabs that lie otherwise, and one in poor light; blocks.  Raises SlabcellError."""
    taken = [render_world(World(scene, seed + _SEEDS_AWAY + number), number) for number in range(STREWN)]
    for number, picture in enumerate(taken, start=1):
        sets.add(DEMO_SET, _png(picture), f"strewn-{number}")
    sets.add(DEMO_SET, _png(np.rint(taken[0] * DIM).astype(taken[0].dtype)), "dim")


def _png(picture: npt.NDArray[Any]) -> bytes:
    done, encoded = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        msg = f"a picture of shape {picture.shape} could not be encoded"
        raise SlabcellError(msg)
    return encoded.tobytes()


async def grade_newest(context: ApiContext) -> Path | None:
    """Add the newest cycle that found a slab for every slot to the recipe's graded set, until it has a few.

    Returns the file, or None where nothing was added.
    """
    recipe, shelf = context.cell.recipe, context.recipes
    if shelf is None:
        return None
    folders = shelf.graded(recipe.name)
    if sum(1 for folder in folders for _ in folder.glob("*.zip")) >= GRADED:
        return None
    rows = await context.history.read(lambda file: file.cycles(before=1 << 60, limit=30))
    for row in rows:
        if row.bundle and not row.verification and json.loads(row.document)["found"] == len(recipe.template.slots):
            try:
                bundle = context.bundles.path(row.bundle)
                found = await asyncio.to_thread(add_graded, shelf.path_of(recipe.name), [bundle], folder=folders[-1])
            except BundleError:  # not kept any more
                continue
            return found[0]
    return None
