"""The HMI as a process: under the limits of its unit, and with TLS."""

import http.client
import importlib.util
import os
import shutil
import ssl
import subprocess
from pathlib import Path
from types import ModuleType
from urllib.parse import urlencode, urlsplit

import pytest

from .conftest import LIMIT_S, PASSWORD, SLABCELL, Child

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(180)]

TESTS = Path(__file__).parents[1]
CONFIG = TESTS.parent / "config" / "demo.toml"
UNIT = TESTS.parent / "systemd" / "slabcell-hmi.service"


@pytest.fixture
def confinement(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The sandbox of the fault tests, with the limits of this unit."""
    spec = importlib.util.spec_from_file_location("hmi_confinement", TESTS / "faults" / "confinement.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "UNIT", UNIT)
    module.needs()
    return module


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[Path, Path]:
    """A certificate for this test, and its key."""
    if shutil.which("openssl") is None:
        if os.environ.get("SLABCELL_REQUIRE_CAMERA") == "1":
            pytest.fail("openssl is not installed")
        pytest.skip("openssl is not installed: the distribution's package openssl has it")
    paths = tmp_path / "hmi.pem", tmp_path / "hmi-key.pem"
    words = ["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2"]
    words += ["-subj", "/CN=127.0.0.1"]
    subprocess.run(
        ["openssl", *words, "-out", str(paths[0]), "-keyout", str(paths[1])], check=True, capture_output=True
    )
    return paths


def test_it_serves_over_tls_and_hashes_passwords_within_the_limits_of_its_unit(
    tmp_path: Path, confinement: ModuleType, certificate: tuple[Path, Path]
) -> None:
    state = tmp_path / "state"
    state.mkdir()
    with confinement.confined(tmp_path, state) as (limits, descriptors):
        child = Child(
            [*limits, *SLABCELL, "hmi", "--config", str(CONFIG)],
            tmp_path / "hmi.log",
            pass_fds=descriptors,
            SLABCELL__API__SOCKET=str(tmp_path / "no-daemon.sock"),
            SLABCELL__HMI__STATE_DIRECTORY=str(state),
            SLABCELL__HMI__PORT="0",
            SLABCELL__HMI__CERTIFICATE=str(certificate[0]),
            SLABCELL__HMI__PRIVATE_KEY=str(certificate[1]),
        )
        try:
            base = child.line().removeprefix("open ").rstrip("/")
            token = child.line().rpartition(" ")[2]
            trusted = ssl.create_default_context(cafile=str(certificate[0]))
            trusted.check_hostname = False
            connection = http.client.HTTPSConnection(urlsplit(base).netloc, timeout=LIMIT_S, context=trusted)
            fields = {"token": token, "name": "anna", "password": PASSWORD, "again": PASSWORD}
            headers = {"Origin": base, "Content-Type": "application/x-www-form-urlencoded"}
            connection.request("POST", "/first", urlencode(fields), headers)
            answer = connection.getresponse()
            answer.read()
            cookie = answer.getheader("set-cookie", "")
            connection.request("GET", "/", headers={"Cookie": cookie.partition(";")[0]})
            page = connection.getresponse()
            content = page.read().decode()
            connection.close()
        finally:
            child.end()
    assert answer.status == 303
    assert cookie.startswith("__Host-slabcell=")
    assert "Secure" in cookie
    assert answer.getheader("strict-transport-security")
    assert page.status == 200
    assert "No connection to the cell" in content, "the pages live without the daemon, and say so"


def test_other_machines_are_served_with_tls_only_unless_that_is_asked_for(tmp_path: Path) -> None:
    done = subprocess.run(
        [*SLABCELL, "hmi", "--config", str(CONFIG)],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
        env={**os.environ, "SLABCELL__HMI__HOST": "192.0.2.1", "SLABCELL__HMI__STATE_DIRECTORY": str(tmp_path)},
    )
    assert done.returncode == 78
    assert "name certificate and private_key" in done.stderr
