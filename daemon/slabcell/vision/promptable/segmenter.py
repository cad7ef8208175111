"""How does a promptable model segment a picture?  Coarse blobs are its prompts, templates judge its masks.

A coarse blob for which the model gave no mask that could be a slab stays as it is, so that the result says of it why it
is refused.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.recipe import PromptableParameters
from slabcell.vision.blobs import Blobs, RawBlob
from slabcell.vision.prepared import Prepared
from slabcell.vision.promptable.candidates import outline_of, select
from slabcell.vision.promptable.contract import open_files
from slabcell.vision.promptable.model import Colour, PromptableModel
from slabcell.vision.promptable.prompts import prompts_of
from slabcell.vision.promptable.session import Deadline
from slabcell.vision.segmentation import Segmentation

__all__ = ["PromptableSegmenter"]

# A coarse blob is explained when masks cover this share of it; below the other it stays as a blob of its own.
EXPLAINED: Final = 0.2


class PromptableSegmenter:
    """A promptable model and how it is used.  Opening the files takes seconds: make it once."""

    def __init__(self, parameters: PromptableParameters) -> None:
        """Open the model's files.  Raises ModelError."""
        decoder = None if parameters.decoder is None else Path(parameters.decoder)
        self._parameters = parameters
        self._model = PromptableModel(open_files(Path(parameters.encoder), decoder, parameters.threads))

    def segment(
        self, image: npt.NDArray[Any], coarse: Segmentation, blobs: Blobs, prepared: Prepared
    ) -> tuple[Segmentation, Blobs]:
        """Return the mask and the blobs of the slabs in a picture whose coarse blobs are known.

        Raises ImageError where the model takes too long, ModelError where it fails.
        """
        parameters = self._parameters
        deadline = Deadline(parameters.max_seconds)
        areas = prepared.shapes.area_mm2 / prepared.plane.mm_per_px**2
        largest = float(areas.max()) * (1.0 + parameters.area_tolerance)
        prompts = prompts_of(coarse.mask, blobs, largest, parameters.max_prompts)
        picture = _colour(image, coarse.picture)
        logits = list(self._model.masks(picture, [prompt for _, prompt in prompts], deadline))
        selection = select(logits, prepared, picture.shape[:2], parameters)
        rest = [blob for blob in blobs if _explained(blob, selection.shapes) < EXPLAINED]
        kept = sorted([*selection.blobs, *rest], key=lambda blob: -blob.area_px)
        mask = np.zeros(coarse.mask.shape, np.uint8)
        for blob in kept:
            cv2.fillPoly(mask, [np.rint(blob.polygon).astype(np.int32)], 255)
        text = (
            f"promptable model ({self._model.name}): {len(prompts)} prompts from {coarse.description};"
            f" {len(selection.blobs)} masks kept, left out {selection.wrong} of no slot's area and inertia,"
            f" {selection.unstable} not firm, {selection.repeated} that overlap a better one"
        )
        return replace(coarse, level=None, made=mask, description=text), Blobs.of(kept)


def _explained(blob: RawBlob, shapes: list[Any]) -> float:
    """Return which share of a coarse blob is covered by masks."""
    outline = outline_of(blob)
    if outline.area <= 0.0:
        return 0.0
    return sum(float(outline.intersection(shape).area) for shape in shapes) / float(outline.area)


def _colour(image: npt.NDArray[Any], picture: npt.NDArray[np.uint8]) -> Colour:
    """Return the picture with three channels of 8 bits; ``picture`` is its grey version of 8 bits."""
    if image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8:
        return image.astype(np.uint8, copy=False)
    return np.repeat(picture[:, :, None], 3, axis=2)
