from dataclasses import fields
from pathlib import Path

import pytest

from slabcell_drivers.simulation.scene import BoardSpec, CameraSpec, GripperSpec, Optics, SlabSpec, TableSpec
from slabcell_drivers.simulation.surfaces import Surface

pytestmark = pytest.mark.unit

PAGE = (Path(__file__).parents[3] / "docs" / "reference" / "scenes.md").read_text()


@pytest.mark.parametrize("kind", [TableSpec, CameraSpec, Optics, GripperSpec, BoardSpec, SlabSpec])
def test_every_key_of_a_scene_file_is_on_its_page(kind: type) -> None:
    prefix = {GripperSpec: "gripper.", BoardSpec: "board."}.get(kind, "")

    missing = [field.name for field in fields(kind) if f"`{prefix}{field.name}`" not in PAGE]

    assert not missing


def test_every_surface_is_on_the_page() -> None:
    assert all(f"`{surface}`" in PAGE for surface in Surface)
