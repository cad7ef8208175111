"""The page Calibrate: from an empty list of views to a calibration that is in use, seen, advised, compared, checked."""

import json
import re
from collections.abc import Iterator

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from slabcell.calibration import Calibration, load_calibration
from slabcell_drivers.robot import Frame

from .browser import window
from .conftest import LIMIT_S, Cell, Server, wait_for

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(600)]

expect.set_options(timeout=LIMIT_S * 1000)


@pytest.fixture(autouse=True)
def tidy(cell: Cell) -> Iterator[None]:
    """The cell is left as it was found: other pages look at slabs, with the calibration of the configuration."""
    cell.api.post("/v1/calibration/clear")
    yield
    job = cell.api.get("/v1/status")["job"]
    if job is not None and job["state"] == "open":
        cell.api.post("/v1/jobs/current/abandon")
    cell.api.post("/v1/calibrations/configured/activate")
    cell.api.post("/v1/calibration/clear")
    cell.api.post("/v1/simulation/board", {"place": "away"})


def show(cell: Cell, place: str, number: int) -> dict:
    return cell.api.post("/v1/simulation/board", {"place": place, "number": number})


def collect(cell: Cell, place: str, numbers: range) -> None:
    for number in numbers:
        shown = show(cell, place, number)
        cell.api.post("/v1/frames/take")
        pose = shown["flange"]
        cell.api.post("/v1/calibration/views", {"board": shown["board"], "picture": "latest", "pose": pose})


def computed(page: Page) -> str:
    """Have it computed; return the name of what was made."""
    page.locator("#compute").click()
    expect(page.locator("#result .outcome")).to_be_visible()
    return page.locator("#result .outcome .mono").first.inner_text()


def test_a_new_calibration_is_made_step_by_step_and_is_in_use_in_the_end(
    cell: Cell, hmi: Server, browser: Browser
) -> None:
    with window(browser, hmi, "engineer") as page:
        page.goto("/calibrate")
        expect(page.locator("#views .advice")).to_contain_text("Views so far: 0. Take 10 more")
        for number in range(2):
            page.get_by_role("button", name="Hold it otherwise").click()
            expect(page.locator("#simulated")).to_contain_text(f"held up, {number + 1}")
            expect(page.locator("#said")).to_contain_text("108 points found")
            expect(page.locator(".overlay .board circle")).to_have_count(108)
            page.get_by_role("button", name="Collect view").click()
            expect(page.locator("#views .count")).to_have_text(str(number + 1))
            expect(page.locator("#views svg.coverage .hull")).to_have_count(number + 1)
        expect(page.locator("#views .advice")).to_contain_text("Show the board near")
        drawn = [float(value) for value in page.locator("svg.coverage").get_attribute("viewBox").split()]
        frame = cell.api.get("/v1/frames/latest")
        assert drawn == [-0.5, -0.5, frame["width"], frame["height"]], "not in pixels of the picture"
        collect(cell, "held", range(2, 9))
        page.reload()
        expect(page.locator("#views .count")).to_have_text("9")
        lens = computed(page)
        expect(page.locator("#result .facts")).to_contain_text("px")
        expect(page.locator("#result svg path.strokes")).to_have_attribute("d", re.compile(r"^M\d"))
        page.locator("#result").get_by_role("link", name="Table").click()
        cell.api.post("/v1/calibration/clear")
        collect(cell, "table", range(3))
        page.reload()
        expect(page.locator("select[name=base]")).to_have_value(lens)
        name = computed(page)
        expect(page.locator("#result svg.moves circle")).to_have_count(81)
        page.get_by_role("button", name="Activate").click()
        wait_for(
            lambda: (
                [item["name"] for item in cell.api.get("/v1/calibrations")["calibrations"] if item["active"]] == [name]
            ),
            "the new calibration in use",
        )


def test_hand_and_eye_with_the_robots_pose_at_each_view(cell: Cell, hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "engineer") as page:
        page.goto("/calibrate?kind=hand-eye")
        page.get_by_role("button", name="Move the flange").click()
        expect(page.locator("#pose")).not_to_have_value("")
        given = [float(part) for part in page.locator("#pose").input_value().split(";")]
        assert given == pytest.approx(cell.api.get("/v1/simulation/board")["flange"], abs=1e-3)
        expect(page.locator("#said")).to_contain_text("108 points found")
        page.get_by_role("button", name="Collect view").click()
        expect(page.locator("#views .count")).to_have_text("1")
        collect(cell, "flange", range(1, 7))
        page.reload()
        expect(page.locator("#views .advice")).to_contain_text("Views so far: 7. Take 8 more")
        expect(page.locator("#views")).to_contain_text("Poses turn by")
        computed(page)
        expect(page.locator("#result .facts")).to_contain_text("Table in the base")
        expect(page.locator("#result tbody tr").first).to_contain_text("view-")


def test_a_camera_on_the_flange_and_the_poses_as_a_table(cell: Cell, hmi: Server, browser: Browser) -> None:
    """A board that is moved before a camera looks to it as a camera that is moved the other way before a board.

    So pictures of the board on the flange, with every pose turned round, are those of a camera on a flange, and that
    stands on it where the fixed one stands in the base.
    """
    with window(browser, hmi, "engineer") as page:
        page.goto("/calibrate?kind=hand-eye")
        expect(page.locator("#views .count")).to_have_text("0")
        lines: list[str] = []
        views: list[int] = []  # their numbers go on where those of views before ended
        for number in range(7):
            shown = show(cell, "flange", number)
            cell.api.post("/v1/frames/take")
            body = {"board": shown["board"], "picture": "latest", "pose": None}
            views.append(cell.api.post("/v1/calibration/views", body)["view"])
            turned = Frame(*shown["flange"]).inverse()
            lines.append(", ".join([str(views[-1]), *(f"{value:.9f}" for value in turned.as_tuple())]))
        page.reload()
        expect(page.locator("#views")).to_contain_text("no pose")
        page.locator("summary", has_text="Poses as a table").click()
        page.get_by_label("A line for each view").fill("\n".join(lines))
        page.get_by_role("button", name="Take over").click()
        expect(page.locator(".message")).to_contain_text("7 of 7 views know where the robot was")
        page.locator("select[name=mount]").select_option("eye-in-hand")
        page.locator("summary", has_text="Photo pose").click()
        page.get_by_label("Flange when the table was calibrated").fill("0; 0; 0; 0; 0; 0")
        name = computed(page)
        made = cell.api.get(f"/v1/calibrations/{name}")["calibration"]["hand_eye"]
        assert made["mount"] == "eye-in-hand"
        collected = [show(cell, "flange", number)["flange"] for number in range(7)]
        for number, flange in zip(views, collected, strict=True):
            cell.api.post(f"/v1/calibration/views/{number}/pose", {"pose": flange})
        page.locator("select[name=mount]").select_option("eye-to-hand")
        page.locator("#result").evaluate("element => element.replaceChildren()")
        fixed = cell.api.get(f"/v1/calibrations/{computed(page)}")["calibration"]["hand_eye"]
        assert made["translation_mm"] == pytest.approx(fixed["translation_mm"], abs=0.5)
        assert np.array(made["rotation"]) == pytest.approx(np.array(fixed["rotation"]), abs=1e-3)


def loaded(cell: Cell, name: str) -> Calibration:
    path = cell.folder / "loaded.json"
    path.write_text(json.dumps(cell.api.get(f"/v1/calibrations/{name}")["calibration"]))
    return load_calibration(path)


def test_points_that_the_robot_touched_are_the_frame_of_the_table(cell: Cell, hmi: Server, browser: Browser) -> None:
    collect(cell, "table", range(3))
    known = loaded(cell, "configured")
    pixels = np.array([[500.0, 300.0], [1400.0, 320.0], [1380.0, 900.0], [520.0, 880.0], [960.0, 600.0]])
    table = known.table_from_image(pixels)
    robot = np.column_stack([100.0 - table[:, 1], 40.0 + table[:, 0]])  # a quarter of a turn and away
    lines = [f"{u}; {v}; {x:.4f}; {y:.4f}" for (u, v), (x, y) in zip(pixels, robot, strict=True)]
    with window(browser, hmi, "engineer", calm=False) as page:  # what is refused is an error to the console
        page.goto("/calibrate?kind=plane")
        page.locator("summary", has_text="Points touched").click()
        page.get_by_label("A line each").fill("1, 2, three, 4, 5")
        page.locator("#compute").click()
        expect(page.locator(".message.failed")).to_contain_text("is neither view, column, row")
        page.get_by_label("A line each").fill("\n".join(["u; v; x; y", *lines]))
        name = computed(page)
        expect(page.locator("#result .facts")).to_contain_text("Touched points")
        made = loaded(cell, name)
        assert made.table_from_image(pixels) == pytest.approx(robot, abs=0.3)


def test_a_robot_that_does_not_say_where_it_is_is_told_of(cell: Cell, hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "engineer", calm=False) as page:  # a refusal is an error to the browser's console
        page.goto("/calibrate?kind=hand-eye")
        page.locator("#from-robot").click()
        expect(page.locator(".message.failed")).to_contain_text(re.compile("the robot (has said nothing|said it)"))


def test_two_calibrations_are_held_against_each_other_and_a_file_is_uploaded(
    cell: Cell, hmi: Server, browser: Browser
) -> None:
    with window(browser, hmi, "engineer") as page:
        page.goto("/calibrate/history")
        before = page.locator("#list tbody tr").count()
        with page.expect_download() as download:
            page.get_by_role("link", name="Download configured").click()
        page.locator("#upload").set_input_files(download.value.path())
        expect(page.locator("#list tbody tr")).to_have_count(before + 1)
        page.locator("input[name=after]").first.check()
        expect(page.locator("#compared")).to_contain_text("Points on the table move by 0.000 mm")
        expect(page.locator("#compared svg.moves")).to_be_visible()


def test_checks_are_kept_and_drawn_over_time(cell: Cell, hmi: Server, browser: Browser) -> None:
    show(cell, "table", 0)
    before = len(cell.api.get("/v1/calibration/checks")["checks"])
    with window(browser, hmi, "operator") as page:
        page.goto("/calibrate/drift")
        page.get_by_label("Board always in the same place").check()
        for number in (1, 2):
            page.get_by_role("button", name="Check now").click()
            expect(page.locator(".message")).to_have_count(number)
            expect(page.locator("#charts tbody tr")).to_have_count(before + number)
        expect(page.locator("section[aria-label=Sideways] .head strong")).to_contain_text("mm")
        expect(page.locator("section[aria-label='Residual of the corners'] .dot")).to_have_count(before + 2)


def test_a_picture_without_a_board_says_so_and_a_viewer_only_looks(cell: Cell, hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "engineer") as page:
        page.goto("/calibrate")
        page.get_by_role("button", name="Take picture").click()
        expect(page.locator("#said")).to_contain_text("No board")
        show(cell, "table", 1)
        page.get_by_role("button", name="Keep looking").click()
        expect(page.locator("#said")).to_contain_text("108 points found")
        page.get_by_role("button", name="Keep looking").click()
        expect(page.locator("#watch")).to_have_attribute("aria-pressed", "false")
    with window(browser, hmi, "viewer") as page:
        page.goto("/calibrate")
        for name in ("Take picture", "Collect view", "Compute"):
            expect(page.get_by_role("button", name=name)).to_be_disabled()
