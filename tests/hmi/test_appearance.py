"""Every page is accessible and fits, in both languages, light and dark, from a panel to a large screen."""

import html
import os
import re
from collections.abc import Sequence
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from slabcell.catalogue import catalogue
from slabcell.hmi.messages import translate
from slabcell.hmi.words import LANGUAGES, load_alarms, load_tables

from .browser import PATHS, SIZES, serious_findings, window
from .conftest import LIMIT_S, Cell, Server

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(300)]

expect.set_options(timeout=LIMIT_S * 1000)


@pytest.fixture(scope="module", autouse=True)
def laid(cell: Cell) -> None:
    """There is something to see: a job half laid is not, a finished one is."""
    cell.lay()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where pictures go: CI keeps them."""
    wanted = os.environ.get("SLABCELL_SCREENSHOTS")
    found = Path(wanted) if wanted else tmp_path_factory.mktemp("screenshots")
    found.mkdir(parents=True, exist_ok=True)
    return found


def settle(page: Page, path: str, cell: Cell) -> None:
    """Load a page and wait until it shows what it is there for."""
    page.goto(f"/history/cycles/{cell.kept_cycle()}" if path == "/history" else path)
    if path in {"/", "/run", "/tune", "/history"}:
        expect(page.locator("slab-picture .stage").first).to_be_visible()
    if path == "/tune":
        expect(page.locator("#tune")).to_have_attribute("data-runs", re.compile("[1-9]"))
    if path == "/templates":
        expect(page.locator("svg.pattern .slot").first).to_be_visible(timeout=LIMIT_S * 1000)
    if path == "/doctor":
        expect(page.locator(".finding").first).to_be_visible()


@pytest.mark.parametrize("paths", [PATHS[part::4] for part in range(4)], ids=" ".join)
@pytest.mark.parametrize(("colours", "language"), [("light", "en"), ("dark", "de")])
def test_every_page_fits_every_screen_and_axe_finds_nothing_serious(
    cell: Cell, hmi: Server, browser: Browser, folder: Path, colours: str, language: str, paths: Sequence[str]
) -> None:
    with window(browser, hmi, "admin", colours=colours, language=language) as page:
        for path in paths:
            settle(page, path, cell)
            assert serious_findings(page) == [], path
            for width, height in SIZES:
                page.set_viewport_size({"width": width, "height": height})
                page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
                name = re.sub("[^a-z]+", "-", path.strip("/")) or "overview"
                page.screenshot(path=folder / f"{name}-{width}x{height}-{colours}-{language}.png")
                beyond = page.evaluate(
                    "() => [document.documentElement, document.querySelector('main')]"
                    ".map(element => element.scrollWidth - element.clientWidth)"
                )
                assert beyond == [0, 0], (path, width)
                small = page.evaluate(
                    "() => [...document.querySelectorAll('button, .button, nav a')]"
                    ".filter(element => element.offsetParent && element.getBoundingClientRect().height < 44)"
                    ".map(element => element.outerHTML.slice(0, 120))"
                )
                assert small == [], (path, width)


def test_both_languages_say_the_same_things() -> None:
    english, german = (load_tables(language) for language in LANGUAGES)
    assert english.keys() == german.keys()
    for page, words in english.items():
        assert words.keys() == german[page].keys(), page
        for key, text in words.items():
            assert places(text) == places(german[page][key]), (page, key)


def places(text: str) -> set[str]:
    return {part.partition("}")[0] for part in text.split("{")[1:]}


def test_every_alarm_has_its_words_in_german() -> None:
    words = load_alarms("de")
    wanted = {f"alarm.{number}.{key}" for number in catalogue() for key in ("title", "meaning", "action")}
    assert words.keys() == wanted


def test_the_doctor_speaks_german(cell: Cell, hmi: Server) -> None:
    client = hmi.client("engineer")
    client.cookies["slabcell-language"] = "de"
    shown = client.get("/doctor/findings").text
    for finding in cell.api.get("/v1/doctor")["findings"]:
        for text in filter(None, (finding["detail"], finding["remedy"])):
            known = translate("de", text)
            if known != text and "UTC" not in text and "process" not in text and "MiB" not in text:
                assert html.escape(known, quote=True).replace("&#x27;", "&#39;").replace("&quot;", "&#34;") in shown
