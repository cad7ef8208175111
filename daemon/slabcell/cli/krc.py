"""`slabcell krc run`: what does a robot program do, in the software KRC?"""

import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from slabcell.cli.files import write_file
from slabcell.errors import SlabcellError, UsageError
from slabcell_drivers.krc import KrlError, RunResult, SoftwareKrc, TraceEvent, read_project
from slabcell_drivers.krc.path_picture import PathPen, draw_path
from slabcell_drivers.krc.smartpad import ShownMessage
from slabcell_drivers.robot.arm import ArmModel, arm_by_name
from slabcell_drivers.robot.machine_data import MachineDataError, parse_machine_data

__all__ = ["krc_app"]

TRACES = ("statements", "motion", "io", "telegrams", "messages")
_KINDS = {"statements": "statement", "motion": "motion", "io": "io", "telegrams": "telegram", "messages": "message"}

krc_app = typer.Typer(help="Run robot programs in the software KRC.", no_args_is_help=True)


@krc_app.callback()
def _group() -> None:
    """Run robot programs in the software KRC."""


@krc_app.command()
def run(
    program: Annotated[str, typer.Argument(help="Program to select: NAME or NAME.src")],
    project: Annotated[Path, typer.Option("--project", help="Folder of .src and .dat files, in any depth")] = Path(),
    eki: Annotated[Path | None, typer.Option("--eki", help="Folder of EKI files; default: the project")] = None,
    robot: Annotated[str, typer.Option("--robot", help="Robot model, or the path of a $machine.dat")] = "kr3r540",
    speed: Annotated[str, typer.Option("--speed", help="1 = real time, 2 = twice as fast, …, or max")] = "max",
    address: Annotated[
        list[str] | None, typer.Option("--address", help="CHANNEL=HOST:PORT in place of the one in the EKI file")
    ] = None,
    timeout_s: Annotated[float, typer.Option("--timeout", min=0.1, help="Give up after so many seconds")] = 300.0,
    seed: Annotated[int, typer.Option("--seed", help="Of everything that is left to chance")] = 0,
    trace: Annotated[str, typer.Option("--trace", help=f"Comma-separated: {','.join(TRACES)}")] = "",
    picture: Annotated[Path | None, typer.Option("--picture", help="Draw the tool's path into this SVG file")] = None,
    assignments: Annotated[
        list[str] | None, typer.Option("--set", help="Assignment in KRL before the start: TOOL_DATA[1]={Z 200,…}")
    ] = None,
    answers: Annotated[
        list[str] | None,
        typer.Option("--answer", help="Answer to the next dialog: number or text of a softkey; once for each dialog"),
    ] = None,
    submit: Annotated[
        str, typer.Option("--submit", help="Program that the submit interpreter runs beside it, SPS for example")
    ] = "",
    keep: Annotated[
        Path | None, typer.Option("--keep", help="Folder for the data lists as they are at the end")
    ] = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Run a program to its end in virtual time, against real EKI connections.

    Exit code 0 if the program came to its end, 1 if it stopped on HALT, on an error or was still running at the
    time limit.
    """
    if not project.is_dir():
        msg = f"{project}: there is no such folder; --project takes the folder that holds the .src and .dat files"
        raise UsageError(msg)
    recorder = _Recorder(_wanted(trace), echo=not as_json)
    pen = PathPen() if picture is not None else None
    operator = _Operator(answers or ())
    with SoftwareKrc(
        read_project(project),
        robot=_robot(robot),
        eki_configs=_channels(eki or project),
        eki_addresses=dict(_address(text) for text in address or ()),
        seed=seed,
        speed=_speed(speed),
        trace=recorder.take,
        trace_kinds=recorder.kinds | ({"path"} if pen is not None else set[str]()),
        io=pen,
        dialog=operator.answer,
        submit=submit,
        on_trajectory=pen.begin if pen is not None else None,
    ) as krc:
        for assignment in assignments or ():
            _assign(krc, assignment)
        operator.gives_up = krc.cancel
        result = _run(krc, program, timeout_s)
        if picture is not None and pen is not None:
            write_file(picture, _drawn(pen, program))
        if keep is not None:
            for name, content in krc.data_files().items():
                write_file(keep / name, content)
        _report(krc, result, recorder, as_json=as_json)
    if operator.problem:
        raise UsageError(operator.problem)
    if result.status != "done":
        raise typer.Exit(1)


def _run(krc: SoftwareKrc, program: str, timeout_s: float) -> RunResult:
    """Run in a thread, so that Ctrl-C cancels the program as a person at the controller would."""
    # not Thread.join: once a signal has interrupted it, Python takes the thread for ended
    with ThreadPoolExecutor(1, thread_name_prefix="software KRC") as executor:
        result = executor.submit(krc.run, program, max_wall_s=timeout_s)
        try:
            return result.result()
        except KeyboardInterrupt:
            krc.cancel()
            return result.result()


def _report(krc: SoftwareKrc, result: RunResult, recorder: "_Recorder", *, as_json: bool) -> None:
    if as_json:
        tcp = krc.tcp
        document = {
            "schema": "slabcell.krc-run/1",
            "status": result.status,
            "message_number": result.message_number,
            "message": result.message,
            "file": result.file,
            "line": result.line,
            "virtual_time_s": round(result.virtual_time_s, 3),
            "statements": result.statements,
            "axes_deg": [round(a, 4) for a in krc.axes_deg],
            "tcp": {k: round(v, 4) for k, v in zip("XYZABC", tcp.as_tuple(), strict=True)},
            "messages": [str(message) for message in krc.messages],
            "problems": [str(problem) for problem in krc.diagnostics],
            "trace": [asdict(event) for event in recorder.events],
        }
        typer.echo(json.dumps(document))
        return
    for problem in krc.diagnostics:
        typer.echo(str(problem), err=True)
    if "message" not in recorder.kinds:
        for message in krc.messages:
            typer.echo(str(message))
    where = f" in {result.file}, line {result.line}" if result.file else ""
    text = f": {result.message_number} {result.message}{where}" if result.message else ""
    typer.echo(f"{result.status}{text}; {result.virtual_time_s:.2f} s of the robot, {result.statements} statements")


class _Operator:
    """Answers the dialogs of a program with what the command line gave, one after another; then lets them stand."""

    def __init__(self, answers: Sequence[str]) -> None:
        self._answers = list(answers)
        self.gives_up: Callable[[], None] = lambda: None
        self.problem = ""

    def answer(self, message: ShownMessage) -> int:
        """Return the number of the softkey, 0 to let the dialog stand."""
        if not self._answers or self.problem:
            return 0
        wanted = self._answers[0].strip()
        keys = {text.strip().upper(): number for number, text in enumerate(message.softkeys, start=1) if text.strip()}
        number = keys.get(wanted.upper(), int(wanted) if wanted.isdigit() else 0)
        if number not in keys.values():
            shown = ", ".join(f"{number} {message.softkeys[number - 1].strip()}" for number in sorted(keys.values()))
            self.problem = f"--answer {wanted}: the dialog {message.text!r} has the softkeys {shown or 'none'}"
            self.gives_up()
            return 0
        del self._answers[0]
        return number


class _Recorder:
    """Prints what happens as it happens, or keeps it for the JSON document."""

    MAX_EVENTS = 1_000_000

    def __init__(self, kinds: frozenset[str], *, echo: bool) -> None:
        self.kinds = kinds
        self.events: list[TraceEvent] = []
        self._echo = echo

    def take(self, event: TraceEvent) -> None:
        """Take one event."""
        if event.kind not in self.kinds:
            return
        if self._echo:
            typer.echo(f"{event.time_s:9.3f} {event.kind:9} {event.file}:{event.line} {event.text}")
        elif len(self.events) < self.MAX_EVENTS:
            self.events.append(event)


def _assign(krc: SoftwareKrc, assignment: str) -> None:
    try:
        krc.assign(assignment)
    except KrlError as error:
        msg = f"--set {assignment}: {error.text}"
        raise UsageError(msg) from error


def _drawn(pen: PathPen, title: str) -> bytes:
    try:
        return draw_path(pen.segments, title=title, marks=pen.marks).encode()
    except ValueError as error:
        msg = f"--picture: {error}"
        raise SlabcellError(msg) from error


def _wanted(trace: str) -> frozenset[str]:
    words = [word.strip() for word in trace.split(",") if word.strip()]
    for word in words:
        if word not in _KINDS:
            msg = f"--trace {word}: not one of {', '.join(TRACES)}"
            raise UsageError(msg)
    return frozenset(_KINDS[word] for word in words)


def _robot(name: str) -> ArmModel:
    """Return a known arm, or that of a controller's $machine.dat."""
    path = Path(name)
    try:
        return parse_machine_data(path.read_bytes()).arm if path.is_file() else arm_by_name(name)
    except MachineDataError as error:
        msg = f"--robot {name}: {error}"
        raise UsageError(msg) from error
    except ValueError as error:
        msg = f"--robot: {error}; or give the path of a $machine.dat"
        raise UsageError(msg) from error


def _speed(text: str) -> float | None:
    if text == "max":
        return None
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.001 <= value <= 1000.0:
        msg = f"--speed {text}: a number from 0.001 to 1000, or max"
        raise UsageError(msg)
    return value


def _address(text: str) -> tuple[str, tuple[str, int]]:
    channel, _, rest = text.partition("=")
    host, _, port = rest.rpartition(":")
    if not channel or not host or not port.isdigit() or not 1 <= int(port) <= 65535:
        msg = f"--address {text}: expected CHANNEL=HOST:PORT"
        raise UsageError(msg)
    return channel, (host, int(port))


def _channels(folder: Path) -> dict[str, bytes]:
    if not folder.is_dir():
        msg = f"{folder}: there is no such folder; --eki takes the folder that holds the channels' .xml files"
        raise UsageError(msg)
    return {path.stem: path.read_bytes() for path in sorted(folder.rglob("*")) if path.suffix.lower() == ".xml"}
