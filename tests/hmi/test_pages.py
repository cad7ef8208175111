"""Each page does what it is there for, in a real browser, with a cell that lives."""

import re
import signal
from contextlib import suppress

import pytest
from playwright.sync_api import Browser, Response, expect
from playwright.sync_api import TimeoutError as PlaywrightTimeoutError

from .browser import PATHS, window
from .conftest import LIMIT_S, PASSWORD, Cell, Client, Server, wait_for

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(300)]

expect.set_options(timeout=LIMIT_S * 1000)


@pytest.fixture(scope="module", autouse=True)
def laid(cell: Cell) -> None:
    """There is a job to look at."""
    cell.lay()


def test_the_overview_follows_the_job_without_being_loaded_again(cell: Cell, hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "viewer") as page:
        page.goto("/")
        before = int(page.locator(".job h2").inner_text().split()[1])
        cell.lay()
        expect(page.locator(".job h2")).to_contain_text(f"Job {before + 1}")
        expect(page.locator(".job .big")).to_contain_text("5")
        expect(page.locator(".template .slot-laid")).to_have_count(5)
        expect(page.locator(".links")).to_contain_text("Camera")


def test_the_overlay_lies_where_the_vision_found_the_slabs(cell: Cell, hmi: Server, browser: Browser) -> None:
    cell.tell("strew")
    cell.api.post("/v1/trigger")
    known = cell.api.get("/v1/frames/latest")
    with window(browser, hmi, "viewer") as page:
        page.goto("/")
        expect(page.locator("slab-picture")).to_have_attribute("data-frame", known["frame"])
        expect(page.locator(".overlay .part")).to_have_count(len(known["overlay"]["parts"]))
        box = page.locator(".overlay").get_attribute("viewBox")
        assert box == f"-0.5 -0.5 {known['width']} {known['height']}"
        for part in known["overlay"]["parts"]:
            drawn = page.locator(f".overlay .part[data-slot='{part['slot']}'] path").last.get_attribute("d")
            assert drawn is not None
            numbers = [float(text) for text in re.findall(r"[\d.]+", drawn)]
            assert numbers == [value for point in part["outline_px"] for value in point]
        natural = page.locator("slab-picture img").evaluate("image => [image.naturalWidth, image.naturalHeight]")
        assert natural == [known["width"], known["height"]]


def test_the_picture_is_zoomed_and_moved_by_keys(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "viewer") as page:
        page.goto("/")
        expect(page.locator("slab-picture .stage")).to_be_visible()
        stage, view = page.locator("slab-picture .stage"), page.locator("slab-picture .view")

        def scale() -> float:
            return float(stage.evaluate("stage => new DOMMatrix(getComputedStyle(stage).transform).a"))

        fits = scale()
        view.press("+")
        assert scale() == pytest.approx(fits * 1.25, rel=1e-3)
        view.press("0")
        assert scale() == pytest.approx(fits, rel=1e-3)


def test_an_operator_stops_and_starts_and_every_tab_sees_it(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "operator") as page, window(browser, hmi, "viewer") as other:
        page.goto("/run")
        other.goto("/")
        page.get_by_role("button", name="Stop", exact=True).click()
        expect(page.locator("header .cell-state")).to_contain_text("Halted")
        expect(other.locator("header .cell-state")).to_contain_text("Halted")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(other.locator("header .cell-state")).to_contain_text("Ready")
        assert page.get_by_role("button", name="Abandon").count() == 0, "an operator abandons no job"


def test_a_picture_is_taken_on_request_and_said_what_was_seen(hmi: Server, browser: Browser) -> None:
    # As long as the cell knows a robot, or its camera is on its way back, it refuses a look: that is said, too.
    with window(browser, hmi, "operator", calm=False) as page:
        page.goto("/run")
        said = page.locator("#messages .done")

        def asked() -> bool:
            page.get_by_role("button", name="Take a picture").click()
            try:
                expect(said.last).to_contain_text("slabs found", timeout=7_000)
            except AssertionError:
                return False
            return True

        wait_for(asked, "a picture on request")


def test_a_button_is_not_replaced_while_it_is_pressed_nor_for_nothing(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "operator") as page:
        page.goto("/run")
        stop = page.get_by_role("button", name="Stop", exact=True)
        expect(stop).to_be_enabled()

        def news() -> None:
            with page.expect_response(lambda response: response.url.endswith("/run/buttons")):
                page.evaluate("document.body.dispatchEvent(new CustomEvent('slab:state'))")

        def marked() -> int:
            return page.locator(".controls button[data-mark]").count()

        def served() -> str:
            return page.locator("section.controls").inner_html().replace(' data-mark="seen"', "")

        # The cell may become ready for another button meanwhile: that has to show, and says nothing here.
        for _ in range(20):
            news()  # what was served with the page is put in once
            before = served()
            stop.evaluate("button => button.dataset.mark = 'seen'")
            news()
            page.wait_for_timeout(50)
            if served() == before:
                break
        assert marked() == 1
        stop.hover()
        page.mouse.down()
        news()
        assert marked() == 1
        page.mouse.up()
        expect(page.locator("header .cell-state")).to_contain_text("Halted")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(page.locator("header .cell-state")).to_contain_text("Ready")


def test_a_viewer_finds_the_controls_off(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "viewer") as page:
        page.goto("/run")
        for button in page.locator(".controls button").all():
            expect(button).to_be_disabled()


def test_a_cycle_of_the_history_is_shown_with_its_picture(cell: Cell, hmi: Server, browser: Browser) -> None:
    number = cell.kept_cycle()
    with window(browser, hmi, "viewer") as page:
        page.goto("/history")
        page.locator("#rows").get_by_role("link", name=str(number), exact=True).click()
        expect(page.locator("#detail slab-picture .overlay g").first).to_be_attached()
        page.get_by_label("Failed only").check()
        expect(page.locator("#rows")).to_contain_text(re.compile(r"No such cycle|✗"))


def test_how_slabs_lie_is_charted_and_exported(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "viewer") as page:
        page.goto("/history/placements")
        expect(page.locator(".plot .values")).to_have_count(3)
        exported = page.request.get("/history/placements.csv").text().splitlines()
        assert exported[0] == "at,job,slot,found,dx_mm,dy_mm,da_deg,residual_mm"
        assert len(exported) > 5


def test_an_alarm_comes_is_acknowledged_and_goes(cell: Cell, hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "operator", calm=False) as page:  # a refused action is an error to the browser, too
        page.goto("/alarms")
        cell.tell("off")
        try:
            page.goto("/run")

            def alarmed() -> bool:  # a look that is refused for the robot's sake finds no fault of the camera
                page.get_by_role("button", name="Take a picture").click()
                try:
                    expect(page.locator("header .cell-alarm")).to_contain_text("110", timeout=7_000)
                except AssertionError:
                    return False
                return True

            wait_for(alarmed, "the alarm of a camera that is off")
            page.locator("header .cell-alarm").click()
            card = page.locator(".alarm-card").first
            expect(card).to_contain_text("110")
            said = re.compile("alarm 110\\d is acknowledged|seen by operator")

            def acknowledged() -> bool:  # one alarm of the camera takes another's place while it is being missed
                with suppress(PlaywrightTimeoutError):
                    card.get_by_role("button", name="Acknowledge").click(timeout=7_000)
                try:
                    expect(page.locator("body")).to_contain_text(said, timeout=7_000)
                except AssertionError:
                    return False
                return True

            wait_for(acknowledged, "the word that an alarm is acknowledged")
        finally:
            cell.tell("on")
        expect(page.locator(".alarm-card")).to_have_count(0)


def test_an_admin_adds_and_removes_a_user(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "admin") as page:
        page.goto("/users")
        form = page.locator("form[hx-post='/users/add']")
        form.get_by_label("Name").fill("berta")
        form.get_by_label("Password", exact=True).fill(PASSWORD)
        form.get_by_label("Password again").fill(PASSWORD)
        form.get_by_role("button").click()
        row = page.locator("#list tr", has_text="berta")
        expect(row).to_be_visible()
        remove = row.get_by_role("button", name="Remove berta")
        remove.click()
        expect(row).to_be_visible()  # a mere click does nothing
        remove.focus()
        page.keyboard.down("Enter")
        expect(page.locator("#messages")).to_contain_text("berta is removed")
        page.keyboard.up("Enter")
        expect(row).to_have_count(0)


def test_the_doctor_says_what_it_found(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "engineer") as page:
        page.goto("/doctor")
        expect(page.locator(".finding")).not_to_have_count(0)
        expect(page.locator("#findings")).to_contain_text("Configuration")


def test_logging_in_leads_to_the_page_that_was_asked_for(hmi: Server, browser: Browser) -> None:
    context = browser.new_context(base_url=hmi.base)
    page = context.new_page()
    page.goto("/about")
    page.get_by_label("Name").fill("viewer")
    page.get_by_label("Password").fill(PASSWORD)
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="slabcell")).to_be_visible()
    assert page.url.endswith("/about")
    context.close()


def test_what_is_old_is_grey_and_its_buttons_are_off_until_the_link_is_back(
    cell: Cell, hmi: Server, browser: Browser
) -> None:
    with window(browser, hmi, "operator", calm=False) as page:
        page.goto("/run")
        button = page.get_by_role("button", name="Take a picture")
        expect(button).to_be_enabled()
        for child in (hmi.child, cell.child):  # the HMI hangs; the daemon hangs
            child.process.send_signal(signal.SIGSTOP)
            try:
                expect(page.locator("#link-lost")).to_be_visible()
                expect(page.locator("body")).to_have_class(re.compile("stale"))
                expect(button).to_be_disabled()
            finally:
                child.process.send_signal(signal.SIGCONT)
            expect(page.locator("#link-lost")).to_be_hidden()
            expect(button).to_be_enabled()


def test_a_login_that_ends_leads_an_open_page_to_the_login(hmi: Server, browser: Browser) -> None:
    own = hmi.fresh_client("viewer")
    context = browser.new_context(base_url=hmi.base)
    context.add_cookies([{"name": "slabcell", "value": own.cookies["slabcell"], "url": hmi.base}])
    page = context.new_page()
    page.goto("/")
    Client(hmi.base, dict(own.cookies), own.form).post("/logout")
    expect(page.get_by_role("heading", name="Log in")).to_be_visible()
    context.close()


def test_pages_are_light_without_their_pictures(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "admin") as page:
        browsing = page.context.new_cdp_session(page)
        browsing.send("Network.setCacheDisabled", {"cacheDisabled": True})
        sizes: list[int] = []

        def weigh(answer: Response) -> None:
            sizes.append(_weight(answer))

        page.on("response", weigh)
        for path in PATHS:
            sizes.clear()
            page.goto(path, wait_until="load")
            assert sum(sizes) <= 300_000, (path, sizes)
        page.remove_listener("response", weigh)
        browsing.detach()


def _weight(answer: Response) -> int:
    """Return the bytes of what is no picture: camera pictures come over the live link, and are shown as blobs."""
    picture = answer.url.startswith("blob:") or answer.headers.get("content-type", "").startswith("image/")
    return 0 if picture else int(answer.headers.get("content-length", 0))
