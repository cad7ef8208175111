"""The distribution's Chromium, and what no page of ours may do in it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, Request, sync_playwright

from .conftest import LIMIT_S, Server

SIZES = ((1024, 600), (1366, 768), (1920, 1080))
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

    def follow(self, context: BrowserContext) -> None:
        """Watch a window."""
        context.on("console", self._console)
        context.on("weberror", lambda error: self.wrong.append(f"script: {error.error}"))
        context.on("request", self._request)

    def _console(self, message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"}:
            self.wrong.append(f"{message.type}: {message.text} {message.location}")

    def _request(self, request: Request) -> None:
        address = urlsplit(request.url)
        if address.scheme not in {"blob", "data"} and f"{address.scheme}://{address.netloc}" != self.base:
            self.wrong.append(f"foreign request: {request.url}")


@contextmanager
def window(
    browser: Browser, hmi: Server, role: str, *, colours: str = "light", language: str = "en", calm: bool = True
) -> Iterator[Page]:
    """Give a window that is logged in; with ``calm``, nothing may go wrong in it."""
    context = browser.new_context(base_url=hmi.base, viewport={"width": 1366, "height": 768}, reduced_motion="reduce")
    context.set_default_timeout(LIMIT_S * 1000)
    watch = Watch(hmi.base)
    watch.follow(context)
    cookies = {**hmi.client(role).cookies, "slabcell-theme": colours, "slabcell-language": language}
    context.add_cookies([{"name": name, "value": value, "url": hmi.base} for name, value in cookies.items()])
    try:
        yield context.new_page()
    finally:
        context.close()
    if calm:
        assert not watch.wrong, "\n".join(watch.wrong)
