"""Which keys does the table ``[hmi]`` have?  Where the web pages are served, to whom, and how long a login lasts."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from slabcell.toml_file import TomlTable

__all__ = ["HmiConfig", "is_local_host"]

Name = Annotated[str, Field(pattern=r"^[a-z0-9]([a-z0-9.-]{0,251}[a-z0-9])?$")]


class HmiConfig(TomlTable):
    """``[hmi]``: the pages of `slabcell hmi`, a process of its own beside the daemon."""

    host: str = Field(default="127.0.0.1", max_length=253, description="address to listen on")
    port: Annotated[int, Field(ge=0, le=65_535)] = Field(default=8080, description="TCP port; 0 lets the host choose")
    certificate: Path | None = Field(default=None, description="TLS certificate with its chain, PEM")
    private_key: Path | None = Field(default=None, description="its private key, PEM")
    allow_plain_http: bool = Field(
        default=False, description="serve other machines without TLS: passwords then cross the network readable"
    )
    names: list[Name] = Field(
        default=[], max_length=20, description="host names by which browsers reach it; addresses need no entry"
    )
    state_directory: Path | None = Field(
        default=None,
        description="of users and audit log; the default is systemd's STATE_DIRECTORY, else hmi below the cell's",
    )
    language: Literal["en", "de"] = Field(default="en", description="for who has chosen none")
    live_clients: Annotated[int, Field(ge=1, le=64)] = Field(default=16, description="pages open at once")
    idle_minutes: Annotated[int, Field(ge=1, le=1440)] = Field(
        default=60, description="a login that is not used for so long ends; an open page is use"
    )
    session_hours: Annotated[int, Field(ge=1, le=168)] = Field(default=12, description="a login ends after so long")

    @model_validator(mode="after")
    def _is_safe(self) -> Self:
        if (self.certificate is None) != (self.private_key is None):
            msg = "certificate and private_key belong together: name both, or neither"
            raise ValueError(msg)
        if not self.is_local and self.certificate is None and not self.allow_plain_http:
            msg = (
                f"host {self.host} is reached by other machines: name certificate and private_key,"
                " or say allow_plain_http = true on a network that you trust"
            )
            raise ValueError(msg)
        return self

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches the address."""
        return is_local_host(self.host)


def is_local_host(host: str) -> bool:
    """Return whether an address or a name means this machine alone; other names are not looked up."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
