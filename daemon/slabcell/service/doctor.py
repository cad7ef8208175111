"""What is wrong with this cell, and what is there to do?  Looks at one thing after the other, and names what it finds.

Nothing is changed by looking.  A check that cannot be made is itself a finding; one that was made and found nothing
wrong is one of severity ``ok``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from slabcell.calibration import Calibration
from slabcell.errors import SlabcellError
from slabcell.recipe import Recipe
from slabcell.service.config import CellConfig

__all__ = ["Check", "Finding", "Patient", "Severity", "examine"]


class Severity(StrEnum):
    """How bad it is: with an error the cell does not work."""

    OK = "ok"
    NOTE = "note"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was found.

    ``number`` is the check's; its page is ``docs``, a path in the documentation.  ``remedy`` says what to do, and is
    empty where there is nothing to do.
    """

    number: int
    severity: Severity
    subject: str
    detail: str
    remedy: str = ""
    docs: str = ""


@dataclass(slots=True)
class Patient:
    """What is looked at; the configuration's check fills in what the later ones need."""

    path: Path
    root: Path = Path("/")
    config: CellConfig | None = None
    recipe: Recipe | None = None
    calibration: Calibration | None = None
    state: Path | None = None


@dataclass(frozen=True, slots=True)
class Check:
    """One question: its number, what it is about, where that is described, and what answers it."""

    number: int
    subject: str
    docs: str
    answer: Callable[[Patient], Iterable[tuple[Severity, str, str]]]
    """Gives severity, what was found, and what to do."""


def examine(patient: Patient, checks: Iterable[Check]) -> Iterator[Finding]:
    """Give what each check finds, as soon as it is known."""
    for check in checks:
        said = False
        try:
            for severity, detail, remedy in check.answer(patient):
                said = True
                yield Finding(check.number, severity, check.subject, detail, remedy, check.docs)
        except (SlabcellError, OSError) as error:
            said = True
            yield Finding(check.number, Severity.ERROR, check.subject, str(error), "", check.docs)
        except Exception as error:  # noqa: BLE001 - the other checks are still worth their answer
            said = True
            detail = f"this check failed itself: {type(error).__name__}: {error}"
            yield Finding(check.number, Severity.WARNING, check.subject, detail, "report it", check.docs)
        if not said:
            yield Finding(check.number, Severity.NOTE, check.subject, "cannot be looked at", "", check.docs)
