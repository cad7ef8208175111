"""Templates over the control API: checked with places, read out of drawings, kept, laid by the next job."""

from __future__ import annotations

import asyncio
import io
import json
from pathlib import Path

import ezdxf
import pytest
from typer.testing import CliRunner

from slabcell.cli.recipe import recipe_app
from slabcell.errors import SlabcellError
from slabcell.service.api.client import ApiClient

pytestmark = [pytest.mark.unit, pytest.mark.timeout(180)]

SQUARE = "0,0,40,0,40,40,0,40"


@pytest.fixture
def client(api, tmp_path: Path) -> ApiClient:
    return ApiClient(tmp_path / "api.sock", timeout_s=120.0)


async def checked(client: ApiClient, content: bytes, query: str = "") -> dict:
    path, kind = f"/v1/templates/check{query}", "application/octet-stream"
    return await asyncio.to_thread(client.send, path, content, kind)


def kinds(document: dict) -> list[str]:
    return [item["kind"] for item in document["findings"]]


async def test_every_fault_has_its_place_in_the_file_and_on_the_pattern(client: ApiClient) -> None:
    document = await checked(client, f"{SQUARE}\n30,0,70,0,70,40,30,40\n1,x,2,2,3,3\n".encode())
    assert not document["usable"]
    assert document["problems"] == ["template:3: column 2 (B): 'x' is not a number"]
    document = await checked(client, f"{SQUARE}\n30,0,70,0,70,40,30,40\n".encode())
    (fault,) = document["findings"]
    assert (fault["kind"], fault["advice"], fault["slots"]) == ("overlap", False, [0, 1])
    assert fault["place"] == "2: column 1 (A)"
    assert fault["values"]["area_mm2"] == pytest.approx(400.0)
    x, y = fault["at_mm"]
    assert 30 <= x <= 40
    assert 0 <= y <= 40
    assert len(document["slots"]) == 2, "what is wrong is drawn, too"


async def test_what_the_gripper_and_the_vision_make_of_it_is_said(client: ApiClient) -> None:
    twins = await checked(client, f"{SQUARE}\n50,0,90,0,90,40,50,40\n90.3,0,130.3,0,130.3,20,90.3,20\n".encode())
    assert twins["usable"]
    assert sorted(set(kinds(twins))) == ["alike", "gap", "turns"]
    thin = await checked(client, b"0,0,100,0,100,6,0,6\n")
    assert "no_grasp" in kinds(thin)
    near = await checked(client, f"{SQUARE}\n50,0,90.25,0,90.25,40,50,40\n".encode())
    (item,) = [found for found in near["findings"] if found["kind"] == "confusable"]
    assert 0.0 < item["values"]["apart_mm"] < 0.1


async def test_a_drawing_comes_back_as_the_csv_that_it_makes(client: ApiClient) -> None:
    document = ezdxf.new()
    space = document.modelspace()
    space.add_lwpolyline([(0, 0), (4, 0), (4, 4), (0, 4)], close=True, dxfattribs={"layer": "S_8mm"})
    space.add_text("K7").set_placement((1, 1))
    stream = io.StringIO()
    document.header["$INSUNITS"] = 0
    document.write(stream)
    raw = stream.getvalue().encode()
    assert kinds(await checked(client, raw)) == ["no_unit"]
    found = await checked(client, raw, "?unit=cm&layers=S_8mm")
    assert found["slots"][0]["name"] == "K7"
    assert found["slots"][0]["thickness_mm"] == 8.0
    assert found["slots"][0]["area_mm2"] == pytest.approx(1600.0)
    again = await checked(client, found["csv"].encode())
    assert again["slots"][0]["outline_mm"] == found["slots"][0]["outline_mm"]
    assert again["sha256"] == found["sha256"]
    assert kinds(await checked(client, b"AC1032 rest")) == ["dwg"]
    with pytest.raises(SlabcellError, match="unit"):
        await checked(client, raw, "?unit=furlong")


async def test_a_template_becomes_a_recipe_of_its_own_and_the_next_job_lays_it(api, client: ApiClient) -> None:
    body = {"template_csv": f"# name: K7\n{SQUARE}\n", "name": "roof"}
    saved = await asyncio.to_thread(client.post, "/v1/recipes/squares/versions", body)
    assert saved["name"] == "roof"
    listed = {item["name"]: item for item in (await asyncio.to_thread(client.get, "/v1/recipes"))["recipes"]}
    assert (listed["roof"]["root"], listed["roof"]["version"], listed["roof"]["problem"]) == ("roof", 0, "")
    shown = await asyncio.to_thread(client.get, "/v1/recipes/roof/template")
    assert shown["slots"][0]["name"] == "K7"
    assert "turns" in kinds(shown)
    await asyncio.to_thread(client.post, "/v1/recipes/roof/activate")
    assert api.cell.recipe.template.slots[0].bounds[2] == 40.0
    for name, why in (("roof", "already"), ("ROOF", "already"), ("../x", "no name"), ("a~1", "no name")):
        with pytest.raises(SlabcellError, match=why):
            await asyncio.to_thread(client.post, "/v1/recipes/squares/versions", {**body, "name": name})


async def test_the_command_line_does_what_the_page_does(api, client: ApiClient, tmp_path: Path) -> None:
    file = tmp_path / "new.csv"
    file.write_text(f"{SQUARE}\n")
    toml = tmp_path / "squares.toml"
    toml.write_text("[matching]\nmin_score = 0.5\n")

    async def slabcell(*words: str) -> str:
        socket = ["--socket", str(tmp_path / "api.sock")]
        ran = await asyncio.to_thread(CliRunner().invoke, recipe_app, [*words, *socket])
        assert ran.exit_code == 0, (ran.output, ran.exception)
        return ran.stdout

    assert "4 rotations" in await slabcell("template", "squares", str(file))
    saved = await slabcell("save", "squares", str(toml), "--template", str(file), "--as", "roof")
    assert saved.split()[-1] == "roof"
    assert json.loads((await slabcell("template", "roof", "--json")).splitlines()[-1])["usable"]
