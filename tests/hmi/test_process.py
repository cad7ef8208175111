"""The HMI as a process: under the limits of its unit, and with TLS."""

import http.client
import importlib.util
import os
import shutil
import signal
import ssl
import subprocess
from pathlib import Path
from types import ModuleType
from urllib.parse import urlencode, urlsplit

import pytest

from .conftest import LIMIT_S, PASSWORD, SLABCELL, Child, wait_for

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


def openssl(*words: str) -> None:
    """Run the distribution's tool."""
    if shutil.which("openssl") is None:
        if os.environ.get("SLABCELL_REQUIRE_CAMERA") == "1":
            pytest.fail("openssl is not installed")
        pytest.skip("openssl is not installed: the distribution's package openssl has it")
    subprocess.run(["openssl", *words], check=True, capture_output=True)


def make_certificate(folder: Path, name: str = "127.0.0.1", *more: str) -> tuple[Path, Path]:
    """Return a new certificate and its key."""
    paths = folder / "hmi.pem", folder / "hmi-key.pem"
    words = [
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:P-256",
        "-days",
        "2",
        "-subj",
        f"/CN={name}",
    ]
    openssl(*words, *(more or ("-nodes",)), "-out", str(paths[0]), "-keyout", str(paths[1]))
    return paths


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[Path, Path]:
    """A certificate for this test, and its key."""
    return make_certificate(tmp_path)


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


def with_tls(tmp_path: Path, certificate: tuple[Path, Path]) -> dict[str, str]:
    """Return what names files and places of an HMI that speaks TLS."""
    return {
        "SLABCELL__API__SOCKET": str(tmp_path / "no-daemon.sock"),
        "SLABCELL__HMI__STATE_DIRECTORY": str(tmp_path / "state"),
        "SLABCELL__HMI__PORT": "0",
        "SLABCELL__HMI__CERTIFICATE": str(certificate[0]),
        "SLABCELL__HMI__PRIVATE_KEY": str(certificate[1]),
    }


def shown(base: str) -> str:
    """Return the certificate that is shown to who connects."""
    host, _, port = urlsplit(base).netloc.rpartition(":")
    return ssl.get_server_certificate((host, int(port)))


def test_a_new_certificate_is_read_when_asked_and_a_bad_one_changes_nothing(
    tmp_path: Path, certificate: tuple[Path, Path]
) -> None:
    command = [*SLABCELL, "hmi", "--config", str(CONFIG)]
    child = Child(command, tmp_path / "hmi.log", **with_tls(tmp_path, certificate))
    try:
        base = child.line().removeprefix("open ").rstrip("/")
        before = shown(base)
        good = certificate[0].read_text()
        assert before.split() == good.split()
        certificate[0].write_text("damaged")
        child.process.send_signal(signal.SIGHUP)
        wait_for(lambda: "certificate not renewed" in child.log.read_text(), "a refusal of a damaged certificate")
        assert shown(base) == before
        make_certificate(tmp_path, "renewed")
        child.process.send_signal(signal.SIGHUP)
        wait_for(lambda: "certificate read again" in child.log.read_text(), "the new certificate")
        assert shown(base).split() == certificate[0].read_text().split() != good.split()
    finally:
        child.end()


@pytest.mark.parametrize("fault", ["no file", "no certificate", "another key", "a key with a password"])
def test_files_of_tls_that_cannot_be_used_are_named_at_the_start(
    tmp_path: Path, certificate: tuple[Path, Path], fault: str
) -> None:
    match fault:
        case "no file":
            certificate[1].unlink()
        case "no certificate":
            certificate[0].write_text("damaged")
        case "another key":
            good = certificate[0].read_text()
            make_certificate(tmp_path)
            certificate[0].write_text(good)
        case _:
            make_certificate(tmp_path, "127.0.0.1", "-passout", "pass:secret")
    done = subprocess.run(
        [*SLABCELL, "hmi", "--config", str(CONFIG)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
        env={**os.environ, **with_tls(tmp_path, certificate)},
    )
    assert done.returncode == 78, done.stderr
    assert f"certificate {certificate[0]}, private_key {certificate[1]}: cannot be used" in done.stderr
    assert ("password" in done.stderr) == (fault == "a key with a password")
    assert not done.stdout
