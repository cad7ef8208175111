"""Tune: parameters are tried on pictures, and become the cell's only where its graded pictures pass."""

import json
import zipfile

import pytest

from .conftest import Cell

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(300)]


def test_the_demo_has_recipes_calibrations_and_pictures_to_work_on(cell: Cell) -> None:
    active = cell.api.get("/v1/status")["recipe"]
    assert active in [item["name"] for item in cell.api.get("/v1/recipes")["recipes"]]
    assert [item["name"] for item in cell.api.get("/v1/calibrations")["calibrations"]][-1] == "configured"
    kept = sorted((cell.folder / "pictures" / "examples").glob("*.png"))
    assert len(kept) == 4
    strewn = next(file for file in kept if file.name.startswith("strewn-1"))
    done = cell.api.post("/v1/vision/preview", {"picture": f"set:examples/{strewn.name}"})
    assert len(done["located"]["parts"]) == 5


def test_a_graded_picture_is_looked_at_by_its_name(cell: Cell) -> None:
    cell.lay()
    recipe = cell.api.get("/v1/status")["recipe"]
    cell.api.post(f"/v1/recipes/{recipe}/grade", {"cycle": cell.kept_cycle()})
    (bundle, *_) = cell.api.get(f"/v1/recipes/{recipe}")["graded"]
    done = cell.api.post("/v1/vision/preview", {"picture": f"graded:{recipe}/{bundle}"})
    file = next((cell.folder / "recipes" / f"{recipe}.graded").glob("*.zip"))
    with zipfile.ZipFile(file) as archive:
        offered = json.loads(archive.read("result.json"))["parts"]
    assert len(done["located"]["parts"]) == len(offered)
