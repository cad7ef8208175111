"""Sets of pictures are kept as plain files, bounded, and nothing outside of their folder is touched."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from slabcell.errors import ImageError, UsageError
from slabcell.service import picture_sets
from slabcell.service.picture_sets import NoSuchPictureError, PictureSets

pytestmark = pytest.mark.unit


def picture(grey: int, ending: str = ".png") -> bytes:
    return bytes(cv2.imencode(ending, np.full((8, 8), grey, np.uint8))[1])


@pytest.fixture
def sets(tmp_path: Path) -> PictureSets:
    return PictureSets(tmp_path / "pictures")


def test_a_picture_is_found_again_under_its_name_and_kept_once(sets: PictureSets) -> None:
    assert sets.sets() == []
    name = sets.add("winter", picture(10), "morning")
    assert sets.add("winter", picture(10)) == name
    other = sets.add("winter", picture(20, ".jpg"))
    (found,) = sets.sets()
    assert found.name == "winter"
    assert {item.name for item in found.pictures} == {name, other}
    assert name.startswith("morning-")
    assert (Path(name).suffix, Path(other).suffix) == (".png", ".jpg")
    assert sets.path("winter", name).read_bytes() == picture(10)


def test_a_set_ends_with_its_last_picture(sets: PictureSets) -> None:
    name = sets.add("winter", picture(10))
    sets.remove("winter", name)
    assert sets.sets() == []
    with pytest.raises(NoSuchPictureError):
        sets.remove("winter", name)


def test_a_file_that_a_person_has_copied_there_belongs_to_the_set(sets: PictureSets, tmp_path: Path) -> None:
    folder = tmp_path / "pictures" / "by-hand"
    folder.mkdir(parents=True)
    (folder / "from the phone.png").write_bytes(picture(1))  # no name that an address could hold
    (folder / "phone.png").write_bytes(picture(1))
    (folder / "notes.txt").write_text("no picture")
    assert [item.name for item in sets.sets()[0].pictures] == ["phone.png"]


@pytest.mark.parametrize("name", ["", "..", "a/b", "Winter", "x" * 41, "-x"])
def test_a_set_whose_name_is_none_is_refused(sets: PictureSets, name: str) -> None:
    with pytest.raises(UsageError):
        sets.add(name, picture(10))
    with pytest.raises(NoSuchPictureError):
        sets.path(name, "x.png")


@pytest.mark.parametrize("name", ["../x", "a/b", ".hidden", "x" * 80])
def test_a_picture_whose_name_is_none_is_refused(sets: PictureSets, name: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError):
        sets.add("winter", picture(10), name)
    (tmp_path / "x.png").write_bytes(picture(1))
    sets.add("winter", picture(20))
    with pytest.raises(NoSuchPictureError):
        sets.path("winter", "../../x.png")


def test_what_is_no_picture_is_not_kept(sets: PictureSets) -> None:
    for raw in (b"", b"no picture", picture(10)[:-10]):
        with pytest.raises(ImageError):
            sets.add("winter", raw)
    assert sets.sets() == []


def test_sets_are_bounded_in_number_and_size(sets: PictureSets, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture_sets, "MAX_PICTURES", 2)
    monkeypatch.setattr(picture_sets, "MAX_SETS", 2)
    sets.add("a", picture(1))
    sets.add("a", picture(2))
    with pytest.raises(UsageError, match="holds 2 pictures"):
        sets.add("a", picture(3))
    sets.add("b", picture(3))
    with pytest.raises(UsageError, match="there are 2 sets"):
        sets.add("c", picture(3))
    monkeypatch.setattr(picture_sets, "MAX_TOTAL_BYTES", 300)
    with pytest.raises(UsageError, match="MiB of pictures"):
        sets.add("b", picture(4))
