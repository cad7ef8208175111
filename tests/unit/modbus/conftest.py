"""The shipped register map, and the same with another layout."""

import itertools
from pathlib import Path

import pytest

from slabcell_drivers.robot.modbus import Layout, Order, load_map

FILE = Path(__file__).parents[3] / "config" / "modbus_map.toml"


@pytest.fixture(scope="session")
def map_text():
    return FILE.read_text("utf-8")


@pytest.fixture(scope="session")
def shipped():
    return load_map(FILE)


@pytest.fixture(
    scope="session",
    params=[(*orders, offset) for orders, offset in zip(itertools.product(Order, Order), (0, -0, 100, 7), strict=True)],
    ids=lambda layout: "-".join(map(str, layout)),
)
def any_map(request):
    word_order, byte_order, offset = request.param
    return load_map(FILE, Layout(1, offset, word_order, byte_order))
