"""What is this cell made of?  Its configuration: camera, robot, table, files; one TOML file, `cell.toml`.

Configuration is of one cell; a calibration is of one camera in one place; a recipe is of one product.  How files,
drop-ins and environment become one configuration is in `config_layers`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

import shapely
from pydantic import AfterValidator, Field, model_validator

from slabcell.service.hmi_config import HmiConfig
from slabcell.service.krl_config import KrlConfig
from slabcell.service.light_config import LightConfig
from slabcell.service.modbus_config import ModbusConfig
from slabcell.toml_file import TomlTable
from slabcell_drivers.camera.settings import MIN_HEARTBEAT_MS, CameraSettings
from slabcell_drivers.robot import Frame

__all__ = [
    "ApiConfig",
    "BundlesConfig",
    "CameraConfig",
    "CellConfig",
    "EkiConfig",
    "FrameConfig",
    "PlanningConfig",
    "RobotConfig",
    "TableConfig",
    "VerificationConfig",
]

Millimetres = Annotated[float, Field(ge=-20_000, le=20_000)]
Degrees = Annotated[float, Field(ge=-360, le=360)]
Seconds = Annotated[float, Field(gt=0, le=600)]
Point = tuple[Millimetres, Millimetres]


def _one_area(points: list[Point]) -> list[Point]:
    """Return the corners of one area.  Raises ValueError: of an outline that crosses itself nobody knows the inside."""
    shape = shapely.Polygon(points)
    if not shape.is_valid:
        msg = f"is no simple polygon: {shapely.is_valid_reason(shape)}; give its corners in order, around it once"
        raise ValueError(msg)
    return points


Area = Annotated[list[Point], Field(min_length=3, max_length=100), AfterValidator(_one_area)]
"""Corners of a polygon, in order around it; the first is not repeated."""


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
    """``[camera]``: where pictures come from, and how the camera is set; what is left out stays as it is there."""

    driver: Literal["aravis", "harvesters", "replay", "simulated"] = Field(description="how the camera is reached")
    camera: str = Field(
        default="", max_length=100, description="IPv4 address or serial number, for drivers aravis and harvesters"
    )
    producers: list[Path] = Field(
        default=[], max_length=10, description="GenTL producers (.cti) for driver harvesters; empty: the environment's"
    )
    images: Path | None = Field(default=None, description="folder of pictures, for driver replay")
    timeout_s: Seconds = Field(default=2.0, description="a frame later than this is a camera fault")
    exposure_us: Annotated[float, Field(gt=0, le=10_000_000)] | None = Field(default=None, description="exposure time")
    gain_db: Annotated[float, Field(ge=-40, le=60)] | None = Field(default=None, description="gain")
    pixel_format: str | None = Field(default=None, max_length=40, description="GenICam name, such as Mono8")
    packet_size: Annotated[int, Field(ge=576, le=16_000)] | None = Field(
        default=None, description="bytes in a packet; the default is the largest that passes"
    )
    packet_delay_ns: Annotated[int, Field(ge=0, le=10_000_000)] | None = Field(
        default=None, description="pause between packets"
    )
    heartbeat_ms: Annotated[int, Field(ge=MIN_HEARTBEAT_MS, le=60_000)] = Field(
        default=3000, description="after this long without us the camera is free for others"
    )

    @model_validator(mode="after")
    def _names_its_camera(self) -> Self:
        if self.driver in ("aravis", "harvesters") and not self.camera:
            msg = f'driver {self.driver} needs camera = "ADDRESS OR SERIAL"; `slabcell camera list` shows them'
            raise ValueError(msg)
        if self.driver == "replay" and self.images is None:
            msg = "driver replay needs images = FOLDER"
            raise ValueError(msg)
        return self

    def settings(self) -> CameraSettings:
        """Return what the drivers of real cameras are told."""
        return CameraSettings(
            pixel_format=self.pixel_format,
            exposure_us=self.exposure_us,
            gain_db=self.gain_db,
            packet_size=self.packet_size,
            packet_delay_ns=self.packet_delay_ns,
            heartbeat_ms=self.heartbeat_ms,
        )


class EkiConfig(TomlTable):
    """``[robot.eki]``: the address at which the cell waits for the robot controller."""

    host: str = Field(default="127.0.0.1", max_length=253, description="address to listen on")
    port: Annotated[int, Field(ge=0, le=65_534)] = Field(default=54_610, description="TCP port; 0 lets the host choose")


class RobotConfig(TomlTable):
    """``[robot]``: the arm, its tool and its bases as they are taught on the controller."""

    model: Literal["kr3r540", "kr6r900"] = Field(default="kr3r540", description="which arm")
    link: Literal["eki", "modbus-tcp", "modbus-rtu"] = Field(
        default="eki", description="eki: the robot controller itself; modbus: a PLC or gateway in between"
    )
    eki: EkiConfig = EkiConfig()
    modbus: ModbusConfig = ModbusConfig()
    krl: KrlConfig = KrlConfig()
    tool: FrameConfig = Field(description="TOOL_DATA of the suction cup: flange to cup")
    gripper_radius_mm: Annotated[float, Field(gt=0, le=1000)] = Field(
        default=10.0, description="of what is lowered beside other slabs"
    )
    pick_base: FrameConfig = Field(description="BASE_DATA of the table, in the robot's root frame")
    place_base: FrameConfig = Field(description="BASE_DATA of the assembly, in the robot's root frame")


class TableConfig(TomlTable):
    """``[table]``: where slabs are looked for."""

    pick_area: Area = Field(description="polygon in table coordinates, mm")
    forbidden: list[Area] = Field(
        default=[],
        max_length=50,
        description="polygons in table coordinates into which neither tool nor slab is lowered, mm",
    )


class PlanningConfig(TomlTable):
    """``[planning]``: what is tried, and for how long."""

    attempts_per_slot: Annotated[int, Field(ge=1, le=100)] = Field(
        default=3, description="after so many failures a slot is left out until a person has looked"
    )
    vision_timeout_s: Seconds = Field(default=10.0, description="a picture that takes longer gives no result")


class VerificationConfig(TomlTable):
    """``[verification]``: how laid slabs must lie."""

    tolerance_mm: Annotated[float, Field(gt=0, le=100)] = Field(
        default=0.5, description="largest offset in x or y before alarm 1901 comes"
    )
    tolerance_deg: Annotated[float, Field(gt=0, le=180)] = Field(default=0.5, description="the same for the angle")
    check_assembly_is_empty: bool = Field(
        default=True, description="before a job begins, see that nothing lies in its slots"
    )
    correct_systematic: bool = Field(
        default=False, description="lay a job the other way by what the last one was off as a whole"
    )


class BundlesConfig(TomlTable):
    """``[bundles]``: for how long cycles are kept."""

    max_mib: Annotated[int, Field(ge=0, le=1 << 24)] = Field(default=4096, description="of cycles that went well")
    max_days: Annotated[float, Field(gt=0, le=36_500)] = Field(default=30.0, description="of cycles that went well")
    failures_max_mib: Annotated[int, Field(ge=0, le=1 << 24)] = Field(default=4096, description="of those that failed")
    failures_max_days: Annotated[float, Field(gt=0, le=36_500)] = Field(
        default=365.0, description="of those that failed"
    )
    min_free_mib: Annotated[int, Field(ge=0, le=1 << 24)] = Field(
        default=512, description="with less room on the disk nothing is kept"
    )


class ApiConfig(TomlTable):
    """``[api]``: the control API, for `slabcell status` and its like, the HMI, and other programs."""

    socket: Path | None = Field(
        default=None,
        description="Unix socket; the default is api.sock in systemd's RUNTIME_DIRECTORY, else in the state directory",
    )
    group: Annotated[str, Field(pattern=r"^[a-z_][a-z0-9_-]{0,31}$")] | None = Field(
        default=None, description="group whose members may use the API; the default is the daemon's own"
    )
    event_clients: Annotated[int, Field(ge=1, le=32)] = Field(
        default=16, description="so many clients may listen to events at once"
    )


class CellConfig(TomlTable):
    """The whole file."""

    name: str = Field(default="cell", min_length=1, max_length=60, description="what people call this cell")
    recipe: Path = Field(description="the product: a recipe file, relative to this file")
    calibration: Path | None = Field(default=None, description="of this camera in this place, relative to this file")
    state_directory: Path | None = Field(
        default=None, description="where ledger and bundles are kept; the default is systemd's STATE_DIRECTORY"
    )
    camera: CameraConfig
    light: LightConfig | None = None
    robot: RobotConfig
    table: TableConfig
    planning: PlanningConfig = PlanningConfig()
    verification: VerificationConfig = VerificationConfig()
    bundles: BundlesConfig = BundlesConfig()
    api: ApiConfig = ApiConfig()
    hmi: HmiConfig = HmiConfig()
