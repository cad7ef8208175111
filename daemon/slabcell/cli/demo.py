"""`slabcell demo`: the whole cell, simulated, and a measurement of what it laid."""

import asyncio
import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from slabcell.cli.demo_hmi import show_demo
from slabcell.errors import UsageError
from slabcell.hmi.report import render_report
from slabcell.logs import log_to_file
from slabcell.service.demo import DemoOptions, run_demo
from slabcell.service.demo_camera import DemoCamera
from slabcell.service.demo_cell import DemoCellOptions
from slabcell.service.demo_robot import DemoLink

__all__ = ["demo_command"]


class _Display:
    """Shows on the terminal how far the demo is: a line for each stage, with a bar if there is something to count."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._task: TaskID | None = None

    def stage(self, name: str, total: int | None = None) -> None:
        """Begin a stage; ``total`` is what there is to count in it."""
        self._end()
        self._task = self._progress.add_task(name, total=total, detail="")

    def advance(self, text: str) -> None:
        """Count one thing of the stage."""
        if self._task is not None:
            self._progress.advance(self._task)
            self._progress.update(self._task, detail=text)
            if not self._progress.console.is_terminal:
                self._progress.console.print(f"  {text}", highlight=False)

    def close(self) -> None:
        """End the last stage."""
        self._end()

    def _end(self) -> None:
        if self._task is not None:
            task = self._progress.tasks[self._task]
            total = task.total if task.total is not None else 1
            self._progress.update(self._task, total=total, completed=max(task.completed, total), detail="")
            self._task = None


def demo_command(
    scene: Annotated[
        str,
        typer.Option("--scene", metavar="NAME", help="Scene: dresden, irregular, stones, or a scene file of your own."),
    ] = "dresden",
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=2**31 - 1, help="How the slabs are strewn, and the noise.")
    ] = 0,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where pictures, report and bundles go.")] = Path(
        "demo-out"
    ),
    camera: Annotated[
        DemoCamera,
        typer.Option("--camera", help="What looks at the table; aravis and harvesters: over GigE Vision on loopback."),
    ] = DemoCamera.SIMULATED,
    link: Annotated[
        DemoLink,
        typer.Option("--link", help="How robot and cell speak; Modbus: with a PLC in software between them."),
    ] = DemoLink.EKI,
    *,
    hmi: Annotated[bool, typer.Option("--hmi", help="Lay job after job, and serve the web pages of the cell.")] = False,
    port: Annotated[int, typer.Option("--port", min=0, max=65_535, help="With --hmi: where the pages are.")] = 8080,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")] = False,
) -> None:
    """Run the whole cell, simulated, and measure what it laid.

    Renders the table, calibrates the camera from rendered boards, runs the shipped KRL programs in the software KRC
    (or, over Modbus, the same job in a PLC in software), lays the template and measures every slab in the world's
    truth.  Exit code 1 if a slot is not filled to within 0.5 mm and 0.5 degrees.

    With --hmi the cell lives on, and its web pages can be opened in a browser, until Ctrl-C.
    """
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[detail]}", style="dim"),
    )
    log_to_file(out / "slabcell.log")
    if hmi:
        if camera is not DemoCamera.SIMULATED or link is not DemoLink.EKI or as_json:
            msg = "--hmi goes with the simulated camera, with link eki, and without --json"
            raise UsageError(msg)
        with Progress(*columns, console=console) as progress:
            asyncio.run(show_demo(DemoCellOptions(scene, seed, out), _Display(progress), port))
        return
    with Progress(*columns, console=console) as progress:
        display = _Display(progress)
        document = asyncio.run(run_demo(DemoOptions(scene, seed, out, camera, link), display))
        display.close()
    document["files"]["report"] = str(_write_report(document))
    if as_json:
        typer.echo(json.dumps(document))
    else:
        _print(document, Console())
    if not document["ok"]:
        raise typer.Exit(1)


def _write_report(document: dict[str, Any]) -> Path:
    files = document["files"]
    captions = {"before": "Before", "overlay": "What the vision found", "after": "After"}
    pictures = {text: Path(files[name]).read_bytes() for name, text in captions.items() if name in files}
    path = Path(files["folder"]) / "report.html"
    path.write_text(render_report(document, pictures), encoding="utf-8")
    return path


def _print(document: dict[str, Any], console: Console) -> None:
    slots = Table("slot", "score", "dx mm", "dy mm", "dθ °", title="Placement, measured in the world's truth")
    for column in slots.columns:
        column.justify = "right"
    for slot in document["slots"]:
        if slot["filled"]:
            numbers = [f"{slot[key]:+.3f}" for key in ("dx_mm", "dy_mm", "dtheta_deg")]
            score = "" if slot["score"] is None else f"{slot['score']:.3f}"
            slots.add_row(str(slot["slot"]), score, *numbers)
        else:
            slots.add_row(str(slot["slot"]), "not filled", "", "", "", style="bold red")
    console.print(slots)
    times = Table("stage", *(f"cycle {cycle['cycle']}" for cycle in document["cycles"]), title="Time in milliseconds")
    for column in times.columns[1:]:
        column.justify = "right"
    for stage in document["stages"]:
        measured = [cycle["timing_ms"].get(stage) for cycle in document["cycles"]]
        times.add_row(stage, *("" if ms is None else f"{ms:.1f}" for ms in measured))
    console.print(times)
    worst, limits = document["worst"], document["limits"]
    for failure in document["failures"]:
        console.print(f"✗ {failure}", style="bold red", highlight=False)
    if document["ok"]:
        console.print(
            f"✓ every slot is filled; worst error {worst['position_mm']:.3f} mm and {worst['angle_deg']:.3f}°"
            f" (limits {limits['position_mm']} mm and {limits['angle_deg']}°)",
            highlight=False,
        )
    console.print(f"pictures, report.html and bundles: {document['files']['folder']}", highlight=False)
