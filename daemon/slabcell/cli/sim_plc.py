"""`slabcell sim plc`: a PLC in software with a robot behind it, for a cell that runs as on the real line."""

import asyncio
import json
import math
import re
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Literal

import typer

from slabcell.errors import ConfigurationError, UnavailableError, UsageError
from slabcell.recipe import load_recipe
from slabcell.service.config_layers import load_config
from slabcell.service.modbus_config import shipped_map
from slabcell_drivers.plc.program import JobEnd
from slabcell_drivers.plc.pty_pair import PtyPair
from slabcell_drivers.plc.registers import RegisterPort
from slabcell_drivers.plc.simulated import SimulatedPlc, polled_on_line, polled_over_tcp
from slabcell_drivers.robot.arm import arm_by_name
from slabcell_drivers.robot.modbus import (
    ModbusMapError,
    RegisterClient,
    RegisterMap,
    SerialSettings,
    load_map,
    serial_client,
    tcp_client,
)
from slabcell_drivers.simulation import Scene, SceneError, World, load_scene, render_world
from slabcell_drivers.simulation.gige import GigeCamera, GigeCameraError, SensorLimits

__all__ = ["plc_command"]

POLL_TIMEOUT_S = 1.0
_TCP = re.compile(r"tcp://(?P<host>[^:/]+|\[[^\]]+\]):(?P<port>[0-9]{1,5})")
_PARITY: dict[str, Literal["N", "E", "O"]] = {"none": "N", "even": "E", "odd": "O"}


def plc_command(
    cell: Annotated[
        str | None,
        typer.Option("--cell", metavar="URL", help="Poll the cell there: tcp://HOST:PORT, or rtu:///dev/ttyUSB0."),
    ] = None,
    serve: Annotated[
        str | None,
        typer.Option("--serve", metavar="URL", help="Be polled by the cell there instead; the same URLs."),
    ] = None,
    scene: Annotated[
        str, typer.Option("--scene", metavar="NAME", help="The table: dresden, irregular, stones, or a scene file.")
    ] = "dresden",
    seed: Annotated[int, typer.Option("--seed", min=0, help="How the slabs are strewn.")] = 0,
    camera: Annotated[
        str | None,
        typer.Option("--camera", metavar="IP", help="Be the camera over this table too: a loopback address."),
    ] = None,
    map_file: Annotated[Path | None, typer.Option("--map", metavar="FILE", help="Register map of your own.")] = None,
    baud_rate: Annotated[int, typer.Option("--baud-rate", min=300, help="Of the serial line.")] = 115_200,
    parity: Annotated[str, typer.Option("--parity", help="Of the serial line: none, even or odd.")] = "none",
    starts: Annotated[
        int, typer.Option("--starts", min=1, max=100, help="Press START so often when the program stops.")
    ] = 5,
    *,
    pty: Annotated[
        bool, typer.Option("--pty", help="Make a serial line in software; prints the end that is the cell's.")
    ] = False,
) -> None:
    """Be a PLC with a robot: run one job against a cell, over Modbus, in a simulated world.

    Prints a JSON object with the placements, measured in the world's truth; exit code 1 if a slot is not filled to
    within 0.5 mm and 0.5 degrees.
    """
    if sum(map(bool, (cell, serve, pty))) != 1:
        raise UsageError("name one of --cell URL (poll the cell), --serve URL (be polled) and --pty (line in software)")
    if parity not in _PARITY:
        raise UsageError(f"--parity {parity}: none, even or odd")
    world = World(_scene(scene), seed)
    register_map = _map(map_file)
    line = SerialSettings("", baud_rate, _PARITY[parity])
    document = asyncio.run(_run(world, register_map, cell or "", serve or "", line, camera, starts))
    typer.echo(json.dumps(document))
    if not document["ok"]:
        raise typer.Exit(1)


async def _run(
    world: World,
    register_map: RegisterMap,
    cell: str,
    serve: str,
    line: SerialSettings,
    camera: str | None,
    starts: int,
) -> dict[str, object]:
    with as_file(files("slabcell") / "data" / "config" / "demo.toml") as path:
        robot = load_config(path).robot
    async with AsyncExitStack() as stack:
        if camera is not None:
            device = _camera(world, camera)
            try:
                stack.enter_context(device)
            except GigeCameraError as error:
                raise UnavailableError(str(error)) from error
            typer.echo(f"camera {device.device.serial} ready at {camera}", err=True)
        port = await stack.enter_async_context(_port(register_map, cell, serve, line))
        plc = SimulatedPlc(world, port, register_map, arm=arm_by_name(robot.model), tool=robot.tool.to_frame())
        end = await plc.run(starts=starts)
    return _document(world, end)


@asynccontextmanager
async def _port(register_map: RegisterMap, cell: str, serve: str, line: SerialSettings) -> AsyncGenerator[RegisterPort]:
    """Give the PLC's way to the registers, as the URLs say."""
    async with AsyncExitStack() as stack:
        try:
            if serve:
                kind, place, number = _url(serve)
                if kind == "tcp":
                    held = polled_over_tcp(register_map, place, number, _tell_address)
                else:
                    held = polled_on_line(register_map, SerialSettings(place, line.baud_rate, line.parity))
                yield await stack.enter_async_context(held)
                return
        except OSError as error:
            raise UnavailableError(f"--serve {serve}: {error.strerror or error}") from error
        if cell:
            kind, place, number = _url(cell)
        else:
            pair = await stack.enter_async_context(PtyPair())
            typer.echo(f"line for the cell: {pair.ends[0]}", err=True)
            kind, place, number = "rtu", pair.ends[1], 0
        make = (
            tcp_client(place, number, POLL_TIMEOUT_S)
            if kind == "tcp"
            else serial_client(SerialSettings(place, line.baud_rate, line.parity), POLL_TIMEOUT_S)
        )
        client = RegisterClient(make, register_map, timeout_s=POLL_TIMEOUT_S)
        stack.callback(client.close)
        yield client


def _tell_address(address: tuple[str, int]) -> None:
    typer.echo(f"registers at tcp://{address[0]}:{address[1]}", err=True)


def _url(text: str) -> tuple[str, str, int]:
    if match := _TCP.fullmatch(text):
        return "tcp", match["host"].strip("[]"), int(match["port"])
    if text.startswith("rtu://") and len(text) > 6:
        return "rtu", text.removeprefix("rtu://"), 0
    raise UsageError(f"{text}: tcp://HOST:PORT or rtu:///dev/ttyUSB0")


def _map(path: Path | None) -> RegisterMap:
    try:
        return load_map(path) if path else shipped_map()
    except ModbusMapError as error:
        raise ConfigurationError(str(error)) from error


def _scene(name: str) -> Scene:
    shipped = files("slabcell") / "data" / "config" / "scenes" / f"{name}.toml"
    try:
        if "/" not in name and shipped.is_file():
            with as_file(shipped) as path:
                return load_scene(path)
        return load_scene(Path(name))
    except (SceneError, OSError) as error:
        raise UsageError(f"--scene {name}: {error}") from error


def _camera(world: World, address: str) -> GigeCamera:
    spec = world.scene.camera
    limits = SensorLimits(spec.width, spec.height)
    return GigeCamera(lambda number: render_world(world, number), address, serial=spec.serial, limits=limits)


def _document(world: World, end: JobEnd) -> dict[str, object]:
    with as_file(files("slabcell") / "data" / "config" / "recipes") as folder:
        recipe = load_recipe(folder / f"{world.scene.name}.toml")
    placements = world.placements([slot.vertices for slot in recipe.template.slots])
    good = [p.filled and math.hypot(p.dx_mm, p.dy_mm) <= 0.5 and abs(p.dtheta_deg) <= 0.5 for p in placements]
    return {
        "schema": "slabcell.plc/1",
        "ok": end.status == "done" and all(good),
        "status": end.status,
        "message": end.message,
        "requests": end.requests,
        "picks": list(world.pick_counts),
        "slots": [
            {"slot": p.slot, "filled": p.filled, "dx_mm": p.dx_mm, "dy_mm": p.dy_mm, "dtheta_deg": p.dtheta_deg}
            for p in placements
        ],
    }
