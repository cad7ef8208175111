"""A stranger gets nothing, everybody what the role says, and no other site can use somebody's login."""

import json
import os
import re
import subprocess
from pathlib import Path

import pytest

from slabcell.hmi.pages import PAGES
from slabcell.hmi.route import HmiRoute
from slabcell.hmi.security.roles import Role

from .conftest import LIMIT_S, PASSWORD, ROLES, SLABCELL, Client, Server

pytestmark = pytest.mark.hmi

EVERY_ROUTE = [route for page in PAGES for route in page.routes]
GUARDED = [route for route in EVERY_ROUTE if route.role is not None]
OPEN = {"/login", "/logout", "/first", "/preferences"}


def concrete(route: HmiRoute) -> str:
    """Return an address that the route answers."""
    return re.sub(r"\{[^}]+\}", "1", route.path)


def name_of(route: HmiRoute) -> str:
    return f"{route.method} {route.path}"


def test_only_logging_in_and_preferences_are_open_to_everybody() -> None:
    assert {route.path for route in EVERY_ROUTE if route.role is None} == OPEN


@pytest.mark.parametrize("route", GUARDED, ids=name_of)
def test_a_stranger_gets_nothing(hmi: Server, route: HmiRoute) -> None:
    client = hmi.client()
    if route.method == "GET":
        answer = client.get(concrete(route))
        assert (answer.status, answer.headers["location"].partition("?")[0]) == (303, "/login")
        assert not answer.content
    else:
        answer = client.post(concrete(route))
        assert answer.status == 401
        assert answer.said["text"] == "Log in first."


@pytest.mark.parametrize("route", GUARDED, ids=name_of)
def test_a_lower_role_is_refused(hmi: Server, route: HmiRoute) -> None:
    assert route.role is not None
    for role in ROLES[: route.role - 1]:
        client = hmi.client(role)
        answer = client.get(concrete(route)) if route.method == "GET" else client.post(concrete(route))
        assert answer.status == 403, (role, route)


@pytest.mark.parametrize("route", [route for route in GUARDED if route.method == "GET"], ids=name_of)
def test_the_role_that_is_named_may_look(hmi: Server, route: HmiRoute) -> None:
    assert route.role is not None
    answer = hmi.client(route.role.word).get(concrete(route))
    assert answer.status in {200, 404, 409}, answer.text


def test_the_navigation_shows_what_the_role_may_see(hmi: Server) -> None:
    for role in ROLES:
        page = hmi.client(role).get("/").text
        for one in PAGES:
            if one.order is not None:
                assert (f'<a href="{one.path}"' in page) == (Role.of(role) >= one.role), (role, one.name)


def test_a_wrong_password_is_refused_in_the_same_words_as_a_wrong_name(hmi: Server) -> None:
    answers = [hmi.client().post("/login", {"name": name, "password": "wrong"}) for name in ("viewer", "nobody")]
    assert [answer.status for answer in answers] == [403, 403]
    assert answers[0].text.replace("viewer", "nobody") == answers[1].text


def test_guessing_is_slowed_down(hmi: Server) -> None:
    client = hmi.client()
    statuses = [client.post("/login", {"name": "guessed", "password": str(n)}).status for n in range(7)]
    assert statuses == [403] * 5 + [429] * 2


def test_the_login_makes_a_new_session_whatever_the_browser_had(hmi: Server) -> None:
    client = hmi.client()
    client.cookies["slabcell"] = "chosen-by-somebody-else"
    assert client.login("viewer").status == 303
    first = client.cookies["slabcell"]
    assert first != "chosen-by-somebody-else"
    client.login("viewer")
    assert client.cookies["slabcell"] != first
    old = Client(hmi.base, {"slabcell": first})
    assert old.get("/").status == 303, "the session before the login still stands"


def test_the_cookie_is_for_this_host_and_no_script(hmi: Server) -> None:
    answer = hmi.client().post("/login", {"name": "viewer", "password": PASSWORD}, HX_Request="")
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert "domain" not in cookie


def test_logging_out_ends_the_session(hmi: Server) -> None:
    client = hmi.fresh_client("viewer")
    kept = dict(client.cookies)
    assert client.post("/logout", HX_Request="").status == 303
    assert Client(hmi.base, kept).get("/").status == 303


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": ""},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
        {"X_Slabcell_Form": "wrong"},
        {"X_Slabcell_Form": ""},
    ],
    ids=str,
)
def test_another_site_cannot_use_a_login(hmi: Server, headers: dict[str, str]) -> None:
    client = hmi.client("admin")
    answer = client.post("/users/add", {"name": "mallory", "role": "admin", "password": PASSWORD}, **headers)
    assert answer.status == 403
    assert "mallory" not in client.get("/users/list").text


def test_a_form_of_another_session_is_refused(hmi: Server) -> None:
    mine, other = hmi.fresh_client("admin"), hmi.fresh_client("admin")
    mine.form = other.form
    assert mine.post("/users/remove", {"name": "viewer"}).status == 403


def test_a_foreign_host_name_gets_nothing(hmi: Server) -> None:
    answer = hmi.client("viewer").get("/", Host="rebound.example")
    assert answer.status == 421


def test_every_answer_carries_the_headers(hmi: Server) -> None:
    client = hmi.client("viewer")
    for path in ("/", "/login", "/nothing-here", "/static/x/y", "/frames/latest.json"):
        headers = client.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["x-frame-options"] == "DENY"
        assert headers["cache-control"] == "no-store"
        assert "server" not in headers


@pytest.mark.parametrize("path", ["../app.py", "..%2fapp.py", "%2e%2e/app.py", "js/../../app.py", "/etc/passwd"])
def test_nothing_but_the_static_files_can_be_read(hmi: Server, path: str) -> None:
    client = hmi.client("admin")
    version = re.search(r"/static/(\w+)/hmi\.css", client.get("/").text)
    assert version is not None
    answer = client.get(f"/static/{version[1]}/{path}")
    assert answer.status == 404
    assert b"import" not in answer.content


def test_a_large_body_is_refused_before_it_is_read(hmi: Server) -> None:
    answer = hmi.client("admin").post("/users/add", {"name": "x" * 100_000})
    assert answer.status == 413


def test_the_way_back_after_the_login_stays_on_this_host(hmi: Server) -> None:
    for bad in ("https://evil.example/", "//evil.example", "/\\evil.example", "javascript:alert(1)"):
        client = hmi.client()
        fields = {"name": "viewer", "password": PASSWORD, "next": bad}
        assert client.post("/login", fields, HX_Request="").headers["location"] == "/"


def test_the_file_of_users_is_for_nobody_else(hmi: Server) -> None:
    path = hmi.state / "hmi.sqlite"
    assert path.stat().st_mode & 0o077 == 0
    content = b"".join(file.read_bytes() for file in Path(hmi.state).iterdir())
    assert PASSWORD.encode() not in content
    assert b"$argon2id$" in content


def test_writes_are_in_the_audit_log_without_their_secrets(hmi: Server) -> None:
    admin = hmi.client("admin")
    hmi.client("viewer").post("/users/remove", {"name": "admin"})
    page = admin.get("/users").text
    assert "/users/remove" in page
    assert "403" in page
    assert "Your role may not do this" in page
    assert PASSWORD not in page


def test_users_are_kept_by_the_command_too(tmp_path: Path) -> None:
    config = Path(__file__).parents[2] / "config" / "demo.toml"

    def command(*words: str, given: str = "") -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*SLABCELL, "hmi", *words, "--config", str(config)],
            input=given,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
            env={**os.environ, "SLABCELL__HMI__STATE_DIRECTORY": str(tmp_path), "COLUMNS": "200"},
        )

    assert command("user", "add", "anna", "--role", "admin", given=f"{PASSWORD}\n").returncode == 0
    assert "anna" in command("user", "list").stdout
    refused = command("user", "role", "anna", "--role", "viewer")
    assert refused.returncode == 1
    assert "the only admin" in refused.stderr
    assert command("user", "add", "bert", given="short\n").returncode == 1
    assert json.loads(command("audit", "--json").stdout)["lines"] == []


def test_the_token_of_the_first_start_is_worth_nothing_once_somebody_can_log_in(hmi: Server) -> None:
    fields = {"token": hmi.token, "name": "second", "password": PASSWORD, "again": PASSWORD}
    assert hmi.client().post("/first", fields).status == 404
    assert hmi.client().get("/first").headers["location"] == "/login"
