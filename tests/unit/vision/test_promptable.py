import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from slabcell.errors import ImageError
from slabcell.geometry import RigidTransform2D
from slabcell.recipe import PromptableParameters, Recipe, SegmentationParameters
from slabcell.vision import Locator
from slabcell.vision.blobs import find_blobs
from slabcell.vision.promptable import ModelError
from slabcell.vision.promptable.prompts import prompts_of
from slabcell.vision.result import LocateResult, RejectionReason

from . import promptable_models as models
from .pictures import KITE, RECTANGLE, calibration, moved, recipe, render, scatter

pytestmark = pytest.mark.unit

CAMERA = calibration()
PRODUCT = recipe()
MOTIONS = scatter(PRODUCT)
OUTLINES = [motion.apply(slot.vertices) for motion, slot in zip(MOTIONS, PRODUCT.template.slots, strict=True)]
PICTURE = render(CAMERA, OUTLINES)

# Encoder and decoder of each kind of export, and what the result calls it.
EXPORTS = {
    "SAM": (models.sam_encoder, models.sam_decoder, "Segment Anything or MobileSAM"),
    "SAM, encoder with preprocessing": (
        models.sam_encoder_with_preprocessing,
        models.sam_decoder,
        "Segment Anything or MobileSAM",
    ),
    "SAM, input named images": (
        lambda path: models.sam_encoder(path, name="images"),
        models.sam_decoder,
        "Segment Anything or MobileSAM",
    ),
    "SAM, no low-resolution output": (
        models.sam_encoder,
        lambda path: models.sam_decoder(path, low_res=False),
        "Segment Anything or MobileSAM",
    ),
    "SAM 2": (models.sam2_encoder, models.sam2_decoder, "SAM 2"),
    "EfficientSAM": (models.efficient_encoder, models.efficient_decoder, "EfficientSAM"),
    "EfficientSAM in one file": (models.efficient, None, "EfficientSAM in one file"),
    "EfficientSAM in one file, one prompt at once": (
        lambda path: models.efficient(path, queries=1),
        None,
        "EfficientSAM in one file",
    ),
    "EfficientSAM in one file, two points a prompt": (
        lambda path: models.efficient(path, points=2),
        None,
        "EfficientSAM in one file",
    ),
}


def locator(product: Recipe, encoder: Path, decoder: Path | None = None, **keys: object) -> Locator:
    parameters = PromptableParameters.model_validate(
        {"encoder": str(encoder), "decoder": None if decoder is None else str(decoder), **keys}
    )
    segmentation = SegmentationParameters(method="promptable", promptable=parameters)
    return Locator(CAMERA, replace(product, segmentation=segmentation))


def error_mm(found: LocateResult, product: Recipe, motions: list[RigidTransform2D]) -> float:
    """Return the largest error of the slots' middles."""
    errors = [0.0]
    for part in found.parts:
        centre = product.template.slots[part.slot].centroid
        moved_back = part.table_to_assembly.inverse().apply(centre)
        errors.append(float(np.hypot(*(moved_back - motions[part.slot].apply(centre)))))
    return max(errors)


@pytest.fixture
def sam(tmp_path: Path) -> tuple[Path, Path]:
    return models.sam_encoder(tmp_path / "encoder.onnx"), models.sam_decoder(tmp_path / "decoder.onnx")


@pytest.mark.parametrize("export", EXPORTS)
def test_every_export_is_known_by_its_tensors_and_finds_the_slabs(tmp_path: Path, export: str):
    encoder, decoder, name = EXPORTS[export]
    first = encoder(tmp_path / "a.onnx")
    found = locator(PRODUCT, first, decoder(tmp_path / "b.onnx") if decoder else None).locate(PICTURE)
    assert [part.slot for part in found.parts] == [0, 1, 2, 3, 4]
    assert found.rejected == ()
    assert f"({name})" in found.segmentation
    # The masks are coarse, the poses are not: they come from the raw pixels.
    assert error_mm(found, PRODUCT, MOTIONS) < 0.025


@pytest.mark.parametrize(
    "picture",
    [
        cv2.cvtColor(PICTURE, cv2.COLOR_GRAY2BGR),
        PICTURE.astype(np.uint16) * 200,
        np.repeat((PICTURE.astype(np.uint16) * 200)[:, :, None], 3, axis=2),
    ],
    ids=["colour", "16 bit", "16 bit colour"],
)
def test_pictures_of_every_kind_reach_the_model(sam: tuple[Path, Path], picture: np.ndarray):
    assert len(locator(PRODUCT, *sam).locate(picture).parts) == 5


def test_the_mask_with_the_best_score_is_not_what_is_taken(sam: tuple[Path, Path]):
    # The models' best score goes to everything that is light, the second best to half a slab.
    assert int(np.argmax(models.SCORES)) == 0
    found = locator(PRODUCT, *sam).locate(PICTURE)
    assert "5 masks kept" in found.segmentation
    left_out = [int(word) for word in found.segmentation.split("left out")[1].split() if word.isdigit()]
    assert sum(left_out) == 10


def test_slabs_that_touch_are_asked_for_one_by_one(sam: tuple[Path, Path]):
    product = recipe([RECTANGLE, KITE])
    # The rectangle's right edge and the kite's leftmost corner meet at the picture's middle.
    motions = [RigidTransform2D(0.0, -80.0, -30.0), RigidTransform2D(0.0, -100.0, -30.0)]
    outlines = [motion.apply(slot.vertices) for motion, slot in zip(motions, product.template.slots, strict=True)]
    picture = render(CAMERA, outlines)
    one_blob = replace(product, matching=product.matching.model_copy(update={"split_touching": False}))
    plain = Locator(CAMERA, one_blob).locate(picture)
    assert [blob.reason for blob in plain.rejected] == [RejectionReason.TOUCHING]
    found = locator(one_blob, *sam).locate(picture)
    assert [part.slot for part in found.parts] == [0, 1]
    assert error_mm(found, product, motions) < 0.1


def test_a_model_with_one_point_a_prompt_is_asked_for_the_middles(tmp_path: Path):
    # Asked by a point alone, the model answers with what is light on that side of the picture.
    product = recipe([RECTANGLE, KITE])
    motions = [RigidTransform2D(20.0, -110.0, -30.0), RigidTransform2D(0.0, -60.0, -30.0)]
    outlines = [motion.apply(slot.vertices) for motion, slot in zip(motions, product.template.slots, strict=True)]
    found = locator(product, models.efficient(tmp_path / "a.onnx", points=1)).locate(render(CAMERA, outlines))
    assert [part.slot for part in found.parts] == [0, 1]
    assert "2 masks kept" in found.segmentation
    assert error_mm(found, product, motions) < 0.05


def test_a_blob_of_which_the_model_makes_no_slab_stays_and_is_refused_with_the_reason(sam: tuple[Path, Path]):
    unknown = moved([(0, 0), (60, 0), (60, 12), (12, 12), (12, 60), (0, 60)], -30.0, -30.0)
    found = locator(recipe([RECTANGLE]), *sam).locate(render(CAMERA, [unknown]))
    assert found.parts == ()
    assert len(found.rejected) == 1
    assert found.rejected[0].detail


def test_masks_that_are_not_firm_are_left_out(tmp_path: Path):
    decoder = models.sam_decoder(tmp_path / "decoder.onnx", scale=0.02)
    found = locator(PRODUCT, models.sam_encoder(tmp_path / "encoder.onnx"), decoder).locate(PICTURE)
    assert "0 masks kept" in found.segmentation
    assert ", 0 not firm" not in found.segmentation


def test_a_large_blob_is_asked_for_at_its_thick_places_and_a_small_one_with_its_box():
    mask = np.zeros((200, 400), np.uint8)
    cv2.circle(mask, (80, 100), 50, 255, cv2.FILLED)
    cv2.circle(mask, (170, 100), 50, 255, cv2.FILLED)
    cv2.rectangle(mask, (300, 60), (360, 120), 255, cv2.FILLED)
    blobs, _ = find_blobs(mask, 10)
    asked = prompts_of(mask, blobs, 9000.0, 10)
    large = sorted(prompt.points[0].tolist() for index, prompt in asked if index == 0)
    assert np.allclose(large, [[80, 100], [170, 100]], atol=4)
    (small,) = [prompt for index, prompt in asked if index == 1]
    assert small.box is not None
    assert np.allclose(small.box, (300, 60, 360, 120), atol=3)
    assert len(prompts_of(mask, blobs, 9000.0, 2)) == 2


def test_a_model_that_takes_too_long_is_stopped(sam: tuple[Path, Path]):
    with pytest.raises(ImageError, match=r"not done within 0\.001 s.*max_seconds") as caught:
        locator(PRODUCT, *sam, max_seconds=0.001).locate(PICTURE)
    assert caught.value.number == 1504


def refused(message: str, encoder: Path, decoder: Path | None = None) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        _ = locator(PRODUCT, encoder, decoder).segmenter
    assert caught.value.number == 1505
    assert caught.value.exit_code == 78
    assert str(encoder) in str(caught.value) or (decoder is not None and str(decoder) in str(caught.value))


def test_files_that_are_no_model_are_refused(tmp_path: Path, sam: tuple[Path, Path]):
    encoder, decoder = sam
    refused("cannot be read: No such file", tmp_path / "missing.onnx", decoder)
    refused("cannot be read: No such file", encoder, tmp_path / "missing.onnx")
    refused("cannot be read: Is a directory", tmp_path, decoder)
    (tmp_path / "empty.onnx").write_bytes(b"")
    refused("has 0 bytes", tmp_path / "empty.onnx", decoder)
    for content in (b"weights", b"\x89PNG\r\n\x1a\n" * 100, encoder.read_bytes()[:-200]):
        (tmp_path / "broken.onnx").write_bytes(content)
        refused("is no ONNX model|no encoder that is known", tmp_path / "broken.onnx", decoder)


def test_one_file_of_a_pair_is_not_enough(tmp_path: Path, sam: tuple[Path, Path]):
    refused("alone; give the key 'decoder'", sam[0])
    refused("is the decoder of Segment Anything", sam[1])
    refused("is the decoder of SAM 2", models.sam2_decoder(tmp_path / "d2.onnx"), sam[1])
    whole = models.efficient(tmp_path / "whole.onnx")
    refused("leave the key 'decoder' out", whole, sam[1])
    refused("in one file", sam[0], whole)


def test_files_of_two_models_are_refused(tmp_path: Path, sam: tuple[Path, Path]):
    refused("give two of one model", models.sam2_encoder(tmp_path / "e2.onnx"), sam[1])
    refused("give two of one model", sam[0], models.efficient_decoder(tmp_path / "ed.onnx"))
    narrow = models.sam_encoder(tmp_path / "narrow.onnx", embedding=(1, 128, 64, 64))
    refused(r"gives image_embeddings\(1, 128, 64, 64\).*two different models", narrow, sam[1])


def test_a_model_of_another_kind_is_refused(tmp_path: Path, sam: tuple[Path, Path]):
    other = models.other_model(tmp_path / "other.onnx")
    refused(r"no encoder that is known: its inputs are data\(1, 3, 224, 224\)", other, sam[1])
    refused("no decoder that is known", sam[0], other)
    small = models.sam_encoder(tmp_path / "small.onnx", side=512, embedding=(1, 64, 64, 64))
    refused("must be 1024 high and wide", small, sam[1])


def test_logits_that_are_no_numbers_are_refused(tmp_path: Path, sam: tuple[Path, Path]):
    broken = models.sam_decoder(tmp_path / "nan.onnx", scale=float("nan"))
    with pytest.raises(ModelError, match="no numbers"):
        locator(PRODUCT, sam[0], broken).locate(PICTURE)


def test_without_onnxruntime_the_extra_is_named(sam: tuple[Path, Path]):
    # A process of its own, in which the package cannot be imported.
    code = (
        "import sys; sys.modules['onnxruntime'] = None\n"
        "from pathlib import Path\n"
        "from slabcell.vision.promptable.contract import open_files\n"
        f"open_files(Path({str(sam[0])!r}), Path({str(sam[1])!r}), 1)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=60)
    assert "ModelError" in done.stderr
    assert "pip install 'slabcell[sam]'" in done.stderr


def test_nothing_of_it_is_imported_by_a_recipe_that_does_not_use_it():
    code = (
        "import sys, slabcell.vision, slabcell.cell.eyes\n"
        "names = [n for n in sys.modules if n.startswith('onnx') or n.startswith('slabcell.vision.promptable')]\n"
        "assert not names, names\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_an_empty_table_needs_no_run_of_the_model(sam: tuple[Path, Path]):
    found = locator(PRODUCT, *sam).locate(render(CAMERA, []))
    assert found.parts == found.rejected == ()


def test_the_outline_of_the_slot_decides_between_masks_that_overlap(sam: tuple[Path, Path]):
    # Half of this rectangle has area and inertia of the square, which is a slot too.
    product = recipe([[(0, 0), (90, 0), (90, 45), (0, 45)], [(0, 0), (45, 0), (45, 45), (0, 45)]])
    motions = [RigidTransform2D(0.0, -45.0, -30.0)]
    found = locator(product, *sam).locate(render(CAMERA, [motions[0].apply(product.template.slots[0].vertices)]))
    assert [part.slot for part in found.parts] == [0]
    assert found.empty_slots == (1,)
