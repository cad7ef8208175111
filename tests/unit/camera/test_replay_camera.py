import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from slabcell_drivers.camera import CameraError, CameraIncomplete, CameraLost, CameraState, ReplayCamera, ReplayMode

pytestmark = pytest.mark.unit


def write(folder: Path, name: str, pixels: np.ndarray) -> Path:
    path = folder / name
    assert cv2.imwrite(str(path), pixels)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number, name in enumerate(["b.png", "a.png", "c.tif"], start=1):
        write(tmp_path, name, np.full((6, 8), number, np.uint8))
    (tmp_path / "notes.txt").write_text("not a picture")
    return tmp_path


async def levels(camera: ReplayCamera, count: int) -> list[int]:
    return [int((await camera.snap(1.0)).pixels[0, 0]) for _ in range(count)]


async def test_pictures_come_in_the_order_of_their_names_and_then_the_camera_is_lost(folder: Path) -> None:
    camera = ReplayCamera(folder)
    await camera.open(1.0)

    assert await levels(camera, 3) == [2, 1, 3]
    with pytest.raises(CameraLost, match="all 3 pictures have been shown"):
        await camera.snap(1.0)
    assert camera.state is CameraState.LOST


async def test_a_looping_replay_begins_again(folder: Path) -> None:
    camera = ReplayCamera(folder, mode=ReplayMode.LOOP)
    await camera.open(1.0)

    assert await levels(camera, 7) == [2, 1, 3, 2, 1, 3, 2]


async def test_given_files_come_in_the_given_order(folder: Path) -> None:
    camera = ReplayCamera([folder / "c.tif", folder / "a.png"])
    await camera.open(1.0)

    assert camera.upcoming == folder / "c.tif"
    assert await levels(camera, 2) == [3, 2]
    assert camera.upcoming is None


async def test_sixteen_bits_and_colour_keep_their_values_and_say_their_format(tmp_path: Path) -> None:
    write(tmp_path, "1.png", np.full((4, 5), 40_000, np.uint16))
    write(tmp_path, "2.png", np.full((4, 5, 3), (10, 20, 30), np.uint8))
    write(tmp_path, "3.tif", np.full((4, 5, 3), (1000, 2000, 3000), np.uint16))
    camera = ReplayCamera(tmp_path)
    info = await camera.open(1.0)

    deep, colour, both = [await camera.snap(1.0) for _ in range(3)]

    assert (info.pixel_format, deep.pixel_format, colour.pixel_format) == ("Mono16", "Mono16", "BGR8")
    assert deep.pixels.dtype == np.uint16
    assert deep.pixels[0, 0] == 40_000
    assert colour.pixels[0, 0].tolist() == [10, 20, 30]
    assert both.pixel_format == "BGR16"
    assert both.pixels[0, 0].tolist() == [1000, 2000, 3000]


async def test_a_damaged_picture_is_an_error_by_name_and_the_next_one_comes_after_it(folder: Path) -> None:
    (folder / "b.png").write_bytes((folder / "b.png").read_bytes()[:20])
    camera = ReplayCamera(folder)
    await camera.open(1.0)
    await camera.snap(1.0)

    with pytest.raises(CameraIncomplete, match=r"b\.png: is not a picture"):
        await camera.snap(1.0)

    assert await levels(camera, 1) == [3]


async def test_an_empty_file_is_an_error_by_name(folder: Path) -> None:
    (folder / "a.png").write_bytes(b"")

    camera = ReplayCamera(folder)

    with pytest.raises(CameraIncomplete, match=r"a\.png: is not a picture"):
        await camera.open(1.0)
    assert camera.state is CameraState.LOST


async def test_a_picture_of_another_size_is_refused_with_both_sizes(folder: Path) -> None:
    write(folder, "b.png", np.zeros((3, 3), np.uint8))
    camera = ReplayCamera(folder)
    await camera.open(1.0)
    await camera.snap(1.0)

    with pytest.raises(CameraIncomplete, match=r"b\.png has 3x3 pixels, the first picture 8x6"):
        await camera.snap(1.0)


@pytest.mark.parametrize("name", ["none", "empty", "notes.txt"])
async def test_a_source_without_pictures_is_refused_by_name(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("x")
    camera = ReplayCamera(tmp_path / name)

    with pytest.raises(CameraError, match=name):
        await camera.open(1.0)


def bundle(path: Path, content: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def png(level: int) -> bytes:
    return cv2.imencode(".png", np.full((6, 8), level, np.uint8))[1].tobytes()


async def test_the_pictures_of_cycle_bundles_are_shown_too(tmp_path: Path) -> None:
    for level in (7, 9):
        bundle(tmp_path / f"cycle{level}.zip", {"manifest.json": b"{}", "frame.png": png(level)})
    camera = ReplayCamera(tmp_path)
    await camera.open(1.0)

    assert await levels(camera, 2) == [7, 9]

    alone = ReplayCamera(tmp_path / "cycle9.zip")
    await alone.open(1.0)
    assert await levels(alone, 1) == [9]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"manifest.json": b"{}"}, "holds no frame.png"),
        ({"frame.png": b"not a picture"}, "is not a picture"),
        (None, "is not a bundle"),
    ],
)
async def test_a_bundle_without_a_good_picture_is_refused_by_name(
    tmp_path: Path, content: dict[str, bytes] | None, says: str
) -> None:
    path = tmp_path / "cycle.zip"
    if content is None:
        path.write_bytes(b"PK but no more")
    else:
        bundle(path, content)

    with pytest.raises(CameraIncomplete, match=rf"cycle\.zip: .*{says}"):
        await ReplayCamera(path).open(1.0)


async def test_a_chosen_picture_comes_next_and_the_others_follow_it(folder: Path) -> None:
    camera = ReplayCamera(folder)
    await camera.open(1.0)

    camera.choose("c.tif")
    assert await levels(camera, 1) == [3]
    camera.choose("b.png")
    assert await levels(camera, 2) == [1, 3]
    with pytest.raises(KeyError, match=r"no picture 'd\.png' among the 3"):
        camera.choose("d.png")


async def test_opening_again_begins_at_the_first_picture(folder: Path) -> None:
    camera = ReplayCamera(folder)
    await camera.open(1.0)
    await camera.snap(1.0)
    await camera.close()

    await camera.open(1.0)

    assert await levels(camera, 1) == [2]
