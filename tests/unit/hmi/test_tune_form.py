"""The form of a recipe is that of its schema, with units, ranges and help, in every language."""

import pytest

from slabcell.hmi.pages.tune.form import TABLES, field_words, form_fields, keys_of, option_words
from slabcell.service.recipe_schema import recipe_schema

pytestmark = pytest.mark.unit


def test_every_parameter_has_its_words_in_german_and_none_is_left_over() -> None:
    schema = recipe_schema()
    keys = {key for table in TABLES for key in keys_of(form_fields(schema, table, "de"))}
    words = dict(field_words("de"))
    choices = option_words([field for table in TABLES for field in form_fields(schema, table, "de")], "de")
    assert words.pop("options").keys() <= choices.keys()
    assert words.keys() == keys
    assert all(said.keys() == {"label", "help"} for said in words.values())
    assert set(field_words("en")) <= keys


def test_the_form_says_units_ranges_and_help_of_the_schema() -> None:
    known = {item.key: item for item in form_fields(recipe_schema(), "matching", "en")}
    residual = known["matching.max_residual_mm"]
    assert (residual.label, residual.unit, residual.minimum, residual.above, residual.maximum) == (
        *("Max residual", "mm", 0, True, 50),
    )
    assert "root mean square distance" in residual.help
    fields = {item.key: item for item in form_fields(recipe_schema(), "segmentation", "de")}
    assert (fields["segmentation.roi"].kind, fields["segmentation.roi"].least) == ("points", 3)
    assert fields["segmentation.threshold"].optional
    assert [item.key for item in fields["segmentation.morphology"].fields] == [
        "segmentation.morphology.operation",
        "segmentation.morphology.size_px",
    ]
