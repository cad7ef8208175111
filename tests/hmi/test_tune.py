"""Tune: parameters are tried on pictures, and become the cell's only where its graded pictures pass."""

import json
import re
import signal
import subprocess
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from .browser import serious_findings, window
from .conftest import LIMIT_S, SLABCELL, Cell, Server, wait_for

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(300)]

expect.set_options(timeout=LIMIT_S * 1000)


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
    words = ["recipe", "grade", recipe, "--cycle", str(cell.kept_cycle()), "--socket", str(cell.socket)]
    said = subprocess.run([*SLABCELL, *words], capture_output=True, text=True, timeout=LIMIT_S, check=True)
    assert f"belongs to the graded set of {recipe}" in said.stdout
    (bundle, *_) = cell.api.get(f"/v1/recipes/{recipe}")["graded"]
    done = cell.api.post("/v1/vision/preview", {"picture": f"graded:{recipe}/{bundle}"})
    file = next((cell.folder / "recipes" / f"{recipe}.graded").glob("*.zip"))
    with zipfile.ZipFile(file) as archive:
        offered = json.loads(archive.read("result.json"))["parts"]
    assert len(done["located"]["parts"]) == len(offered)


# The page


@pytest.fixture(scope="module")
def graded(cell: Cell) -> str:
    """The active recipe, which has a graded picture; the job that gave it is over."""
    cell.lay()
    recipe = cell.api.get("/v1/status")["recipe"]
    cell.api.post(f"/v1/recipes/{recipe}/grade", {"cycle": cell.kept_cycle()})
    return str(recipe)


@contextmanager
def tune(browser: Browser, hmi: Server, role: str = "engineer", **how: Any) -> Iterator[Page]:
    """Give the page after its first run, on a stored picture of five slabs."""
    with window(browser, hmi, role, **how) as page:
        page.goto("/tune")
        ran(page)
        page.locator("#source button[value=set]").click()
        choose(page, "strewn-1")
        yield page


def choose(page: Page, name: str) -> None:
    """Run a stored picture."""
    option = page.locator("#picture option", has_text=name)
    expect(option).to_have_count(1)
    before = runs(page)
    page.locator("#picture").select_option(option.get_attribute("value"))
    ran(page, before + 1)


def runs(page: Page) -> int:
    return int(page.locator("#tune").get_attribute("data-runs") or 0)


def ran(page: Page, times: int = 1) -> None:
    """Wait until the vision was run so many times."""
    wait_for(lambda: runs(page) >= times, f"run {times} of the vision")
    expect(page.locator("#run")).to_be_enabled()


def field(page: Page, key: str) -> Locator:
    return page.locator(f"[data-key='{key}']")


def change(page: Page, key: str, value: str) -> None:
    """Change a number as a person does, and wait for the run that follows."""
    before = runs(page)
    box = field(page, key).locator("input")
    box.fill(value)
    box.press("Enter")
    ran(page, before + 1)


def parameter(page: Page, key: str) -> float:
    return float(field(page, key).locator("input").input_value())


def test_a_changed_parameter_is_tried_at_once_shown_and_put_back(hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        expect(page.locator("#outcome")).to_contain_text("5 of 5 slots found")
        expect(page.locator("#parts tbody tr")).to_have_count(5)
        page.locator("#stages button[value=match]").click()
        change(page, "matching.max_residual_mm", "0.0001")
        expect(page.locator("#outcome")).to_contain_text("0 of 5 slots found, 5 refused")
        expect(page.locator("#rejected tbody tr")).to_have_count(5)
        expect(page.locator("#stages button[value=match] .mark")).to_be_visible()
        page.locator("#tab-changes").click()
        row = page.locator("#differences tbody tr")
        expect(row).to_contain_text("matching.max_residual_mm")
        expect(row).to_contain_text("0.0001 mm")
        before = runs(page)
        field(page, "matching.max_residual_mm").get_by_role("button", name="As active").click()
        ran(page, before + 1)
        expect(page.locator("#outcome")).to_contain_text("5 of 5 slots found")
        expect(page.locator("#no-differences")).to_be_visible()
        expect(page.locator("#no-differences")).to_contain_text("Every parameter is as in the active recipe")


def test_what_is_no_value_is_not_tried(hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        page.locator("#stages button[value=match]").click()
        box = field(page, "matching.max_residual_mm").locator("input")
        before = runs(page)
        for wrong in ("0", "51", ""):
            box.fill(wrong)
            box.press("Enter")
            expect(box).to_have_attribute("aria-invalid", "true")
        assert runs(page) == before
        page.locator("#stages button[value=segment]").click()
        field(page, "segmentation.method").locator("select").select_option("fixed")  # which needs a threshold
        expect(page.locator("#outcome")).to_contain_text("Not run")
        expect(page.locator("#outcome")).to_contain_text("threshold")


def test_every_buffer_is_a_picture_of_the_sensor_with_its_overlay(hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        picture = page.locator("slab-picture#tried")
        for buffer in ("input", "undistorted", "mask", "blobs", "contours", "residuals"):
            page.locator("#buffer").select_option(buffer)
            expect(picture).to_have_attribute("data-buffer", buffer)
            size = picture.locator("img").evaluate("image => [image.naturalWidth, image.naturalHeight]")
            for layer in picture.locator("svg.overlay").all():
                assert layer.get_attribute("viewBox") == f"-0.5 -0.5 {size[0]} {size[1]}"
            expect(picture.locator(".overlay .part")).to_have_count(5)
            drawn = {"contours": ".layer .contour", "residuals": ".layer .residuals"}.get(buffer)
            expect(picture.locator(drawn or ".layer > *")).to_have_count(5 if drawn else 0)
            page.get_by_label("Result on it").uncheck()
            expect(picture.locator(".overlay .part")).to_have_count(0)
            page.get_by_label("Result on it").check()


def test_each_stage_shows_its_time_its_parameters_and_its_buffer(hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        for stage, key, buffer in (
            ("segment", "segmentation.method", "mask"),
            ("blobs", "blobs.report", "blobs"),
            ("match", "matching.min_score", "residuals"),
            ("grasp", "grasp.cup_radius_mm", "input"),
        ):
            button = page.locator(f"#stages button[value={stage}]")
            button.click()
            expect(page.locator("slab-picture#tried")).to_have_attribute("data-buffer", buffer)
            expect(field(page, key)).to_be_visible()
            expect(button.locator(".ms")).to_have_text(re.compile(r"^\d+\.\d\sms$"))


def test_the_handles_of_the_histogram_are_the_numbers_of_the_form(hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        page.locator("#tab-histogram").click()
        before = runs(page)
        page.get_by_role("button", name="Fix this level").click()
        ran(page, before + 1)
        expect(page.locator("#outcome")).to_contain_text("fixed threshold")
        handle = page.get_by_role("slider", name="Threshold")
        level = parameter(page, "segmentation.threshold")
        handle.focus()
        handle.press("ArrowRight")
        assert parameter(page, "segmentation.threshold") == level + 1
        handle.press("PageDown")
        assert parameter(page, "segmentation.threshold") == level - 9
        box, plot = handle.bounding_box(), page.locator("#histogram .plot").bounding_box()
        assert box is not None
        assert plot is not None
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        page.mouse.move(plot["x"] + plot["width"] / 2, box["y"] + box["height"] / 2, steps=4)
        page.mouse.up()
        assert parameter(page, "segmentation.threshold") == pytest.approx(128, abs=2)
        change(page, "segmentation.threshold", "100")
        assert float(handle.get_attribute("aria-valuenow") or 0) == pytest.approx(100.5)


def test_the_handles_of_a_dynamic_threshold_move_its_tails_and_its_level(hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        page.locator("#tab-histogram").click()
        field(page, "segmentation.method").locator("select").select_option("dynamic_soft")
        expect(page.get_by_role("slider")).to_have_count(5)
        for name, key, arrow, grows in (
            ("Low tail", "low_tail_percent", "ArrowRight", True),
            ("High tail", "high_tail_percent", "ArrowRight", False),
            ("Level", "level_percent", "ArrowRight", True),
            ("Soft to", "softness_percent", "ArrowRight", True),
            ("Soft from", "softness_percent", "ArrowRight", False),
        ):
            value = parameter(page, f"segmentation.{key}")
            page.get_by_role("slider", name=name).press(arrow)
            moved = parameter(page, f"segmentation.{key}")
            assert (moved > value) is grows, (name, value, moved)
            assert moved != value


def roi(page: Page) -> list[float]:
    return [float(box.input_value()) for box in field(page, "segmentation.roi").locator("input").all()]


def test_the_region_of_interest_is_drawn_moved_and_removed(hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        tools = field(page, "segmentation.roi")
        tools.get_by_role("button", name="Draw").click()
        box = page.locator("slab-picture .drawing .screen").bounding_box()
        assert box is not None
        before = runs(page)
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 2)
        page.mouse.down()
        page.mouse.move(box["x"] + box["width"] - 2, box["y"] + box["height"] - 2, steps=5)
        page.mouse.up()
        ran(page, before + 1)
        corners = page.locator("slab-picture .corner")
        expect(corners).to_have_count(4)
        width = 1920
        drawn = roi(page)
        assert len(drawn) == 8
        assert drawn[0] == pytest.approx(width / 2, abs=width / 40)
        assert drawn[2] == pytest.approx(width, abs=width / 40)
        corners.first.press("ArrowRight")
        corners.first.press("Shift+ArrowDown")
        assert roi(page)[:2] == pytest.approx([drawn[0] + 1, drawn[1] + 10])
        expect(corners.first).to_be_focused()
        corners.last.press("Delete")
        expect(corners).to_have_count(3)
        tools.get_by_role("button", name="Remove all").click()
        expect(corners).to_have_count(0)


def test_a_region_of_corners_is_clicked_and_one_is_begun_by_keys_alone(hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        tools = field(page, "segmentation.roi")
        tools.get_by_role("button", name="Draw").click()
        box = page.locator("slab-picture .drawing .screen").bounding_box()
        assert box is not None
        for across, down in ((0.2, 0.2), (0.8, 0.2), (0.5, 0.8)):
            page.mouse.click(box["x"] + across * box["width"], box["y"] + down * box["height"])
        page.keyboard.press("Enter")
        expect(page.locator("slab-picture .corner")).to_have_count(3)
        tools.get_by_role("button", name="Draw").press("Enter")
        page.keyboard.press("Escape")
        expect(page.locator("slab-picture .screen")).to_have_count(0)
        expect(page.locator("slab-picture .corner")).to_have_count(3)
        tools.get_by_role("button", name="Remove all").press("Enter")
        tools.get_by_role("button", name="Add a corner").press("Enter")
        expect(page.locator("slab-picture .corner")).to_have_count(4)
        before = runs(page)
        number = tools.get_by_label("Region of interest 1: u")
        number.fill("0")
        number.press("Enter")
        ran(page, before + 1)
        assert page.locator("slab-picture .corner circle").first.get_attribute("cx") == "0"


def test_a_set_is_run_as_a_whole_and_a_picture_is_kept_in_another(cell: Cell, hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        page.locator("#tab-pictures").click()
        page.get_by_role("button", name="Run all").click()
        rows = page.locator("#picture-rows tr")
        expect(rows.filter(has_text="5 / 5")).to_have_count(4)
        page.locator("#keep-set").fill("kept-by-test")
        page.locator("#keep-name").fill("one")
        page.get_by_role("button", name="Keep").click()
        expect(page.locator("#messages")).to_contain_text("Kept as set:kept-by-test/one-")
        assert [item.name[:4] for item in (cell.folder / "pictures" / "kept-by-test").iterdir()] == ["one-"]
        choose(page, "one-")
        page.get_by_role("button", name="Remove from the set").click()
        expect(page.locator("#messages")).to_contain_text("is removed from set kept-by-test")
        assert not (cell.folder / "pictures" / "kept-by-test").exists()


def test_a_file_is_opened_and_run(cell: Cell, hmi: Server, browser: Browser) -> None:
    file = next((cell.folder / "pictures" / "examples").glob("strewn-2*"))
    with tune(browser, hmi) as page:
        page.locator("#tab-pictures").click()
        before = runs(page)
        page.locator("#upload").set_input_files(file)
        ran(page, before + 1)
        expect(page.locator("#outcome")).to_contain_text("5 of 5 slots found")


def hold(page: Page, button: Locator, until: Callable[[], None]) -> None:
    """Hold a button by its key until something is so."""
    button.focus()
    page.keyboard.down("Enter")
    try:
        until()
    finally:
        page.keyboard.up("Enter")


def test_only_what_passes_its_graded_pictures_is_applied_and_it_can_be_taken_back(
    cell: Cell, hmi: Server, browser: Browser, graded: str
) -> None:
    def active() -> str:
        return str(cell.api.get("/v1/status")["recipe"])

    with tune(browser, hmi) as page:
        page.locator("#tab-changes").click()
        apply, verdict = page.locator("#apply"), page.locator("#verdict")
        expect(apply).to_be_disabled()
        page.locator("#stages button[value=match]").click()
        change(page, "matching.max_residual_mm", "0.0001")
        page.get_by_role("button", name="Check on graded pictures").click()
        expect(verdict).to_contain_text("graded pictures failed")
        expect(page.locator("#graded li.bad")).not_to_have_count(0)
        expect(apply).to_be_disabled()
        change(page, "matching.max_residual_mm", "0.5")
        expect(verdict).to_contain_text("check them again")
        page.get_by_role("button", name="Check on graded pictures").click()
        expect(verdict).to_contain_text("graded pictures passed")
        expect(apply).to_be_enabled()
        apply.click()  # a mere click does nothing
        assert active() == graded
        hold(page, apply, lambda: expect(verdict).to_contain_text("Applied"))
        assert active().startswith(f"{graded}~")
        expect(page.locator("#base")).to_have_value(active())
        assert cell.api.get("/v1/recipes/active")["recipe"]["matching"]["max_residual_mm"] == 0.5
        page.get_by_role("button", name=f"Back to {graded}").click()
        expect(page.locator("#base")).to_have_value(graded)
        assert active() == graded
    lines = hmi.client("admin").get("/users").text
    by_engineer = "<td>engineer</td><td>127.0.0.1</td><td>"
    assert f"{by_engineer}/tune/check" in lines
    assert f"{by_engineer}/tune/apply" in lines
    assert f"{by_engineer}/tune/preview" not in lines, "what changes nothing is not in the audit log"


def test_a_live_picture_is_refused_in_words_while_a_robot_might_wait(cell: Cell, hmi: Server, browser: Browser) -> None:
    alarms = cell.api.get("/v1/alarms")["alarms"]
    with tune(browser, hmi) as page:  # calm: a refusal is no error in the browser's console
        page.locator("#source button[value=live]").click()
        assert cell.tell("connect") == "connected"
        try:
            before = runs(page)
            page.locator("#run").click()
            ran(page, before + 1)
            expect(page.locator("#outcome")).to_contain_text("The cell is at work")
            expect(page.locator("#messages .failed")).to_have_count(0)
        finally:
            assert cell.tell("disconnect") == "disconnected"
        assert cell.api.get("/v1/alarms")["alarms"] == alarms

        def asked() -> bool:  # until the cell knows that the robot has gone
            before = runs(page)
            page.locator("#run").click()
            ran(page, before + 1)
            return "slots found" in page.locator("#outcome").inner_text()

        wait_for(asked, "a live picture")


def test_live_pictures_are_run_one_after_the_other(hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        page.locator("#source button[value=live]").click()
        repeat = page.get_by_label("Repeat live")
        before = runs(page)
        repeat.check()
        ran(page, before + 3)
        repeat.uncheck()


def test_the_picture_of_a_cycle_is_graded_as_right(cell: Cell, hmi: Server, browser: Browser, graded: str) -> None:
    number = cell.kept_cycle()
    folder = cell.folder / "recipes" / f"{graded}.graded"
    for file in folder.glob("*.zip"):
        file.unlink()
    with tune(browser, hmi) as page:
        page.locator("#tab-changes").click()
        page.get_by_role("button", name="Check on graded pictures").click()
        expect(page.locator("#verdict")).to_contain_text("Nothing was checked")
        expect(page.locator("#apply")).to_be_disabled()
        page.locator("#tab-pictures").click()
        expect(page.get_by_role("button", name="Grade as right")).to_be_disabled()
        before = runs(page)
        page.locator("#picture").select_option(f"cycle:{number}")
        ran(page, before + 1)
        page.get_by_role("button", name="Grade as right").click()
        expect(page.locator("#messages")).to_contain_text(f"belongs to the graded set of {graded}")
        expect(page.locator("#picture option[value^='graded:']")).to_have_count(1)
        assert len(list(folder.glob("*.zip"))) == 1


def test_a_draft_outlives_a_look_at_another_page_until_it_is_discarded(hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi) as page:
        change(page, "segmentation.min_area_mm2", "31")
        page.goto("/history")
        page.goto("/tune")
        ran(page)
        assert parameter(page, "segmentation.min_area_mm2") == 31
        expect(page.locator("#tab-changes .count")).to_have_text("1")
        page.locator("#tab-changes").click()
        page.get_by_role("button", name="Discard changes").click()
        expect(field(page, "segmentation.min_area_mm2").locator("input")).to_have_value("25")
        expect(page.locator("#no-differences")).to_be_visible()


def test_another_recipe_that_becomes_active_elsewhere_is_noticed(
    cell: Cell, hmi: Server, browser: Browser, graded: str
) -> None:
    saved = cell.api.post(f"/v1/recipes/{graded}/versions", {"parameters": {"matching": {"min_score": 0.7}}})["name"]
    with tune(browser, hmi) as page:
        expect(page.locator("#base option", has_text="✓")).to_have_text(f"{graded} ✓")
        cell.api.post(f"/v1/recipes/{saved}/activate")
        try:
            expect(page.locator("#base option", has_text="✓")).to_have_text(f"{saved} ✓")
            page.locator("#stages button[value=match]").click()
            expect(field(page, "matching.min_score").get_by_role("button", name="As active: 0.7")).to_be_visible()
        finally:
            cell.api.post(f"/v1/recipes/{graded}/activate")


@pytest.mark.parametrize("colours", ["light", "dark"])
def test_axe_finds_nothing_serious_on_any_tab_and_stage(hmi: Server, browser: Browser, colours: str) -> None:
    with tune(browser, hmi, colours=colours) as page:
        field(page, "segmentation.method").locator("select").select_option("dynamic_soft")
        field(page, "segmentation.roi").get_by_role("button", name="Add a corner").click()
        field(page, "segmentation.morphology").get_by_role("button", name="Add").click()
        for tab, stage in (
            ("histogram", "segment"),
            ("pictures", "picture"),
            ("changes", "grasp"),
            ("results", "match"),
        ):
            page.locator(f"#tab-{tab}").click()
            page.locator(f"#stages button[value={stage}]").click()
            assert serious_findings(page) == [], tab


def test_without_the_cell_nothing_can_be_run(cell: Cell, hmi: Server, browser: Browser) -> None:
    with tune(browser, hmi, calm=False) as page:
        cell.child.process.send_signal(signal.SIGSTOP)
        try:
            expect(page.locator("body")).to_have_class(re.compile("stale"))
            for name in ("#run", "#check"):
                expect(page.locator(name)).to_be_disabled()
        finally:
            cell.child.process.send_signal(signal.SIGCONT)
        expect(page.locator("#run")).to_be_enabled()


def test_an_operator_does_not_tune(hmi: Server) -> None:
    client = hmi.client("operator")
    assert client.get("/tune").status == 403
    assert 'href="/tune"' not in client.get("/").text


def test_the_tables_fold_away_so_that_a_small_screen_has_room_for_the_picture(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "engineer") as page:
        page.set_viewport_size({"width": 1024, "height": 600})
        page.goto("/tune")
        fold, view = page.locator("#fold"), page.locator("slab-picture .view")
        expect(fold).to_have_attribute("aria-expanded", "false")
        expect(page.locator("#results")).to_be_hidden()
        alone = view.bounding_box()
        assert alone is not None
        assert alone["height"] >= 290, "a picture of 1.6 to 1 fills the width that it has"
        page.locator("#tab-histogram").focus()
        page.keyboard.press("Enter")
        expect(page.locator("#histogram")).to_be_visible()
        expect(fold).to_have_attribute("aria-expanded", "true")
        beside = view.bounding_box()
        assert beside is not None
        assert beside["height"] < alone["height"]
        fold.focus()
        page.keyboard.press("Space")
        expect(page.locator("#histogram")).to_be_hidden()
        page.set_viewport_size({"width": 1366, "height": 768})
        expect(page.locator("#histogram")).to_be_visible()
