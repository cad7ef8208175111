"""Pictures are kept in sets and looked at together; what parameters change is said, against the active recipe."""

import asyncio
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from slabcell.calibration.model import Lens
from slabcell.cli.recipe import recipe_app
from slabcell.cli.vision_sets import vision_app
from slabcell.errors import SlabcellError
from slabcell.recipe import SegmentationParameters
from slabcell.service.api.client import ApiClient
from slabcell.service.bench.histogram import histogram_document
from slabcell.service.bench.undistorted import undistorted_overlay

from .test_vision import picture

pytestmark = pytest.mark.unit


@pytest.fixture
def client(api, tmp_path) -> ApiClient:
    return ApiClient(tmp_path / "api.sock", timeout_s=60.0)


async def post(client: ApiClient, path: str, body: dict) -> dict:
    return await asyncio.to_thread(client.post, path, body)


async def slabcell(app, *words: object, socket: Path, code: int = 0) -> str:
    ran = await asyncio.to_thread(CliRunner().invoke, app, [*map(str, words), "--socket", str(socket)])
    assert ran.exit_code == code, (ran.output, ran.exception)
    return ran.stdout.rstrip("\n")


def last_line(text: str) -> str:
    """Return what the command says, without the log of the daemon, which is in this process too."""
    return text.splitlines()[-1]


async def test_pictures_are_kept_run_together_and_forgotten(api, client, tmp_path):
    files = [tmp_path / f"{name}.png" for name in ("one", "two", "none")]
    for file, squares in zip(files, ([(300, 200)], [(300, 200), (100, 90)], []), strict=True):
        file.write_bytes(picture(*squares))
    socket = tmp_path / "api.sock"
    kept = [
        last_line(await slabcell(vision_app, "keep", "day", "--picture", file, "--name", file.stem, socket=socket))
        for file in files
    ]
    assert [name.rpartition("-")[0] for name in kept] == [f"set:day/{file.stem}" for file in files]
    assert (await slabcell(vision_app, "sets", socket=socket)).split() == sorted(kept)
    text = await slabcell(vision_app, "run", "set:day", "--everywhere", "--json", socket=socket)
    rows = {row["picture"]: row for row in json.loads(last_line(text))["pictures"]}
    assert [rows[name]["slots"] for name in kept] == [[0], [0], []]
    assert [len(rows[name]["rejected"]) for name in kept] == [0, 1, 0]
    assert [rows[name]["empty_slots"] for name in kept] == [[], [], [0]]
    assert all(row["timing_ms"]["total"] > 0 for row in rows.values())
    await slabcell(vision_app, "forget", kept[0], socket=socket)
    with pytest.raises(SlabcellError, match="no picture"):
        await post(client, "/v1/vision/preview", {"picture": kept[0]})
    with pytest.raises(SlabcellError, match="no picture"):
        await post(client, "/v1/vision/sets/day/remove", {"file": kept[0].partition("/")[2]})
    await slabcell(vision_app, "run", "set:nothing", socket=socket, code=1)


async def test_a_run_uses_the_parameters_that_are_tried_and_says_what_was_refused(api, client, tmp_path):
    name = (await post(client, "/v1/vision/sets/day/keep", {"picture": await upload(client)}))["picture"]
    body = {"pictures": [name], "everywhere": True, "parameters": {"gates": {"min_brightness_percent": 99.0}}}
    done = await asyncio.to_thread(client.follow, await post(client, "/v1/vision/run", body))
    (row,) = done["pictures"]
    assert row["slots"] == []
    assert "dark" in row["refusal"] or "brightness" in row["refusal"]


async def upload(client: ApiClient) -> str:
    return (await asyncio.to_thread(client.send, "/v1/vision/pictures", picture((300, 200)), "image/png"))["picture"]


async def test_the_newest_picture_is_kept_as_it_is(api, client, tmp_path):
    await api.cell.look()
    name = (await post(client, "/v1/vision/sets/day/keep", {}))["picture"]
    kept = cv2.imread(str(tmp_path / "pictures" / "day" / name.partition("/")[2]), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(kept, api.frames.last.pixels)


async def test_a_run_over_a_picture_that_is_gone_fails_and_says_which(client):
    task = await post(client, "/v1/vision/run", {"pictures": ["set:day/gone.png"]})
    with pytest.raises(SlabcellError, match=r"gone\.png"):
        await asyncio.to_thread(client.follow, task)


async def test_what_parameters_change_is_said_against_the_active_recipe(api, client, tmp_path):
    same = await post(client, "/v1/recipes/compare", {"base": "squares"})
    assert (same["active"], same["template_changed"], same["changes"]) == ("squares", True, [])  # the fixture's own
    toml = "[template]\nthickness_mm = 12.0\n[segmentation]\nmin_area_mm2 = 30.0\nroi = [[0, 0], [9, 0], [9, 9]]\n"
    said = await post(client, "/v1/recipes/compare", {"base": "squares", "toml": toml})
    assert [(item["key"], item["unit"], item["active"], item["candidate"]) for item in said["changes"]] == [
        ("template.thickness_mm", "mm", 10.0, 12.0),
        ("segmentation.roi", "", None, [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]]),
        ("segmentation.min_area_mm2", "mm²", 25.0, 30.0),
    ]
    (tmp_path / "trial.toml").write_text(toml)
    shown = await slabcell(recipe_app, "diff", "squares", tmp_path / "trial.toml", socket=tmp_path / "api.sock")
    assert "segmentation.min_area_mm2" in shown
    with pytest.raises(SlabcellError, match="there is no recipe"):
        await post(client, "/v1/recipes/compare", {"base": "nobody"})


async def test_the_histogram_counts_every_pixel_and_says_where_is_cut(client):
    done = await post(client, "/v1/vision/preview", {"picture": await upload(client), "everywhere": True})
    path = next(item["path"] for item in done["buffers"] if item["name"] == "histogram.json")
    document = json.loads((await asyncio.to_thread(client.fetch, path)).content)
    assert sum(document["counts"]) == 640 * 480
    assert 40 < document["level"] < 220
    assert document["light"]


def table(depth: type) -> np.ndarray:
    pixels = np.full((60, 80), 40, depth)
    pixels[20:40, 30:50] = 220
    return pixels if depth is np.uint8 else pixels * 100


@pytest.mark.parametrize(
    ("said", "level"),
    [
        ({"method": "fixed", "threshold": 100}, 100.5),
        ({"method": "dynamic_hard", "level_percent": 25.0}, 40 + 0.25 * 180),
        ({"method": "kmeans"}, None),
    ],
)
def test_the_level_is_that_of_the_method(said, level):
    document = histogram_document(table(np.uint8), SegmentationParameters(**said))
    assert (document["level"], document["low"], document["high"]) == (level, 40.0, 220.0)


def test_a_threshold_of_16_bits_is_counted_in_the_greys_of_the_picture():
    document = histogram_document(table(np.uint16), SegmentationParameters(method="fixed", threshold=11_000))
    per_level, level = document["grey_per_level"], document["level"]
    assert isinstance(per_level, float)
    assert isinstance(level, float)
    assert level * per_level == pytest.approx(11_000, rel=1e-2)


def test_an_overlay_moves_with_the_undistorted_picture():
    lens = Lens(np.array([[900.0, 0, 320], [0, 900.0, 240], [0, 0, 1]]), np.array([-0.2, 0.05, 0.0, 0.0, 0.0]))
    ideal = np.array([[[-0.3, 0.1, 1.0]], [[-0.29, 0.1, 1.0]]])
    seen = cv2.projectPoints(ideal, np.zeros(3), np.zeros(3), lens.matrix, lens.distortion)[0].reshape(-1, 2)
    step = seen[1] - seen[0]
    angle = -float(np.degrees(np.arctan2(step[1], step[0])))
    part = {"image": {"u": seen[0][0], "v": seen[0][1], "angle_deg": angle}, "outline_px": seen.tolist()}
    (moved,) = undistorted_overlay({"parts": [part], "rejected": []}, lens)["parts"]
    wanted = (ideal.reshape(-1, 3) @ lens.matrix.T)[:, :2]
    assert np.allclose(moved["outline_px"], wanted, atol=0.02)
    assert (moved["image"]["u"], moved["image"]["v"]) == pytest.approx(tuple(wanted[0]), abs=0.02)
    assert moved["image"]["angle_deg"] == pytest.approx(0.0, abs=0.2)
    bare = {"image": {"u": seen[0][0], "v": seen[0][1]}, "outline_px": []}
    assert undistorted_overlay({"parts": [], "rejected": [bare]}, lens)["rejected"][0]["outline_px"] == []
