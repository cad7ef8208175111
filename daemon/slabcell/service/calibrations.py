"""Which calibration is in use?  The one that was activated last, else that of the configuration.

Calibrations that were made or uploaded over the control API lie in the state directory, each under a name of its own;
none is ever overwritten.  The choice is a file beside them, so that it survives a restart; one that names a calibration
that is gone is an error, and never a silent return to another.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Final, cast

from slabcell.calibration import Calibration, calibration_from_document, calibration_to_document, load_calibration
from slabcell.catalogue import Fault
from slabcell.errors import CalibrationError
from slabcell.service.atomic import write_atomically
from slabcell.service.calibration_checks import CheckLog
from slabcell.service.choice import read_choice

__all__ = ["CONFIGURED", "CalibrationEntry", "CalibrationShelf"]

SCHEMA: Final = "slabcell.active-calibration/1"
CONFIGURED: Final = "configured"
"""What the calibration of the configuration is called."""
MAX_CALIBRATIONS: Final = 500


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationEntry:
    """One calibration; ``problem`` says what is wrong with its file, empty if nothing is."""

    name: str
    created: str
    sha256: str
    calibration: Calibration | None
    problem: str


class CalibrationShelf:
    """The calibrations of one cell.  Methods block: run them in a thread."""

    def __init__(self, configured: Path | None, state: Path) -> None:
        self._configured = configured
        self._folder = state / "calibrations"
        self._choice = state / "active-calibration.json"
        self.checks = CheckLog(state / "calibration-checks.jsonl")
        """What checks of the calibrations found."""

    @property
    def chosen(self) -> str:
        """The name of the calibration in use.  Raises CalibrationError if the choice cannot be read, or is gone."""
        try:
            name = read_choice(self._choice, SCHEMA, "calibration")
        except OSError as error:
            msg = f"{self._choice}: cannot be read: {error.strerror}"
            raise CalibrationError(msg, number=Fault.CALIBRATION_MISSING) from error
        if name is None:
            return CONFIGURED
        if self._find(name) is None:
            said = f"names calibration {name!r:.60}, which is not there" if name else "is damaged"
            msg = f"{self._choice}: {said}; delete this file to go by the configuration, or restore the calibration"
            raise CalibrationError(msg, number=Fault.CALIBRATION_MISSING)
        return name

    @property
    def active(self) -> Path | None:
        """The file in use; None where neither choice nor configuration names one.  Raises CalibrationError."""
        return self._find(self.chosen)

    def _find(self, name: str) -> Path | None:
        if name == CONFIGURED:
            return self._configured
        path = self._folder / f"{name}.json"
        return path if name and Path(name).name == name and path.is_file() else None

    def path_of(self, name: str) -> Path:
        """Return the file of a calibration.  Raises CalibrationError."""
        path = self._find(name)
        if path is None:
            msg = f"there is no calibration {name!r:.60} in {self._folder}"
            raise CalibrationError(msg, number=Fault.CALIBRATION_MISSING)
        return path

    def entries(self) -> list[CalibrationEntry]:
        """Return every calibration, the newest first, that of the configuration last."""
        names = sorted((path.stem for path in self._folder.glob("*.json")), reverse=True)[:MAX_CALIBRATIONS]
        return [self._entry(name) for name in [*names, CONFIGURED] if self._find(name) is not None]

    def _entry(self, name: str) -> CalibrationEntry:
        path = self.path_of(name)
        try:
            raw = path.read_bytes()
            found = load_calibration(path)
            created = str(cast("dict[str, object]", json.loads(raw)).get("created", ""))
        except (CalibrationError, OSError, ValueError) as error:
            return CalibrationEntry(name, "", "", None, str(error))
        return CalibrationEntry(name, created, sha256(raw).hexdigest(), found, "")

    def save(self, calibration: Calibration) -> str:
        """Keep a calibration under a new name; return the name.  Raises CalibrationError."""
        document = calibration_to_document(calibration)
        calibration_from_document(document, "the calibration")  # nothing is kept that could not be read again
        content = json.dumps(document, indent=1, allow_nan=False).encode() + b"\n"
        name = f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{sha256(content).hexdigest()[:8]}"
        try:
            self._folder.mkdir(exist_ok=True)
            kept = len(list(self._folder.glob("*.json")))
            if kept >= MAX_CALIBRATIONS:
                msg = f"{self._folder} holds {kept} calibrations, the limit: delete some that are not in use"
                raise CalibrationError(msg)
            write_atomically(self._folder / f"{name}.json", content)
        except OSError as error:
            msg = f"{self._folder}: cannot be written: {error.strerror}"
            raise CalibrationError(msg, number=Fault.STATE_UNWRITABLE) from error
        return name

    def choose(self, name: str) -> None:
        """Have a calibration be the one in use from the next start on.  Raises CalibrationError."""
        self.path_of(name)
        try:
            write_atomically(self._choice, json.dumps({"schema": SCHEMA, "calibration": name}).encode())
        except OSError as error:
            msg = f"{self._choice}: cannot be written: {error.strerror}"
            raise CalibrationError(msg, number=Fault.STATE_UNWRITABLE) from error
