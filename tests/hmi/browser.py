"""The distribution's Chromium, and what no page of ours may do in it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import (
    Browser,
    BrowserContext,
    ConsoleMessage,
    Page,
    Request,
    ViewportSize,
    WebError,
    sync_playwright,
)

from .conftest import LIMIT_S, Server

SIZES = ((1024, 600), (1366, 768), (1920, 1080))
VIEWPORT: ViewportSize = {"width": 1366, "height": 768}
FREE = "about:blank#free"
"""Where a window waits for the next test."""
PATHS = (
    "/",
    "/run",
    "/tune",
    "/calibrate",
    "/calibrate?kind=plane",
    "/calibrate?kind=hand-eye",
    "/calibrate/history",
    "/calibrate/drift",
    "/templates",
    "/history",
    "/history/jobs",
    "/history/placements",
    "/alarms",
    "/doctor",
    "/users",
    "/about",
)


def chromium() -> str:
    """Return the program; skip, or fail in CI, where there is none."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if found := shutil.which(name):
            return found
    reason = "no Chromium is installed: the distribution's package chromium has it"
    if os.environ.get("SLABCELL_REQUIRE_CAMERA") == "1":  # CI has to have it
        pytest.fail(reason)
    pytest.skip(reason)


def serious_findings(page: Page) -> list[str]:
    """Return what axe-core finds on a page that keeps people out."""
    return [
        f"{item['id']}: {node['html']}"
        for item in Axe().run(page).response["violations"]
        if item["impact"] in {"serious", "critical"}
        for node in item["nodes"]
    ]


@contextmanager
def opened_browser() -> Iterator[Browser]:
    """Run one Chromium, without a window."""
    path = chromium()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-dev-shm-usage"])
        yield browser
        browser.close()


@dataclass
class Watch:
    """What went wrong in the pages of one browser window."""

    base: str
    wrong: list[str] = field(default_factory=list)

    @contextmanager
    def over(self, context: BrowserContext) -> Iterator[None]:
        """Watch a window during the block."""
        listeners: dict[Any, Any] = {"console": self._console, "weberror": self._script, "request": self._request}
        for event, listener in listeners.items():
            context.on(event, listener)
        try:
            yield
        finally:
            for event, listener in listeners.items():
                context.remove_listener(event, listener)

    def _console(self, message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"}:
            self.wrong.append(f"{message.type}: {message.text} {message.location}")

    def _script(self, error: WebError) -> None:
        self.wrong.append(f"script: {error.error}")

    def _request(self, request: Request) -> None:
        address = urlsplit(request.url)
        if address.scheme not in {"blob", "data"} and f"{address.scheme}://{address.netloc}" != self.base:
            self.wrong.append(f"foreign request: {request.url}")


@contextmanager
def window(
    browser: Browser, hmi: Server, role: str, *, colours: str = "light", language: str = "en", calm: bool = True
) -> Iterator[Page]:
    """Give a window that is logged in; with ``calm``, nothing may go wrong in it.

    It has no cookie and nothing in its storage but the login; only what may be kept for ever may be in its cache.
    """
    watch = Watch(hmi.base)
    cookies = {**hmi.client(role).cookies, "slabcell-theme": colours, "slabcell-language": language}
    with _borrowed(browser, hmi) as page, watch.over(page.context):
        page.context.add_cookies([{"name": name, "value": value, "url": hmi.base} for name, value in cookies.items()])
        yield page
    if calm:
        assert not watch.wrong, "\n".join(watch.wrong)


@contextmanager
def _borrowed(browser: Browser, hmi: Server) -> Iterator[Page]:
    """Give a window as if it were new: to open one takes Chromium a second of a core, to clear one a tenth of that.

    One that a test failed in, or that has more pages than its first, is not used again.
    """
    page = next((page for context in browser.contexts for page in context.pages if page.url == FREE), None)
    if page is None:
        context = browser.new_context(base_url=hmi.base, viewport=VIEWPORT, reduced_motion="reduce")
        context.set_default_timeout(LIMIT_S * 1000)
        page = context.new_page()
    page.goto("about:blank")
    try:
        yield page
    except BaseException:
        page.context.close()
        raise
    if len(page.context.pages) > 1:
        page.context.close()
        return
    if page.url.startswith(hmi.base):
        page.evaluate("() => { localStorage.clear(); sessionStorage.clear(); }")
    page.context.clear_cookies()
    page.set_viewport_size(VIEWPORT)
    page.goto(FREE)
