"""What can the bench be asked for?"""

from __future__ import annotations

from typing import Final

from slabcell.service.bench.boards import calibrate, check, detect, look_over
from slabcell.service.bench.grading import grade
from slabcell.service.bench.preview import preview
from slabcell.service.bench.templates import template
from slabcell.service.bench.work import Task, Work

__all__ = ["TASKS", "Work"]

TASKS: Final[dict[str, Task]] = {
    "calibrate": calibrate,
    "check": check,
    "detect": detect,
    "grade": grade,
    "preview": preview,
    "survey": look_over,
    "template": template,
}
