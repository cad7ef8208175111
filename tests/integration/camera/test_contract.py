"""Do the real drivers keep the contract that the simulated and the replayed camera keep?  The same tests."""

import importlib.util
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from slabcell_drivers.camera import Camera, CameraInfo
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.aravis_library import AravisLibrary
from slabcell_drivers.camera.harvesters import HarvestersCamera
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.gentl import ProducerBuildError, build
from slabcell_drivers.simulation.gige import GigeCamera, SensorLimits

from .conftest import need, serial_of

pytestmark = pytest.mark.integration

_PATH = Path(__file__).parents[2] / "unit" / "camera" / "test_camera_contract.py"
_SPEC = importlib.util.spec_from_file_location("camera_contract", _PATH)
assert _SPEC is not None
assert _SPEC.loader is not None
contract = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(contract)

# Every test of the contract is a test here, with the `make` below.
globals().update({name: thing for name, thing in vars(contract).items() if name.startswith("test_")})

SETTINGS = CameraSettings(packet_size=1500, heartbeat_ms=2000)


class PatientCamera(HarvestersCamera):
    """A new process that lists cameras for a second takes longer than a contract for everybody can know."""

    async def open(self, timeout_s: float) -> CameraInfo:
        return await super().open(8 * timeout_s)


def through_aravis(address: str) -> Camera:
    return AravisCamera(address, SETTINGS)


def through_harvesters(address: str) -> Camera:
    try:
        return PatientCamera(address, [build()], SETTINGS)
    except ProducerBuildError as error:
        need(str(error))
        raise


@pytest.fixture
def serial(address: str) -> str:
    return serial_of(address)


@pytest.fixture(params=[through_aravis, through_harvesters], ids=["aravis", "harvesters"])
def make(
    request: pytest.FixtureRequest, aravis: AravisLibrary, address: str, serial: str
) -> Iterator[Callable[[], Camera]]:
    with ExitStack() as running:
        gige = GigeCamera(
            contract.picture, address, serial=serial, vendor="slabcell", model="test", limits=SensorLimits(64, 48)
        )

        def make_camera() -> Camera:
            running.enter_context(gige)
            return request.param(address)

        yield make_camera
