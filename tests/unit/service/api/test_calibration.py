"""A camera is calibrated on the running cell: boards are found, views collected, the rest is done beside the cell."""

import asyncio
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from slabcell.calibration import CameraIdentity, TablePlane, calibration_to_document, load_calibration
from slabcell.calibration.compare import distance
from slabcell.cell.records import Job, JobState
from slabcell.cli.calibration import calibration_app
from slabcell.errors import CalibrationError, SlabcellError
from slabcell.service.api.client import ApiClient
from slabcell.service.calibration_checks import CheckLog
from slabcell.service.calibrations import CONFIGURED, CalibrationShelf
from slabcell_drivers.robot import Frame
from slabcell_drivers.robot.protocol import Request, RequestType

pytestmark = pytest.mark.unit

BOARD, COLUMNS, ROWS, SQUARE_MM = "checkerboard:8x5:30", 8, 5, 30.0
MATRIX = np.array([[400.0, 0, 320], [0, 400.0, 240], [0, 0, 1]])
FINE = 4


def drawn() -> np.ndarray:
    """The board and a light margin around it, 2 pixels a millimetre; its first inner corner is at (120, 120)."""
    face = np.full((int(2 * (ROWS + 3) * SQUARE_MM), int(2 * (COLUMNS + 3) * SQUARE_MM)), 235, np.uint8)
    for row in range(ROWS + 1):
        for column in range(COLUMNS + 1):
            if (row + column) % 2 == 0:
                top, left = (int(2 * SQUARE_MM * (1 + n)) for n in (row, column))
                face[top : top + 60, left : left + 60] = 25
    return face


def picture(rotation: np.ndarray, translation: np.ndarray) -> bytes:
    """What a camera without distortion sees of a board at this pose in its frame, as a PNG."""
    to_pixels = MATRIX @ np.column_stack([rotation[:, 0], rotation[:, 1], translation])
    drawn_to_mm = np.array([[0.5, 0, -60.0], [0, 0.5, -60.0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]
    )
    enlarge = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1]])
    size = (640 * FINE, 480 * FINE)
    fine = cv2.warpPerspective(drawn(), enlarge @ to_pixels @ drawn_to_mm, size, borderValue=110)
    return bytes(cv2.imencode(".png", cv2.resize(fine, (640, 480), interpolation=cv2.INTER_AREA))[1])


def pose(x: float, y: float, z: float, a: float = 0.0, b: float = 0.0, c: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A board whose middle is at x, y, z before the camera, turned by a, tilted by b and c, its face to the camera."""
    rotation = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_euler("ZYX", (a, b, c), degrees=True).as_matrix()
    return rotation, np.array([x, y, z]) - rotation @ (105.0, 60.0, 0.0)


TILTED = [
    pose(x, y, 560.0, 15.0 * n, *tilt)
    for n, (x, y, tilt) in enumerate(
        [
            (-90, -60, (25, 0)),
            (90, -60, (-25, 10)),
            (-90, 60, (0, 30)),
            (90, 60, (10, -30)),
            (0, 0, (30, 20)),
            (0, 0, (-30, -20)),
            (60, 0, (20, -25)),
            (-60, 0, (-20, 25)),
        ]
    )
]


@pytest.fixture
def client(api, tmp_path) -> ApiClient:
    return ApiClient(tmp_path / "api.sock", timeout_s=60.0)


async def post(client: ApiClient, path: str, body: dict | None = None) -> dict:
    return await asyncio.to_thread(client.post, path, body)


async def upload(client: ApiClient, content: bytes) -> str:
    return (await asyncio.to_thread(client.send, "/v1/vision/pictures", content, "image/png"))["picture"]


async def collect(client: ApiClient, poses, flanges=None) -> None:
    for number, (rotation, translation) in enumerate(poses):
        name = await upload(client, picture(rotation, translation))
        body = {"board": BOARD, "picture": name, "pose": None if flanges is None else flanges[number]}
        await post(client, "/v1/calibration/views", body)


async def made(client: ApiClient, **body: object) -> dict:
    return await asyncio.to_thread(client.follow, await post(client, "/v1/calibration/run", body))


async def test_a_board_is_found_in_a_picture_with_its_points(client):
    rotation, translation = pose(0.0, 0.0, 500.0, 30.0)
    found = await post(
        client,
        "/v1/calibration/detect",
        {"board": BOARD, "picture": await upload(client, picture(rotation, translation))},
    )
    assert (found["found"], found["columns"], found["rows"], len(found["points"])) == (True, 8, 5, 40)
    for number, u, v in found["points"]:
        seen = MATRIX @ (rotation @ (SQUARE_MM * (number % 8), SQUARE_MM * (number // 8), 0.0) + translation)
        assert np.hypot(u - seen[0] / seen[2], v - seen[1] / seen[2]) < 0.1
    empty = await upload(client, bytes(cv2.imencode(".png", np.zeros((480, 640), np.uint8))[1]))
    nothing = await post(client, "/v1/calibration/detect", {"board": BOARD, "picture": empty})
    assert (nothing["found"], nothing["points"]) == (False, [])
    assert "no checkerboard:8x5:30 found" in nothing["problem"]
    with pytest.raises(SlabcellError, match="is not one of"):
        await post(client, "/v1/calibration/detect", {"board": "chess", "picture": empty})


async def test_lens_and_plane_are_computed_beside_the_cell_and_activated(api, client, tmp_path):
    await collect(client, TILTED)
    lens = await made(client, kind="camera", model="brown4")
    assert len(lens["report"]["views"]) == len(TILTED)
    kept = load_calibration(api.calibrations.path_of(lens["calibration"]))
    assert abs(kept.lens.matrix[0, 0] - 400.0) < 4.0
    with pytest.raises(SlabcellError, match="plane"):
        await post(client, f"/v1/calibrations/{lens['calibration']}/activate")
    await post(client, "/v1/calibration/clear")
    await collect(client, [pose(0.0, 0.0, 500.0), pose(60.0, 30.0, 500.0, 40.0), pose(-60.0, -30.0, 500.0, -70.0)])
    plane = await made(client, kind="plane", calibration=lens["calibration"], board_thickness_mm=0.0)
    assert plane["report"]["rms_px"] < 0.2
    done = await post(client, f"/v1/calibrations/{plane['calibration']}/activate")
    assert "is in use, for restarts too; points of the table moved by" in done["detail"]
    assert api.cell.calibration.lens.matrix[0, 0] == pytest.approx(kept.lens.matrix[0, 0], abs=4.0)
    assert CalibrationShelf(tmp_path / "calibration.json", tmp_path).chosen == plane["calibration"]
    listed = (await asyncio.to_thread(client.get, "/v1/calibrations"))["calibrations"]
    assert {item["name"]: item["active"] for item in listed}[plane["calibration"]]
    flat = await upload(client, picture(*pose(20.0, 10.0, 500.0, 5.0)))
    check = await post(client, "/v1/calibration/check", {"board": BOARD, "picture": flat, "limit_mm": 2.0})
    assert (check["ok"], check["problems"]) == (True, [])
    lifted = await upload(client, picture(*pose(20.0, 10.0, 480.0, 5.0)))
    check = await post(client, "/v1/calibration/check", {"board": BOARD, "picture": lifted, "limit_mm": 2.0})
    assert not check["ok"]
    kept = (await asyncio.to_thread(client.get, "/v1/calibration/checks"))["checks"]
    assert [(item["check"], item["ok"]) for item in kept] == [(1, True), (2, False)]
    assert {item["calibration"] for item in kept} == {plane["calibration"]}
    compared = await asyncio.to_thread(
        client.get, f"/v1/calibrations/{plane['calibration']}/compare", base=lens["calibration"]
    )
    assert compared["drift"] is None, "without a plane nothing can be compared in millimetres"
    assert (compared["figures_before"]["views"], compared["figures_after"]["plane_views"]) == (len(TILTED), 3)
    assert compared["figures_after"]["plane_rms_px"] == pytest.approx(plane["report"]["rms_px"])
    moved = await asyncio.to_thread(client.get, f"/v1/calibrations/{plane['calibration']}/compare", base=CONFIGURED)
    lengths = [float(np.hypot(x, y)) for _, _, x, y in moved["moved"]]
    assert np.mean(lengths) == pytest.approx(moved["drift"]["mean_mm"], abs=1e-3)
    grid = np.array(lens["report"]["coverage"]["counts"])
    assert grid.sum() == sum(view["points"] for view in lens["report"]["views"] if view["used"])
    assert len(lens["report"]["residuals"]) == grid.sum()


async def test_a_board_that_is_always_in_the_same_place_tells_how_far_the_camera_moved_sideways(client):
    def said(shift: float) -> bytes:
        return picture(*pose(20.0 + shift, 10.0, 500.0))

    async def check(shift: float, **more: object) -> dict:
        name = await upload(client, said(shift))
        return await post(client, "/v1/calibration/check", {"board": BOARD, "picture": name, "limit_mm": 0.5, **more})

    assert (await check(0.0, fixed=True))["drift"] is None, "the first one is the reference"
    assert (await check(0.0))["drift"] is None
    held = await check(0.0, fixed=True)
    assert held["drift"]["worst_mm"] < 0.05
    moved = await check(2.0, fixed=True)
    assert moved["drift"]["mean_mm"] == pytest.approx(2.0, abs=0.1)
    assert any("the fixed board moved" in problem for problem in moved["problems"])
    rows = (await asyncio.to_thread(client.get, "/v1/calibration/checks", limit=2))["checks"]
    assert [row["drift"]["worst_mm"] for row in rows] == [held["drift"]["worst_mm"], moved["drift"]["worst_mm"]]


async def test_what_is_missing_yet_is_said_while_views_are_collected(client):
    async def advice(kind: str) -> dict[str, dict]:
        document = await asyncio.to_thread(client.get, "/v1/calibration/survey", kind=kind)
        return {item["code"]: item["values"] for item in document["advice"]}

    assert (await advice("camera"))["views"]["more"] == 10
    await collect(client, [pose(-100.0, -60.0, 500.0), pose(-100.0, -60.0, 500.0, 0.0, 20.0)])
    found = await advice("camera")
    assert found["tilt"]["more"] == 3
    assert "lower right" in found["place"]["places"]
    assert "upper left" not in found["place"]["places"]
    assert set(found["towards"]["sides"]) < {"left", "right", "up", "down"}
    assert "distance" in found
    await post(client, "/v1/calibration/clear")
    await collect(client, TILTED, [[0.0, 0.0, 900.0, 0.0, float(10 * n), 180.0] for n in range(len(TILTED))])
    found = await advice("hand-eye")
    assert set(found) == {"views", "axis"}, "70° about one axis only"
    survey = await asyncio.to_thread(client.get, "/v1/calibration/survey", kind="camera")
    assert [round(stand["tilt_deg"]) for stand in survey["stands"]][:2] == [25, 27]
    assert set((await advice("plane"))["flat"]["views"]) <= {f"view-{n}" for n in range(3, 11)}


async def test_where_the_robot_was_is_said_by_hand_by_a_table_or_by_the_robot_itself(api, client):
    await collect(client, TILTED[:3])
    await post(client, "/v1/calibration/views/1/pose", {"pose": [1, 2, 3, 4, 5, 6]})
    with pytest.raises(SlabcellError, match="the robot has said nothing"):
        await post(client, "/v1/calibration/views/2/pose", {"pose": "robot"})
    tcp = Frame(400.0, 10.0, 300.0, 0.0, 0.0, 180.0)
    await api.robot.handle(Request(RequestType.HELLO, 0, 1, tcp=tcp))
    told = (await post(client, "/v1/calibration/views/2/pose", {"pose": "robot"}))["pose"]
    assert told == pytest.approx((tcp @ api.cell.settings.tool.inverse()).as_tuple())
    assert told[2] == pytest.approx(560.0), "the flange is a tool's length above its tip"
    table = b"image;X;Y;Z;A;B;C\n3;7;8;9;10;11;12\nview-1;0;0;0;0;0;0\n"
    views = (await asyncio.to_thread(client.send, "/v1/calibration/poses", table, "text/csv"))["views"]
    assert [view["pose"] for view in views] == [[0.0] * 6, pytest.approx(told), [7.0, 8.0, 9.0, 10.0, 11.0, 12.0]]
    for wrong, why in ((b"image,X,Y,Z,A,B,C\n9,1,2,3,4,5,6\n", "9, which is no view"), (b"x", "a header and 1 to")):
        with pytest.raises(SlabcellError, match=why):
            await asyncio.to_thread(client.send, "/v1/calibration/poses", wrong, "text/csv")


async def test_only_a_simulated_cell_has_a_board_to_show(client):
    with pytest.raises(SlabcellError, match="this cell is not simulated"):
        await post(client, "/v1/simulation/board", {"place": "table"})


def test_checks_survive_a_line_that_a_power_loss_has_cut(tmp_path: Path):
    log = CheckLog(tmp_path / "checks.jsonl")
    for n in range(3):
        assert log.add({"at": "2026-01-01T00:00:00", "ok": True}) == n + 1
    with (tmp_path / "checks.jsonl").open("r+b") as stream:
        stream.truncate((tmp_path / "checks.jsonl").stat().st_size - 9)
    assert [item["check"] for item in log.read()] == [1, 2]
    assert log.add({"at": "2026-01-02T00:00:00", "ok": False}) == 3
    assert [item["check"] for item in log.read()] == [1, 2, 3]


async def test_the_place_of_the_camera_is_computed_from_views_with_the_robots_poses(client):
    # Camera in the base, board on the flange: flange = camera · board pose · inverse(board on flange).
    camera, on_flange = np.eye(4), np.eye(4)
    camera[:3, :3], camera[:3, 3] = Rotation.from_euler("ZYX", (20, 5, 175), degrees=True).as_matrix(), (400, 50, 900)
    on_flange[:3, :3], on_flange[:3, 3] = (
        Rotation.from_euler("ZYX", (10, 0, 5), degrees=True).as_matrix(),
        (30, -20, 60),
    )
    flanges = []
    for rotation, translation in TILTED:
        seen = np.eye(4)
        seen[:3, :3], seen[:3, 3] = rotation, translation
        flange = camera @ seen @ np.linalg.inv(on_flange)
        a, b, c = Rotation.from_matrix(flange[:3, :3]).as_euler("ZYX", degrees=True)
        flanges.append([*flange[:3, 3], a, b, c])
    await collect(client, TILTED, flanges)
    done = await made(client, kind="hand-eye", mount="eye-to-hand")
    assert np.allclose(done["report"]["camera"][:3], camera[:3, 3], atol=3.0)
    views = (await asyncio.to_thread(client.get, "/v1/calibration/views"))["views"]
    assert [item["points"] for item in views] == [40] * len(TILTED)
    assert all(3 < len(item["hull"]) <= 40 for item in views)


async def test_what_cannot_be_computed_is_said(client):
    with pytest.raises(SlabcellError, match="there are no views"):
        await post(client, "/v1/calibration/run", {"kind": "camera"})
    await collect(client, TILTED[:2])
    with pytest.raises(SlabcellError, match="say no pose of the robot"):
        await post(client, "/v1/calibration/run", {"kind": "hand-eye"})
    with pytest.raises(SlabcellError, match="at least 4 are needed"):
        await made(client, kind="camera")
    with pytest.raises(SlabcellError, match="the views so far are of"):
        await post(client, "/v1/calibration/views", {"board": "checkerboard:7x5:30"})
    with pytest.raises(SlabcellError, match="no calibration 'none'"):
        await post(client, "/v1/calibration/run", {"kind": "plane", "calibration": "none"})
    await post(client, "/v1/calibration/views/1/remove")
    with pytest.raises(SlabcellError, match="there is no view 1"):
        await post(client, "/v1/calibration/views/1/remove")


async def test_an_uploaded_calibration_must_be_of_this_camera_and_is_activated_between_jobs_only(api, client, tmp_path):
    own = api.cell.calibration

    async def send(calibration) -> str:
        content = json.dumps(calibration_to_document(calibration)).encode()
        return (await asyncio.to_thread(client.send, "/v1/calibrations", content, "application/json"))["name"]

    for camera, words in ((CameraIdentity(800, 600), "800x600"), (CameraIdentity(640, 480, binning=2), "binning")):
        with pytest.raises(SlabcellError, match=words):
            await send(replace(own, camera=camera))
    for raw, words in ((b"{", "is no JSON"), (b"{}", "'schema' is missing"), (b"[" * 100_000, "no JSON|object")):
        with pytest.raises(SlabcellError, match=words):
            await asyncio.to_thread(client.send, "/v1/calibrations", raw, "application/json")
    moved = replace(own, plane=TablePlane(own.plane.rotation, own.plane.translation + np.array([1.5, 0.0, 0.0])))
    name = await send(moved)
    drift = {
        item["name"]: item["drift"]
        for item in (await asyncio.to_thread(client.get, "/v1/calibrations"))["calibrations"]
    }
    assert drift[name]["mean_mm"] == pytest.approx(1.5)
    api.cell._desk.job = Job(1, 1, "squares", "a" * 64, 1, JobState.OPEN)
    with pytest.raises(SlabcellError, match="a calibration changes only between jobs"):
        await post(client, f"/v1/calibrations/{name}/activate")
    assert api.calibrations.chosen == CONFIGURED
    api.cell._desk.job = None
    await post(client, f"/v1/calibrations/{name}/activate")
    assert distance(own, api.cell.calibration).worst_mm == pytest.approx(1.5)


def test_a_choice_that_is_damaged_or_gone_is_an_error(tmp_path: Path):
    shelf = CalibrationShelf(tmp_path / "calibration.json", tmp_path)
    choice = tmp_path / "active-calibration.json"
    choice.write_text("{")
    with pytest.raises(CalibrationError, match="is damaged"):
        _ = shelf.active
    choice.write_text('{"schema": "slabcell.active-calibration/1", "calibration": "../x"}')
    with pytest.raises(CalibrationError, match="which is not there"):
        _ = shelf.active


async def test_the_commands_do_the_same(api, client, tmp_path):
    async def slabcell(*words: object, code: int = 0) -> str:
        ran = await asyncio.to_thread(
            CliRunner().invoke, calibration_app, [*map(str, words), "--socket", str(tmp_path / "api.sock")]
        )
        assert ran.exit_code == code, (ran.output, ran.exception)
        return "".join(ran.stdout.strip().splitlines()[-1:])

    file = tmp_path / "board.png"
    for rotation, translation in TILTED[:4]:
        file.write_bytes(picture(rotation, translation))
        assert "40 points" in await slabcell("collect", "--board", BOARD, "--picture", file, "--pose", "1,2,3,4,5,6")
    assert "40 points found" in await slabcell("detect", "--board", BOARD, "--picture", file)
    assert "found" in await slabcell("detect", "--board", BOARD, "--picture", "new", code=1)  # a grey square only
    assert "robot at 1, 2, 3, 4, 5, 6" in await slabcell("views")
    assert "robot at 9, 2, 3, 4, 5, 6" in await slabcell("pose", 1, "9,2,3,4,5,6")
    (tmp_path / "poses.csv").write_text("image,X,Y,Z,A,B,C\n2,1,2,3,4,5,6\n")
    assert "4 of 4 views" in await slabcell("poses", tmp_path / "poses.csv")
    assert "to do: " in await slabcell("survey", "hand-eye")
    plane = await slabcell("run", "plane", "--set", "views=[1]", "--set", "board_thickness_mm=0.0")
    assert "is in use" in await slabcell("activate", plane)
    assert json.loads(await slabcell("list", "--json"))["calibrations"][0]["name"] == plane
    assert "}" in await slabcell("show")
    assert "}" in await slabcell("show", plane)
    assert "view 4" in await slabcell("remove", 4)
    await slabcell("robot", code=1)  # it has said nothing
    assert "points on the table move by" in await slabcell("compare", plane, CONFIGURED)
    for how in (["--fixed"], ["--fixed", "--json"]):
        await slabcell("check", "--board", BOARD, "--picture", file, "--limit-mm", 0.2, *how, code=1)  # it is tilted
    assert len(json.loads(await slabcell("checks", "--json"))["checks"]) == 2
    assert await slabcell("checks")
    uploaded = await slabcell("upload", api.calibrations.path_of(plane))
    assert uploaded != CONFIGURED
    assert "every view is forgotten" in await slabcell("clear")
