"""What is wrong with this cell?  The questions of `slabcell doctor`, asked by the daemon itself.

The answers are those of the daemon's user, behind its restrictions: the command, run by root, sees more.
"""

from __future__ import annotations

import asyncio
from typing import Literal

from pydantic import Field

from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document
from slabcell.service.api.endpoint import Call, Endpoint
from slabcell.service.api.problems import ProblemError
from slabcell.service.doctor import Patient, examine
from slabcell.service.doctor_checks import CHECKS

__all__ = ["ENDPOINTS"]


class FindingDocument(Document):
    """One thing that was found."""

    number: int
    severity: Literal["ok", "note", "warning", "error"]
    subject: str
    detail: str
    remedy: str
    docs: str = Field(description="page of the documentation")


class DoctorDocument(Document):
    """Everything that was found."""

    schema_: Literal["slabcell.doctor/1"] = Field(default="slabcell.doctor/1", alias="schema")
    config: str
    findings: list[FindingDocument]
    counts: dict[str, int]


async def _examine(call: Call[ApiContext]) -> DoctorDocument:
    path = call.context.config_path
    if path is None:
        raise ProblemError(404, "this daemon has no configuration file to look at")
    async with call.context.doctor_turn:
        found = await asyncio.to_thread(lambda: list(examine(Patient(path), CHECKS)))
    findings = [
        FindingDocument(
            number=item.number,
            severity=item.severity.value,
            subject=item.subject,
            detail=item.detail,
            remedy=item.remedy,
            docs=item.docs,
        )
        for item in found
    ]
    counts = {word: sum(item.severity == word for item in findings) for word in ("ok", "note", "warning", "error")}
    return DoctorDocument(config=str(path), findings=findings, counts=counts)


ENDPOINTS = (
    Endpoint(
        *("GET", "/v1/doctor", "What is wrong with this cell; takes some seconds", _examine, DoctorDocument, "doctor"),
        problems=(404,),
    ),
)
