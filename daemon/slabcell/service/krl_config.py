"""What do the robot's own programs need to know of this cell?  ``[robot.krl]`` of the cell's configuration."""

from typing import Annotated

from pydantic import Field

from slabcell.toml_file import TomlTable

__all__ = ["KrlConfig"]

_Address = Annotated[str, Field(pattern=r"^[0-9]{1,3}(\.[0-9]{1,3}){3}$")]
_Signal = Annotated[int, Field(ge=1, le=4096)]
_Angle = Annotated[float, Field(ge=-360, le=360)]


class KrlConfig(TomlTable):
    """``[robot.krl]``: numbers that `slabcell krl export` fills into the programs."""

    cell_ip: _Address | None = Field(
        default=None, description="address of this PC as the robot sees it; the default is [robot.eki] host"
    )
    robot_ip: _Address = Field(default="192.168.1.147", description="the controller's address on its KLI")
    robot_port: Annotated[int, Field(ge=54_600, le=54_615)] = Field(
        default=54_600, description="port that the controller opens, where the cell connects to the robot"
    )
    robot_connects: bool = Field(default=True, description="the robot connects to the cell; false: the other way round")
    prefix: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9]{0,5}$")] = Field(
        default="VT", description="first part of the link's KRL names, against clashes with installed packages"
    )
    tool_number: Annotated[int, Field(ge=1, le=16)] = Field(default=1, description="TOOL_DATA[] of the suction cup")
    pick_base_number: Annotated[int, Field(ge=1, le=32)] = Field(default=1, description="BASE_DATA[] of the table")
    place_base_number: Annotated[int, Field(ge=1, le=32)] = Field(default=2, description="BASE_DATA[] of the assembly")
    vacuum_output: _Signal = Field(default=1, description="$OUT[] that turns the suction on")
    vacuum_input: _Signal = Field(default=1, description="$IN[] that says that a part is held")
    blow_output: Annotated[int, Field(ge=0, le=4096)] = Field(default=0, description="$OUT[] of the blow-off, 0 = none")
    approach_mm: Annotated[float, Field(gt=0, le=1000)] = Field(default=80.0, description="height above pick and place")
    photo_axes_deg: tuple[_Angle, _Angle, _Angle, _Angle, _Angle, _Angle] = Field(
        default=(120.0, -90.0, 90.0, 0.0, 90.0, 0.0), description="photo position: the arm outside of the picture"
    )
