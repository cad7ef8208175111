"""Recipes: the smallest one works, and what is wrong with a file is said with key and remedy."""

from pathlib import Path

import pytest

from slabcell.errors import RecipeError, TemplateError
from slabcell.recipe import load_recipe

pytestmark = pytest.mark.unit

SMALLEST = '[template]\nfile = "slabs.csv"\nthickness_mm = 10.0\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "slabs.csv").write_text("0,0,88,0,88,50,0,50\n")
    return tmp_path


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "r.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_template_and_thickness_are_a_whole_recipe(folder: Path) -> None:
    recipe = load_recipe(write(folder, SMALLEST))
    assert recipe.name == "r"
    assert recipe.thickness_mm == 10.0
    assert len(recipe.template.slots) == 1
    assert recipe.segmentation.method == "auto"


def test_slots_may_have_another_thickness(folder: Path) -> None:
    more = "[[template.other_thickness]]\nslots = [0]\nthickness_mm = 15.0\n"
    recipe = load_recipe(write(folder, SMALLEST + more))
    assert (recipe.thickness_mm, recipe.height_mm(0)) == (10.0, 15.0)
    for slots, words in (("[3]", "slot 3 is none of the template's"), ("[0, 0]", "slot 0 is named twice")):
        with pytest.raises(RecipeError, match=words):
            load_recipe(write(folder, SMALLEST + more.replace("[0]", slots)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (SMALLEST + "[segmentation]\nmetod = 'otsu'\n", "unknown key 'segmentation.metod': did you mean 'method'?"),
        (SMALLEST + "[grasps]\n", "unknown key 'grasps': did you mean 'grasp'?"),
        (SMALLEST + "[segmentation]\nmethod = 'otsi'\n", "segmentation.method = 'otsi'"),
        (SMALLEST + "[matching]\nmin_score = 2\n", "less than or equal to 1"),
        ('[template]\nfile = "slabs.csv"\n', "key 'template.thickness_mm' is missing"),
        ('[template]\nfile = "slabs.csv"\nthickness_mm = "thick"\n', "template.thickness_mm = 'thick'"),
        ("[template\n", "is not TOML"),
        (b"# \xff\n", "r.toml:1: holds a byte that is not UTF-8"),
        (b"#" * (2 << 20), "1 MiB"),
    ],
)
def test_a_fault_is_named_with_file_and_key(folder: Path, text: str | bytes, words: str) -> None:
    with pytest.raises(RecipeError) as caught:
        load_recipe(write(folder, text))
    assert "r.toml" in str(caught.value)
    assert words in str(caught.value)


def test_a_missing_recipe_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match=r"none\.toml: cannot be read"):
        load_recipe(tmp_path / "none.toml")


def test_a_missing_template_is_named(tmp_path: Path) -> None:
    with pytest.raises(TemplateError, match=r"slabs\.csv: cannot be read"):
        load_recipe(write(tmp_path, SMALLEST))
