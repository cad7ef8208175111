"""`slabcell light`: what families there are, set a light by hand, and try whether it does what it should."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from serial.tools import list_ports

from slabcell.cli.talk import make_console
from slabcell.errors import ConfigurationError, UnavailableError, UsageError
from slabcell.service.config_layers import load_config
from slabcell.service.light_config import known_presets, make_light
from slabcell_drivers.light import LightConfigError, LightError, LightInfo, LightSetting, SerialLight

__all__ = ["light_app"]

light_app = typer.Typer(help="Set and try lights.", no_args_is_help=True)

TEST_PERCENT = 20.0
TEST_PAUSE_S = 0.5

_Url = Annotated[
    str | None, typer.Option("--url", metavar="URL", help="/dev/ttyUSB1, socket://HOST:PORT or rfc2217://HOST:PORT.")
]
_Preset = Annotated[str | None, typer.Option("--preset", metavar="NAME", help="Family: see `slabcell light list`.")]
_Presets = Annotated[Path | None, typer.Option("--presets", metavar="FILE", help="File with families of your own.")]
_Baud = Annotated[int | None, typer.Option("--baud-rate", min=300, help="Of the line; the default is the family's.")]
_Config = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="Take url, family and line from [light] of this file.")
]
_Channel = Annotated[int, typer.Option("--channel", min=1, max=64, help="Number of the channel, from 1.")]
_Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@light_app.command("list")
def list_command(presets: _Presets = None, *, as_json: _Json = False) -> None:
    """List the families that are known, where their commands are from, and the serial lines of this machine."""
    known = known_presets(presets)
    lines = [{"device": port.device, "description": port.description} for port in list_ports.comports()]
    if as_json:
        families = [
            {
                "preset": preset.name,
                "title": preset.title,
                "channels": preset.channels,
                "baud_rate": preset.baud_rate,
                "strobe": preset.commands.strobe is not None,
                "trigger": preset.commands.trigger is not None,
                "source": preset.source,
            }
            for preset in known.values()
        ]
        typer.echo(json.dumps({"schema": "slabcell.lights/1", "families": families, "lines": lines}))
        return
    table = Table("preset", "controllers", "channels", "baud", "strobe", "source")
    for preset in known.values():
        strobe = "by command or wire" if preset.commands.trigger else "by wire" if preset.commands.strobe else "no"
        baud = str(preset.baud_rate or "name it")
        table.add_row(preset.name, preset.title, str(preset.channels), baud, strobe, preset.source)
    console = make_console()
    console.print(table)
    console.print("serial lines: " + (", ".join(line["device"] for line in lines) or "none"), highlight=False)


@light_app.command("set")
def set_command(
    url: _Url = None,
    preset: _Preset = None,
    presets: _Presets = None,
    baud_rate: _Baud = None,
    config: _Config = None,
    channel: _Channel = 1,
    intensity: Annotated[
        float | None, typer.Option("--intensity", metavar="PERCENT", help="Shine this bright; 0 turns off.")
    ] = None,
    strobe_us: Annotated[
        float | None, typer.Option("--strobe-us", metavar="US", help="Pulse this long with each trigger instead.")
    ] = None,
    delay_us: Annotated[float, typer.Option("--delay-us", metavar="US", help="From the trigger to the pulse.")] = 10.0,
    *,
    as_json: _Json = False,
) -> None:
    """Set one channel; it stays so when the command ends."""
    if intensity is None:
        raise UsageError("name the intensity: --intensity PERCENT")

    async def work(light: SerialLight) -> dict[str, object]:
        if intensity == 0:
            await light.off(channel)
        else:
            await light.on(LightSetting(channel, intensity, strobe_us, delay_us))
        return {"channel": channel, "intensity_percent": intensity, "strobe_width_us": strobe_us}

    _report(_run(_light(url, preset, presets, baud_rate, config), work), as_json=as_json)


@light_app.command("test")
def try_command(
    url: _Url = None,
    preset: _Preset = None,
    presets: _Presets = None,
    baud_rate: _Baud = None,
    config: _Config = None,
    channel: _Channel = 1,
    *,
    as_json: _Json = False,
) -> None:
    """Ask the controller who it is, and have one channel shine for half a second at 20 %.

    Exit code 69 if it does not answer.
    """

    async def work(light: SerialLight) -> dict[str, object]:
        await light.on(LightSetting(channel, TEST_PERCENT))
        await asyncio.sleep(TEST_PAUSE_S)
        await light.check()
        await light.off(channel)
        return {"channel": channel, "shone_percent": TEST_PERCENT}

    _report(_run(_light(url, preset, presets, baud_rate, config), work), as_json=as_json)


def _light(
    url: str | None, preset: str | None, presets: Path | None, baud_rate: int | None, config: Path | None
) -> SerialLight:
    if config is not None:
        table = load_config(config).light
        if table is None:
            raise ConfigurationError(f"{config}: has no [light]")
        url, preset = url or table.url, preset or table.preset
        presets, baud_rate = presets or table.presets, baud_rate or table.baud_rate
    if url is None or preset is None:
        raise UsageError("name --url and --preset, or a --config with [light]")
    return make_light(url, preset, own=presets, baud_rate=baud_rate)


def _run(
    light: SerialLight, work: Callable[[SerialLight], Awaitable[dict[str, object]]]
) -> tuple[LightInfo, dict[str, object]]:
    async def talk() -> tuple[LightInfo, dict[str, object]]:
        try:
            info = await light.open()
            return info, await work(light)
        finally:
            await light.close()

    try:
        return asyncio.run(talk())
    except LightConfigError as error:
        raise UsageError(str(error)) from error
    except LightError as error:
        raise UnavailableError(str(error)) from error


def _report(done: tuple[LightInfo, dict[str, object]], *, as_json: bool) -> None:
    info, did = done
    if as_json:
        document = {"schema": "slabcell.light/1", "family": info.family, "identity": info.identity, **did}
        typer.echo(json.dumps(document))
    else:
        words = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in did.items() if value is not None)
        typer.echo(f"{info.family} ({info.identity}): {words}")
