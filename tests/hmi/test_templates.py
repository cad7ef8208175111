"""The page Templates: what is sent is read, drawn, judged with places, kept and laid; a viewer only looks."""

from __future__ import annotations

import io
from pathlib import Path

import ezdxf
import pytest
from playwright.sync_api import Browser, expect

from slabcell.hmi.words import LANGUAGES, load_tables
from slabcell.template.model import TEXTS

from .browser import window
from .conftest import LIMIT_S, Cell, Client, Server, wait_for

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(300)]

PATIENCE_MS = LIMIT_S * 1000
GOOD = "# name: K1\n0,0,80,0,80,50,0,50\n# name: K2\n80,0,120,0,120,50,80,50\n"
OVERLAP = "0,0,80,0,80,50,0,50\n70,0,120,0,120,50,70,50\n"


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_finding_has_its_words(language: str) -> None:
    words = load_tables(language)["templates"]
    assert {key.partition(".")[2] for key in words if key.startswith("finding.")} == TEXTS.keys()


def test_an_overlap_is_drawn_at_its_place_and_found_by_click_and_key(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "engineer") as page:
        page.goto("/templates")
        expect(page.locator("svg.pattern .slot").first).to_be_visible(timeout=PATIENCE_MS)
        page.get_by_label("Choose a file, CSV or DXF").set_input_files(
            {"name": "two.csv", "mimeType": "text/csv", "buffer": OVERLAP.encode()}
        )
        page.get_by_role("button", name="Check", exact=True).click()
        expect(page.locator("#view-title")).to_have_text("two.csv", timeout=PATIENCE_MS)
        expect(page.locator("svg.pattern .slot")).to_have_count(2)
        fault = page.locator(".list-of-findings .fault")
        expect(fault).to_contain_text("Slot 1 overlaps slot 0 (line 1) by 500 mm²")
        expect(fault).to_contain_text("line 2, column 1 (A)")
        mark = page.locator("g.fault")
        corners = mark.locator("polygon").get_attribute("points") or ""
        assert {tuple(map(float, pair.split(","))) for pair in corners.split()} == {
            *((70.0, 0.0), (80.0, 0.0), (80.0, -50.0), (70.0, -50.0)),
        }
        whole = page.locator("svg.pattern").get_attribute("viewBox")
        fault.focus()
        page.keyboard.press("Enter")
        expect(page.locator("g.fault.chosen")).to_be_attached()
        left, top, width, height = map(float, (page.locator("svg.pattern").get_attribute("viewBox") or "").split())
        assert left < 70
        assert left + width > 80
        assert top < -50
        assert top + height > 0
        page.keyboard.press("Escape")
        expect(page.locator("svg.pattern")).to_have_attribute("viewBox", whole or "")
        mark.locator(".flag").click()
        expect(fault).to_have_attribute("aria-pressed", "true")
        assert page.locator("form.keep").count() == 0, "what cannot be used is not kept"


def test_a_drawing_is_kept_as_a_recipe_and_laid_by_the_next_job(cell: Cell, hmi: Server, browser: Browser) -> None:
    document = ezdxf.new()
    space = document.modelspace()
    document.header["$INSUNITS"] = 0
    for x, name in ((0, "N1"), (9, "N2")):
        space.add_lwpolyline([(x, 0), (x + 8, 0), (x + 8, 5), (x, 5)], close=True, dxfattribs={"layer": "S_6mm"})
        space.add_text(name).set_placement((x + 1, 1))
    stream = io.StringIO()
    document.write(stream)
    before = cell.api.get("/v1/recipes/active")["recipe"]["name"]
    with window(browser, hmi, "engineer", calm=False) as page:  # a job may be open: what is refused is an error, too
        page.goto("/templates")
        file = {"name": "north roof.dxf", "mimeType": "image/vnd.dxf", "buffer": stream.getvalue().encode()}
        page.get_by_label("Choose a file, CSV or DXF").set_input_files(file)
        page.get_by_role("button", name="Check", exact=True).click()
        expect(page.locator(".list-of-findings")).to_contain_text("names no unit", timeout=PATIENCE_MS)
        page.get_by_label("Unit of a drawing").select_option("cm")
        page.get_by_role("button", name="Check", exact=True).click()
        expect(page.locator("svg.pattern .name").first).to_have_text("N1", timeout=PATIENCE_MS)
        form = page.locator("form.keep")
        expect(form.get_by_label("Name of the recipe")).to_have_value("north-roof")
        expect(form.get_by_label("Thickness, mm")).to_have_value("6")
        form.get_by_role("button").click()
        expect(page.locator("#messages")).to_contain_text("north-roof is saved", timeout=PATIENCE_MS)
        page.locator(".recipes").get_by_role("link", name="north-roof").click()
        use = page.get_by_role("button", name="Lay this from the next job on")

        def used() -> bool:  # only between jobs
            with page.expect_response("**/templates/use") as answer:
                use.click()
            return answer.value.ok

        try:
            wait_for(used, "the template in use")
            active = cell.api.get("/v1/recipes/active")["recipe"]
            assert (active["name"], active["thickness_mm"]) == ("north-roof", 6.0)
            assert len(active["template"]["slots"]) == 2
        finally:
            cell.api.post(f"/v1/recipes/{before}/activate")


def test_a_viewer_looks_and_sends_nothing(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "viewer") as page:
        page.goto("/templates")
        expect(page.locator("svg.pattern .slot").first).to_be_visible(timeout=PATIENCE_MS)
        assert page.locator("#send, form.keep, .view form").count() == 0


def sent(client: Client, content: bytes, **headers: str) -> int:
    fixed = {"Origin": client.base, "X-Slabcell-Form": client.form, "HX-Request": "true"}
    return client.ask(
        "POST", "/templates/check", content, {**fixed, "Content-Type": "application/octet-stream", **headers}
    ).status


def rectangles(count: int, decimals: int) -> str:
    """Return a template of so many slabs, with so many decimals."""
    cells = ((80.0 * (n % 50), 60.0 * (n // 50)) for n in range(count))
    slabs = ([(x, y), (x + 70, y), (x + 70 - n % 40, y + 50), (x, y + 50)] for n, (x, y) in enumerate(cells))
    return "".join(",".join(f"{value:.{decimals}f}" for point in slab for value in point) + "\n" for slab in slabs)


def test_a_large_template_is_kept_and_one_that_is_too_large_says_what_to_do(
    cell: Cell, hmi: Server, browser: Browser
) -> None:
    large = rectangles(100, 800)
    assert 500 << 10 < len(large) < 2 << 20
    client = hmi.client("engineer")
    form = {"csv": large, "base": "dresden", "name": "large", "thickness_mm": "8", "others": "[]"}
    assert client.post("/templates/save", form).status == 200
    assert len(cell.api.get("/v1/recipes/large/template")["slots"]) == 100
    fixed = {"Origin": client.base, "X-Slabcell-Form": client.form, "Content-Type": "application/octet-stream"}
    shown = client.ask("POST", "/templates/check?file=a.csv&recipe=dresden", rectangles(100, 2700).encode(), fixed)
    assert 'id="cannot-keep"' in shown.text
    assert "at most 2048 KiB are kept" in shown.text
    with window(browser, hmi, "engineer") as page:
        page.goto("/templates")
        file = {"name": "far too large.csv", "mimeType": "text/csv", "buffer": b"0" * (8 << 20 | 1)}
        page.get_by_label("Choose a file, CSV or DXF").set_input_files(file)
        expect(page.locator("#file-name")).to_have_text("far too large.csv · 8193 KiB")
        page.get_by_role("button", name="Check", exact=True).click()
        expect(page.locator(".message.failed")).to_contain_text("larger than 8 MiB")


def test_what_is_sent_is_bounded_and_never_believed(hmi: Server, tmp_path: Path) -> None:
    client = hmi.client("engineer")
    assert sent(client, GOOD.encode()) == 200
    assert sent(client, b"", **{"Content-Length": str(9 << 20)}) == 413
    assert sent(client, GOOD.encode(), **{"Content-Type": "multipart/form-data; boundary=x"}) == 415
    assert sent(client, GOOD.encode(), **{"X-Slabcell-Form": "another"}) == 403
    evil = "# name: <script>alert(1)</script>{x}\n0,0,80,0,80,50,0,50\n"
    fixed = {"Origin": client.base, "X-Slabcell-Form": client.form, "Content-Type": "application/octet-stream"}
    shown = client.ask("POST", "/templates/check?file=%3Cb%3E.csv", evil.encode(), fixed)
    assert shown.status == 200
    assert "<script>alert" not in shown.text
    assert "<b>" not in shown.text
    for content in (
        b"\xff\xfe\0",
        b"AC1032",
        b"0\nSECTION\n2\nENTITIES\n0\nLINE\n10\nx\n",
        b"{0.__class__},1,2,3,4,5\n",
    ):
        assert sent(client, content) == 200
    assert client.get("/templates/view?recipe=../../etc/passwd").status in {404, 409}
