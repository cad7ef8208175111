"""Does every text that a page may show have its German, and is a message found again whatever stands at its places?"""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import pytest

from slabcell.catalogue import catalogue
from slabcell.cell.records import OfferState
from slabcell.cell.states import CellState, HeldCause
from slabcell.errors import RecipeError
from slabcell.hmi.messages import MAX_LENGTH, load_messages, load_words, translate
from slabcell.recipe import BlobFeature, RecipeFile
from slabcell.service.background import TaskState
from slabcell.service.bench.tasks import TASKS
from slabcell.service.links import LinkState
from slabcell.toml_file import TomlTable, check
from slabcell_drivers.camera.protocol import CameraState

from .messages import ELSEWHERE, ROOMS, ROOT, messages

LINES = Path("/recipes/north.toml")
WRONG: tuple[Any, ...] = (
    *(-1, 0, 1.5, 1e9, 2**80, float("nan"), float("inf"), True, "", "x", "x" * 5000, "3"),
    *(None, [], [1], ["x"], [[1, 2]], [[1, 2]] * 5001, [[1, 2, 3]], {}, {"x": 1}, [{}], [{"x": 1}], [{"slots": 3}]),
)
"""Values of every kind, of which each parameter takes few."""
ENGLISH = ("Input", "should", "Field required", "Unable", "not permitted", "String", "unknown key", "missing")


def test_every_sentence_of_the_rooms_that_speak_to_people_has_its_words_in_german() -> None:
    wanted, words = messages(), load_messages("de")
    assert len(wanted) > 700, "the source is read otherwise than it is written"
    assert {text: wanted[text] for text in wanted.keys() - words.keys()} == {}
    assert words.keys() - wanted.keys() == set(), "nobody says this any more"
    for english, german in words.items():
        assert places(english) == places(german), english


def places(text: str) -> list[str]:
    return sorted(part.partition("}")[0].partition(":")[0] for part in text.split("{")[1:])


def test_no_file_is_passed_over_that_is_not_there() -> None:
    there = [path.as_posix() for room in ROOMS for path in ROOT.glob(room)]
    assert [name for name in ELSEWHERE if not any(path.endswith(f"/{name}") for path in there)] == []


@pytest.mark.parametrize("table", RecipeFile.model_fields)
def test_whatever_is_wrong_with_a_parameter_is_said_in_german(table: str) -> None:
    smallest: dict[str, dict[str, Any]] = {"template": {"file": "a.csv", "thickness_mm": 10}}
    model = RecipeFile.model_fields[table].annotation
    assert isinstance(model, type)
    assert issubclass(model, TomlTable)
    told = 0
    for name in model.model_fields:
        for value in WRONG:
            content: dict[str, Any] = {**smallest, table: {**smallest.get(table, {}), name: value}}
            try:
                check(content, RecipeFile, RecipeError, lambda _: f"{LINES}:3")
            except RecipeError as error:
                told += 1
                said = translate("de", str(error))
                assert not any(word in said for word in ENGLISH), said
    assert told > 3 * len(model.model_fields)


def test_words_that_stand_in_messages_by_themselves_are_known() -> None:
    kinds = (CellState, OfferState, CameraState, HeldCause, LinkState, TaskState)
    named = {*get_args(BlobFeature), *TASKS, *(str(word.value) for words in kinds for word in words)}
    assert named - load_words("de").keys() == set()


EXAMPLES = {
    "/a/b: 512 MiB are free": "/a/b: 512 MiB sind frei",
    "/a: 5 MiB are free; below 9 MiB no bundle is kept": (
        "/a: 5 MiB sind frei; unter 9 MiB wird kein B\u00fcndel aufgehoben"
    ),
    "the clock says 2026-11-27 11:00 UTC": "Die Uhr zeigt 2026-11-27 11:00 UTC",
    "a text of a library {0}": "a text of a library {0}",
    # A message inside of another, and a word that would elsewhere be somebody's name.
    "nearest is slot 3: the outline is 0.6 mm off, the limit is 0.4 mm": (
        "am n\u00e4chsten kommt Platz 3: der Umriss weicht um 0,6 mm ab, die Grenze ist 0,4 mm"
    ),
    "roundness is 0.3, the recipe's filter wants at least 0.5": (
        "Rundheit ist 0,3, der Filter des Rezepts verlangt mindestens 0,5"
    ),
    "there is no recipe roundness in /a or /b": "Es gibt kein Rezept roundness in /a oder /b",
    # A value in which stands what stands between values.
    (
        "slot 2: each of the 4 cups of 4 mm radius with its margin of 1 mm needs a free circle of 5.0 mm radius, the"
        " largest on this slab has 4.0 mm"
    ): (
        "Platz 2: jeder der 4 Sauger mit 4 mm Radius und seinem Abstand von 1 mm braucht einen freien Kreis von 5,0 mm"
        " Radius, der gr\u00f6\u00dfte auf dieser Platte hat 4,0 mm"
    ),
    # Several messages in one go.
    (
        "otsu threshold 120 of 255, chosen because 1.0 % of the smaller population lies between the two; slabs are"
        " light; 3 specks left out"
    ): (
        "Schwelle nach Otsu 120 von 255, gew\u00e4hlt, weil 1,0 % der kleineren Gruppe von Pixeln zwischen beiden"
        " liegen; Platten sind hell; 3 kleine Flecken weggelassen"
    ),
    "/a:3: classes = 9: Input should be less than or equal to 5\n/a:4: unknown key 'x': did you mean 'y'?": (
        "/a:3: classes = 9: darf h\u00f6chstens 5 sein\n/a:4: unbekannter Schl\u00fcssel 'x': ist 'y' gemeint?"
    ),
}


@pytest.mark.parametrize("message", EXAMPLES)
def test_messages_are_told_apart_by_what_they_say(message: str) -> None:
    assert translate("de", message) == EXAMPLES[message]
    assert translate("en", message) == message


def test_what_the_catalogue_says_stands_behind_a_refusal_in_german_too() -> None:
    for number, entry in catalogue().items():
        said = translate("de", f"result 7 is not in the ledger ({entry.action})")
        assert said.startswith("Ergebnis 7 steht nicht in der Buchf\u00fchrung ("), number
        assert entry.action not in said, number


@pytest.mark.parametrize("piece", [": ", "; ", " is ", "a: b; c = d, e (f) of g mm; "])
def test_a_text_that_may_be_read_in_endless_ways_is_read_for_a_while_only(piece: str) -> None:
    hostile = (piece * MAX_LENGTH)[:MAX_LENGTH]
    assert len(translate("de", hostile)) == len(hostile)
    assert translate("de", hostile + "more") == hostile + "more"
