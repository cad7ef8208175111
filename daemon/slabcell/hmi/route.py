"""What is a page, and what is a route?  Declarations: path, who may use it, and the function that answers.

Everything that is served stands in such a table, so that a test can walk through all of it, role by role.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from starlette.responses import Response

from slabcell.hmi.security.roles import Role

if TYPE_CHECKING:
    from slabcell.hmi.visit import Visit

__all__ = ["FORM_BYTES", "HmiRoute", "Page", "get", "post"]

FORM_BYTES: Final = 16 << 10


@dataclass(frozen=True, slots=True)
class HmiRoute:
    """One thing that can be asked for or done.  ``role`` None: without a login.

    A POST is refused unless it comes from one of our own pages, in the session for which that was made, and it is in
    the audit log whatever becomes of it.  ``body_bytes`` bounds what it may carry; ``raw`` is the media type of content
    that is no form.  Only what changes nothing, and is asked for often, may stay out of the log (``logged``).
    """

    method: Literal["GET", "POST"]
    path: str
    handler: Callable[[Visit], Awaitable[Response]]
    role: Role | None
    body_bytes: int = FORM_BYTES
    raw: str | None = None
    logged: bool = True


@dataclass(frozen=True, slots=True)
class Page:
    """One page: its name, which is that of its folder and of its words, its path, its place in the navigation.

    ``role`` is the least that may see it.  A page of ``order`` None is not in the navigation.
    """

    name: str
    path: str
    role: Role
    order: int | None
    routes: tuple[HmiRoute, ...]


def get(path: str, handler: Callable[[Visit], Awaitable[Response]], role: Role | None) -> HmiRoute:
    """Return a route that reads."""
    return HmiRoute("GET", path, handler, role)


def post(path: str, handler: Callable[[Visit], Awaitable[Response]], role: Role | None) -> HmiRoute:
    """Return a route that does something, with the fields of a form."""
    return HmiRoute("POST", path, handler, role)
