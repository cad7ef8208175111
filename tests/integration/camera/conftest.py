"""Cameras to test with: in this process, or as programs that can be killed; each test's on an address of its own."""

import asyncio
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import asynccontextmanager
from ipaddress import IPv4Address
from pathlib import Path
from typing import TypeVar

import pytest

from slabcell_drivers.camera import CameraState
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.aravis_library import AravisLibrary, AravisMissingError
from slabcell_drivers.camera.discovery import Interface
from slabcell_drivers.camera.harvesters import HarvestersCamera
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.camera.supervision import SupervisedCamera
from slabcell_drivers.gentl import ProducerBuildError, build
from slabcell_drivers.simulation.gige import CheckedPattern, GigeCamera, SensorLimits

C = TypeVar("C", bound=SupervisedCamera)

LOOPBACK = [Interface("lo", "127.0.0.1", "127.255.255.255")]
PLAIN = CameraSettings(packet_size=8000, heartbeat_ms=2000)
SLABCELL = str(Path(sys.executable).parent / "slabcell")


def need(missing: str | None) -> None:
    """Skip, or fail where cameras must be tested, because something is not on this machine."""
    if missing is None:
        return
    if os.environ.get("SLABCELL_REQUIRE_CAMERA") == "1":
        pytest.fail(missing)
    pytest.skip(missing)


@pytest.fixture(scope="session")
def aravis(_addresses: Iterator[str]) -> AravisLibrary:
    try:
        library = AravisLibrary()
    except AravisMissingError as error:
        need(str(error))
        raise
    # The library opens a socket at the first use and keeps it; no single test is to be blamed for that.
    with GigeCamera(CheckedPattern(64, 48), next(_addresses), limits=SensorLimits(64, 48)) as camera:
        library.unref(library.call("arv_camera_new", camera.address.encode()))
    return library


@pytest.fixture(scope="session")
def _addresses() -> Iterator[str]:
    """Addresses that no other test process of this machine uses: each has a block of its own, by its process id."""
    high, low = divmod(os.getpid(), 250)
    return (f"127.{1 + high % 250}.{1 + low}.{last}" for last in range(1, 255))


@pytest.fixture(scope="session")
def harvesters() -> None:
    if importlib.util.find_spec("harvesters") is None or importlib.util.find_spec("genicam") is None:
        need("harvesters and genicam are not installed: pip install 'slabcell[camera]'")


@pytest.fixture(scope="session")
def producer(harvesters: None) -> Path:
    """Our own GenTL producer."""
    try:
        return build()
    except ProducerBuildError as error:
        need(str(error))
        raise


@pytest.fixture
def address(_addresses: Iterator[str]) -> str:
    return next(_addresses)


@pytest.fixture
def another_address(_addresses: Iterator[str]) -> str:
    return next(_addresses)


def serial_of(address: str) -> str:
    """Return a serial number that only the camera at this address has: discovery sees those of other processes too."""
    return f"T-{int(IPv4Address(address)):08X}"


@pytest.fixture
def pattern() -> CheckedPattern:
    return CheckedPattern(640, 480)


@pytest.fixture
def gige(address: str, pattern: CheckedPattern) -> Iterator[GigeCamera]:
    """A small camera in this process."""
    with GigeCamera(pattern, address, serial=serial_of(address), limits=SensorLimits(640, 480)) as camera:
        yield camera


class Program:
    """A camera in software that runs as a program."""

    def __init__(self, *options: str) -> None:
        self._command = [SLABCELL, "sim", "camera", *options]
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        self._process = subprocess.Popen(
            self._command, stdout=subprocess.PIPE, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        count = int(self._command[self._command.index("--count") + 1]) if "--count" in self._command else 1
        for _ in range(count):
            line = self._process.stdout.readline()
            if "ready at" not in line:
                _, errors = self._process.communicate()
                pytest.fail(f"{' '.join(self._command)}: {line}{errors}")

    @property
    def process_id(self) -> int:
        assert self._process is not None
        return self._process.pid

    def signal(self, number: signal.Signals) -> None:
        assert self._process is not None
        self._process.send_signal(number)

    def do(self, verb: str) -> None:
        """Have the camera do what a fault verb says, and return when it has heard it."""
        assert self._process is not None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(verb + "\n")
        self._process.stdin.flush()
        assert self._process.stdout.readline() == f"done: {verb}\n"

    def end(self) -> None:
        if self._process is None:
            return
        if self._process.poll() is None:
            self._process.kill()
        self._process.communicate()
        self._process = None


@pytest.fixture
def program() -> Iterator[Callable[..., Program]]:
    """Starts cameras as programs, and ends them after the test."""
    started: list[Program] = []

    def start(*options: str) -> Program:
        found = Program(*options)
        started.append(found)
        found.start()
        return found

    yield start
    for found in started:
        found.end()


@pytest.fixture
def tool() -> Callable[[str], str]:
    """Finds a program of the ecosystem."""

    def find(name: str) -> str:
        path = shutil.which(name)
        need(None if path else f"{name} is not installed (apt-get install aravis-tools aravis-tools-cli)")
        assert path is not None
        return path

    return find


MakeCamera = Callable[[str, CameraSettings], SupervisedCamera]


@pytest.fixture(params=["aravis", "harvesters"])
def make(request: pytest.FixtureRequest, aravis: AravisLibrary) -> MakeCamera:
    """Makes a camera through each real driver, by its address."""
    if request.param == "aravis":
        return lambda address, settings: AravisCamera(address, settings, on=LOOPBACK)
    producer = request.getfixturevalue("producer")
    return lambda address, settings: HarvestersCamera(serial_of(address), [producer], settings, on=LOOPBACK)


@asynccontextmanager
async def opened(camera: C, timeout_s: float = 40.0) -> AsyncGenerator[C]:
    """Open a camera, and close it in the end."""
    try:
        await camera.open(timeout_s)
        yield camera
    finally:
        await camera.close()


async def until(camera: SupervisedCamera, state: CameraState) -> None:
    """Wait until a camera stands so; fail if that never comes."""
    async with asyncio.timeout(60):
        await camera.until(state)
