"""What comes in over the socket is checked, bounded, and answered in one way."""

import asyncio
import hashlib
import json
import shutil
from pathlib import Path

import pytest
from openapi_spec_validator import validate
from typer.testing import CliRunner

from slabcell.catalogue import Fault
from slabcell.cell.ledger import LedgerFile
from slabcell.cell.records import Job, JobState
from slabcell.cli.job import job_app
from slabcell.errors import ConfigurationError, RecipeError, SlabcellError, UnavailableError
from slabcell.service.active_recipe import RecipeShelf
from slabcell.service.api.app import ENDPOINTS, description
from slabcell.service.api.client import ApiClient
from slabcell.service.api.server import listen
from slabcell.service.history import CycleRow

pytestmark = pytest.mark.unit

CONFIG = Path(__file__).parents[4] / "config"


@pytest.fixture
def client(api, tmp_path) -> ApiClient:
    return ApiClient(tmp_path / "api.sock")


async def raw(path: Path, request: bytes) -> tuple[int, dict[str, str], bytes]:
    """Send bytes as they are; return status, headers and body of the answer."""
    reader, writer = await asyncio.open_unix_connection(path)
    writer.write(request)
    head = (await reader.readuntil(b"\r\n\r\n")).decode()
    status, *lines = head.rstrip().split("\r\n")
    headers = {name.lower(): value for name, _, value in (line.partition(": ") for line in lines)}
    body = await reader.readexactly(int(headers["content-length"])) if "content-length" in headers else b""
    writer.close()
    await writer.wait_closed()
    return int(status.split()[1]), headers, body


def head(method: str, target: str, **headers: str) -> bytes:
    lines = [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return "\r\n".join([f"{method} {target} HTTP/1.1", "host: x", *lines, "", ""]).encode()


def test_the_description_is_valid_openapi_and_names_every_operation_once():
    document = description()
    validate(document)  # the peer: openapi-spec-validator
    names = [operation["operationId"] for path in document["paths"].values() for operation in path.values()]
    assert len(names) == len(set(names)) > 20
    unkept = {endpoint.path for endpoint in ENDPOINTS if not endpoint.kept}
    assert unkept == {
        *("/v1/vision/preview", "/v1/vision/pictures", "/v1/templates/check", "/v1/frames/take"),
        *("/v1/calibration/detect", "/v1/recipes/compare", "/v1/vision/run"),
    }
    posts = [item["post"] for path, item in document["paths"].items() if "post" in item and path not in unkept]
    assert all(any(p["name"] == "Idempotency-Key" for p in operation["parameters"]) for operation in posts)


async def test_the_description_is_served(client):
    assert await asyncio.to_thread(client.get, "/v1/openapi.json") == json.loads(json.dumps(description()))


@pytest.mark.parametrize(
    ("request_bytes", "status", "words"),
    [
        (head("GET", "/v1/nothing"), 404, "no such resource"),
        (head("DELETE", "/v1/status"), 405, "method is not possible"),
        (head("GET", "/v1/status?what=1"), 422, "'what' is not known"),
        (head("GET", "/v1/jobs?limit=101"), 422, "less than or equal to 100"),
        (head("GET", "/v1/jobs?limit=1&limit=2"), 422, "given twice"),
        (head("GET", "/v1/jobs?limt=1"), 422, "known are limit, before, state"),
        (head("GET", "/v1/jobs/x"), 404, "is no number"),
        (head("GET", "/v1/jobs/12345678901234567890"), 404, "is no number"),
        (head("GET", "/v1/jobs/7"), 404, "no job 7"),
        (head("GET", "/v1/cycles/7"), 404, "no cycle 7"),
        (head("GET", "/v1/frames/latest"), 404, "no picture"),
        (head("GET", "/v1/events?kinds=alarm,nonsense"), 422, "'nonsense' is no kind"),
        (head("GET", "/v1/status", x="y" * 17_000), 431, "at most 16384 are taken"),
        (head("POST", "/v1/stop"), 400, "Idempotency-Key is missing"),
        (head("POST", "/v1/stop", idempotency_key="short"), 400, "8 to 64"),
        (head("POST", "/v1/stop", idempotency_key="k" * 8, content_length="2") + b"{}", 422, "takes no body"),
        (head("POST", "/v1/alarms/1/acknowledge", idempotency_key="k" * 8), 404, "no number 1"),
        (head("POST", "/v1/alarms/1101/acknowledge", idempotency_key="k" * 8), 404, "does not stand"),
        (head("POST", "/v1/ledger/9/resolve", idempotency_key="k" * 8), 422, "verdict"),
        (
            head("POST", "/v1/ledger/9/resolve", idempotency_key="k" * 8, content_length="3") + b"a=b",
            415,
            "send application/json",
        ),
        (
            head(
                *("POST", "/v1/ledger/9/resolve"),
                idempotency_key="k" * 8,
                content_type="application/json",
                content_length="5",
            )
            + b"[[[[[",
            400,
            "no JSON",
        ),
        (
            head(
                *("POST", "/v1/ledger/9/resolve"),
                idempotency_key="k" * 8,
                content_type="application/json",
                content_length="2",
            )
            + b"[]",
            422,
            "must be a JSON object",
        ),
        (head("POST", "/v1/stop", idempotency_key="k" * 8, content_length="99999999"), 413, "at most 65536"),
    ],
    ids=lambda value: value.split(b" HTTP")[0].decode() if isinstance(value, bytes) else None,
)
async def test_what_is_wrong_with_a_request_is_said_as_a_problem(api, tmp_path, request_bytes, status, words):
    found, headers, body = await raw(tmp_path / "api.sock", request_bytes)
    problem = json.loads(body)
    assert (found, headers["content-type"]) == (status, "application/problem+json")
    assert problem["status"] == status
    assert words in problem["detail"]


async def test_a_chunked_body_is_not_read_beyond_its_limit(api, tmp_path):
    chunk = b"8000\r\n" + b"x" * 0x8000 + b"\r\n"
    request = head("POST", "/v1/stop", idempotency_key="k" * 8, transfer_encoding="chunked") + 3 * chunk
    status, _, body = await raw(tmp_path / "api.sock", request)
    assert status == 413
    assert b"larger than 65536" in body


async def test_a_head_without_end_is_cut_off(api, tmp_path):
    reader, writer = await asyncio.open_unix_connection(tmp_path / "api.sock")
    writer.write(b"GET /v1/status HTTP/1.1\r\nx: " + b"y" * 100_000)
    answer = await reader.read(-1)
    assert answer.startswith(b"HTTP/1.1 400")
    writer.close()


async def test_a_head_that_does_not_come_is_waited_for_only_so_long(api, tmp_path, monkeypatch):
    monkeypatch.setattr("slabcell.http_server.HttpConnection.head_timeout_s", 0.05)
    reader, writer = await asyncio.open_unix_connection(tmp_path / "api.sock")
    writer.write(b"GET /v1/status HTTP/1.1\r\n")
    assert await reader.read(-1) == b""
    writer.close()


async def test_more_clients_than_the_limit_are_cut_off_and_the_others_are_served(api, tmp_path, client, monkeypatch):
    monkeypatch.setattr("slabcell.service.api.server._Connection.max_connections", 3)
    path = tmp_path / "api.sock"
    held = [await asyncio.open_unix_connection(path) for _ in range(3)]
    for _, writer in held:
        writer.write(head("GET", "/v1/status"))
    for reader, _ in held:
        assert (await reader.readline()).startswith(b"HTTP/1.1 200")
    with pytest.raises(UnavailableError):
        await asyncio.to_thread(client.get, "/v1/status")
    for _, writer in held:
        writer.close()
        await writer.wait_closed()
    assert (await asyncio.to_thread(client.get, "/v1/status"))["name"] == "test"


async def test_the_same_write_twice_at_once_is_done_once(api, client):
    both = [asyncio.to_thread(client.post, "/v1/stop", key="once-and-only-once") for _ in range(2)]
    first, second = await asyncio.gather(*both)
    assert first == second
    assert api.cell.state == "halted"


async def test_a_write_that_was_cut_short_is_not_done_again(api, client):
    target = "/v1/stop"
    fingerprint = hashlib.sha256(f"POST {target}?".encode() + b"\0").hexdigest()
    await api.history.read(lambda file: file.request_begins("was-cut-short", fingerprint, "root", target, "now"))
    with pytest.raises(SlabcellError, match="was cut short"):
        await asyncio.to_thread(client.post, target, key="was-cut-short")
    assert api.cell.state == "ready"


async def test_who_looks_waits_for_a_robot_that_is_served_and_who_does_something_does_not(api, client, monkeypatch):
    monkeypatch.setattr("slabcell.service.api.context.LOOKING_WAITS_S", 600.0)
    with api.cell.leisure.serving():
        looking = asyncio.create_task(asyncio.to_thread(client.get, "/v1/status"))
        async with asyncio.timeout(60):
            await asyncio.to_thread(client.post, "/v1/stop")
        assert not (await asyncio.wait({looking}, timeout=0.2))[0]
    async with asyncio.timeout(60):
        assert (await looking)["state"] == "halted"


async def test_a_problem_carries_the_catalogues_number_and_what_to_do(api, client):
    with pytest.raises(SlabcellError, match="a verification needs a job") as caught:
        await asyncio.to_thread(client.post, "/v1/verify")
    assert caught.value.number == Fault.NOT_READY


async def test_a_look_shows_the_picture_and_what_is_in_it_and_writes_nothing(api, client):
    cycle = await asyncio.to_thread(client.post, "/v1/trigger")
    assert (cycle["cycle"], cycle["offers"]) == (0, [])
    frame = await asyncio.to_thread(client.get, "/v1/frames/latest")
    assert (frame["width"], frame["height"]) == (640, 480)
    overlay = frame["overlay"]
    assert overlay["schema"] == "slabcell.locate/1"
    assert len(overlay["parts"]) + len(overlay["rejected"]) == 1
    png = await asyncio.to_thread(client.fetch, "/v1/frames/latest.png")
    assert png.content.startswith(b"\x89PNG")
    status, headers, _ = await raw(Path(client.path), head("GET", "/v1/frames/latest.png", if_none_match=png.etag))
    assert (status, headers["etag"]) == (304, png.etag)
    jpeg = await asyncio.to_thread(client.fetch, "/v1/frames/latest.jpg")
    assert jpeg.content.startswith(b"\xff\xd8")
    assert (await asyncio.to_thread(client.get, "/v1/jobs"))["jobs"] == []


async def test_a_shelved_alarm_is_hidden_until_somebody_asks_for_it(api, client):
    api.cell.alarms.come(Fault.BUNDLE_UNWRITABLE, "no room")
    await asyncio.to_thread(client.post, "/v1/alarms/1707/shelve", {"duration_s": 60})
    assert (await asyncio.to_thread(client.get, "/v1/alarms"))["alarms"] == []
    (shelved,) = (await asyncio.to_thread(client.get, "/v1/alarms", shelved=True))["alarms"]
    assert 0 < shelved["shelved_s"] <= 60
    await asyncio.to_thread(client.post, "/v1/alarms/1707/unshelve")
    assert len((await asyncio.to_thread(client.get, "/v1/alarms"))["alarms"]) == 1


async def test_pages_of_cycles_join_up_and_can_be_filtered(api, client):
    document = json.dumps(
        {
            **dict.fromkeys(("ledger_cycle", "session", "trigger", "found", "rejected"), 0),
            "cycle": 0,
            "job": 0,
            "verification": False,
            "began": "",
            "ended": True,
            "code": 0,
            "message": "",
            "times_ms": {},
            "refused": [],
            "offers": [],
            "placements": [],
            "frame": None,
        }
    )
    for number in range(1, 26):
        content = json.loads(document) | {"cycle": number, "job": number % 3, "code": 1101 if number % 5 == 0 else 0}
        row = CycleRow(number, content["job"], False, content["code"], "", json.dumps(content))
        api.history.add_cycle(row)
    seen, before = [], {}
    while True:
        page = await asyncio.to_thread(lambda query=dict(before): client.get("/v1/cycles", limit=10, **query))
        seen += [cycle["cycle"] for cycle in page["cycles"]]
        if page["before"] is None:
            break
        before = {"before": page["before"]}
    assert seen == list(range(25, 0, -1))
    failed = await asyncio.to_thread(lambda: client.get("/v1/cycles", failed=True))
    assert [cycle["cycle"] for cycle in failed["cycles"]] == [25, 20, 15, 10, 5]
    of_job = await asyncio.to_thread(lambda: client.get("/v1/cycles", job=2, limit=3))
    assert [cycle["cycle"] for cycle in of_job["cycles"]] == [23, 20, 17]


def test_a_socket_that_somebody_listens_at_is_not_taken_and_one_left_behind_is(tmp_path):
    path = tmp_path / "api.sock"
    first = listen(path, mode=0o660, group=None)
    with pytest.raises(UnavailableError, match="another process listens there"):
        listen(path, mode=0o660, group=None)
    first.close()  # as kill -9 leaves it: the file stays
    assert path.exists()
    listen(path, mode=0o660, group=None).close()


def test_a_socket_path_that_cannot_be_is_refused_with_its_limit(tmp_path):
    with pytest.raises(ConfigurationError, match="107 bytes"):
        listen(tmp_path / ("x" * 120), mode=0o660, group=None)
    with pytest.raises(ConfigurationError, match="no such group"):
        listen(tmp_path / "s", mode=0o660, group="nobody-has-this-group")
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="is no socket"):
        listen(tmp_path / "file", mode=0o660, group=None)


async def test_a_recipe_is_activated_between_jobs_for_restarts_too(api, client, tmp_path):
    shutil.copytree(CONFIG / "recipes", tmp_path / "recipes", dirs_exist_ok=True)
    shutil.copytree(CONFIG / "templates", tmp_path / "templates")
    (tmp_path / "recipes" / "broken.toml").write_text("[template]\nfile = 1\n")
    shelf = api.recipes = RecipeShelf(tmp_path / "recipes" / "irregular.toml", tmp_path)
    listed = (await asyncio.to_thread(client.get, "/v1/recipes"))["recipes"]
    problems = {recipe["name"]: recipe["problem"] for recipe in listed}
    assert problems.keys() >= {"broken", "dresden", "irregular"}
    assert "broken.toml" in problems["broken"]
    assert problems["dresden"] == ""
    await asyncio.to_thread(client.post, "/v1/recipes/dresden/activate")
    assert api.cell.recipe.name == "dresden"
    assert (await asyncio.to_thread(client.get, "/v1/recipes/active"))["recipe"]["name"] == "dresden"
    assert shelf.active == tmp_path / "recipes" / "dresden.toml"
    for name in ("broken", "none", "..%2Fdresden"):
        with pytest.raises(SlabcellError):
            await asyncio.to_thread(client.post, f"/v1/recipes/{name}/activate")
    assert api.cell.recipe.name == "dresden"
    graded = tmp_path / "recipes" / "irregular.graded"
    graded.mkdir()
    (graded / "damaged.zip").write_bytes(b"no bundle")
    with pytest.raises(SlabcellError, match=r"damaged\.zip"):
        await asyncio.to_thread(client.post, "/v1/recipes/irregular/activate")
    assert api.cell.recipe.name == "dresden"
    (tmp_path / "recipes" / "dresden.toml").unlink()
    with pytest.raises(RecipeError, match="which is not there"):
        _ = shelf.active
    (tmp_path / "active-recipe.json").write_text("{")
    with pytest.raises(RecipeError, match="is damaged"):
        _ = shelf.active


async def test_a_recipe_does_not_change_within_a_job(api, client, tmp_path):
    shutil.copytree(CONFIG / "recipes", tmp_path / "recipes", dirs_exist_ok=True)
    shutil.copytree(CONFIG / "templates", tmp_path / "templates")
    api.recipes = RecipeShelf(tmp_path / "recipes" / "dresden.toml", tmp_path)
    api.cell._desk.job = Job(1, 1, "squares", "a" * 64, 1, JobState.OPEN)
    with pytest.raises(SlabcellError, match="a recipe changes"):
        await asyncio.to_thread(client.post, "/v1/recipes/dresden/activate")
    assert not (tmp_path / "active-recipe.json").exists()


async def test_the_calibration_in_use_can_be_read(api, client):
    document = (await asyncio.to_thread(client.get, "/v1/calibration"))["calibration"]
    assert document["schema"] == "slabcell.calibration/1"
    assert document["camera"]["width"] == 640


async def test_a_job_says_by_how_much_its_places_are_moved(api, client, tmp_path):
    book = LedgerFile(tmp_path / "ledger.sqlite")
    book.begin_job(1, "squares", "a" * 64, 1, (0.125, -0.5))
    book.close()
    job = (await asyncio.to_thread(client.get, "/v1/jobs/1"))["job"]
    assert (job["correction_x_mm"], job["correction_y_mm"]) == (0.125, -0.5)
    shown = await asyncio.to_thread(CliRunner().invoke, job_app, ["show", "1", "--socket", str(client.path)])
    assert "every place is moved by dx +0.125 mm, dy -0.500 mm" in shown.output
