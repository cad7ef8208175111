"""What does a page work with?  One checked request: who asks, in which language, with which fields."""

from __future__ import annotations

import json
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import quote

from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from slabcell.hmi.cell_api import Json
from slabcell.hmi.context import Hmi
from slabcell.hmi.render import render
from slabcell.hmi.route import Page
from slabcell.hmi.security.roles import Role
from slabcell.hmi.security.sessions import Session
from slabcell.hmi.security.users import User
from slabcell.hmi.words import PageWords

__all__ = ["Refusal", "Visit"]

ADDRESS_SIGNS: Final = "/:?#[]@!$&'()*+,;=%"
"""What stands for itself in an address (RFC 3986, section 2.2), and what is encoded already."""


class Refusal(Exception):  # noqa: N818 - a refusal is no error of ours
    """A request that is not answered: status, and the word that says why."""

    def __init__(self, status: int, key: str, **values: object) -> None:
        super().__init__(key)
        self.status, self.key, self.values = status, key, values


@dataclass(slots=True)
class Visit:
    """One request."""

    hmi: Hmi
    request: Request
    page_name: str
    words: PageWords
    theme: str
    session: Session | None = None
    form: dict[str, str] = field(default_factory=dict[str, str], repr=False)
    raw: bytes = field(default=b"", repr=False)
    outcome: str = ""
    """What came of a write, for the audit log."""

    @property
    def user(self) -> User:
        """Who asks; only routes with a role may ask."""
        if self.session is None:
            raise Refusal(HTTPStatus.UNAUTHORIZED, "refused.login")
        return self.session.user

    def may(self, role: Role) -> bool:
        """Return whether who asks has a role."""
        return self.session is not None and self.session.user.role >= role

    @property
    def address(self) -> str:
        """Where the request comes from."""
        return self.request.client.host if self.request.client else ""

    # What came with it

    def text(self, name: str, *, most: int = 200) -> str:
        """Return a field of the form, or of the address.  Raises Refusal if it is too long."""
        value = self.form.get(name, self.request.query_params.get(name, ""))
        if len(value) > most:
            raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.too_long", name=name, most=most)
        return value

    def number(self, name: str) -> int | None:
        """Return a whole number out of the path, the form or the address; None if it is empty.  Raises Refusal."""
        value = str(self.request.path_params.get(name, "")) or self.text(name)
        if not value:
            return None
        if not value.isascii() or not value.isdecimal() or len(value) > 15:
            raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.no_number", name=name, value=value[:40])
        return int(value)

    # Answers

    def page(self, template: str, *, status: int = 200, **values: object) -> Response:
        """Return a whole page; ``template`` is relative to the page's folder."""
        return HTMLResponse(render(self, f"pages/{self.page_name}/{template}", values), status_code=status)

    fragment = page
    """A part of a page, which htmx puts in its place, is made the same way."""

    def base_fragment(self, template: str) -> Response:
        """Return a part that every page has."""
        return HTMLResponse(render(self, f"base/{template}", {}))

    def problem(self, status: int, text: str) -> Response:
        """Return a page that says why something was not answered."""
        return HTMLResponse(render(self, "base/problem.html", {"number": status, "text": text}), status_code=status)

    async def post(self, path: str, body: Json | None = None) -> Response:
        """Have the daemon do something for who asks; say what came of it.  Raises SlabcellError."""
        done = await self.hmi.api.post(path, body, user=self.user.name, key=self.key())
        detail = str(done.get("detail", ""))
        response = self.done(self.words.said(detail))
        self.outcome = detail  # the log has one language; its page says it in the reader's
        return response

    def key(self) -> str:
        """Return the key under which a write is done once: the page's own, else a new one."""
        return self.text("key", most=64) or str(uuid.uuid4())

    def done(self, text: str, *events: str) -> Response:
        """Say that something was done; pages hear ``events`` and refresh what shows it."""
        self.outcome = text
        self.hmi.link.tell(*events)
        return self._say(HTTPStatus.OK, "done", text)

    def failed(self, status: int, text: str) -> Response:
        """Say that something was not done, and why."""
        self.outcome = text
        return self._say(status, "failed", text)

    def _say(self, status: int, kind: str, text: str) -> Response:
        trigger = json.dumps({"slab:say": {"kind": kind, "text": text}})
        return Response(status_code=status, headers={"hx-trigger": trigger, "hx-reswap": "none"})

    def go(self, path: str) -> Response:
        """Send the browser to another page of ours."""
        if self.wants_fragment:
            return Response(status_code=HTTPStatus.OK, headers={"hx-redirect": quote(path, safe=ADDRESS_SIGNS)})
        return RedirectResponse(path, HTTPStatus.SEE_OTHER)

    @property
    def wants_fragment(self) -> bool:
        """Whether htmx asks, not the browser itself."""
        return self.request.headers.get("hx-request") == "true"

    # For the templates

    @property
    def navigation(self) -> list[Page]:
        """The pages that who asks may see, in their order."""
        seen = [page for page in self.hmi.pages if page.order is not None and self.may(page.role)]
        return sorted(seen, key=lambda page: page.order or 0)

    def globals(self) -> Mapping[str, Any]:
        """Return what every template knows."""
        link = self.hmi.link
        return {
            "visit": self,
            "w": self.words,
            "status": link.status,
            "up": link.up,
            "age_s": link.age_s,
            "Role": Role,
            "csrf": self.session.csrf if self.session else "",
        }
