"""How does the API say that something did not work?  One JSON object as RFC 9457 has it, with the catalogue's number.

Source: RFC 9457, "Problem Details for HTTP APIs".
"""

from __future__ import annotations

from typing import Final

from pydantic import BaseModel, Field
from starlette.responses import JSONResponse

from slabcell.catalogue import Fault, entry
from slabcell.errors import ConfigurationError, SlabcellError, TemporaryError, UnavailableError, UsageError

__all__ = ["MEDIA_TYPE", "Problem", "ProblemError", "problem_of", "respond"]

MEDIA_TYPE: Final = "application/problem+json"

_TITLES: Final = {
    400: "Request is wrong",
    403: "Not permitted",
    404: "There is no such thing",
    405: "Method is not possible here",
    408: "Request came too slowly",
    409: "Not possible now",
    413: "Request is too large",
    415: "Content is of another type",
    422: "Request cannot be taken",
    431: "Request's head is too large",
    500: "Internal error",
    503: "Try again later",
}

_BAD_GATEWAY_CATEGORIES: Final = frozenset({"camera"})
"""Faults of what stands behind the cell: the request was right, and the same one may succeed later."""


class Problem(BaseModel):
    """What went wrong with a request."""

    type: str = Field(description="urn:slabcell:error:NUMBER for an entry of the error catalogue, else about:blank")
    title: str = Field(description="a few words")
    status: int = Field(description="the HTTP status")
    detail: str = Field(description="what exactly, with value and limit")
    number: int | None = Field(default=None, description="number in the error catalogue")
    action: str | None = Field(default=None, description="what a person does, in the words of the error catalogue")


class ProblemError(Exception):
    """A request that cannot be answered as asked."""

    def __init__(self, status: int, detail: str, *, number: int = 0) -> None:
        super().__init__(detail)
        self.status = status
        self.detail = detail
        self.number = number

    @property
    def problem(self) -> Problem:
        """The object that is sent."""
        if not self.number:
            title = _TITLES.get(self.status, "Request failed")
            return Problem(type="about:blank", title=title, status=self.status, detail=self.detail)
        words = entry(self.number)
        return Problem(
            type=f"urn:slabcell:error:{self.number}",
            title=words.title,
            status=self.status,
            detail=self.detail,
            number=self.number,
            action=words.action,
        )


def problem_of(error: SlabcellError) -> ProblemError:
    """Return the problem that an error of the house is to a client."""
    return ProblemError(_status(error), str(error), number=error.number)


def _status(error: SlabcellError) -> int:
    if isinstance(error, (UsageError, ConfigurationError)):
        return 422
    if isinstance(error, (UnavailableError, TemporaryError)):
        return 503
    if error.number and entry(error.number).category in _BAD_GATEWAY_CATEGORIES:
        return 503
    return 500 if error.number == Fault.INTERNAL else 409


def respond(error: ProblemError) -> JSONResponse:
    """Return the response for a problem."""
    return JSONResponse(error.problem.model_dump(mode="json", exclude_none=True), error.status, media_type=MEDIA_TYPE)
