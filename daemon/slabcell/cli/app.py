"""Which verbs does the command have, and what does the shell see when one fails?

Only the module of the verb that is used is imported, so that `slabcell --help` and small verbs start at once.
"""

import importlib
import os
import sys
from typing import Annotated, Any, Final

import typer

from slabcell import __version__
from slabcell.errors import SlabcellError

__all__ = ["main"]

# Verb -> (module, its typer app or command function, one line of help).
VERBS: Final[dict[str, tuple[str, str, str]]] = {
    "demo": ("slabcell.cli.demo", "demo_command", "Run the whole cell, simulated, and measure what it laid."),
    "run": ("slabcell.cli.run", "run_command", "Run the cell as a daemon."),
    "hmi": ("slabcell.cli.hmi", "hmi_app", "Serve the web pages of the cell, and keep their users."),
    "status": ("slabcell.cli.status", "status_command", "Show how the running cell is."),
    "job": ("slabcell.cli.job", "job_app", "Show jobs, and what became of their slabs."),
    "cycle": ("slabcell.cli.cycle", "cycle_app", "Show cycles, their pictures, and how slabs were measured to lie."),
    "alarms": ("slabcell.cli.alarms", "alarms_app", "Show alarms, and acknowledge or shelve them."),
    "trigger": ("slabcell.cli.trigger", "trigger_command", "Have the running cell take a picture, and offer nothing."),
    "verify": ("slabcell.cli.trigger", "verify_command", "Have the running cell measure how the slabs lie."),
    "cell": ("slabcell.cli.cell", "cell_app", "Halt the running cell, have it go on, step, or clear an error."),
    "config": ("slabcell.cli.config", "config_app", "Check and show the configuration of the cell."),
    "events": ("slabcell.cli.events", "events_command", "Follow what happens in the running cell."),
    "locate": ("slabcell.cli.locate", "locate_command", "Find the slabs on image files, and the slot of each."),
    "calibrate": ("slabcell.cli.calibrate", "calibrate_app", "Make a calibration from images of a board."),
    "calibration": ("slabcell.cli.calibration", "calibration_app", "See and change calibrations on the running cell."),
    "ledger": ("slabcell.cli.ledger", "ledger_app", "Show, export and settle the record of offers."),
    "install": ("slabcell.cli.install", "install_command", "Lay this version out on the cell PC, with its service."),
    "doctor": ("slabcell.cli.doctor", "doctor_command", "Say what is wrong with this cell and what to do."),
    "vision": ("slabcell.cli.vision_sets", "vision_app", "Try parameters of the vision on the running cell."),
    "recipe": ("slabcell.cli.recipe", "recipe_app", "Verify a recipe on graded pictures, and make it the active one."),
    "task": ("slabcell.cli.tasks", "task_app", "Show what runs beside the running cell, and end it."),
    "replay": ("slabcell.cli.replay", "replay_command", "Run recorded cycles again and compare."),
    "template": ("slabcell.cli.template", "template_app", "Check and draw a template."),
    "camera": ("slabcell.cli.camera", "camera_app", "Find, set and test cameras."),
    "light": ("slabcell.cli.light", "light_app", "Set and try lights."),
    "sim": ("slabcell.cli.sim", "sim_app", "Run devices in software."),
    "krl": ("slabcell.cli.krl", "krl_app", "Check the robot programs."),
    "krc": ("slabcell.cli.krc", "krc_app", "Run robot programs in the software KRC."),
}

EXIT_SOFTWARE = 70  # sysexits.h EX_SOFTWARE: a fault of ours, not of the user
EXIT_INTERRUPTED = 130


def _print_version(wanted: bool) -> None:  # noqa: FBT001 - typer calls it with the option's value
    if wanted:
        typer.echo(f"slabcell {__version__}")
        raise typer.Exit


def _root(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Control a robot cell that lays irregular flat slabs into a given pattern.

    Exit codes: 0 done, 1 the work failed, 2 wrong usage, 69 a device or the daemon is unavailable, 75 try again,
    77 not permitted, 78 configuration.
    """
    del version  # its callback has done the work


def _build(used: str | None) -> typer.Typer:
    """Return the command with the verb ``used`` imported and every other verb known by name and help only."""
    app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.callback()(_root)
    for verb, (module, attribute, text) in VERBS.items():
        if verb != used:
            app.command(verb, help=text)(_not_imported)
            continue
        found: Any = getattr(importlib.import_module(module), attribute)
        if isinstance(found, typer.Typer):
            app.add_typer(found, name=verb, help=text)
        else:
            app.command(verb)(found)
    return app


def _not_imported() -> None:
    """Stand in the list of verbs."""


def main() -> None:
    """Run the command and end the process with its exit code; what goes wrong is said in words, never a traceback.

    With SLABCELL_DEBUG=1 the traceback of an internal error is shown.
    """
    used = next((word for word in sys.argv[1:] if not word.startswith("-")), None)
    try:
        _build(used)()
    except SlabcellError as error:
        number = f" [{error.number}]" if error.number else ""
        _fail(f"slabcell: error{number}: {error}", error.exit_code)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:
        # The reader went away, as `slabcell ... | head` does; Python would complain again while flushing at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:
        if os.environ.get("SLABCELL_DEBUG") == "1":
            raise
        _fail(
            f"slabcell: internal error: {type(error).__name__}: {error}\n"
            "This is a fault in slabcell. Run it again with SLABCELL_DEBUG=1 and report what it prints.",
            EXIT_SOFTWARE,
        )


def _fail(message: str, code: int) -> None:
    sys.stderr.write(message + "\n")
    sys.exit(code)
