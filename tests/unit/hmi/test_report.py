"""The report page: self-contained, and nothing from outside gets into it unescaped."""

from typing import Any

import pytest

from slabcell.hmi.report import render_report

pytestmark = pytest.mark.unit

PNG = b"\x89PNG\r\n\x1a\n"


def document(**changes: Any) -> dict[str, Any]:
    base: dict[str, Any] = {
        "version": "1.2.3",
        "scene": "dresden",
        "seed": 5,
        "ok": True,
        "failures": [],
        "limits": {"position_mm": 0.5, "angle_deg": 0.5},
        "worst": {"position_mm": 0.01, "angle_deg": 0.02},
        "slots": [{"slot": 0, "filled": True, "score": 1.0, "dx_mm": 0.001, "dy_mm": -0.002, "dtheta_deg": 0.0}],
        "stages": ["acquire", "total"],
        "cycles": [{"cycle": 1, "timing_ms": {"acquire": 1.0, "total": 2.5}}],
    }
    return base | changes


def test_a_good_run_shows_the_worst_error_and_no_colour_class() -> None:
    page = render_report(document(), {"Before": PNG})
    assert "0.010 mm" in page
    assert "+0.001" in page
    assert 'class="verdict"' in page
    assert "data:image/png;base64," in page


def test_a_bad_run_says_so_in_words_beside_the_colour() -> None:
    slots = [{"slot": 3, "filled": False, "score": None, "dx_mm": None, "dy_mm": None, "dtheta_deg": None}]
    page = render_report(document(ok=False, failures=["slot 3 is not filled"], slots=slots), {})
    assert "✗ slot 3 is not filled" in page
    assert 'class="verdict bad"' in page


def test_text_from_outside_is_escaped() -> None:
    page = render_report(document(scene="<script>alert(1)</script>"), {"<b>": PNG})
    assert "<script>" not in page
    assert "<b>" not in page


def test_the_page_asks_nothing_of_the_network() -> None:
    page = render_report(document(), {"Before": PNG})
    assert "http" not in page.replace("http-equiv", "")
    assert "default-src 'none'" in page
