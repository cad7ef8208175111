"""Is a bundle read back as it was written, and a damaged one refused by name?"""

import json
import random
import zipfile
from pathlib import Path

import pytest

from slabcell.cell.bundle_file import BundleError, read_bundle
from slabcell.errors import SlabcellError

pytestmark = pytest.mark.unit


@pytest.fixture
async def bundle(bench) -> Path:
    await bench.stop()
    bench.bundles = True
    await bench.start()
    await bench.robot.hello()
    await bench.robot.trigger()
    await bench.cell.stop()
    (path,) = (bench.folder / "bundles").iterdir()
    return path


def rewritten(path: Path, name: str, change) -> Path:
    """Return a copy of the bundle in which one member is another, or is left out."""
    other = path.with_name("other.zip")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(other, "w") as new:
        for item in old.namelist():
            content = change(old.read(item)) if item == name else old.read(item)
            if content is not None:
                new.writestr(item, content)
    return other


def with_value(*keys, value):
    def change(raw):
        document = json.loads(raw)
        inner = document
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = value
        return json.dumps(document)

    return change


async def test_what_went_in_comes_out(bench, bundle):
    read = read_bundle(bundle)
    assert read.recipe.template.slots[1].vertices.tolist() == bench.recipe.template.slots[1].vertices.tolist()
    assert read.recipe.segmentation == bench.recipe.segmentation
    assert read.settings.pick_base == bench.settings.pick_base
    assert read.arm.name == "KR 3 R540"
    assert read.picture is not None
    assert read.picture.shape == (48, 64)
    assert [(pair.slot, pair.pick, pair.place) for pair in read.pairs] == [
        (offer.slot, offer.pick, offer.place) for offer in bench.cell.cycles[-1].offers
    ]
    assert read.free_slots == (0, 1, 2)


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("manifest.json", lambda raw: None, "holds no manifest.json"),
        ("cell.json", lambda raw: b"{", "cell.json is no JSON"),
        ("recipe.json", lambda raw: b"[1]", "holds no object"),
        ("manifest.json", with_value("schema", value="slabcell.bundle/9"), "this version reads"),
        ("cell.json", with_value("arm", value="no such arm"), "no arm is called"),
        ("cell.json", with_value("tool", value=[1, 2, 3]), "6 finite numbers"),
        ("cell.json", with_value("approach_mm", value="high"), "could not convert"),
        ("recipe.json", with_value("segmentation", "method", value="magic"), "magic"),
        ("recipe.json", with_value("template", "slots", 0, value=[[1, 2]]), "three points"),
        ("manifest.json", with_value("offers", 0, "pick", 0, value=1e999), "finite"),
        ("calibration.json", lambda raw: b"\xff\xfe", "no JSON"),
    ],
)
async def test_a_damaged_member_is_named(bundle, name, change, said):
    with pytest.raises(BundleError, match=said) as caught:
        read_bundle(rewritten(bundle, name, change))
    assert "other.zip" in str(caught.value)


async def test_a_file_that_is_no_bundle_is_refused(tmp_path):
    path = tmp_path / "x.zip"
    path.write_bytes(b"PK\x03\x04 not really")
    with pytest.raises(BundleError, match="damaged, or no bundle"):
        read_bundle(path)
    with pytest.raises(BundleError, match="cannot be read"):
        read_bundle(tmp_path / "none.zip")


async def test_any_damage_is_an_error_with_words_or_does_no_harm(bundle):
    raw, chance = bundle.read_bytes(), random.Random(5)
    other = bundle.with_name("other.zip")
    for _ in range(150):
        damaged = bytearray(raw)
        if chance.random() < 0.3:
            del damaged[chance.randrange(len(damaged)) :]
        else:
            for _ in range(chance.randint(1, 20)):
                damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        other.write_bytes(damaged)
        try:
            read_bundle(other)
        except SlabcellError as error:
            assert str(other) in str(error)  # noqa: PT017 - most damage is an error, some is none
