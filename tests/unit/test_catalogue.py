"""Is the error catalogue complete, and does a damaged one say what is wrong with it?"""

import pytest

from slabcell.catalogue import CatalogueError, Fault, catalogue, entry, parse_catalogue

pytestmark = pytest.mark.unit

GOOD = """
schema = "slabcell.errors/1"
[1101]
name = "CAMERA_LOST"
category = "camera"
title = "Camera lost"
robot = "1101 Camera lost"
meaning = "It is gone."
action = "Find it."
clears = "itself"
priority = "high"
"""


def test_every_number_has_the_name_that_the_code_uses():
    assert {number: item.name for number, item in catalogue().items()} == {int(fault): fault.name for fault in Fault}


def test_the_robot_shows_each_number_in_at_most_eighty_ascii_characters():
    for number, item in catalogue().items():
        assert item.robot.isascii()
        assert len(item.robot) <= 80
        assert item.robot.startswith(f"{number} ")


def test_numbers_rise_and_their_hundreds_are_their_category():
    numbers = list(catalogue())
    assert numbers == sorted(numbers)
    categories = {number // 100: item.category for number, item in catalogue().items()}
    assert all(categories[number // 100] == item.category for number, item in catalogue().items())
    assert len(set(categories.values())) == len(categories)


def test_a_number_that_nobody_knows_is_an_internal_error():
    assert entry(4711).number == Fault.INTERNAL


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('clears = "itself"', 'clears = "never"', "never"),
        ('robot = "1101 Camera lost"', 'robot = "1101 Kamera weg – prüfen"', "ASCII"),
        ('robot = "1101 Camera lost"', f'robot = "{"x" * 81}"', "80"),
        ('meaning = "It is gone."', 'meaning = ""', "none of them empty"),
        ('action = "Find it."', "", "exactly the keys"),
        ("[1101]", "[camera]", "not a number's table"),
        ("slabcell.errors/1", "slabcell.errors/9", "schema"),
        ("[1101]", "[1101", "not TOML"),
    ],
)
def test_a_damaged_catalogue_is_refused_with_the_place(before, after, said):
    assert before in GOOD
    with pytest.raises(CatalogueError, match=said):
        parse_catalogue(GOOD.replace(before, after))
