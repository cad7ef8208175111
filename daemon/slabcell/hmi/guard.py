"""Is this request one of ours?  Host, origin and form token, and the headers that every answer carries.

Sources: OWASP cheat sheets "Cross-Site Request Forgery Prevention", "Session Management", "HTTP Headers"; Fetch
Metadata (W3C).
"""

from __future__ import annotations

import ipaddress
import socket
from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers

from slabcell.hmi.context import Hmi

__all__ = ["FORM_TOKEN", "HEADERS", "cookie_name", "is_known_host", "is_own_origin"]

FORM_TOKEN: Final = "x-slabcell-form"  # noqa: S105 - the name of a header
POLICY: Final = "; ".join(
    [
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob:",
        "font-src 'self'",
        "connect-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    ]
)
HEADERS: Final = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), usb=()",
    "cache-control": "no-store",
}
TLS_HEADERS: Final = {"strict-transport-security": "max-age=31536000"}


def cookie_name(hmi: Hmi) -> str:
    """Return the name of the session's cookie; with TLS its prefix binds it to this host and to TLS."""
    return "__Host-slabcell" if hmi.secure else "slabcell"


def is_known_host(hmi: Hmi, headers: Headers) -> bool:
    """Return whether a request names this machine: else a page elsewhere has bent a name of its own to our address."""
    host = _host_of(headers.get("host", ""))
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return host in {"localhost", socket.gethostname().lower(), *hmi.options.names}
    return True  # nobody's name leads here


def is_own_origin(hmi: Hmi, headers: Headers) -> bool:
    """Return whether a page of ours sent this, as browsers say it."""
    if headers.get("sec-fetch-site", "same-origin") != "same-origin":
        return False
    try:
        origin = urlsplit(headers.get("origin", ""))
    except ValueError:  # no browser says such a thing
        return False
    return origin.scheme == ("https" if hmi.secure else "http") and origin.netloc.lower() == headers["host"].lower()


def _host_of(netloc: str) -> str:
    if "@" in netloc:  # a user's name has no place there
        return ""
    try:
        return (urlsplit(f"//{netloc}").hostname or "").rstrip(".")
    except ValueError:
        return ""
