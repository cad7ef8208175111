"""Which promptable model is in these files?  Told by names and shapes of inputs and outputs, never by a file's name.

Contracts: Segment Anything, ``scripts/export_onnx_model.py`` for the decoder, and the encoder that samexporter writes,
with its preprocessing inside (h, w, 3) or not (1, 3, 1024, 1024); MobileSAM has the same.  SAM 2: encoder and decoder
as samexporter writes them.  EfficientSAM: its own export, in one file or split; one of its two kinds takes a single
point for each prompt, the other a single prompt of many points.
"""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

from slabcell.vision.promptable.errors import ModelError
from slabcell.vision.promptable.session import TYPES, Model, Tensor, open_model

__all__ = ["Family", "ModelFiles", "open_files"]


class Family(StrEnum):
    """Models that share tensors and the way a picture is prepared."""

    SAM = "Segment Anything or MobileSAM"
    SAM2 = "SAM 2"
    EFFICIENT = "EfficientSAM"
    EFFICIENT_WHOLE = "EfficientSAM in one file"


# Inputs that a decoder must have, and one that it may have.
DECODERS: Final = {
    Family.SAM: {"image_embeddings", "point_coords", "point_labels", "mask_input", "has_mask_input"},
    Family.SAM2: {
        "image_embed",
        "high_res_feats_0",
        "high_res_feats_1",
        "point_coords",
        "point_labels",
        "mask_input",
        "has_mask_input",
    },
    Family.EFFICIENT: {"image_embeddings", "batched_point_coords", "batched_point_labels"},
    Family.EFFICIENT_WHOLE: {"batched_images", "batched_point_coords", "batched_point_labels"},
}
OPTIONAL_INPUT: Final = "orig_im_size"
SAM2_FEATURES: Final = ("image_embed", "high_res_feats_0", "high_res_feats_1")
RANKS: Final = {
    "image_embeddings": 4,
    "image_embed": 4,
    "high_res_feats_0": 4,
    "high_res_feats_1": 4,
    "point_coords": 3,
    "point_labels": 2,
    "mask_input": 4,
    "has_mask_input": 1,
    "orig_im_size": 1,
    "batched_images": 4,
    "batched_point_coords": 4,
    "batched_point_labels": 3,
}
# A model that takes more prompts at once than this would need too much memory.
MAX_PLACES: Final = 64
KNOWN: Final = (
    "known are the encoder and the decoder of Segment Anything, MobileSAM and SAM 2 as samexporter writes them, and"
    " EfficientSAM in one file or split"
)


@dataclass(frozen=True, slots=True, eq=False)
class ModelFiles:
    """The opened files of one model; for EfficientSAM in one file both are the same."""

    family: Family
    encoder: Model
    decoder: Model

    @property
    def picture(self) -> Tensor:
        """The encoder's input."""
        if self.family is Family.EFFICIENT_WHOLE:
            return self.encoder.inputs["batched_images"]
        return next(iter(self.encoder.inputs.values()))


def open_files(encoder: Path, decoder: Path | None, threads: int) -> ModelFiles:
    """Return the model of these files.  Raises ModelError that names the file, what it has, and what is needed."""
    first = open_model(encoder, threads)
    family = _decoder_family(first)
    if family is Family.EFFICIENT_WHOLE:
        if decoder is not None:
            msg = f"{encoder}: is {family}, which has its decoder inside; leave the key 'decoder' out"
            raise ModelError(msg)
        files = ModelFiles(family, first, first)
        _check(files)
        return files
    if family is not None:
        msg = f"{encoder}: is the decoder of {family}; the key 'encoder' needs the file of the encoder"
        raise ModelError(msg)
    kind = _encoder_family(first)
    if decoder is None:
        msg = f"{encoder}: is the encoder of {kind} alone; give the key 'decoder' the file that belongs to it"
        raise ModelError(msg)
    second = open_model(decoder, threads)
    other = _decoder_family(second)
    if other is None or other is Family.EFFICIENT_WHOLE:
        what = str(other) if other else f"no decoder that is known: its inputs are {_listed(second)}"
        msg = f"{decoder}: is {what}; {KNOWN}"
        raise ModelError(msg)
    if other is not kind:
        msg = f"{encoder} is the encoder of {kind}, but {decoder} is the decoder of {other}; give two of one model"
        raise ModelError(msg)
    files = ModelFiles(kind, first, second)
    _check(files)
    return files


def _decoder_family(model: Model) -> Family | None:
    names = set(model.inputs) - {OPTIONAL_INPUT}
    return next((family for family, needed in DECODERS.items() if names == needed), None)


def _encoder_family(model: Model) -> Family:
    if len(model.inputs) == 1:
        (picture,) = model.inputs.values()
        if set(SAM2_FEATURES) <= set(model.outputs):
            return Family.SAM2
        if picture.name == "batched_images" and "image_embeddings" in model.outputs:
            return Family.EFFICIENT
        if len(model.outputs) == 1 and picture.name != "batched_images" and len(picture.shape) in (3, 4):
            return Family.SAM
    msg = (
        f"{model.path}: is no encoder that is known: its inputs are {_listed(model)}, its outputs"
        f" {', '.join(model.outputs)}; {KNOWN}"
    )
    raise ModelError(msg)


def _listed(model: Model) -> str:
    return ", ".join(str(item) for item in model.inputs.values())


def _check(files: ModelFiles) -> None:
    """Raise ModelError where type or shape of an input is not that of the family."""
    for model in (files.encoder, files.decoder):
        for item in model.inputs.values():
            if item.kind not in TYPES:
                msg = f"{model.path}: its input {item} has the type {item.kind}; export the model with float32"
                raise ModelError(msg)
            rank = RANKS.get(item.name)
            if rank is not None and len(item.shape) != rank:
                msg = f"{model.path}: its input {item} has {len(item.shape)} dimensions, {files.family} has {rank}"
                raise ModelError(msg)
    _check_picture(files)
    _check_points(files)
    for name in files.decoder.inputs:
        taken, given = files.decoder.inputs[name], files.encoder.outputs.get(_encoder_name(files, name))
        if given is None or files.encoder is files.decoder:
            continue
        pairs = zip(taken.shape, given.shape, strict=False)
        if len(taken.shape) != len(given.shape) or any(a and b and a != b for a, b in pairs):
            msg = f"{files.encoder.path} gives {given}, but {files.decoder.path} takes {taken}: two different models"
            raise ModelError(msg)


def _encoder_name(files: ModelFiles, name: str) -> str:
    """Return the name that the encoder has for an input of the decoder."""
    if files.family is Family.SAM and name == "image_embeddings":
        return next(iter(files.encoder.outputs))
    return name


def _check_picture(files: ModelFiles) -> None:
    picture, path = files.picture, files.encoder.path
    if files.family is Family.SAM and len(picture.shape) == 3:
        if picture.shape[2] not in (3, None) or picture.shape[0] or picture.shape[1]:
            msg = f"{path}: its input {picture} must be (height, width, 3) with open height and width"
            raise ModelError(msg)
        return
    _, channels, height, width = picture.shape if len(picture.shape) == 4 else (1, 0, None, None)
    if channels not in (3, None):
        msg = f"{path}: its input {picture} must be (1, 3, height, width), or (height, width, 3) with preprocessing"
        raise ModelError(msg)
    fixed = 1024 if files.family in (Family.SAM, Family.SAM2) else None
    if fixed and any(size not in (fixed, None) for size in (height, width)):
        msg = f"{path}: its input {picture} must be {fixed} high and wide, as {files.family} is trained"
        raise ModelError(msg)
    if any(size is not None and not 64 <= size <= 4096 for size in (height, width)):
        msg = f"{path}: its input {picture} must be between 64 and 4096 high and wide"
        raise ModelError(msg)


def _check_points(files: ModelFiles) -> None:
    efficient = files.family in (Family.EFFICIENT, Family.EFFICIENT_WHOLE)
    coords = files.decoder.inputs["batched_point_coords" if efficient else "point_coords"]
    count = coords.shape[-2]
    if coords.shape[-1] not in (2, None) or (not efficient and count in (1, 2)):
        msg = f"{files.decoder.path}: its input {coords} must take at least 3 points (two corners and a middle) of 2"
        raise ModelError(msg)
    if efficient and (coords.shape[1] or 0) > MAX_PLACES:
        msg = f"{files.decoder.path}: its input {coords} takes more than {MAX_PLACES} prompts at once; export it again"
        raise ModelError(msg)
    masks = "output_masks" if efficient else "masks"
    if masks not in files.decoder.outputs:
        msg = f"{files.decoder.path}: has no output {masks!r}, only {', '.join(files.decoder.outputs)}"
        raise ModelError(msg)
