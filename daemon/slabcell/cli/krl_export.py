"""`slabcell krl export`: which files go onto this cell's controller?"""

import dataclasses
import json
import re
import socket
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated

import typer

from slabcell.cli.files import write_file
from slabcell.errors import ConfigurationError
from slabcell.service.config import CellConfig
from slabcell.service.config_layers import load_config
from slabcell_drivers.robot.eki.export import ExportError, ExportSettings, export_files
from slabcell_drivers.robot.eki.schema import CHANNEL

__all__ = ["export_command", "export_settings", "shipped_programs"]

_IPV4 = re.compile(r"[0-9]{1,3}(\.[0-9]{1,3}){3}")


def export_command(
    out: Annotated[Path, typer.Option("--out", help="Folder to write; made if it is not there")],
    config: Annotated[Path, typer.Option("--config", help="The cell's configuration")] = Path("cell.toml"),
    prefix: Annotated[
        str | None, typer.Option("--prefix", help="Other first part of the link's names, against clashes")
    ] = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write the robot programs and the EKI channel of this cell, ready for WorkVisual and for a USB stick."""
    settings = export_settings(load_config(config), config, prefix)
    try:
        exported = export_files(shipped_programs(), settings)
    except ExportError as error:
        msg = f"{config}: {error}"
        raise ConfigurationError(msg) from error
    for path, raw in exported.items():
        write_file(out / path, raw)
    if as_json:
        document = {"schema": "slabcell.krl-export/1", "out": str(out), "files": [str(path) for path in exported]}
        typer.echo(json.dumps(document))
    else:
        typer.echo(f"{out}: {len(exported)} files written; README.txt there says what goes where")


def shipped_programs() -> dict[str, str]:
    """Return the programs as they are shipped: path below ``krl/`` to text."""
    return dict(_texts(files("slabcell") / "data" / "krl", ""))


def _texts(folder: Traversable, prefix: str) -> list[tuple[str, str]]:
    texts: list[tuple[str, str]] = []
    for entry in folder.iterdir():
        if entry.is_dir():
            texts += _texts(entry, f"{prefix}{entry.name}/")
        elif entry.name.endswith((".src", ".dat", ".txt")):
            texts.append((f"{prefix}{entry.name}", entry.read_text("ascii")))
    return texts


def export_settings(config: CellConfig, path: Path, prefix: str | None = None) -> ExportSettings:
    """Return what the programs of this cell are made with; ``path`` names the file in messages."""
    robot = config.robot
    krl = robot.krl
    cell_ip = krl.cell_ip or robot.eki.host
    if krl.robot_connects and (not _IPV4.fullmatch(cell_ip) or cell_ip.startswith(("127.", "0."))):
        msg = (
            f"{path}: [robot.eki] host = {cell_ip!r} is not an address that the robot can connect to;"
            f" set [robot.krl] cell_ip to the IPv4 address of {socket.gethostname()} on the robot's network"
        )
        raise ConfigurationError(msg)
    return ExportSettings(
        channel=dataclasses.replace(
            CHANNEL,
            cell_ip=cell_ip,
            cell_port=robot.eki.port,
            robot_ip=krl.robot_ip,
            robot_port=krl.robot_port,
        ),
        robot_connects=krl.robot_connects,
        tool=robot.tool.to_frame(),
        pick_base=robot.pick_base.to_frame(),
        place_base=robot.place_base.to_frame(),
        tool_number=krl.tool_number,
        pick_base_number=krl.pick_base_number,
        place_base_number=krl.place_base_number,
        vacuum_output=krl.vacuum_output,
        vacuum_input=krl.vacuum_input,
        blow_output=krl.blow_output,
        approach_mm=krl.approach_mm,
        photo_axes_deg=krl.photo_axes_deg,
        prefix=prefix or krl.prefix,
    )
