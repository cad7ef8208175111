"""`slabcell sim`: devices in software, as programs that real clients talk to."""

import sys
import threading
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from importlib.resources import as_file, files
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path
from signal import SIGINT, SIGTERM, signal
from typing import Annotated

import typer
from rich.console import Console

from slabcell.cli.sim_board import board_command
from slabcell.cli.sim_plc import plc_command
from slabcell.errors import ImageError, UnavailableError, UsageError
from slabcell.images import Image, read_image
from slabcell_drivers.simulation import SceneError, World, load_scene, render_world
from slabcell_drivers.simulation.gige import (
    FAULT_VERBS,
    CheckedPattern,
    FaultError,
    GigeCamera,
    GigeCameraError,
    Render,
    SensorLimits,
)

__all__ = ["sim_app"]

sim_app = typer.Typer(help="Run devices in software.", no_args_is_help=True)

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff"})


sim_app.command("plc")(plc_command)
sim_app.command("board")(board_command)


@sim_app.command("camera")
def camera_command(
    address: Annotated[
        str, typer.Option("--address", metavar="IP", help="Loopback address of the first camera, 127.0.0.1 and up.")
    ] = "127.0.0.1",
    count: Annotated[int, typer.Option("--count", min=1, max=16, help="So many cameras, one address each.")] = 1,
    serial: Annotated[str, typer.Option("--serial", help="Serial number of the first; the others count on.")] = "",
    scene: Annotated[
        str | None,
        typer.Option("--scene", metavar="NAME", help="See the table of a scene: dresden, irregular, a file."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="How the slabs of the scene are strewn.")] = 0,
    images: Annotated[
        Path | None, typer.Option("--images", metavar="DIR", help="Show the pictures of a folder, one a frame, again.")
    ] = None,
    width: Annotated[int, typer.Option("--width", min=8, max=8192, help="Width of the sensor.")] = 1920,
    height: Annotated[int, typer.Option("--height", min=1, max=8192, help="Height of the sensor.")] = 1200,
    faults: Annotated[
        list[str] | None, typer.Option("--fault", metavar="VERB", help="A fault from the start, e.g. 'loss 0.005'.")
    ] = None,
) -> None:
    """Be a GigE Vision camera on loopback: found, set, triggered and streamed from like a real one, without root.

    Without --scene or --images it shows a test pattern in which every byte tells the number of the frame.  While it
    runs it reads fault verbs from its input, one a line; `help` lists them.  It ends with Ctrl-C or SIGTERM.
    """
    if scene is not None and images is not None:
        raise UsageError("--scene and --images exclude each other: a camera sees one thing")
    limits = SensorLimits(width, height)
    if scene is not None:
        render, first_serial, limits = _scene(scene, seed)
    elif images is not None:
        render, limits = _folder(images)
        first_serial = "SIM-0001"
    else:
        render, first_serial = CheckedPattern(width, height), "SIM-0001"
    with ExitStack() as running:
        cameras: list[GigeCamera] = []
        for index in range(count):
            name = serial or first_serial
            try:
                camera = GigeCamera(
                    render,
                    str(_address(address) + index),
                    serial=name if index == 0 else f"{name}-{index + 1}",
                    limits=limits,
                    seed=seed + index,
                )
                for line in faults or ():
                    camera.faults.apply(line)
                running.enter_context(camera)
            except FaultError as error:
                raise UsageError(str(error)) from error
            except GigeCameraError as error:
                raise UnavailableError(str(error)) from error
            cameras.append(camera)
            typer.echo(f"camera {camera.device.serial} ready at {camera.address}")
        stop = threading.Event()
        for number in (SIGINT, SIGTERM):
            signal(number, lambda _number, _frame: stop.set())
        threading.Thread(target=_read_verbs, args=(cameras,), daemon=True).start()
        stop.wait()


def _read_verbs(cameras: list[GigeCamera]) -> None:
    """Do what the lines of the input say, to every camera."""
    console = Console(stderr=True, highlight=False)
    for line in sys.stdin:
        if not line.strip():
            continue
        if line.strip() == "help":
            console.print("\n".join(FAULT_VERBS.values()), markup=False)
            continue
        try:
            for camera in cameras:
                camera.faults.apply(line)
        except FaultError as error:
            console.print(str(error), markup=False)
        else:
            typer.echo(f"done: {line.strip()}")


def _address(text: str) -> IPv4Address:
    try:
        return IPv4Address(text)
    except AddressValueError as error:
        raise UsageError(f"--address {text} is no IPv4 address") from error


def _scene(name: str, seed: int) -> tuple[Render, str, SensorLimits]:
    with _scene_file(name) as path:
        try:
            scene = load_scene(path)
        except (SceneError, OSError) as error:
            raise UsageError(f"--scene {name}: {error}") from error
    world = World(scene, seed)
    return (
        lambda number: render_world(world, number),
        scene.camera.serial,
        SensorLimits(scene.camera.width, scene.camera.height),
    )


@contextmanager
def _scene_file(name: str) -> Generator[Path]:
    shipped = files("slabcell") / "data" / "config" / "scenes" / f"{name}.toml"
    if "/" not in name and shipped.is_file():
        with as_file(shipped) as path:
            yield path
    else:
        yield Path(name)


def _folder(folder: Path) -> tuple[Render, SensorLimits]:
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES) if folder.is_dir() else []
    if not paths:
        raise UsageError(f"--images {folder}: holds no picture ({', '.join(sorted(SUFFIXES))})")
    first = read_image(paths[0])

    def render(number: int) -> Image:
        return read_image(paths[(number - 1) % len(paths)])

    if first.shape[1] % 4:
        raise ImageError(f"{paths[0]}: is {first.shape[1]} pixels wide; a camera's width is a multiple of 4")
    return render, SensorLimits(int(first.shape[1]), int(first.shape[0]))
