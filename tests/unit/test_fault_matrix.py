"""Has every row of the fault matrix a test and a number that are there, and every fault test a row?"""

import ast
import tomllib
from pathlib import Path

import pytest

from slabcell.catalogue import catalogue

pytestmark = pytest.mark.unit

TESTS = Path(__file__).parents[1]
ROWS = tomllib.loads((TESTS.parent / "docs" / "reference" / "faults.toml").read_text())["row"]


def names_below(folder: Path) -> set[str]:
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    trees = (ast.parse(path.read_text()) for path in folder.rglob("test_*.py"))
    return {node.name for tree in trees for node in ast.walk(tree) if isinstance(node, kinds)}


@pytest.fixture(scope="module")
def there() -> set[str]:
    return {name for name in names_below(TESTS) if name.startswith("test_")}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["fault"])
def test_a_row_has_tests_and_numbers_that_are_there(row, there):
    assert set(row) == {"fault", "notices", "does", "numbers", "tests"}
    assert row["tests"], "a row without a test"
    assert set(row["tests"]) <= there, f"not there: {sorted(set(row['tests']) - there)}"
    assert set(row["numbers"]) <= set(catalogue())


def test_every_fault_test_stands_in_a_row():
    named = {test for row in ROWS for test in row["tests"]}
    found = {name for name in names_below(TESTS / "faults") if name.startswith("test_")}
    assert found <= named, f"without a row: {sorted(found - named)}"


def test_no_fault_stands_twice():
    faults = [row["fault"] for row in ROWS]
    assert len(faults) == len(set(faults))
