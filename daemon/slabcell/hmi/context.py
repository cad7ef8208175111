"""What is one running HMI made of?  Everything that its pages work with."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from slabcell.hmi.cell_api import CellApi
from slabcell.hmi.link import CellLink
from slabcell.hmi.recipe_view import ActiveTemplate
from slabcell.hmi.route import Page
from slabcell.hmi.security.audit import Audit
from slabcell.hmi.security.limit import LoginLimit
from slabcell.hmi.security.sessions import Sessions
from slabcell.hmi.security.store import Store
from slabcell.hmi.security.users import Users
from slabcell.hmi.words import LANGUAGES, PageWords, Words

__all__ = ["Hmi", "HmiOptions"]


@dataclass(frozen=True, slots=True)
class HmiOptions:
    """Where it is served and how; ``socket`` is the daemon's, ``state`` the folder of users and audit log."""

    socket: Path
    state: Path
    host: str = "127.0.0.1"
    port: int = 8080
    certificate: Path | None = None
    private_key: Path | None = None
    names: tuple[str, ...] = ()
    language: Literal["en", "de"] = "en"
    live_clients: int = 16
    idle_s: float = 3600.0
    lifetime_s: float = 43_200.0


@dataclass(slots=True)
class Hmi:
    """One running HMI.  ``first_token`` is asked for while nobody can log in yet; empty otherwise."""

    options: HmiOptions
    pages: tuple[Page, ...]
    api: CellApi
    link: CellLink
    template: ActiveTemplate
    store: Store
    users: Users
    sessions: Sessions
    audit: Audit
    limit: LoginLimit = field(default_factory=LoginLimit)
    words: dict[str, Words] = field(default_factory=lambda: {name: Words(name) for name in LANGUAGES})
    first_token: str = ""
    live: int = 0
    """Pages that are connected now."""
    stopping: asyncio.Event = field(default_factory=asyncio.Event)
    tls: ssl.SSLContext | None = None

    def words_of(self, cookies: Mapping[str, str], page: str) -> PageWords:
        """Return the words of a page in the language that a person has chosen, else in that of this HMI."""
        chosen = cookies.get("slabcell-language", "")
        return self.words[chosen if chosen in self.words else self.options.language].of(page)

    @classmethod
    def of(cls, options: HmiOptions, pages: tuple[Page, ...]) -> Hmi:
        """Return an HMI, not yet open."""
        store, api = Store(options.state / "hmi.sqlite"), CellApi(options.socket)
        sessions = Sessions(store, idle_s=options.idle_s, lifetime_s=options.lifetime_s)
        return cls(options, pages, api, CellLink(api), ActiveTemplate(api), store, Users(store), sessions, Audit(store))

    @property
    def secure(self) -> bool:
        """Whether it speaks TLS."""
        return self.options.certificate is not None
