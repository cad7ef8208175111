"""`slabcell calibrate`: pictures of a board in, a calibration file out, and what to think of it."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Column, Table

from slabcell.calibration import (
    Board,
    BoardCheck,
    CameraResult,
    Detection,
    Drift,
    HandEyeMethod,
    HandEyeResult,
    LensModel,
    Mount,
    PlaneResult,
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
    save_calibration,
)
from slabcell.calibration.coverage import draw_coverage
from slabcell.calibration.detection import Picture
from slabcell.errors import CalibrationError, ImageError, SlabcellError, UsageError
from slabcell.images import read_image

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
        _write_png(coverage, draw_coverage(result.coverage, result.residuals))
    if as_json:
        typer.echo(json.dumps(_camera_document(result, out, failures)))
    else:
        _print_camera(result, out, failures)


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
    if detections and detections[0].name != str(images[0]) and touch is None:
        raise ImageError(f"{failures[0]} (the first picture's board is the table's frame)")
    result = calibrate_plane(
        before, detections, shown, board_thickness_mm=board_thickness_mm, touch=touched, affine=affine
    )
    save_calibration(out, result.calibration)
    if as_json:
        typer.echo(json.dumps(_plane_document(result, out, failures)))
    else:
        _print_plane(result, out, failures)


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
    *,
    as_json: AsJson = False,
) -> None:
    """Find where the camera sits, from pictures of a board and the robot's pose at each; 15 are good."""
    before = load_calibration(calibration)
    shown = Board.parse(board)
    known = load_poses(poses)
    detections, failures = _detect(images, shown, quiet=as_json)
    result = calibrate_hand_eye(
        before, detections, known, shown, mount, method=method, robot_mm=robot_mm, robot_deg=robot_deg
    )
    save_calibration(out, result.calibration)
    if as_json:
        document = {"schema": "slabcell.calibrate-hand-eye/1", "out": str(out), **result.to_document()}
        typer.echo(json.dumps({**document, "not_found": failures}))
    else:
        _print_hand_eye(result, out, failures)


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
        _print_check(found, drift, problems)
    if problems:
        raise typer.Exit(1)


def _print_check(found: BoardCheck | None, drift: Drift | None, problems: Sequence[str]) -> None:
    console = Console()
    rows: list[tuple[str, str]] = []
    if found is not None:
        usual = "" if found.calibrated_rms_px is None else f" (calibrated with {found.calibrated_rms_px:.3f})"
        rows.append(("residual of the corners", f"{found.lens_rms_px:.3f} px{usual}"))
        if found.lift_mm is not None and found.tilt_deg is not None and found.scale_ppm is not None:
            rows.append(("the board lies", f"{found.lift_mm:+.3f} mm off the table, tilted by {found.tilt_deg:.3f}°"))
            rows.append(("scale on the table", f"{found.scale_ppm:+.0f} ppm"))
    if drift is not None:
        rows.append(
            ("drift", f"{drift.x_mm:+.3f}, {drift.y_mm:+.3f} mm, {drift.turn_deg:+.4f}°, {drift.scale_ppm:+.0f} ppm")
        )
        rows.append(
            ("points", f"{drift.points}, moved {drift.mean_mm:.3f} mm on average, {drift.worst_mm:.3f} mm at most")
        )
    table = Table("Checked", "Found")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    for line in problems:
        console.print(f"problem: {line}", style="red", highlight=False, markup=False)
    if not problems:
        console.print("the calibration holds", highlight=False)


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


def _write_png(path: Path, picture: npt.NDArray[np.uint8]) -> None:
    done, encoded = cv2.imencode(".png", picture)
    if not done:
        raise SlabcellError(f"{path}: the picture could not be encoded")
    try:
        path.write_bytes(encoded.tobytes())
    except OSError as error:
        raise SlabcellError(f"{path}: cannot be written: {error.strerror}") from error


def _camera_document(result: CameraResult, out: Path, failures: Sequence[str]) -> dict[str, object]:
    lens = result.calibration.lens
    return {
        "schema": "slabcell.calibrate-camera/1",
        "out": str(out),
        "rms_px": result.rms_px,
        "holdout_px": result.holdout_px if np.isfinite(result.holdout_px) else None,
        "focal_distance_correlation": result.focal_distance_correlation,
        "lens": {"model": lens.model, "matrix": lens.matrix.tolist(), "distortion": lens.distortion.tolist()},
        "std": result.std,
        "views": [
            {"name": v.name, "points": v.points, "rms_px": v.rms_px, "used": v.used, "tilt_deg": v.tilt_deg}
            for v in result.views
        ],
        "coverage": {
            "hull_fraction": result.coverage.hull_fraction,
            "reach_fraction": result.coverage.reach_fraction,
        },
        "not_found": list(failures),
        "warnings": list(result.warnings),
    }


def _plane_document(result: PlaneResult, out: Path, failures: Sequence[str]) -> dict[str, object]:
    plane = result.calibration.require_plane()
    return {
        "schema": "slabcell.calibrate-plane/1",
        "out": str(out),
        "rms_px": result.rms_px,
        "plane": {
            "rotation": plane.rotation.tolist(),
            "translation_mm": plane.translation.tolist(),
            "adjustment": plane.adjustment.tolist(),
        },
        "views": [
            {"name": v.name, "rms_px": v.rms_px, "rms_mm": v.rms_mm, "lift_mm": v.lift_mm, "tilt_deg": v.tilt_deg}
            for v in result.views
        ],
        "touch": result.touch.to_document() if result.touch else None,
        "not_found": list(failures),
        "warnings": list(result.warnings),
    }


def _print_camera(result: CameraResult, out: Path, failures: Sequence[str]) -> None:
    console = Console()
    table = Table("Picture", "Points", "RMS px", "Tilt °", "Distance mm", "")
    for v in result.views:
        state = "" if v.used else "left out"
        table.add_row(
            Path(v.name).name, str(v.points), f"{v.rms_px:.3f}", f"{v.tilt_deg:.1f}", f"{v.distance_mm:.0f}", state,
            style=None if v.used else "yellow",
        )  # fmt: skip
    console.print(table)
    m = result.calibration.lens.matrix
    std = result.std
    console.print(
        f"residual {result.rms_px:.3f} px (hold-out {result.holdout_px:.3f}); focal length {m[0, 0]:.2f} ± "
        f"{std['fx']:.2f}, {m[1, 1]:.2f} ± "
        f"{std['fy']:.2f} px;"
        f" principal point {m[0, 2]:.2f} ± {std['cx']:.2f}, {m[1, 2]:.2f} ± {std['cy']:.2f} px;"
        f" {result.coverage.hull_fraction:.0%} of the picture covered",
        highlight=False,
    )
    _print_end(console, [*failures, *result.warnings], out)


def _print_plane(result: PlaneResult, out: Path, failures: Sequence[str]) -> None:
    console = Console()
    table = Table("Picture", "Points", "RMS px", "RMS mm", "Stands off mm", "Tilt °")
    for v in result.views:
        table.add_row(
            Path(v.name).name,
            str(v.points),
            f"{v.rms_px:.3f}",
            f"{v.rms_mm:.4f}",
            f"{v.lift_mm:+.3f}",
            f"{v.tilt_deg:.3f}",
        )
    console.print(table)
    if result.touch is not None:
        fit = result.touch
        points = Table("Touched", "Residual mm")
        for name, residual in fit.residuals:
            points.add_row(name, f"{residual:.3f}")
        console.print(points)
        console.print(
            f"{fit.kind} frame from {len(fit.residuals)} touched points: residual {fit.residual_mm:.3f} mm, hold-out"
            f" {fit.holdout_mm:.3f} mm, robot's scale {fit.scale_ppm:+.0f} ppm",
            highlight=False,
        )
    _print_end(console, [*failures, *result.warnings], out)


def _print_hand_eye(result: HandEyeResult, out: Path, failures: Sequence[str]) -> None:
    console = Console()
    table = Table("Picture", "Off by px", "mm", "°", "")
    for r in result.stations:
        gone = r.name in result.left_out
        table.add_row(
            Path(r.name).name, f"{r.px:.2f}", f"{r.mm:.3f}", f"{r.deg:.3f}", "left out" if gone else "",
            style="yellow" if gone else None,
        )  # fmt: skip
    console.print(table)
    to_hand = result.mount == "eye-to-hand"
    frames = {
        "camera in the base" if to_hand else "camera on the flange": result.camera,
        "board on the flange" if to_hand else "board in the base": result.board,
    }
    if result.table is not None:
        frames["table in the base"] = result.table
    places = Table(Column(no_wrap=True), "X mm", "Y mm", "Z mm", "A °", "B °", "C °")
    for name, frame in frames.items():
        places.add_row(name, *(f"{v:.3f}" for v in frame))
    console.print(places)
    quality = (
        f"hold-out: {result.holdout_px:.2f} px, {result.holdout_mm:.3f} mm; spread of the result "
        f"{result.spread_mm:.3f} mm,"
        f" {result.spread_deg:.4f}°"
    )
    agreement = (
        f"robot against camera: {result.angle_disagreement_deg:.3f}° in angles, {result.axis_disagreement_mm:.3f} mm "
        "along"
        f" axes, scale {result.scale:.5f} ± {result.scale_std:.5f}"
    )
    lines = [quality, agreement]
    if result.robot_mm is not None and result.robot_deg is not None:
        lines.append(
            f"noise of a robot pose: {result.robot_mm:.3f} mm, {result.robot_deg:.4f}° (one standard deviation)"
        )
    for line in lines:
        console.print(line, highlight=False)
    _print_end(console, [*failures, *result.warnings], out)


def _print_end(console: Console, warnings: Sequence[str], out: Path) -> None:
    for line in warnings:
        console.print(f"warning: {line}", style="yellow", highlight=False, markup=False)
    console.print(str(out), highlight=False, markup=False)
