"""`slabcell calibration`: see, collect, compute and activate calibrations on a running cell."""

import json
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

import typer
from rich.table import Table

from slabcell.calibration import parse_pose
from slabcell.cli.files import read_file
from slabcell.cli.talk import AsJson, Socket, client, make_console, print_json
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


_CHECKED = ("lens_rms_px", "lift_mm", "tilt_deg", "scale_ppm")


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
    make_console().print(table)


@calibration_app.command("show")
def show_command(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Which one; none: the one in use.")] = None,
    socket: Socket = None,
) -> None:
    """Print a calibration, as its file is."""
    path = "/v1/calibration" if name is None else f"/v1/calibrations/{quote(name, safe='')}"
    typer.echo(json.dumps(client(socket).get(path)["calibration"], indent=1))


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
    fixed: Annotated[
        bool, typer.Option("--fixed", help="The board is always in the same place: tell sideways drift too.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Say whether the calibration in use still holds, by a board on the table.  Exit code 1 if it does not."""
    body = _body(socket, board, picture, board_thickness_mm=thickness_mm, limit_mm=limit_mm, fixed=fixed)
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
        str | None,
        typer.Option("--pose", metavar="X,Y,Z,A,B,C", help="Flange in the base, for hand-eye; robot: as it says."),
    ] = None,
    socket: Socket = None,
) -> None:
    """Take a picture of the board and keep its points as a view to calibrate with."""
    body = _body(socket, board, picture, pose=None if pose is None else _pose(pose))
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


@calibration_app.command("survey")
def survey_command(
    kind: Annotated[str, typer.Argument(metavar="camera|plane|hand-eye", help="What is to be computed.")] = "camera",
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Say what the views cover, and which pictures are missing yet."""
    document = client(socket).get("/v1/calibration/survey", kind=kind)
    if as_json:
        print_json(document)
        return
    for stand in document["stands"]:
        said = f"{stand['name']}: tilted by {stand['tilt_deg']:.0f}°, {stand['distance_mm']:.0f} mm away"
        typer.echo(f"{said}, its face turned {stand['towards']}")
    if document["coverage"] is not None:
        typer.echo(f"{document['coverage']['hull_fraction']:.0%} of the picture covered")
    for item in document["advice"]:
        typer.echo(f"to do: {item['text']}")
    if not document["advice"]:
        typer.echo("these views are good to calibrate with")


@calibration_app.command("pose")
def pose_command(
    view: Annotated[int, typer.Argument(metavar="VIEW", help="Its number.")],
    pose: Annotated[str, typer.Argument(metavar="POSE", help="X,Y,Z,A,B,C of the flange; robot: as it says.")],
    socket: Socket = None,
) -> None:
    """Say where the robot was for a view."""
    document = client(socket).post(f"/v1/calibration/views/{view}/pose", {"pose": _pose(pose)})
    typer.echo(f"view {view}: robot at {', '.join(f'{value:g}' for value in document['pose'])}")


@calibration_app.command("poses")
def poses_command(
    file: Annotated[Path, typer.Argument(metavar="POSES.csv", help="image,X,Y,Z,A,B,C with a view's number as image.")],
    socket: Socket = None,
) -> None:
    """Say where the robot was for many views, from a table."""
    document = client(socket).send("/v1/calibration/poses", read_file(file), "text/csv")
    known = sum(item["pose"] is not None for item in document["views"])
    typer.echo(f"{known} of {len(document['views'])} views know where the robot was")


@calibration_app.command("compare")
def compare_command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The one after.")],
    base: Annotated[str, typer.Argument(metavar="BEFORE", help="The one before; the one in use if not given.")] = "",
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Hold two calibrations against each other: their figures, and by how much points on the table move."""
    document = client(socket).get(f"/v1/calibrations/{quote(name, safe='')}/compare", base=base)
    if as_json:
        print_json(document)
        return
    table = Table("", document["before"], document["after"])
    before, after = document["figures_before"], document["figures_after"]
    for key in before:
        if key != "warnings" and (before[key], after[key]) not in {(None, None), ("", "")}:
            table.add_row(key, *("" if item[key] is None else str(item[key]) for item in (before, after)))
    make_console().print(table)
    drift = document["drift"]
    if drift is not None:
        typer.echo(f"points on the table move by {drift['mean_mm']:.3f} mm, {drift['worst_mm']:.3f} at most")


@calibration_app.command("checks")
def checks_command(
    limit: Annotated[int, typer.Option("--limit", min=1, max=2000, help="So many, the newest of them.")] = 30,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """List what checks found over time."""
    document = client(socket).get("/v1/calibration/checks", limit=limit)
    if as_json:
        print_json(document)
        return
    table = Table("at", "calibration", "", "corners px", "lift mm", "tilt °", "scale ppm", "moved mm (worst)")
    for item in document["checks"]:
        board, drift = item["board"], item["drift"]
        numbers = (f"{board[key]:.3f}" if board[key] is not None else "" for key in _CHECKED)
        table.add_row(
            *(item["at"][:19], item["calibration"], "holds" if item["ok"] else "does not hold", *numbers),
            "" if drift is None else f"{drift['worst_mm']:.3f}",
        )
    make_console().print(table)


@calibration_app.command("robot")
def robot_command(socket: Socket = None, *, as_json: AsJson = False) -> None:
    """Print where the robot says that its flange is: X Y Z in mm, A B C in degrees, in its base."""
    document = client(socket).get("/v1/calibration/robot-pose")
    if as_json:
        print_json(document)
    else:
        typer.echo(",".join(f"{value:.3f}" for value in document["pose"]))


@calibration_app.command("remove")
def remove_command(
    view: Annotated[int, typer.Argument(metavar="VIEW", help="Its number.")], socket: Socket = None
) -> None:
    """Forget one view."""
    typer.echo(client(socket).post(f"/v1/calibration/views/{view}/remove")["detail"])


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


def _pose(text: str) -> str | list[float]:
    return text if text == "robot" else list(parse_pose(text, "the pose").frame)


def _body(socket: Path | None, board: str, picture: str, **rest: object) -> dict[str, Any]:
    api = client(socket)
    if picture == "new":
        api.post("/v1/frames/take")
        picture = "latest"
    return {"board": board, "picture": chosen_picture(api, picture), **rest}
