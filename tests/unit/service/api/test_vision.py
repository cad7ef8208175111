"""Parameters are tried on pictures beside the cell: nothing becomes active, and nothing makes the robot wait."""

import asyncio
import json
import os
import signal
from pathlib import Path

import cv2
import numpy as np
import pytest

from slabcell.cell.events import StateChanged
from slabcell.cell.states import CellState
from slabcell.errors import SlabcellError, TemporaryError
from slabcell.images import decode_image
from slabcell.service.api.client import ApiClient
from slabcell.service.bench.process import BenchError
from slabcell.service.bench.workbench import MAX_WAITING, Workbench
from slabcell.service.expiring import Expiring

pytestmark = pytest.mark.unit


def picture(*squares: tuple[int, int]) -> bytes:
    """A table of 640 x 480 pixels, 1.225 mm each at the height of slabs, with squares of 30 mm."""
    fine = np.full((960, 1280), 40, np.uint8)
    for left, top in squares:
        fine[2 * top : 2 * top + 49, 2 * left : 2 * left + 49] = 220
    pixels = cv2.resize(cv2.GaussianBlur(fine, (5, 5), 1.2), (640, 480), interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".png", pixels)[1])


@pytest.fixture
def client(api, tmp_path) -> ApiClient:
    return ApiClient(tmp_path / "api.sock", timeout_s=60.0)


@pytest.fixture
async def uploaded(client) -> str:
    content = picture((300, 200), (100, 90))
    document = await asyncio.to_thread(client.send, "/v1/vision/pictures", content, "image/png")
    assert (document["width"], document["height"]) == (640, 480)
    return document["picture"]


async def preview(client: ApiClient, **body: object) -> dict:
    return await asyncio.to_thread(client.post, "/v1/vision/preview", body)


async def test_a_preview_finds_what_the_parameters_find_and_leaves_the_active_recipe_alone(api, client, uploaded):
    before = api.cell.recipe
    plain = await preview(client, picture=uploaded, everywhere=True)
    strict = await preview(
        client, picture=uploaded, everywhere=True, parameters={"segmentation": {"min_area_mm2": 5000.0}}
    )
    slots = [part["slot"] for part in plain["located"]["parts"]]
    assert slots == [0]
    assert plain["located"]["timing_ms"]["total"] > 0.0
    assert strict["located"]["parts"] == []
    assert api.cell.recipe is before


async def test_what_the_vision_passed_by_can_be_looked_at(client, uploaded):
    done = await preview(client, picture=uploaded, everywhere=True)
    files = {item["name"]: (await asyncio.to_thread(client.fetch, item["path"])).content for item in done["buffers"]}
    assert set(files) == {
        *("input.png", "undistorted.png", "mask.png", "blobs.png", "contours.json", "residuals.json"),
        *("histogram.json", "undistorted.json"),
    }
    mask = decode_image(files["mask.png"], "mask")
    assert 2 * 20 * 20 < np.count_nonzero(mask) < 2 * 28 * 28
    assert len(json.loads(files["contours.json"])["blobs"]) == 2
    (part,) = json.loads(files["residuals.json"])["parts"]
    found = [value for value in part["outward_mm"] if value is not None]
    assert len(found) == 4  # one piece on each side of so small a square
    assert max(map(abs, found)) < 1.0
    colours = np.unique(decode_image(files["blobs.png"], "blobs").reshape(-1, 3), axis=0)
    assert len(colours) == 3  # the table and two blobs


async def test_a_picture_that_is_refused_is_a_preview_with_the_reason(client, uploaded):
    done = await preview(client, picture=uploaded, parameters={"gates": {"min_brightness_percent": 99.0}})
    assert done["located"] is None
    assert "brightness" in done["refusal"] or "dark" in done["refusal"]
    assert "input.png" in [item["name"] for item in done["buffers"]]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ({"toml": "[template]\nthickness = 4"}, "candidate.toml:2: unknown key 'template.thickness'"),
        ({"toml": "this is none"}, "is not TOML"),
        ({"toml": "", "parameters": {}}, "given twice"),
        ({"parameters": {"segmentation": {"threshold": 70000}}}, "less than or equal to 65535"),
        ({"template_csv": "0,0,30,0"}, "a polygon needs at least 3"),
        ({"base": "nobody"}, "there is no recipe 'nobody'"),
        ({"base": "../squares"}, "there is no recipe"),
        ({"picture": "cycle:3"}, "no cycle 3"),
        ({"picture": "latest"}, "no picture was taken"),
        ({"picture": "upload:0000"}, "was not uploaded"),
        ({"picture": "/etc/passwd"}, "say latest, cycle:NUMBER, set:SET/FILE"),
        ({"picture": "set:winter/x.png"}, "no picture 'x.png' in set 'winter'"),
        ({"picture": "set:../recipes/squares.toml"}, "no picture"),
        ({"picture": "graded:squares/none.zip"}, "no graded picture 'none.zip' of recipe 'squares'"),
        ({"picture": "graded:../x/none.zip"}, "no graded picture"),
        (
            {"parameters": {"segmentation": {"method": "promptable", "promptable": {"encoder": "/etc/shadow"}}}},
            "is not one of the recipe this is based on",
        ),
    ],
)
async def test_what_cannot_be_tried_is_refused_in_words(client, uploaded, body, words):
    with pytest.raises(SlabcellError, match=words.replace("(", r"\(")):
        await preview(client, **{"picture": uploaded, **body})


async def test_a_picture_of_another_size_than_the_calibration_is_refused(client):
    small = bytes(cv2.imencode(".png", np.zeros((48, 64), np.uint8))[1])
    document = await asyncio.to_thread(client.send, "/v1/vision/pictures", small, "image/png")
    with pytest.raises(SlabcellError, match="64x48"):
        await preview(client, picture=document["picture"])


@pytest.mark.parametrize("raw", [b"", b"no picture", picture()[:-20]])
async def test_what_is_no_whole_picture_is_not_kept(api, client, raw):
    with pytest.raises(SlabcellError):
        await asyncio.to_thread(client.send, "/v1/vision/pictures", raw, "image/png")
    assert len(api.studio.pictures.uploads) == 0


async def test_a_preview_of_the_newest_picture_works_on_its_pixels(api, client):
    await api.cell.look()
    done = await preview(client, everywhere=True)
    assert done["picture"] == api.frames.id_of(api.frames.last)
    assert [item["reason"] for item in done["located"]["rejected"]] == ["touching"]  # larger than the slot


async def test_only_some_previews_are_kept(api, client, uploaded):
    first = await preview(client, picture=uploaded)
    for _ in range(8):
        await preview(client, picture=uploaded)
    assert len(api.studio.previews) == 8
    with pytest.raises(SlabcellError, match="not kept any more"):
        await asyncio.to_thread(client.fetch, first["buffers"][0]["path"])


async def test_things_expire_by_time_and_by_size():
    kept: Expiring[str] = Expiring(number=5, total_bytes=10, kept_s=0.01)
    kept.add("a", "a", 6)
    kept.add("b", "b", 6)
    assert (kept.get("a"), kept.get("b")) == (None, "b")
    await until(lambda: len(kept) == 0)
    assert kept.get("b") is None


def stopped(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "T"


async def until(condition) -> None:
    async with asyncio.timeout(60):
        while not condition():  # noqa: ASYNC110 - the state of another process
            await asyncio.sleep(0.005)


async def test_the_bench_stands_still_while_the_cell_looks_and_computes(client, api, uploaded):
    bench = api.studio.bench
    await preview(client, picture=uploaded)
    pid = bench.process.pid
    bench.see(StateChanged(CellState.READY, CellState.ACQUIRING, "test"))
    await until(lambda: stopped(pid))
    waiting = asyncio.create_task(preview(client, picture=uploaded))
    bench.see(StateChanged(CellState.ACQUIRING, CellState.LOCATING, "test"))
    assert stopped(pid)
    bench.see(StateChanged(CellState.LOCATING, CellState.OFFERING, "test"))
    await waiting
    assert not stopped(pid)


async def test_a_bench_that_dies_fails_its_task_only_and_is_started_again(client, api, uploaded):
    process = api.studio.bench.process
    process.pause()
    waiting = asyncio.create_task(preview(client, picture=uploaded))
    await until(lambda: process.pid is not None)
    pid = process.pid
    os.kill(pid, signal.SIGKILL)
    process.resume()
    with pytest.raises(SlabcellError, match="status -9"):
        await waiting
    assert (await preview(client, picture=uploaded))["located"] is not None
    assert process.pid != pid


async def test_the_bench_runs_at_low_priority_and_ends_with_the_daemon():
    bench = Workbench()
    with pytest.raises(BenchError, match="KeyError"):
        await bench.run("nothing", {}, timeout_s=60.0)
    pid = bench.process.pid
    assert os.getpriority(os.PRIO_PROCESS, pid) == 15
    await bench.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    with pytest.raises(TemporaryError, match="is ending"):
        await bench.run("preview", {}, timeout_s=1.0)


async def test_a_task_that_takes_too_long_is_ended_and_so_is_one_that_is_cancelled():
    bench = Workbench()
    bench.process.pause()
    with pytest.raises(BenchError, match="was not ready after"):
        await bench.run("preview", {}, timeout_s=0.2)
    task = asyncio.create_task(bench.run("preview", {}, timeout_s=60.0))
    await until(lambda: bench.process.pid is not None)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await bench.close()


async def test_only_some_tasks_wait_for_the_bench():
    bench = Workbench()
    bench.process.pause()
    tasks = [asyncio.create_task(bench.run("preview", {}, timeout_s=60.0)) for _ in range(MAX_WAITING)]
    await asyncio.sleep(0)
    with pytest.raises(TemporaryError, match="ask again later"):
        await bench.run("preview", {}, timeout_s=60.0)
    await bench.close()
    ended = await asyncio.gather(*tasks, return_exceptions=True)
    assert all(isinstance(item, BenchError) for item in ended)


async def test_an_idle_bench_is_ended():
    bench = Workbench(idle_s=0.01)
    with pytest.raises(BenchError):
        await bench.run("nothing", {}, timeout_s=60.0)
    await until(lambda: bench.process.pid is None)
    await bench.close()
