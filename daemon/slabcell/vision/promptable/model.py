"""What does a promptable model say of a picture and of prompts in it?  Logits on its own grid, and where that lies.

The picture is encoded once; each prompt is a run of the decoder.  Decoders of Segment Anything are asked for their
low-resolution logits: the full-size masks of its export keep the aspect ratio of the picture it was traced with.

Source: A. Kirillov and others, "Segment Anything", ICCV 2023; N. Ravi and others, "SAM 2", 2024; Y. Xiong and others,
"EfficientSAM", CVPR 2024.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.promptable.contract import SAM2_FEATURES, Family, ModelFiles
from slabcell.vision.promptable.errors import ModelError
from slabcell.vision.promptable.session import TYPES, Deadline, Model

__all__ = ["Logits", "Prompt", "PromptableModel"]

Array = npt.NDArray[Any]
Floats32 = npt.NDArray[np.float32]
Colour = npt.NDArray[np.uint8]

SIDE: Final = 1024
MEAN: Final = np.array([123.675, 116.28, 103.53], np.float32)
DEVIATION: Final = np.array([58.395, 57.12, 57.375], np.float32)
# Meaning of a point's label: padding, on the object, first and second corner of a box.
PADDING, ON, FIRST, SECOND = -1.0, 1.0, 2.0, 3.0
# Prompts that EfficientSAM in one file is asked at once: each time it encodes the picture again.
AT_ONCE: Final = 16
MAX_ALTERNATIVES: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class Prompt:
    """What is asked for: ``points`` (n, 2) pixels on the object, and ``box`` (left, top, right, bottom) around it."""

    points: Points
    box: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Logits:
    """``values`` (alternatives, rows, columns): positive on the object; ``per_u``, ``per_v``: cells a pixel.

    Pixel u is at column (u + ½)·per_u - ½.
    """

    values: Floats32
    per_u: float
    per_v: float


@dataclass(frozen=True, slots=True, eq=False)
class _Encoded:
    """What the encoder made of a picture, and how that was scaled."""

    features: dict[str, Array]
    width: int
    height: int
    scale_u: float
    scale_v: float


class PromptableModel:
    """An opened model of any family."""

    def __init__(self, files: ModelFiles) -> None:
        self._files = files

    @property
    def name(self) -> str:
        """The family."""
        return str(self._files.family)

    def masks(self, picture: Colour, prompts: Sequence[Prompt], deadline: Deadline) -> Iterator[Logits]:
        """Yield the logits of each prompt, in their order.

        ``picture`` (h, w, 3) blue green red, uint8.  Raises ImageError after the deadline, ModelError where the model
        fails or gives what its family does not.
        """
        if not prompts:
            return
        encoded = self._encode(picture, deadline)
        if self._files.family in (Family.SAM, Family.SAM2):
            for prompt in prompts:
                yield self._decode(encoded, prompt, deadline)
            return
        most = self._files.decoder.inputs["batched_point_coords"].shape[1]
        step = most or (AT_ONCE if self._files.family is Family.EFFICIENT_WHOLE else 1)
        for begin in range(0, len(prompts), step):
            yield from self._decode_batch(encoded, prompts[begin : begin + step], most, deadline)

    def _encode(self, picture: Colour, deadline: Deadline) -> _Encoded:
        rows, columns = picture.shape[:2]
        family, shape = self._files.family, self._files.picture.shape
        scale = SIDE / max(rows, columns)
        height, width = max(round(rows * scale), 1), max(round(columns * scale), 1)
        if family is Family.SAM2:
            height = width = SIDE
        elif family is not Family.SAM and (shape[2] or shape[3]):
            height, width = shape[2] or SIDE, shape[3] or SIDE
        shrinks = width < columns
        resized = cv2.resize(
            cv2.cvtColor(picture, cv2.COLOR_BGR2RGB),
            (width, height),
            interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR,
        ).astype(np.float32)
        if family is Family.SAM and len(shape) == 3:
            tensor = resized
        elif family in (Family.SAM, Family.SAM2):
            tensor = np.zeros((1, 3, SIDE, SIDE), np.float32)
            tensor[0, :, :height, :width] = ((resized - MEAN) / DEVIATION).transpose(2, 0, 1)
        else:
            tensor = np.ascontiguousarray((resized / 255.0).transpose(2, 0, 1)[None])
        name = self._files.picture.name
        if family is Family.EFFICIENT_WHOLE:
            features: dict[str, Array] = {name: tensor}
        else:
            features = self._features(tensor, name, deadline)
        return _Encoded(features, width, height, width / columns, height / rows)

    def _features(self, tensor: Floats32, name: str, deadline: Deadline) -> dict[str, Array]:
        encoder = self._files.encoder
        wanted: list[str] = list(SAM2_FEATURES) if self._files.family is Family.SAM2 else list(encoder.outputs)[:1]
        values = encoder.run({name: tensor}, wanted, deadline)
        taken = wanted if self._files.family is Family.SAM2 else ["image_embeddings"]
        for key, value in zip(taken, values, strict=True):
            shape = self._files.decoder.inputs[key].shape
            fits = len(shape) == value.ndim and all(
                a is None or a == b for a, b in zip(shape, value.shape, strict=True)
            )
            if not fits or value.dtype != np.float32:
                msg = (
                    f"{encoder.path}: gave {value.dtype} of shape {value.shape} for {key}, which the decoder"
                    f" {self._files.decoder.path} does not take: two different models"
                )
                raise ModelError(msg)
        return dict(zip(taken, values, strict=True))

    def _points(self, encoded: _Encoded, prompt: Prompt, count: int | None) -> tuple[Floats32, Floats32]:
        """Return coordinates (n, 2) in the encoded picture, and labels (n,); ``count``: so many, padded.

        Models with one place for a prompt are asked for the middle alone, those with two for the box.
        """
        pixels = np.asarray(prompt.points, np.float64).reshape(-1, 2)[: 0 if count == 2 and prompt.box else count]
        labels = [ON] * len(pixels)
        if prompt.box is not None and count != 1:
            pixels = np.vstack([np.array(prompt.box).reshape(2, 2), pixels])
            labels = [FIRST, SECOND, *labels]
        scaled = (pixels + 0.5) * np.array([encoded.scale_u, encoded.scale_v]) - 0.5
        # Segment Anything's export expects a padding point where there is no box.
        missing = max((count or 0) - len(labels), 1 if prompt.box is None and count is None else 0)
        padded = np.vstack([scaled, np.zeros((missing, 2))]).astype(np.float32)
        return padded, np.array(labels + [PADDING] * missing, np.float32)

    def _decode(self, encoded: _Encoded, prompt: Prompt, deadline: Deadline) -> Logits:
        decoder = self._files.decoder
        coords, labels = self._points(encoded, prompt, decoder.inputs["point_coords"].shape[1])
        shape = decoder.inputs["mask_input"].shape
        feeds: dict[str, Array] = {
            **encoded.features,
            "point_coords": coords[None],
            "point_labels": labels[None],
            "mask_input": np.zeros((1, 1, shape[2] or 256, shape[3] or 256), np.float32),
            "has_mask_input": np.zeros(1, np.float32),
            "orig_im_size": np.array([encoded.height, encoded.width], np.float32),
        }
        # Without low-resolution logits the masks have the size that was asked for.
        low = self._files.family is Family.SAM2 or "low_res_masks" in decoder.outputs
        name = "low_res_masks" if "low_res_masks" in decoder.outputs else "masks"
        (values,) = decoder.run(_typed(decoder, feeds), [name], deadline)
        masks = self._checked(values, 4)[0]
        if not low:
            if masks.shape[1:] != (encoded.height, encoded.width):
                self._wrong(masks)
            return Logits(masks, encoded.scale_u, encoded.scale_v)
        # The low-resolution grid covers the square of SIDE that the encoder saw, padding included.
        per_u, per_v = masks.shape[2] / SIDE, masks.shape[1] / SIDE
        rows, columns = int(np.ceil(encoded.height * per_v)), int(np.ceil(encoded.width * per_u))
        return Logits(masks[:, :rows, :columns], per_u * encoded.scale_u, per_v * encoded.scale_v)

    def _decode_batch(
        self, encoded: _Encoded, prompts: Sequence[Prompt], places: int | None, deadline: Deadline
    ) -> Iterator[Logits]:
        decoder = self._files.decoder
        fixed = decoder.inputs["batched_point_coords"].shape[2]
        count = fixed or max(len(prompt.points) + (2 if prompt.box is not None else 0) for prompt in prompts)
        points = [self._points(encoded, prompt, count) for prompt in prompts]
        # Where the model has a fixed number of places for prompts, the last one is repeated.
        points += [points[-1]] * ((places or len(prompts)) - len(prompts))
        feeds: dict[str, Array] = {
            **encoded.features,
            "batched_point_coords": np.stack([coords for coords, _ in points])[None],
            "batched_point_labels": np.stack([labels for _, labels in points])[None],
            "orig_im_size": np.array([encoded.height, encoded.width], np.int64),
        }
        (values,) = decoder.run(_typed(decoder, feeds), ["output_masks"], deadline)
        masks = self._checked(values, 5)[0]
        if masks.shape[0] != len(points) or masks.shape[2:] != (encoded.height, encoded.width):
            self._wrong(masks)
        for item in masks[: len(prompts)]:
            yield Logits(item, encoded.scale_u, encoded.scale_v)

    def _checked(self, values: Array, rank: int) -> Floats32:
        sound = values.ndim == rank and values.dtype == np.float32 and values.size > 0 and values.shape[0] == 1
        if not sound or values.shape[rank - 3] > MAX_ALTERNATIVES or max(values.shape[-2:]) > 4 * SIDE:
            self._wrong(values)
        if not bool(np.isfinite(values).all()):
            msg = f"{self._files.decoder.path}: gave logits that are no numbers; export the model again"
            raise ModelError(msg)
        return values.astype(np.float32, copy=False)

    def _wrong(self, values: Array) -> None:
        msg = (
            f"{self._files.decoder.path}: gave masks of type {values.dtype} and shape {values.shape}, which"
            f" {self._files.family} does not; export the model again"
        )
        raise ModelError(msg)


def _typed(model: Model, feeds: dict[str, Array]) -> dict[str, Array]:
    """Return the feeds that the model takes, each in the type it takes."""
    return {
        name: feeds[name].astype(TYPES[item.kind], copy=False) for name, item in model.inputs.items() if name in feeds
    }
