"""Drawings: which outlines are found in them, what is refused with which place, and that no content breaks it."""

from __future__ import annotations

import io
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from slabcell.cli.template import template_app
from slabcell.errors import TemplateError
from slabcell.recipe import load_recipe
from slabcell.template import load_template, parse_template
from slabcell.template.dxf import Drawing, DrawingOptions, is_drawing, read_drawing
from slabcell.template.dxf_entities import MAX_DEPTH

pytestmark = pytest.mark.unit

RING = [(0.0, 0.0), (100.0, 0.0), (100.0, 50.0), (0.0, 50.0)]


def drawing(*draw: Callable[[Any, Any], object], unit: int = 4, version: str = "R2010") -> bytes:
    """Return a DXF file; each function draws into its model space, with the document beside it."""
    document = ezdxf.new(version)
    document.header["$INSUNITS"] = unit
    for item in draw:
        item(document.modelspace(), document)
    stream = io.StringIO()
    document.write(stream)
    return stream.getvalue().encode(document.output_encoding)


def ring(x: float = 0.0, **attributes: Any) -> Callable[[Any, Any], object]:
    points = [(x + u, v) for u, v in RING]
    return lambda space, _: space.add_lwpolyline(points, close=True, dxfattribs=attributes)


def text(words: str, x: float, y: float) -> Callable[[Any, Any], object]:
    return lambda space, _: space.add_text(words).set_placement((x, y))


def faults(found: Drawing) -> dict[str, str]:
    return {item.kind: item.line for item in found.problems if not item.advice}


def test_a_closed_polyline_is_a_slot_and_says_where_it_was_drawn() -> None:
    found = read_drawing(drawing(ring(layer="STONE")))
    (slot,) = found.slots
    assert not found.problems
    assert slot.layer == "STONE"
    assert slot.handle
    assert np.allclose(slot.points, RING)


@pytest.mark.parametrize(("code", "mm"), [(1, 25.4), (2, 304.8), (4, 1.0), (5, 10.0), (6, 1000.0), (14, 100.0)])
def test_units_are_those_that_the_drawing_names(code: int, mm: float) -> None:
    (slot,) = read_drawing(drawing(ring(), unit=code)).slots
    assert slot.polygon.area_mm2 == pytest.approx(5000.0 * mm * mm)


def test_a_drawing_without_a_unit_is_refused_until_somebody_says_it() -> None:
    raw = drawing(ring(), unit=0)
    assert "$INSUNITS is 0" in faults(read_drawing(raw))["no_unit"]
    (slot,) = read_drawing(raw, DrawingOptions(unit="cm")).slots
    assert slot.polygon.area_mm2 == pytest.approx(500_000.0)


@pytest.mark.parametrize("chord_mm", [0.002, 0.02, 0.5])
@pytest.mark.parametrize("bulge", [0.2, 1.0, 3.0, -0.2])
def test_a_bulge_is_an_arc_that_no_chord_leaves_by_more_than_the_tolerance(bulge: float, chord_mm: float) -> None:
    def draw(space: Any, _: Any) -> None:
        space.add_lwpolyline([(0, 0, 0), (100, 0, bulge), (100, 60, 0), (0, 60, 0)], format="xyb", close=True)

    (slot,) = read_drawing(drawing(draw), DrawingOptions(chord_mm=chord_mm)).slots
    angle = 4 * math.atan(bulge)
    radius = 60.0 / (2 * abs(math.sin(angle / 2)))
    bulging = radius * radius * (abs(angle) - math.sin(abs(angle))) / 2 * math.copysign(1, bulge)
    length = radius * abs(angle)
    assert slot.polygon.area_mm2 == pytest.approx(6000.0 + bulging, abs=chord_mm * length)
    centre = np.array([100 - 30 / math.tan(angle / 2), 30.0])
    on_arc = slot.points[(np.abs(slot.points - [100, 0]).sum(1) < 1e-6).argmax() :]
    away = np.hypot(*(on_arc - centre).T)
    assert np.isclose(away, radius, atol=1e-6).sum() >= 3
    first, second = on_arc[0], on_arc[1]
    assert radius - np.hypot(*((first + second) / 2 - centre)) <= chord_mm + 1e-9


def test_old_polylines_circles_and_curves_are_read() -> None:
    def draw(space: Any, _: Any) -> None:
        space.add_polyline2d([(0, 0, 0), (50, 0, 1), (50, 50, 0), (0, 50, 0)], format="xyb", close=True)
        space.add_circle((200, 25), 25)
        space.add_ellipse((300, 25), (40, 0), 0.5)
        space.add_spline([(400, 0), (450, 0), (450, 50), (400, 50), (400, 0)])

    found = read_drawing(drawing(draw))
    assert not found.problems
    areas = [slot.polygon.area_mm2 for slot in found.slots]
    assert areas[0] == pytest.approx(2500 + math.pi * 625 / 2, rel=2e-3)
    assert areas[1] == pytest.approx(math.pi * 625, rel=2e-3)
    assert areas[2] == pytest.approx(math.pi * 800, rel=2e-3)


@pytest.mark.parametrize("version", ["R12", "R2000", "R2018"])
@pytest.mark.parametrize("seed", range(4))
def test_lines_and_arcs_are_joined_in_any_order_and_direction(seed: int, version: str) -> None:
    shuffle = random.Random(seed)
    pieces = [((0, 0), (100, 0)), ((100.03, 0), (100, 50)), ((25, 50), (100, 50.02)), ((0, 25), (0, 0))]

    def draw(space: Any, _: Any) -> None:
        todo = [*pieces]
        shuffle.shuffle(todo)
        for start, end in todo:
            points = [start, end]
            shuffle.shuffle(points)
            space.add_line(*points)
        space.add_arc((25, 25), 25, 90, 180)

    found = read_drawing(drawing(draw, version=version), DrawingOptions(unit="mm"))
    assert not found.problems
    (slot,) = found.slots
    assert slot.polygon.area_mm2 == pytest.approx(5000 - 625 + math.pi * 625 / 4, abs=6.0)


def test_an_outline_that_stays_open_and_lines_that_branch_are_named_with_their_place() -> None:
    def gap(space: Any, _: Any) -> None:
        space.add_lwpolyline([*RING, (0, 1)], dxfattribs={"layer": "STONE"})

    line = faults(read_drawing(drawing(gap)))["open_chain"]
    assert "on layer STONE" in line
    assert "1.000 mm are missing at (0, 1)" in line
    assert "0.05 mm are closed" in line

    def branch(space: Any, _: Any) -> None:
        for end in ((100, 0), (0, 100), (-50, -50)):
            space.add_line((0, 0), end)

    assert "3 lines meet at (0, 0)" in faults(read_drawing(drawing(branch)))["branch"]


def test_texts_inside_name_the_slots_and_order_them() -> None:
    found = read_drawing(
        drawing(ring(), ring(120), ring(240), text("A10", 10, 10), text("A2", 130, 10), text("A1", 250, 10))
    )
    assert [slot.name for slot in found.slots] == ["A1", "A2", "A10"]
    assert found.slots[0].points[:, 0].min() == pytest.approx(240)
    half = read_drawing(drawing(ring(), ring(120), text("B", 10, 10)))
    assert [slot.name for slot in half.slots] == ["B", ""]


def test_blocks_are_expanded_with_their_attributes_mirrored_and_in_each_other() -> None:
    def draw(space: Any, document: Any) -> None:
        inner = document.blocks.new("SLAB")
        inner.add_lwpolyline([(0, 0, 0), (40, 0, 0.4), (40, 20, 0), (0, 30, 0)], format="xyb", close=True)
        outer = document.blocks.new("PAIR")
        outer.add_blockref("SLAB", (0, 0))
        outer.add_blockref("SLAB", (60, 0), dxfattribs={"rotation": 20})
        space.add_blockref("PAIR", (0, 0), dxfattribs={"layer": "STONE"})
        space.add_blockref("PAIR", (0, 100), dxfattribs={"xscale": -1})
        space.add_blockref("SLAB", (200, 0), dxfattribs={"xscale": 2}).add_attrib("NO", "S7", (205, 5))

    found = read_drawing(drawing(draw))
    assert not found.problems
    areas = sorted(slot.polygon.area_mm2 for slot in found.slots)
    assert len(areas) == 5
    assert np.allclose(areas[:4], areas[0], rtol=1e-6)
    assert areas[4] == pytest.approx(2 * areas[0], rel=2e-3)
    assert [slot.name for slot in found.slots].count("S7") == 1
    assert found.slots[0].layer == "STONE"


def test_thickness_is_the_entitys_own_or_that_of_its_layer() -> None:
    found = read_drawing(
        drawing(ring(thickness=12.0), ring(120, layer="ROOF_8,5MM"), ring(240, layer="ROOF 8.5 mm"), ring(360))
    )
    assert [slot.thickness_mm for slot in found.slots] == [12.0, 8.5, 8.5, None]
    assert found.recipe_text("a.csv").splitlines() == [
        *("[template]", 'file = "a.csv"', "thickness_mm = 8.5"),
        *("", "[[template.other_thickness]]", "slots = [0]", "thickness_mm = 12"),
    ]


def test_layers_that_are_off_are_passed_over_and_layers_can_be_chosen() -> None:
    def hide(_: Any, document: Any) -> None:
        document.layers.add("NOTES").off()

    raw = drawing(ring(layer="STONE"), ring(10, layer="NOTES"), hide)
    assert [slot.layer for slot in read_drawing(raw).slots] == ["STONE"]
    assert [slot.layer for slot in read_drawing(raw, DrawingOptions(layers=("notes",))).slots] == ["NOTES"]
    assert len(read_drawing(drawing(ring(layer="BARE")), DrawingOptions(layers=("bare",))).slots) == 1
    assert "no layer 'ROOF'" in faults(read_drawing(raw, DrawingOptions(layers=("ROOF",))))["no_layer"]


def test_overlaps_frames_and_what_is_no_slab_are_said() -> None:
    overlap = faults(read_drawing(drawing(ring(), ring(90, layer="TWO"))))["overlap"]
    assert "on layer TWO: slot 1 overlaps slot 0 of entity" in overlap
    assert "by 500.0 mm²" in overlap

    def frame(space: Any, _: Any) -> None:
        space.add_lwpolyline([(-10, -10), (110, -10), (110, 60), (-10, 60)], close=True, dxfattribs={"layer": "FRAME"})

    assert "on layer FRAME: the outline encloses 1" in faults(read_drawing(drawing(ring(), frame)))["encloses"]

    def solid(space: Any, _: Any) -> None:
        space.add_lwpolyline([(0, 0), (10, 0), (10, 10)], close=True, dxfattribs={"layer": "STONE"})
        space.add_polyline3d([(200, 0, 0), (300, 0, 5), (300, 50, 0)], close=True)

    assert "height changes by 5 mm" in faults(read_drawing(drawing(solid)))["not_flat"]
    (advice,) = read_drawing(drawing(ring(), lambda space, _: space.add_point((1, 1)))).problems
    assert advice.advice
    assert "POINT (1)" in advice.text
    assert "no closed outline" in faults(read_drawing(drawing()))["no_outline"]


def test_blocks_in_themselves_and_blocks_of_many_copies_are_bounded() -> None:
    def loop(space: Any, document: Any) -> None:
        block = document.blocks.new("LOOP")
        block.add_blockref("LOOP", (1, 0))
        space.add_blockref("LOOP", (0, 0))

    assert set(faults(read_drawing(drawing(loop)))) == {"too_deep"}

    def tower(space: Any, document: Any) -> None:
        below = ""
        for level in range(MAX_DEPTH):
            block = document.blocks.new(f"L{level}")
            for x in range(10):
                block.add_blockref(below, (x, 0)) if below else block.add_line((0, 0), (1, 1))
            below = f"L{level}"
        space.add_blockref(below, (0, 0))

    assert "20000 entities" in faults(read_drawing(drawing(tower)))["too_many_entities"]

    def barren(space: Any, document: Any) -> None:
        below = ""
        for level in range(60):  # no entity but insertions that cannot be insertions after they were transformed
            block = document.blocks.new(f"B{level}")
            for x in range(2 if below else 0):
                block.add_blockref(below, (x, 0), dxfattribs={"rotation": 30})
            below = f"B{level}"
        space.add_blockref(below, (0, 0), dxfattribs={"xscale": 2})

    assert "blocks stand in blocks" in faults(read_drawing(drawing(barren)))["too_deep"]

    def grid(space: Any, document: Any) -> None:
        document.blocks.new("ONE").add_line((0, 0), (1, 1))
        space.add_blockref(
            "ONE",
            (0, 0),
            dxfattribs={"row_count": 32_000, "column_count": 32_000, "row_spacing": 1, "column_spacing": 1},
        )

    assert "20000 entities" in faults(read_drawing(drawing(grid)))["too_many_entities"]


@pytest.mark.parametrize(
    ("raw", "kind"),
    [
        (b"AutoCAD Binary DXF\r\n\x1a\x00", "binary_dxf"),
        (b"AC1027\0\0\0", "dwg"),
        (b"0,0,50,0,50,50\n", "not_dxf"),
        (b"", "not_dxf"),
        (b"  0\nSECTION\n  2\nENTITIES\n  0\nLINE\n 10\nx\n", "not_dxf"),
        (b"0\nSECTION\n" + b"\0" * (9 << 20), "too_large"),
    ],
)
def test_what_is_no_drawing_is_refused_with_the_remedy(raw: bytes, kind: str) -> None:
    assert set(faults(read_drawing(raw))) & {kind, "no_unit"}


coordinates = st.floats(-1e4, 1e4) | st.sampled_from([0.0, 1e300, -1e-300])
points = st.lists(st.tuples(coordinates, coordinates, st.floats(-5, 5)), max_size=8)
GOOD = drawing(ring(), ring(120), text("A", 5, 5), lambda space, _: space.add_circle((300, 0), 20))


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(points, max_size=4), st.booleans(), st.sampled_from([0, 1, 4, 6, 21, 99]))
def test_any_polylines_give_a_drawing_or_problems(lines: list[list[tuple[float, ...]]], close: bool, unit: int) -> None:
    def draw(space: Any, _: Any) -> None:
        for line in lines:
            space.add_lwpolyline(line, format="xyb", close=close)

    check(drawing(draw, unit=unit))


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_any_damage_gives_a_drawing_or_problems(data: st.DataObject) -> None:
    rows = GOOD.split(b"\n")
    start = rows.index(b"ENTITIES")
    for _ in range(data.draw(st.integers(1, 5))):
        line = data.draw(st.integers(start, len(rows) - 1) | st.integers(0, len(rows) - 1))
        rows[line : line + data.draw(st.integers(0, 2))] = data.draw(
            st.lists(
                st.sampled_from([b"0", b" 10", b"1e999", b"nan", b"INSERT", b"-1", b"POLYLINE"])
                | st.binary(max_size=6),
                max_size=2,
            )
        )
    check(b"\n".join(rows))


def check(raw: bytes) -> None:
    found = read_drawing(raw)
    for item in found.problems:
        assert item.line
    if faults(found):
        return
    assert found.slots
    again = parse_template(found.csv("fuzz.dxf"), "again.csv")
    assert len(again.slots) == len(found.slots)


sides = st.floats(5.0, 900.0)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(sides, sides, st.text(max_size=80)), min_size=1, max_size=6))
def test_what_is_imported_reads_back_as_it_was_drawn(sizes: list[tuple[float, float, str]]) -> None:
    def draw(space: Any, _: Any) -> None:
        for number, (width, height, _name) in enumerate(sizes):
            x = 1000.0 * number
            space.add_lwpolyline([(x, 0), (x + width, 0), (x + width, height), (x, height)], close=True)

    found = read_drawing(drawing(draw))
    named = [
        type(slot)(slot.polygon, name, slot.layer, slot.handle, None)
        for slot, (*_, name) in zip(found.slots, sizes, strict=True)
    ]
    raw = Drawing(tuple(named), "mm", ()).csv("line\nbreak.dxf")
    again = parse_template(raw, "again.csv")
    for slot, back in zip(found.slots, again.slots, strict=True):
        assert np.allclose(slot.points, back.vertices, atol=6e-5)
    assert all("\n" not in name and len(name) <= 60 for name in again.names)


def test_the_command_writes_a_template_that_a_recipe_can_name(tmp_path: Path) -> None:
    file, out = tmp_path / "roof.dxf", tmp_path / "roof.csv"
    file.write_bytes(drawing(ring(layer="S_10mm"), ring(120, layer="S_10mm"), text("A", 5, 5), text("B", 130, 5)))
    runner = CliRunner()
    done = runner.invoke(template_app, ["import", str(file), "--out", str(out)], catch_exceptions=False)
    assert done.exit_code == 0
    template = load_template(out)
    assert template.names == ("A", "B")
    (tmp_path / "roof.toml").write_text(done.output[done.output.index("[template]") :])
    assert load_recipe(tmp_path / "roof.toml").thickness_mm == 10.0
    assert runner.invoke(template_app, ["check", str(file), "--json"], catch_exceptions=False).exit_code == 0
    (tmp_path / "wrong.toml").write_text('[template]\nfile = "roof.dxf"\nthickness_mm = 10\n')
    with pytest.raises(TemplateError, match="slabcell template import"):
        load_recipe(tmp_path / "wrong.toml")


def test_drawings_are_told_from_csv_by_their_beginning() -> None:
    assert is_drawing(GOOD)
    assert is_drawing(b"AC1032")
    assert not is_drawing(b"0,0,50,0,50,50\n")
    assert not is_drawing(b"0\n")
