"""`slabcell config`: is the configuration right, and where does each value come from?"""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from slabcell.cli.talk import AsJson, make_console, print_json
from slabcell.service.builder import read_parts
from slabcell.service.config import CellConfig
from slabcell.service.config_layers import load_layers
from slabcell.service.config_reload import is_reloadable

__all__ = ["config_app"]

config_app = typer.Typer(help="Check and show the configuration of the cell.", no_args_is_help=True)

Where = Annotated[Path, typer.Option("--config", metavar="FILE", help="The cell's configuration.")]
DEFAULT = Path("/etc/slabcell/cell.toml")


@config_app.command()
def check(config: Where = DEFAULT, *, as_json: AsJson = False) -> None:
    """Check the configuration, its drop-ins and every file that it names.  Exit code 78 if something is wrong."""
    loaded = load_layers(config)
    parts = read_parts(loaded.config)
    files = [str(file) for file in loaded.files]
    if as_json:
        print_json(
            {
                "schema": "slabcell.config-check/1",
                "files": files,
                "recipe": parts.recipe.name,
                "slots": len(parts.recipe.template.slots),
                "calibrated": parts.calibration is not None,
            }
        )
        return
    typer.echo(f"{', '.join(files)}: right; recipe {parts.recipe.name} with {len(parts.recipe.template.slots)} slots")
    if parts.calibration is None:
        named = loaded.config.calibration
        what = f"{named} is not there" if named else "the configuration names none"
        typer.echo(f"there is no calibration yet ({what}): the cell starts, and waits for one")
    if loaded.config.camera.driver == "simulated":
        typer.echo("camera.driver simulated: only `slabcell demo` has a world to look at, `slabcell run` refuses it")


@config_app.command()
def show(
    config: Where = DEFAULT,
    *,
    origin: Annotated[bool, typer.Option("--origin", help="Say where each value was written.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show every value that is in effect; with --origin also file and line, and what a reload takes over."""
    loaded = load_layers(config)
    if as_json:
        values = [{"key": item.key, "value": item.value, "origin": item.origin} for item in loaded.values]
        print_json({"schema": "slabcell.config/1", "files": [str(file) for file in loaded.files], "values": values})
        return
    if not origin:
        for item in loaded.values:
            typer.echo(f"{item.key} = {json.dumps(item.value)}")
        return
    table = Table("key", "value", "from", "reload")
    for item in loaded.values:
        text = json.dumps(item.value)
        shown = text if len(text) <= 40 else f"{text[:37]}..."
        table.add_row(item.key, shown, item.origin, "SIGHUP" if is_reloadable(item.key) else "restart")
    make_console().print(table)


@config_app.command()
def schema() -> None:
    """Print the JSON Schema of the configuration, for editors that know TOML."""
    typer.echo(json.dumps(CellConfig.model_json_schema(), indent=1))
