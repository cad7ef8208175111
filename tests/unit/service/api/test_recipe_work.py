"""A recipe is read, saved as a new version, graded and verified over the control API; nothing is ever overwritten."""

import asyncio
import json
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slabcell.cli.recipe import recipe_app
from slabcell.cli.tasks import task_app
from slabcell.errors import RecipeError, SlabcellError, TemporaryError
from slabcell.recipe import RecipeFile, load_recipe
from slabcell.service.active_recipe import version_of
from slabcell.service.api.client import ApiClient
from slabcell.service.background import UNFINISHED, Background
from slabcell.service.candidate import make_candidate
from slabcell.service.recipe_schema import recipe_schema
from slabcell.service.recipe_text import to_toml
from slabcell.toml_file import read_toml

pytestmark = pytest.mark.unit

CONFIG = Path(__file__).parents[4] / "config"
RICH = {
    "template": {"file": 'a "b" ü\\.csv', "thickness_mm": 10.5},
    "segmentation": {
        "method": "multi_otsu",
        "roi": [[0.0, 0.0], [1e-7, 5.0], [12345.678, 9.0]],
        "morphology": [{"operation": "open", "size_px": 5}, {"operation": "fill"}],
        "promptable": {"encoder": "e.onnx"},
    },
    "blobs": {"report": True, "filters": [{"feature": "roundness", "min": 0.25}], "sort_by": "u"},
    "grasp": {"cups_mm": [[0.0, 1.0]], "forbidden": [{"polygon": [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], "slot": 2}]},
    "gates": {"marks": [{"x_mm": 1.0, "y_mm": -2.5, "diameter_mm": 8.0}]},
}


@pytest.fixture
def client(api, tmp_path) -> ApiClient:
    return ApiClient(tmp_path / "api.sock", timeout_s=60.0)


async def post(client: ApiClient, path: str, body: dict | None = None) -> dict:
    return await asyncio.to_thread(client.post, path, body)


async def slabcell(app, *words: object, socket: Path, code: int = 0) -> str:
    ran = await asyncio.to_thread(CliRunner().invoke, app, [*map(str, words), "--socket", str(socket)])
    assert ran.exit_code == code, (ran.output, ran.exception)
    return ran.stdout


@pytest.mark.parametrize("name", ["rich", *(path.stem for path in sorted((CONFIG / "recipes").glob("*.toml")))])
def test_a_recipe_that_is_written_down_reads_as_the_same(name, tmp_path):
    if name == "rich":
        written = RecipeFile.model_validate(RICH)
    else:
        written = read_toml(CONFIG / "recipes" / f"{name}.toml", RecipeFile, RecipeError)
    text = to_toml(written, remark="two\nlines")
    assert text.startswith("# two\n# lines\n")
    assert RecipeFile.model_validate(tomllib.loads(text)) == written


def test_the_schema_says_range_unit_and_meaning_of_every_number():
    schema = recipe_schema()
    for table in (schema, *schema["$defs"].values()):
        for name, field in table["properties"].items():
            assert field.get("description") or "$ref" in field, name
    area = schema["$defs"]["SegmentationParameters"]["properties"]["min_area_mm2"]
    assert (area["x-unit"], area["exclusiveMinimum"], area["default"]) == ("mm²", 0, 25.0)


async def test_a_recipe_is_read_whole(client, tmp_path):
    document = await asyncio.to_thread(client.get, "/v1/recipes/squares")
    assert document["toml"] == (tmp_path / "recipes" / "squares.toml").read_text()
    assert document["parameters"]["matching"]["max_residual_mm"] == 0.4
    assert document["recipe"]["template"]["slots"] == [[[0.0, 0.0], [30.0, 0.0], [30.0, 30.0], [0.0, 30.0]]]
    assert (document["active"], document["graded"]) == (True, [])
    schema = await asyncio.to_thread(client.get, "/v1/recipes/schema")
    assert schema["json_schema"] == recipe_schema()
    with pytest.raises(SlabcellError, match="there is no recipe 'nobody'"):
        await asyncio.to_thread(client.get, "/v1/recipes/nobody")


async def test_a_candidate_is_saved_as_a_new_version_and_activated(api, client, tmp_path):
    before = (tmp_path / "recipes" / "squares.toml").read_bytes()
    first = await post(client, "/v1/recipes/squares/versions", {"parameters": {"matching": {"min_score": 0.5}}})
    second = await post(
        client,
        "/v1/recipes/squares~1/versions",
        {"toml": "[matching]\nmin_score = 0.6\n", "template_csv": "0,0,40,0,40,30,0,30\n"},
    )
    assert (first["name"], second["name"]) == ("squares~1", "squares~2")
    listed = {item["name"]: item for item in (await asyncio.to_thread(client.get, "/v1/recipes"))["recipes"]}
    assert list(listed) == ["squares", "squares~1", "squares~2"]
    assert [(item["root"], item["version"], item["problem"]) for item in listed.values()] == [
        ("squares", number, "") for number in range(3)
    ]
    assert (tmp_path / "recipes" / "squares.toml").read_bytes() == before
    await post(client, "/v1/recipes/squares~2/activate")
    assert api.cell.recipe.matching.min_score == 0.6
    assert api.cell.recipe.template.slots[0].bounds[2] == 40.0
    assert api.recipes.active.stem == "squares~2"
    with pytest.raises(SlabcellError, match="less than or equal to 1"):
        await post(client, "/v1/recipes/squares/versions", {"parameters": {"matching": {"min_score": 7}}})


async def test_versions_are_counted_on_whatever_is_there(api, tmp_path):
    candidate = make_candidate(api.recipes.path_of("squares"))
    names = await asyncio.gather(*(asyncio.to_thread(api.recipes.save, "squares", candidate) for _ in range(5)))
    assert sorted(names) == [f"squares~{number}" for number in range(1, 6)]
    assert load_recipe(api.recipes.path_of("squares~5")).template.slots[0].area_mm2 == 900.0
    assert [version_of(name) for name in ("a", "a~3", "~3", "a~b", "a~1~2")] == [
        ("a", 0),
        ("a", 3),
        ("~3", 0),
        ("a~b", 0),
        ("a~1", 2),
    ]


async def test_a_recipe_is_verified_in_the_background_on_pictures_that_a_person_has_graded(api, client, tmp_path):
    with pytest.raises(SlabcellError, match="there is no cycle 5"):
        await post(client, "/v1/recipes/squares/grade", {"cycle": 5})
    task = await post(client, "/v1/recipes/squares/verify")
    result = await asyncio.to_thread(client.follow, task)
    assert (result["passed"], result["pictures"]) == (True, [])
    folder = tmp_path / "recipes" / "squares.graded"
    folder.mkdir()
    (folder / "damaged.zip").write_bytes(b"no bundle")
    task = await post(client, "/v1/recipes/squares/verify")
    with pytest.raises(SlabcellError, match=r"run the graded set of squares: .*damaged\.zip"):
        await asyncio.to_thread(client.follow, task)
    listed = await asyncio.to_thread(client.get, "/v1/tasks")
    assert [item["state"] for item in listed["tasks"]] == ["failed", "done"]
    with pytest.raises(SlabcellError, match="there is no task"):
        await asyncio.to_thread(client.get, "/v1/tasks/nothing")


async def test_work_that_is_cancelled_says_so_and_only_some_runs_at_once():
    told: list[str] = []
    background = Background(lambda task: told.append(task.state.value))
    never = asyncio.Event()

    async def wait(progress) -> dict:
        progress({"done": 1, "total": 2, "doing": "waiting"})
        await never.wait()
        return {}

    tasks = [background.start("test", "wait", wait) for _ in range(UNFINISHED)]
    with pytest.raises(TemporaryError, match="under way already"):
        background.start("test", "wait", wait)
    async with asyncio.timeout(60):
        while tasks[-1].doing != "waiting":  # noqa: ASYNC110 - a state
            await asyncio.sleep(0)
    await background.cancel(tasks[0])
    assert (tasks[0].state, tasks[0].problem) == ("cancelled", "was cancelled")
    await background.close()
    assert {task.state for task in background.tasks} == {"cancelled"}
    assert told.count("cancelled") == UNFINISHED


async def test_the_commands_do_the_same(api, client, tmp_path):
    socket = tmp_path / "api.sock"
    trial = tmp_path / "trial.toml"
    trial.write_text("[matching]\nmin_score = 0.7\n")
    assert (await slabcell(recipe_app, "save", "squares", trial, socket=socket)).split()[
        -1
    ] == "squares~1"  # what the daemon logs is there too
    assert "min_score = 0.7" in await slabcell(recipe_app, "show", "squares~1", socket=socket)
    assert "squares~1" in await slabcell(recipe_app, "list", socket=socket)
    assert "x-unit" in await slabcell(recipe_app, "schema", socket=socket)
    assert json.loads((await slabcell(recipe_app, "verify", "squares~1", "--json", socket=socket)).splitlines()[-1])[
        "passed"
    ]
    assert "is active" in await slabcell(recipe_app, "activate", "squares~1", socket=socket)
    assert api.cell.recipe.name == "squares~1"
    tasks = json.loads(await slabcell(task_app, "list", "--json", socket=socket))["tasks"]
    assert json.loads(await slabcell(task_app, "wait", tasks[0]["task"], socket=socket))["passed"]
    assert "is done" in await slabcell(task_app, "cancel", tasks[0]["task"], socket=socket)
