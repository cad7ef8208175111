"""Are the cell's files in order?  Configuration, recipe, calibration, robot programs and the state directory."""

from __future__ import annotations

import json
import os
import shutil
import stat
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from importlib import resources
from pathlib import Path

from slabcell.calibration import load_calibration
from slabcell.cell.ledger import LedgerFile
from slabcell.recipe import load_recipe
from slabcell.service.calibrations import CalibrationShelf
from slabcell.service.config import CellConfig
from slabcell.service.config_layers import load_layers
from slabcell.service.doctor import Patient, Severity
from slabcell_drivers.robot.eki.consistency import check as check_programs

__all__ = ["look_at_calibration", "look_at_clock", "look_at_configuration", "look_at_programs", "look_at_recipe"]
__all__ += ["look_at_state"]

Answers = Iterator[tuple[Severity, str, str]]

OLD_CALIBRATION = timedelta(days=365)
FIRST_YEAR = 2026  # slabcell did not exist before: an earlier clock is wrong
PROGRAM_ENDINGS = (".src", ".dat", ".xml")


def look_at_configuration(patient: Patient) -> Answers:
    """Read the configuration as the daemon does."""
    loaded = load_layers(patient.path)
    patient.config = loaded.config
    yield Severity.OK, f"{', '.join(map(str, loaded.files))}: in order", ""


def look_at_recipe(patient: Patient) -> Answers:
    """Read recipe and template."""
    if patient.config is None:
        return
    patient.recipe = load_recipe(patient.config.recipe)
    slots = len(patient.recipe.template.slots)
    yield Severity.OK, f"{patient.config.recipe}: {slots} slots, {patient.recipe.thickness_mm:g} mm thick", ""


def look_at_calibration(patient: Patient) -> Answers:
    """Read the calibration that is in use after a start; say how old it is."""
    if patient.config is None:
        return
    configured = patient.config.calibration
    path = CalibrationShelf(configured, _state_folder(patient.config)).active
    if path is None or not path.exists():
        how = "make one on page Calibrate or with `slabcell calibration`, and activate it; the cell starts without"
        what = "the configuration names none, and none was activated" if path is None else f"{path} is not there"
        yield Severity.ERROR, f"there is no calibration: {what}", how
        return
    patient.calibration = load_calibration(path)
    patient.calibration.require_plane()
    yield Severity.OK, f"{path}: of camera {patient.calibration.camera.serial or 'without a serial number'}", ""
    created = json.loads(path.read_bytes()).get("created")
    if created is None:
        yield Severity.NOTE, f"{path}: does not say when it was made", ""
        return
    age = datetime.now(UTC) - datetime.fromisoformat(created).astimezone(UTC)
    if age > OLD_CALIBRATION:
        how = "look whether it still holds: `slabcell calibrate check` with one picture of the board"
        yield Severity.WARNING, f"{path}: is {age.days} days old", how


def _state_folder(config: CellConfig) -> Path:
    return config.state_directory or Path(os.environ.get("STATE_DIRECTORY") or "/var/lib/slabcell")


def look_at_programs(patient: Patient) -> Answers:
    """Compare the shipped robot programs and EKI files with the telegrams of this version.

    What was copied to the controller is checked by `slabcell krl check FOLDER`.
    """
    del patient
    folder = resources.files("slabcell") / "data" / "krl"
    files = {item.name: item.read_bytes() for item in folder.iterdir() if item.name.lower().endswith(PROGRAM_ENDINGS)}
    findings = check_programs(files)
    for finding in findings:
        severity = Severity.ERROR if finding.severity == "error" else Severity.WARNING
        yield severity, f"{finding.file}:{finding.line}: {finding.message}", "install slabcell again"
    if not findings:
        how = "compare what lies on the controller with `slabcell krl check FOLDER`"
        yield Severity.OK, f"the {len(files)} files of the robot fit this version's telegrams", how


def look_at_state(patient: Patient) -> Answers:
    """Look at rights and room of the state directory, and at the ledger."""
    if patient.config is None:
        return
    named = _state_folder(patient.config)
    if not named.is_dir():
        how = "start the service, which makes it, or correct state_directory"
        yield Severity.WARNING, f"{named}: is not there", how
        return
    patient.state = named
    mode = stat.S_IMODE(named.stat().st_mode)
    if mode & 0o007:
        yield Severity.WARNING, f"{named}: everybody may look into it (mode {mode:04o})", f"chmod o= {named}"
    if not os.access(named, os.W_OK):
        yield Severity.NOTE, f"{named}: you may not write there; look as the user slabcell or as root", ""
    free_mib = shutil.disk_usage(named).free >> 20
    wanted_mib = patient.config.bundles.min_free_mib
    if free_mib < wanted_mib:
        how = "free some space, or let bundles be kept for less long: [bundles] in the configuration"
        yield Severity.ERROR, f"{named}: {free_mib} MiB are free; below {wanted_mib} MiB no bundle is kept", how
    else:
        yield Severity.OK, f"{named}: {free_mib} MiB are free", ""
    damaged = sorted(path.name for path in named.glob("*.corrupt.*"))
    if damaged:
        yield (
            Severity.WARNING,
            f"{named}: holds damaged files that were set aside: {', '.join(damaged)}",
            "see errors.md",
        )
    ledger = named / "ledger.sqlite"
    if ledger.exists() and os.access(ledger, os.R_OK):
        book = LedgerFile(ledger, copy=True)  # the file itself would be brought up to date by opening it
        try:
            unknown = [row for row in book.rows("offers") if row["state"] == "unknown"]
        finally:
            book.close()
        for row in unknown:
            how = f"look at the slot, then `slabcell ledger resolve {row['result_id']} placed|failed`"
            yield Severity.WARNING, f"nobody knows what became of result {row['result_id']}, slot {row['slot']}", how
        if not unknown:
            yield Severity.OK, f"{ledger}: in order", ""


def look_at_clock(patient: Patient) -> Answers:
    """Ask whether the clock can be right."""
    now = datetime.now(UTC)
    if now.year < FIRST_YEAR:
        how = "set the clock, or give the PC a time server: the times in records would be wrong, nothing else"
        yield Severity.WARNING, f"the clock says {now:%Y-%m-%d}", how
        return
    if patient.state is not None:
        newest = max((path.stat().st_mtime for path in patient.state.iterdir()), default=0.0)
        if newest > time.time() + 60.0:
            ahead = datetime.fromtimestamp(newest, UTC)
            how = "find out which of the two clocks was wrong"
            yield Severity.WARNING, f"the newest file of the state is of {ahead:%Y-%m-%d %H:%M} UTC: the future", how
            return
    yield Severity.OK, f"the clock says {now:%Y-%m-%d %H:%M} UTC", ""
