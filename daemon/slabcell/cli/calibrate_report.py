"""What does a person, or a program, get to see of a calibration?  Tables for the terminal, objects for ``--json``."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Column, Table

from slabcell.calibration import BoardCheck, CameraResult, Drift, HandEyeResult, PlaneResult

__all__ = ["print_camera", "print_check", "print_hand_eye", "print_plane"]


def print_camera(result: CameraResult, out: Path, failures: Sequence[str]) -> None:
    """Print the views, the lens and the warnings."""
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


def print_plane(result: PlaneResult, out: Path, failures: Sequence[str]) -> None:
    """Print the board positions, the touched points and the warnings."""
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


def print_hand_eye(result: HandEyeResult, out: Path, failures: Sequence[str]) -> None:
    """Print the stations, the places and the warnings."""
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


def print_check(found: BoardCheck | None, drift: Drift | None, problems: Sequence[str]) -> None:
    """Print what a check found."""
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
