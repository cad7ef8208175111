"""Are the pages that are drawn from the code what the code says?"""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from slabcell.catalogue import catalogue
from slabcell.cell.states import TABLE

pytestmark = pytest.mark.unit

SCRIPT = Path(__file__).parents[2] / "docs" / "generate.py"


@pytest.fixture
def generate() -> ModuleType:
    spec = importlib.util.spec_from_file_location("docs_generate", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_pages_are_what_the_code_says(generate, capsys):
    assert generate.main(["--check"]) == 0, capsys.readouterr().err


def test_a_page_that_differs_is_named(generate, capsys, monkeypatch):
    monkeypatch.setattr(generate, "pages", lambda: {SCRIPT: "something else"})
    assert generate.main(["--check"]) == 1
    assert str(SCRIPT) in capsys.readouterr().err


def test_every_transition_and_every_error_is_on_its_page(generate):
    diagram = generate.state_diagram()
    assert all(f": {row.event}" in diagram for row in TABLE)
    page = generate.errors_page(catalogue().values())
    assert all(f"### {number} " in page for number in catalogue())
