"""`slabcell calibration`: see, collect, compute and activate calibrations on a running cell."""

import json
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

import typer
from rich.console import Console
from rich.table import Table

from slabcell.calibration import parse_pose
from slabcell.cli.files import read_file
from slabcell.cli.talk import AsJson, Socket, client, print_json
from slabcell.cli.vision import chosen_picture
from slabcell.errors import UsageError

__all__ = ["calibration_app"]

calibration_app = typer.Typer(no_args_is_help=True)

BoardText = Annotated[str, typer.Option("--board", metavar="BOARD", help="As for `slabcell calibrate`.")]
PictureName = Annotated[
    str, typer.Option("--picture", metavar="PICTURE", help="latest, new (take one), cycle:NUMBER, or a picture file.")
]
Thickness = Annotated[
    float, typer.Option("--board-thickness-mm", metavar="MM", help="Height of the printed face above the table.")
]


@calibration_app.command("list")
def list_command(socket: Socket = None, *, as_json: AsJson = False) -> None:
    """List the cell's calibrations, and how far each is from the one in use."""
    document = client(socket).get("/v1/calibrations")
    if as_json:
        print_json(document)
        return
    table = Table("calibration", "in use", "made", "camera", "rms px", "drift mm (worst)", "")
    for item in document["calibrations"]:
        drift = item["drift"]
        table.add_row(
            item["name"],
            "in use" if item["active"] else "",
            item["created"],
            f"{item['serial']} {item['width']}x{item['height']}",
            "" if item["rms_px"] is None else f"{item['rms_px']:.3f}",
            "" if drift is None else f"{drift['mean_mm']:.3f} ({drift['worst_mm']:.3f})",
            item["problem"] or ("" if item["has_plane"] else "no plane"),
        )
    Console().print(table)


@calibration_app.command("show")
def show_command(socket: Socket = None) -> None:
    """Print the calibration in use, as its file is."""
    typer.echo(json.dumps(client(socket).get("/v1/calibration")["calibration"], indent=1))


@calibration_app.command("upload")
def upload_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What `slabcell calibrate` wrote.")],
    socket: Socket = None,
) -> None:
    """Give the cell a calibration of its camera.  It is not in use yet."""
    typer.echo(client(socket).send("/v1/calibrations", read_file(file), "application/json")["name"])


@calibration_app.command("activate")
def activate_command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="As `slabcell calibration list` shows it.")],
    socket: Socket = None,
) -> None:
    """Have the cell work with another calibration, between jobs."""
    typer.echo(client(socket).post(f"/v1/calibrations/{quote(name, safe='')}/activate")["detail"])


@calibration_app.command("check")
def check_command(
    board: BoardText,
    picture: PictureName = "latest",
    thickness_mm: Thickness = 0.0,
    limit_mm: Annotated[float, typer.Option("--limit-mm", help="Drift above which the check fails.")] = 0.2,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Say whether the calibration in use still holds, by a board on the table.  Exit code 1 if it does not."""
    body = _body(socket, board, picture, board_thickness_mm=thickness_mm, limit_mm=limit_mm)
    document = client(socket).post("/v1/calibration/check", body)
    if as_json:
        print_json(document)
    else:
        typer.echo("\n".join(document["problems"]) or "the calibration holds")
    if not document["ok"]:
        raise typer.Exit(1)


@calibration_app.command("detect")
def detect_command(
    board: BoardText, picture: PictureName = "latest", socket: Socket = None, *, as_json: AsJson = False
) -> None:
    """Find the board in a picture.  Exit code 1 if it is not in it."""
    document = client(socket).post("/v1/calibration/detect", _body(socket, board, picture))
    if as_json:
        print_json(document)
    else:
        typer.echo(document["problem"] or f"{len(document['points'])} points found {document['note']}".strip())
    if not document["found"]:
        raise typer.Exit(1)


@calibration_app.command("collect")
def collect_command(
    board: BoardText,
    picture: PictureName = "new",
    pose: Annotated[
        str | None, typer.Option("--pose", metavar="X,Y,Z,A,B,C", help="Flange in the base, for hand-eye.")
    ] = None,
    socket: Socket = None,
) -> None:
    """Take a picture of the board and keep its points as a view to calibrate with."""
    body = _body(socket, board, picture, pose=None if pose is None else list(parse_pose(pose, "--pose").frame))
    document = client(socket).post("/v1/calibration/views", body)
    typer.echo(f"view {document['view']}: {document['points']} points")


@calibration_app.command("views")
def views_command(socket: Socket = None, *, as_json: AsJson = False) -> None:
    """List the views that were collected."""
    document = client(socket).get("/v1/calibration/views")
    if as_json:
        print_json(document)
        return
    for item in document["views"]:
        pose = "" if item["pose"] is None else f", robot at {', '.join(f'{value:g}' for value in item['pose'])}"
        typer.echo(f"view {item['view']}: {item['board']}, {item['points']} points{pose}")


@calibration_app.command("clear")
def clear_command(socket: Socket = None) -> None:
    """Forget every view."""
    typer.echo(client(socket).post("/v1/calibration/clear")["detail"])


@calibration_app.command("run")
def run_command(
    kind: Annotated[str, typer.Argument(metavar="camera|plane|hand-eye", help="What is to be computed.")],
    options: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=JSON", help="Any key of the request, e.g. --set 'board_thickness_mm=5'."),
    ] = None,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Compute a calibration from the views, beside the cell's work, and keep it.  It is not in use yet."""
    body: dict[str, Any] = {"kind": kind}
    for text in options or []:
        key, equals, value = text.partition("=")
        if not equals:
            msg = f"--set {text!r:.60}: write KEY=VALUE, with VALUE as JSON"
            raise UsageError(msg)
        try:
            body[key] = json.loads(value)
        except ValueError:
            body[key] = value
    api = client(socket)
    document = api.follow(api.post("/v1/calibration/run", body))
    if as_json:
        print_json(document)
        return
    report = document["report"]
    for warning in report["warnings"]:
        typer.echo(f"warning: {warning}")
    if "rms_px" in report:
        typer.echo(f"residual {report['rms_px']:.3f} px")
    typer.echo(document["calibration"])


def _body(socket: Path | None, board: str, picture: str, **rest: object) -> dict[str, Any]:
    api = client(socket)
    if picture == "new":
        api.post("/v1/frames/take")
        picture = "latest"
    return {"board": board, "picture": chosen_picture(api, picture), **rest}
