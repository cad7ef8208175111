"""`slabcell calibrate`: pictures of a board in, a calibration file out, and what to think of it."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from slabcell.calibration import (
    Board,
    BoardCheck,
    Detection,
    Drift,
    HandEyeMethod,
    LensModel,
    Mount,
    calibrate_camera,
    calibrate_hand_eye,
    calibrate_plane,
    check_board,
    detect_board,
    detect_boards,
    drift_of_board,
    drift_of_marks,
    load_calibration,
    load_marks,
    load_poses,
    load_touch,
    parse_pose,
    save_calibration,
)
from slabcell.calibration.coverage import draw_coverage
from slabcell.calibration.detection import Picture
from slabcell.calibration.report import camera_document, hand_eye_document, plane_document
from slabcell.cli.calibrate_report import (
    print_camera,
    print_check,
    print_hand_eye,
    print_plane,
)
from slabcell.cli.files import write_file
from slabcell.errors import CalibrationError, ImageError, UsageError
from slabcell.images import encode_image, read_image

__all__ = ["calibrate_app"]

calibrate_app = typer.Typer(help="Make a calibration from images of a board.", no_args_is_help=True)

BoardText = Annotated[
    str,
    typer.Option(
        "--board",
        metavar="BOARD",
        help="checkerboard:12x9:25 (inner corners in a row x in a column : square in mm), charuco:... or circles:...",
    ),
]
Out = Annotated[Path, typer.Option("--out", metavar="FILE", help="Calibration file to write.")]
Images = Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="PNG, JPEG or TIFF pictures of the board.")]
CalibrationFile = Annotated[
    Path, typer.Option("--calibration", metavar="FILE", help="What `slabcell calibrate camera` wrote.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]


@calibrate_app.command("camera")
def camera_command(
    images: Images,
    board: BoardText,
    out: Out,
    model: Annotated[
        LensModel, typer.Option("--model", help="Lens: Brown's with 4, 5, 8 or 14 coefficients, or fisheye.")
    ] = "brown5",
    serial: Annotated[str, typer.Option("--serial", help="Serial number of the camera; the file is bound to it.")] = "",
    offset_x: Annotated[int, typer.Option("--offset-x", min=0, max=65535, help="OffsetX of the camera's region.")] = 0,
    offset_y: Annotated[int, typer.Option("--offset-y", min=0, max=65535, help="OffsetY of the camera's region.")] = 0,
    binning: Annotated[int, typer.Option("--binning", min=1, max=64, help="Binning of the camera.")] = 1,
    coverage: Annotated[
        Path | None,
        typer.Option("--coverage", metavar="PNG", help="Draw where the board was seen, with residuals x100."),
    ] = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Find the lens of a camera from 10 to 20 pictures of a board in different places and tilts (Zhang's method)."""
    shown = Board.parse(board)
    detections, failures = _detect(images, shown, quiet=as_json)
    result = calibrate_camera(
        detections, shown, model=model, serial=serial, offset=(offset_x, offset_y), binning=binning
    )
    save_calibration(out, result.calibration)
    if coverage is not None:
        write_file(coverage, encode_image(draw_coverage(result.coverage, result.residuals), str(coverage)))
    if as_json:
        typer.echo(json.dumps(camera_document(result, str(out), failures)))
    else:
        print_camera(result, out, failures)


@calibrate_app.command("plane")
def plane_command(
    images: Images,
    calibration: CalibrationFile,
    board: BoardText,
    out: Out,
    board_thickness_mm: Annotated[
        float, typer.Option("--board-thickness-mm", metavar="MM", help="Height of the printed face above the table.")
    ] = 0.0,
    touch: Annotated[
        Path | None,
        typer.Option(
            "--touch", metavar="POINTS.csv", help="Points that the robot touched: image,column,row,x,y or u,v,x,y."
        ),
    ] = None,
    *,
    affine: Annotated[
        bool | None,
        typer.Option(
            "--affine/--rigid", help="What touched points may do to the frame; decided by hold-out if not given."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find the table from pictures of the board lying on it; five places over the work area are good.

    Without touched points the first picture's board is the table's frame: origin at its first inner corner (the one
    beside the dark corner square), X along the rows, Z up.
    """
    before = load_calibration(calibration)
    shown = Board.parse(board)
    touched = load_touch(touch) if touch is not None else []
    if affine is not None and touch is None:
        raise UsageError("--affine and --rigid say how touched points are fitted: give --touch POINTS.csv as well")
    detections, failures = _detect(images, shown, quiet=as_json)
    needs_first = not touched or any(t.pixel is None and not t.image for t in touched)
    if needs_first and detections[0].name != str(images[0]):
        raise ImageError(f"{failures[0]} (the first picture's board is the one that counts)")
    result = calibrate_plane(
        before, detections, shown, board_thickness_mm=board_thickness_mm, touch=touched, affine=affine
    )
    save_calibration(out, result.calibration)
    if as_json:
        typer.echo(json.dumps(plane_document(result, str(out), failures)))
    else:
        print_plane(result, out, failures)


@calibrate_app.command("hand-eye")
def hand_eye_command(
    images: Images,
    calibration: CalibrationFile,
    board: BoardText,
    poses: Annotated[
        Path,
        typer.Option(
            "--poses",
            metavar="POSES.csv",
            help="image,X,Y,Z,A,B,C: flange in the base, mm, degrees, R = Rz(A) Ry(B) Rx(C).",
        ),
    ],
    mount: Annotated[
        Mount,
        typer.Option("--mount", help="eye-to-hand: the flange holds the board. eye-in-hand: it holds the camera."),
    ],
    out: Out,
    method: Annotated[HandEyeMethod, typer.Option("--method", help="How it is solved.")] = "joint",
    robot_mm: Annotated[
        float | None,
        typer.Option(
            "--robot-mm", min=1e-4, max=100, help="Standard deviation of a robot pose, mm; estimated if not given."
        ),
    ] = None,
    robot_deg: Annotated[
        float | None,
        typer.Option(
            "--robot-deg", min=1e-5, max=45, help="Standard deviation of a robot pose, degrees; estimated if not given."
        ),
    ] = None,
    photo_pose: Annotated[
        str | None,
        typer.Option(
            "--photo-pose", metavar="X,Y,Z,A,B,C", help="For eye-in-hand: the flange when the table was calibrated."
        ),
    ] = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Find where the camera sits, from pictures of a board and the robot's pose at each; 15 are good."""
    before = load_calibration(calibration)
    shown = Board.parse(board)
    known = load_poses(poses)
    stand = None if photo_pose is None else parse_pose(photo_pose, "--photo-pose")
    detections, failures = _detect(images, shown, quiet=as_json)
    result = calibrate_hand_eye(
        before,
        detections,
        known,
        shown,
        mount,
        method=method,
        robot_mm=robot_mm,
        robot_deg=robot_deg,
        photo_pose=stand,
    )
    save_calibration(out, result.calibration)
    if as_json:
        typer.echo(json.dumps(hand_eye_document(result, str(out), failures)))
    else:
        print_hand_eye(result, out, failures)


@calibrate_app.command("check")
def check_command(
    image: Annotated[
        Path, typer.Argument(metavar="IMAGE", help="A new picture: of the board, or of marks that never move.")
    ],
    calibration: CalibrationFile,
    board: Annotated[
        str | None,
        typer.Option("--board", metavar="BOARD", help="The board that lies on the table, as in the calibration."),
    ] = None,
    board_thickness_mm: Annotated[
        float, typer.Option("--board-thickness-mm", metavar="MM", help="Height of the printed face above the table.")
    ] = 0.0,
    reference: Annotated[
        Path | None,
        typer.Option(
            "--reference",
            metavar="IMAGE",
            help="An older picture of the same fixed board or marks, for sideways drift.",
        ),
    ] = None,
    marks: Annotated[
        Path | None,
        typer.Option("--marks", metavar="MARKS.csv", help="u,v: pixels of fixed marks in the older picture."),
    ] = None,
    limit_mm: Annotated[
        float, typer.Option("--limit-mm", min=0.001, max=100, help="Drift above which the check fails.")
    ] = 0.2,
    *,
    as_json: AsJson = False,
) -> None:
    """Measure how far a calibration drifted, on one new picture; exit code 1 if it no longer holds."""
    known = load_calibration(calibration)
    if (board is None) == (marks is None):
        raise UsageError("a check needs either --board or --marks")
    if marks is not None and reference is None:
        raise UsageError("--marks are pixels of an older picture: give it with --reference")
    found: BoardCheck | None = None
    drift: Drift | None = None
    problems: list[str] = []
    picture = read_image(image)
    if board is not None:
        shown = Board.parse(board)
        now = detect_board(picture, shown, str(image))
        found = check_board(known, now, shown, board_thickness_mm=board_thickness_mm, limit_mm=limit_mm)
        problems += found.problems
        if reference is not None:
            before = detect_board(read_image(reference), shown, str(reference))
            drift = drift_of_board(known, before, now, board_thickness_mm=board_thickness_mm)
    elif marks is not None and reference is not None:
        drift, missing = drift_of_marks(known, read_image(reference), picture, load_marks(marks))
        problems += [f"{image}: {line}" for line in missing]
    if drift is not None and drift.worst_mm > limit_mm:
        problems.append(
            f"{image}: what is fixed moved by {drift.worst_mm:.2f} mm at most ({drift.x_mm:+.2f}, {drift.y_mm:+.2f} mm,"
            f" {drift.turn_deg:+.3f}°), the limit is {limit_mm:g} mm: the camera was moved; calibrate the plane again"
        )
    if as_json:
        document = {
            "schema": "slabcell.calibrate-check/1",
            "image": str(image),
            "ok": not problems,
            "board": found.to_document() if found else None,
            "drift": drift.to_document() if drift else None,
            "problems": problems,
        }
        typer.echo(json.dumps(document))
    else:
        print_check(found, drift, problems)
    if problems:
        raise typer.Exit(1)


def _detect(paths: Sequence[Path], board: Board, *, quiet: bool) -> tuple[list[Detection], list[str]]:
    """Return the detections and one line for each picture without a board.  Raises if no picture shows it."""
    columns = (TextColumn("finding the board"), BarColumn(bar_width=24), MofNCompleteColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal, transient=True) as progress:
        task = progress.add_task("", total=len(paths))
        detections, failures = detect_boards(_read(paths), board, done=lambda _: progress.advance(task))
    if not detections:
        raise CalibrationError("no picture shows the board:\n  " + "\n  ".join(failures))
    return detections, failures


def _read(paths: Sequence[Path]) -> Iterator[tuple[str, Picture]]:
    for path in paths:
        yield str(path), read_image(path)
