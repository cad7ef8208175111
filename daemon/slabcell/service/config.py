"""What is this cell made of?  Its configuration: camera, robot, table, files; one TOML file, `cell.toml`.

Configuration is of one cell; a calibration is of one camera in one place; a recipe is of one product.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from slabcell.errors import ConfigurationError
from slabcell.service.krl_config import KrlConfig
from slabcell.toml_file import TomlTable, read_toml
from slabcell_drivers.robot import Frame

__all__ = ["CameraConfig", "CellConfig", "EkiConfig", "FrameConfig", "RobotConfig", "TableConfig", "load_config"]

Millimetres = Annotated[float, Field(ge=-20_000, le=20_000)]
Degrees = Annotated[float, Field(ge=-360, le=360)]
Seconds = Annotated[float, Field(gt=0, le=600)]
Point = tuple[Millimetres, Millimetres]


class FrameConfig(TomlTable):
    """A KUKA frame; what is left out is zero."""

    x_mm: Millimetres = 0.0
    y_mm: Millimetres = 0.0
    z_mm: Millimetres = 0.0
    a_deg: Degrees = 0.0
    b_deg: Degrees = 0.0
    c_deg: Degrees = 0.0

    def to_frame(self) -> Frame:
        """Return the same pose as the drivers know it."""
        return Frame(self.x_mm, self.y_mm, self.z_mm, self.a_deg, self.b_deg, self.c_deg)

    @classmethod
    def from_frame(cls, frame: Frame) -> FrameConfig:
        """Return the same pose as the configuration writes it."""
        x, y, z, a, b, c = frame.as_tuple()
        return cls(x_mm=x, y_mm=y, z_mm=z, a_deg=a, b_deg=b, c_deg=c)


class CameraConfig(TomlTable):
    """``[camera]``: where pictures come from."""

    driver: Literal["simulated", "replay"] = Field(description="how the camera is reached")
    images: Path | None = Field(default=None, description="folder of pictures, for driver replay")
    timeout_s: Seconds = Field(default=2.0, description="a frame later than this is a camera fault")


class EkiConfig(TomlTable):
    """``[robot.eki]``: the address at which the cell waits for the robot controller."""

    host: str = Field(default="127.0.0.1", max_length=253, description="address to listen on")
    port: Annotated[int, Field(ge=0, le=65_534)] = Field(default=54_610, description="TCP port; 0 lets the host choose")


class RobotConfig(TomlTable):
    """``[robot]``: the arm, its tool and its bases as they are taught on the controller."""

    model: Literal["kr3r540", "kr6r900"] = Field(default="kr3r540", description="which arm")
    eki: EkiConfig = EkiConfig()
    krl: KrlConfig = KrlConfig()
    tool: FrameConfig = Field(description="TOOL_DATA of the suction cup: flange to cup")
    pick_base: FrameConfig = Field(description="BASE_DATA of the table, in the robot's root frame")
    place_base: FrameConfig = Field(description="BASE_DATA of the assembly, in the robot's root frame")


class TableConfig(TomlTable):
    """``[table]``: where slabs are looked for."""

    pick_area: list[Point] = Field(min_length=3, max_length=100, description="polygon in table coordinates, mm")


class CellConfig(TomlTable):
    """The whole file."""

    name: str = Field(default="cell", min_length=1, max_length=60, description="what people call this cell")
    recipe: Path = Field(description="the product: a recipe file, relative to this file")
    calibration: Path | None = Field(default=None, description="of this camera in this place, relative to this file")
    state_directory: Path | None = Field(
        default=None, description="where ledger and bundles are kept; the default is systemd's STATE_DIRECTORY"
    )
    camera: CameraConfig
    robot: RobotConfig
    table: TableConfig


def load_config(path: Path) -> CellConfig:
    """Return the checked configuration; files named in it are taken relative to it.  Raises ConfigurationError."""
    config = read_toml(path, CellConfig, ConfigurationError)
    here = path.parent
    return config.model_copy(
        update={
            "recipe": here / config.recipe,
            "calibration": here / config.calibration if config.calibration else None,
            "camera": config.camera.model_copy(
                update={"images": here / config.camera.images if config.camera.images else None}
            ),
        }
    )
