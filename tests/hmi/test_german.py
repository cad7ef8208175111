"""On a German page nothing is English: not what is there from the start, nor what comes when something is refused."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, expect

from .browser import PATHS, window
from .conftest import LIMIT_S, Answer, Cell, Client, Server, wait_for

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(300)]

expect.set_options(timeout=LIMIT_S * 1000)

ENGLISH = re.compile(
    r"\b(the|of|and|is|are|not|with|from|this|that|has|have|must|cannot|there|should|needs?|only|slots?|views?|board|"
    r"pictures?|again|already|refused|taken|chosen|below|above)\b"
)
"""Words that nearly every English sentence has one of, and no German one."""
READ = (
    "title|aria-label|placeholder|alt|data-(?:label|none|taken|larger|smaller|fit|part|rejected|found|refused|close|"
    "page-lost|cell-lost|too-many)"
)
"""Attributes that people read."""
PARTS = (
    "/overview/cards",
    "/run/work",
    "/run/buttons",
    "/templates/view",
    "/doctor/findings",
    "/alarms/list",
    "/header",
)


@pytest.fixture(scope="module", autouse=True)
def laid(cell: Cell) -> Iterator[None]:
    """There was a job, and it is over."""
    cell.lay()
    yield
    cell.api.post("/v1/calibration/clear")


def german(hmi: Server, role: str) -> Client:
    client = hmi.client(role)
    client.cookies["slabcell-language"] = "de"
    return client


def english(text: str) -> list[str]:
    """Return what of a text is English, with what stands around it; names and commands are data."""
    bare = re.sub(r"`[^`]*`|'[^']*'|\{\w+\}|\w+ = |/\S+|\w+\.(md|toml|conf|xml|csv|json|service)\b|--\w+", " ", text)
    return [bare[max(0, found.start() - 60) : found.end() + 60] for found in ENGLISH.finditer(bare)]


def shown(answer: Answer) -> str:
    """Return what of a page people read: texts, titles, labels, and the words that its scripts say."""
    page = re.sub(r"<(script|style)\b.*?</\1>|<!--.*?-->", " ", answer.text, flags=re.DOTALL)
    read = " ".join(re.findall(rf'(?:{READ})="([^"]*)"', page))
    words = " ".join(re.findall(r"data-words='([^']*)'", page))
    spoken = " ".join(str(value) for value in json.loads(html.unescape(words) or "{}").values())
    return html.unescape(f"{re.sub(r'<[^>]*>', ' ', page)} {read} {spoken}")


def loaded(client: Client, path: str) -> Answer:
    """Return a page; what the cell has no time for now is asked for again, as people do."""
    found: list[Answer] = []

    def ask_again() -> bool:
        found[:] = [client.get(path)]
        return found[0].status != 503

    wait_for(ask_again, path)
    assert found[0].status == 200, found[0].text
    return found[0]


@pytest.mark.parametrize("path", [*PATHS, *PARTS])
def test_a_page_speaks_german(hmi: Server, path: str) -> None:
    text = shown(loaded(german(hmi, "admin"), path))
    if path == "/about":
        text = text.partition("Bestandteil")[0]  # licences have the names that they have
    if path == "/users":
        text = text.partition("Protokoll")[0]  # what others did in English is there as it was said to them
    assert english(text) == []


def test_parameters_and_their_choices_are_named_in_german(hmi: Server, browser: Browser) -> None:
    with window(browser, hmi, "engineer", language="de") as page:
        page.goto("/tune")
        wait_for(lambda: int(page.locator("#tune").get_attribute("data-runs") or 0) > 0, "a run of the vision")
        method = page.locator("[data-key='segmentation.method']")
        expect(method.locator("option[value=fixed]")).to_have_text("feste Schwelle (fixed)")
        before = int(page.locator("#tune").get_attribute("data-runs") or 0)
        method.locator("select").select_option("otsu")
        wait_for(lambda: int(page.locator("#tune").get_attribute("data-runs") or 0) > before, "another run")
        expect(method).to_contain_text("Wie aktiv: automatisch (auto)")
        expect(page.locator("#outcome")).to_contain_text("Schwelle nach Otsu")
        page.locator("#tab-changes").click()
        row = page.locator("#differences tbody tr")
        expect(row).to_contain_text("Verfahren segmentation.method")
        expect(row).to_contain_text("Otsu (otsu)")
        page.locator("#stages button[value=blobs]").click()
        page.locator("[data-key='blobs.filters'] button.add").click()
        expect(page.locator("[data-key='blobs.filters'] option[value=roundness]")).to_have_text("Rundheit (roundness)")
        for form in page.locator("form.fields").all():
            assert english(form.text_content() or "") == []


REFUSED: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("/run/resolve", {"result": "999999", "verdict": "placed"}, "Ergebnis 999999 ist nicht vom jetzigen Auftrag"),
    ("/run/abandon", {}, "Kein Auftrag ist offen"),
    ("/run/clear", {}, "ist im Zustand"),
    ("/alarms/acknowledge", {"number": "1101"}, "Alarm 1101 steht nicht an"),
    ("/alarms/acknowledge", {"number": "99"}, "Der Fehlerkatalog hat keine Nummer 99"),
    ("/calibrate/look", {"board": "cardboard"}, "Tafel 'cardboard' ist keine von: checkerboard:SPALTENxZEILEN"),
    ("/calibrate/collect", {"board": "checkerboard:99x99:0.01", "kind": "camera"}, "liegt außerhalb von"),
    ("/calibrate/collect", {"board": "charuco:5x7:20", "kind": "camera"}, "braucht die Größe des Markers"),
    ("/calibrate/run", {"kind": "camera", "model": "brown5"}, "Es gibt keine Ansichten: erst welche sammeln"),
    ("/calibrate/remove", {"view": "77"}, "Es gibt keine Ansicht 77"),
    ("/calibrate/poses", {"poses": "1,2,3"}, "hat 3 Werte, die Kopfzeile 7"),
    ("/calibrate/poses", {"poses": "1,a,0,0,0,0,0"}, "ist keine Zahl innerhalb von"),
    ("/calibrate/poses", {"poses": "9,1,0,0,0,0,0"}, "Die Tabelle nennt 9, was keine Ansicht ist"),
    ("/calibrate/activate", {"name": "nobody"}, "Es gibt keine Kalibrierung 'nobody'"),
    ("/calibrate/check", {"board": "checkerboard:12x9:25"}, "nicht gefunden; die ganze Tafel muss zu sehen"),
    ("/templates/use", {"name": "nobody"}, "Es gibt kein Rezept 'nobody'"),
    (
        "/templates/save",
        {"base": "nobody", "name": "x", "thickness_mm": "5", "csv": "0,0,9,0,9,9"},
        "Es gibt kein Rezept 'nobody'",
    ),
)
"""What is refused: the path, the fields, and what of the answer is there in German."""


@pytest.mark.parametrize(("path", "fields", "said"), REFUSED)
def test_what_is_refused_is_refused_in_german(hmi: Server, path: str, fields: dict[str, Any], said: str) -> None:
    answer = german(hmi, "admin").post(path, fields)
    assert answer.status >= 400, answer.headers
    text = answer.said["text"]
    assert said in text
    assert english(text) == []


def test_a_robot_that_says_nothing_is_told_of_in_german(hmi: Server) -> None:
    answers: list[Answer] = []

    def refused() -> bool:  # what a robot of another test said counts for some seconds
        answers[:] = [german(hmi, "admin").post("/calibrate/robot-pose")]
        return answers[0].status >= 400

    wait_for(refused, "a refusal")
    assert "Der Roboter " in answers[0].said["text"]
    assert english(answers[0].said["text"]) == []


def test_a_template_that_may_not_be_kept_is_refused_in_german(cell: Cell, hmi: Server) -> None:
    recipe = cell.api.get("/v1/status")["recipe"]
    keep = {"base": recipe, "thickness_mm": "5", "others": "[]"}
    for more, said in (
        ({"name": recipe, "csv": "0,0,80,0,80,50,0,50"}, f"Ein Rezept {recipe} gibt es schon"),
        ({"name": "new", "csv": "0,0,80,0,x,50"}, "ist keine Zahl"),
        ({"name": "new", "csv": "0,0,80,0"}, "2 Punkte; ein Polygon braucht mindestens 3"),
        ({"name": "new", "csv": "0,0,80,0,80,50", "thickness_mm": "-3"}, "muss mindestens 0 sein"),
        ({"name": "no name", "csv": "0,0,80,0,80,50"}, "ist kein Name eines Rezepts"),
    ):
        text = german(hmi, "engineer").post("/templates/save", {**keep, **more}).said["text"]
        assert said in text
        assert english(text) == []


def ask(hmi: Server, path: str, content: Any, *, media_type: str = "application/json") -> Answer:
    """Do what a script of the page does."""
    client = german(hmi, "engineer")
    body = content if isinstance(content, bytes) else json.dumps(content).encode()
    headers = {"Origin": client.base, "X-Slabcell-Form": client.form, "HX-Request": "true", "Content-Type": media_type}
    return client.ask("POST", path, body, headers)


TRIED: tuple[tuple[str, Any, str], ...] = (
    ("/tune/preview", {"picture": "nowhere"}, "Bild 'nowhere': latest, cycle:NUMMER"),
    ("/tune/preview", {"picture": "set:examples/none.png"}, "Es gibt kein Bild 'none.png' in Satz 'examples'"),
    ("/tune/preview", {"picture": "cycle:999999"}, "Es gibt keinen Zyklus 999999"),
    ("/tune/preview", {"picture": "upload:abc"}, "wurde nicht hochgeladen, oder ist nicht mehr aufgehoben"),
    ("/tune/preview", {"picture": 3}, "muss ein Text sein"),
    ("/tune/keep", {"set": "Not a Name", "picture": "latest", "name": "x"}, "Ein Name hat 1 bis 40 von a-z"),
    ("/tune/forget", {"set": "none", "file": "x.png"}, "Es gibt kein Bild 'x.png' in Satz 'none'"),
    ("/tune/compare", {"base": "nobody", "parameters": {}}, "Es gibt kein Rezept 'nobody'"),
    ("/tune/check", {"base": "nobody"}, "Es gibt kein Rezept 'nobody'"),
    ("/tune/apply", {"name": "nobody"}, "Es gibt kein Rezept 'nobody'"),
    ("/tune/cancel", {"task": "nothing"}, "Es gibt keine Aufgabe 'nothing'"),
)


@pytest.mark.parametrize(("path", "content", "said"), TRIED)
def test_what_cannot_be_tried_is_said_in_german(hmi: Server, path: str, content: Any, said: str) -> None:
    answer = ask(hmi, path, content)
    text = json.loads(answer.content)["problem"]
    assert said in text
    assert english(text) == []


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "endet nach 0 Byte; abgeschnitten, neu kopieren"),
        (b"no picture at all", "ist kein Bild in PNG, JPEG oder TIFF"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\1\0\0\0\1\x08\0\0\0\0", "ist"),
        (b"\xff\xd8\xff\xe0\0\x10JFIF", "ist"),
    ],
)
def test_a_picture_that_is_none_is_refused_in_german(hmi: Server, content: bytes, said: str) -> None:
    answer = ask(hmi, "/tune/upload", content, media_type="application/octet-stream")
    text = json.loads(answer.content)["problem"]
    assert said in text
    assert english(text) == []


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"no JSON", "Die Kalibrierung ist kein JSON"),
        (b"[1]", "ist nicht ein Objekt"),
        (b"{}", "die Kalibrierung"),
        (b'{"schema": "slabcell.calibration/99"}', "das, was diese Version liest"),
    ],
)
def test_a_calibration_that_is_none_is_refused_in_german(hmi: Server, content: bytes, said: str) -> None:
    text = ask(hmi, "/calibrate/upload", content).said["text"]
    assert said in text
    assert english(text) == []


@pytest.mark.parametrize(
    ("table", "changed", "said"),
    [
        ("segmentation", {"classes": 9}, "segmentation.classes = 9: darf höchstens 5 sein"),
        ("segmentation", {"method": "guess"}, "muss eines sein von 'auto', 'fixed'"),
        ("segmentation", {"method": "fixed"}, "braucht den Schlüssel 'threshold'"),
        ("segmentation", {"metod": "otsu"}, "unbekannter Schlüssel 'segmentation.metod': ist 'method' gemeint?"),
        ("blobs", {"filters": [{"feature": "u"}]}, "ein Filter braucht den Schlüssel 'min', 'max' oder beide"),
        ("grasp", {"cups_mm": []}, "muss mindestens 1 Eintrag haben, nicht 0"),
    ],
)
def test_a_parameter_that_cannot_be_is_refused_in_german(
    cell: Cell, hmi: Server, table: str, changed: dict[str, Any], said: str
) -> None:
    base = cell.api.get("/v1/status")["recipe"]
    parameters = cell.api.get(f"/v1/recipes/{base}")["parameters"]
    parameters[table] |= changed
    answer = ask(hmi, "/tune/preview", {"base": base, "parameters": parameters, "picture": "latest"})
    text = json.loads(answer.content)["problem"]
    assert said in text
    assert english(text) == []


def preview(cell: Cell, hmi: Server, **tables: dict[str, Any]) -> dict[str, Any]:
    """Return what the vision makes of five slabs with other parameters, as the page hears it."""
    base = cell.api.get("/v1/status")["recipe"]
    parameters = cell.api.get(f"/v1/recipes/{base}")["parameters"]
    for table, changed in tables.items():
        parameters[table] |= changed
    kept = next(file for file in (cell.folder / "pictures" / "examples").glob("strewn-1*.png"))
    content = {"base": base, "parameters": parameters, "picture": f"set:examples/{kept.name}", "everywhere": True}
    found: dict[str, Any] = json.loads(ask(hmi, "/tune/preview", content).content)
    assert "problem" not in found, found
    return found


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"matching": {"max_residual_mm": 0.0001}}, "am nächsten kommt Platz"),
        ({"matching": {"min_score": 1.0}}, "die Grenze ist 1"),
        ({"blobs": {"filters": [{"feature": "area_mm2", "min": 1e6}]}}, "Fläche ist"),
        ({"grasp": {"cup_radius_mm": 400.0}}, "der größte auf dieser Platte hat"),
        (
            {"grasp": {"forbidden": [{"polygon": [[-999, -999], [999, -999], [999, 999], [-999, 999]]}]}},
            "verbotene Zonen",
        ),
    ],
)
def test_a_blob_is_refused_in_german(cell: Cell, hmi: Server, tables: dict[str, Any], said: str) -> None:
    found = preview(cell, hmi, **tables)
    details = [blob["detail"] for blob in found["located"]["rejected"]]
    assert any(said in detail for detail in details), details
    assert [english(detail) for detail in details if english(detail)] == []


@pytest.mark.parametrize(
    "changed",
    [
        {"method": "otsu"},
        {"method": "local"},
        {"method": "fixed", "threshold": 128},
        {"method": "dynamic_hard"},
        {"method": "dynamic_soft"},
        {"method": "multi_otsu"},
        {"method": "kmeans"},
        {"polarity": "light"},
        {"polarity": "dark"},
        {"min_area_mm2": 2000.0},
    ],
)
def test_what_the_segmentation_did_is_said_in_german(cell: Cell, hmi: Server, changed: dict[str, Any]) -> None:
    found = preview(cell, hmi, segmentation=changed)
    assert found["segmentation"]
    assert english(found["segmentation"]) == []
    assert not re.search(r"\b(light|dark|threshold|dynamic)\b", found["segmentation"])


@pytest.mark.parametrize(
    ("gates", "said"),
    [
        ({"min_brightness_percent": 100.0}, "zu dunkel: Die hellsten Pixel erreichen"),
        ({"max_overexposed_percent": 0.0}, "überbelichtet"),
        ({"max_blur_px": 0.01}, "unscharf: Die schärfsten Kanten sind"),
    ],
)
def test_a_picture_is_refused_in_german(cell: Cell, hmi: Server, gates: dict[str, Any], said: str) -> None:
    found = preview(cell, hmi, gates=gates)
    if found["located"] is None:
        assert said in found["refusal"]
        assert english(found["refusal"]) == []
    else:
        assert gates == {"max_overexposed_percent": 0.0}, "only of this there may be none in the picture"


def test_what_is_not_there_is_missed_in_german(hmi: Server) -> None:
    for path, said in (
        ("/history/cycles/999999999", "Es gibt keinen Zyklus 999999999, oder nicht mehr"),
        ("/history/jobs?job=999999999", "Die Buchführung hat keinen Auftrag 999999999"),
        ("/templates/view?recipe=nobody", "Es gibt kein Rezept 'nobody'"),
        ("/calibrate/file?name=nobody", "Es gibt keine Kalibrierung 'nobody'"),
    ):
        answer = german(hmi, "admin").get(path)
        assert answer.status >= 400
        assert said in shown(answer)
        assert english(shown(answer)) == []


def test_the_log_of_writes_is_english_in_its_file_and_german_on_its_page(hmi: Server) -> None:
    client = german(hmi, "admin")
    assert client.post("/templates/use", {"name": "nobody-knows"}).status >= 400
    assert "Es gibt kein Rezept 'nobody-knows'" in shown(client.get("/users"))
    client.cookies["slabcell-language"] = "en"
    assert "there is no recipe 'nobody-knows'" in shown(client.get("/users"))


def test_a_lost_camera_is_named_in_german_wherever_it_shows(cell: Cell, hmi: Server) -> None:
    cell.tell("off")
    try:
        text = german(hmi, "operator").post("/run/look").said["text"]
        assert "Kamera" in text
        assert english(text) == []
        wait_for(lambda: any(link["name"] == "camera" and link["state"] == "down" for link in links(cell)), "the loss")
        for path in ("/overview/cards", "/alarms", "/history", "/header"):
            assert english(shown(german(hmi, "operator").get(path))) == []
    finally:
        cell.tell("on")
        wait_for(lambda: all(link["state"] != "down" for link in links(cell)), "the camera")


def links(cell: Cell) -> list[dict[str, Any]]:
    return cell.api.get("/v1/status")["links"]


def test_a_calibration_and_what_is_to_be_said_of_it_are_german(cell: Cell, hmi: Server) -> None:
    for number in range(4):
        board = cell.api.post("/v1/simulation/board", {"place": "table", "number": number})["board"]
        cell.api.post("/v1/frames/take")
        cell.api.post("/v1/calibration/views", {"board": board, "picture": "latest", "pose": None})
    try:
        for kind in ("camera", "plane", "hand-eye"):
            assert english(shown(german(hmi, "engineer").get(f"/calibrate/views?kind={kind}"))) == []
            answer = german(hmi, "engineer").post("/calibrate/run", {"kind": kind, "model": "brown5"})
            if kind == "hand-eye":
                assert "nennen keine Pose des Roboters" in answer.said["text"]
                continue
            task = re.search(r"task=(\w+)", answer.text)
            assert task is not None, answer.text
            assert english(shown(answer)) == []
            result = f"/calibrate/result?task={task[1]}&kind={kind}"
            wait_for(lambda at=result: "hx-trigger" not in german(hmi, "engineer").get(at).text, "the calibration")
            said = shown(german(hmi, "engineer").get(result))
            assert english(said) == [], said
    finally:
        cell.api.post("/v1/simulation/board", {"place": "away"})
