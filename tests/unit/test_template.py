"""Templates: what is read, and what is refused with which place."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slabcell.errors import TemplateError
from slabcell.geometry import Polygon
from slabcell.template import load_template, parse_template

pytestmark = pytest.mark.unit

SQUARE = "0,0,50,0,50,50,0,50"


def problems(text: str | bytes) -> tuple[str, ...]:
    raw = text if isinstance(text, bytes) else text.encode()
    with pytest.raises(TemplateError) as caught:
        parse_template(raw, "t.csv")
    return caught.value.problems


@pytest.mark.parametrize(
    "text",
    [
        SQUARE,
        "\ufeff" + SQUARE,
        "# laid from the left\n\n" + SQUARE + "\r\n\r\n",
        "0;0;50;0;50;50;0;50",
        "0\t0\t50\t0\t50\t50\t0\t50",
        "0,0;0,0;50,0;0;50;50,0;0;5,0e1",
        SQUARE + ",,,,",
        '"0","0","50","0","50","50","0","50"\r',
        " 0 , 0 , 50 , 0 , 50 , 50 , 0 , 50 ",
        "0,0,0,50,50,50,50,0",  # clockwise
    ],
)
def test_a_square_is_read_however_a_spreadsheet_writes_it(text: str) -> None:
    template = parse_template(text.encode(), "t.csv")
    assert len(template.slots) == 1
    assert template.slots[0].area_mm2 == pytest.approx(2500.0)
    assert np.allclose(template.slots[0].centroid, 25.0)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        (SQUARE + ",7", "t.csv:1: column 9 (I)", "odd"),
        ("0,0,50,x,50,50", "t.csv:1: column 4 (D)", "'x' is not a number"),
        ("0,0,50,nan,50,50", "t.csv:1: column 4 (D)", "not a number"),
        ("0,0,50,1e999,50,50", "t.csv:1: column 4 (D)", "too large"),
        ("0,0,50,,50,50", "t.csv:1: column 4 (D)", "empty"),
        ("# a\n\n0,0,50,0", "t.csv:3: column 4 (D)", "at least 3"),
        ("0,0,50,50,50,0,0,50", "t.csv:1: column", "crosses or touches itself"),
        ("0,0,50,0,100,0", "t.csv:1: column", ""),
        ("0,0,50,0,50,50,50,0,0,50", "t.csv:1: column 7 (G)", "duplicate point (50, 0), the same as point 2"),
        (SQUARE + ",0,0", "t.csv:1: column 9 (I)", "closes by itself"),
        (SQUARE + "\n40,0,90,0,90,50,40,50", "t.csv:2: column 1 (A)", "overlaps slot 0 of line 1 by 500.0 mm²"),
        ("0,0,0.088,0,0.088,0.05,0,0.05", "t.csv: all slots", "metres"),
        ("0,0,88000,0,88000,50000,0,50000", "t.csv: all slots", "micrometres"),
        (SQUARE + "\n60,0,60.02,0,60.02,0.02,60,0.02", "t.csv:2: column 1", "metres among millimetres"),
        ("", "t.csv:", "holds no polygon"),
        (SQUARE + "\n0;60;50;60;50;90", "t.csv:2: column 1 (A)", "separate the cells as the file's first line does"),
        (SQUARE + "\n1,\0,2", "t.csv:2:", "NUL"),
        (b"0,0,50,0,\xff,50", "t.csv:1: byte 10", "UTF-8"),
    ],
)
def test_a_fault_is_named_with_file_line_and_column(text: str | bytes, place: str, words: str) -> None:
    found = problems(text)
    assert found[0].startswith(place)
    assert words in found[0]


def test_every_fault_of_a_file_is_reported_at_once() -> None:
    assert len(problems("0,0,1\nx,0,1,0,1,1\n0,0,50,0")) == 3


def test_neighbours_that_share_an_edge_do_not_overlap() -> None:
    template = parse_template(f"{SQUARE}\n50,0,138,0,138,50,50,50\n49.99,50,138,50,138,90,49.99,90".encode(), "t.csv")
    assert len(template.slots) == 3


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TemplateError, match=r"none\.csv: cannot be read"):
        load_template(tmp_path / "none.csv")


def test_a_file_that_is_no_template_by_its_size_is_not_parsed() -> None:
    assert "8 MiB" in problems(b"0,0," * (3 << 20))[0]


@given(st.binary(max_size=400) | st.text(alphabet="0123456789.,;\t-+eE\n #x\"'\ufeff", max_size=400).map(str.encode))
def test_any_bytes_give_a_template_or_a_template_error(raw: bytes) -> None:
    problems: tuple[str, ...] = ()
    slots: tuple[Polygon, ...] = ()
    try:
        slots = parse_template(raw, "t.csv").slots
    except TemplateError as error:
        problems = error.problems
    assert all(problem.startswith("t.csv") for problem in problems)
    assert all(slot.area_mm2 > 0 for slot in slots)
    assert bool(slots) != bool(problems)
