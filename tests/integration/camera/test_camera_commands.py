"""Do `slabcell camera` and `slabcell sim camera` do what they say, against a camera that speaks GigE Vision?"""

import json
import signal
import socket
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from slabcell.cli.camera import camera_app
from slabcell.cli.sim import sim_app
from slabcell.errors import ConfigurationError, SlabcellError, TemporaryError, UnavailableError, UsageError
from slabcell_drivers.camera.aravis_device import AravisDevice
from slabcell_drivers.camera.aravis_library import AravisLibrary
from slabcell_drivers.camera.settings import CameraSettings, CameraStatistics
from slabcell_drivers.simulation.gige import CheckedPattern, GigeCamera

pytestmark = pytest.mark.integration

LO = ["--interface", "lo"]


def run(*words: str) -> str:
    result = CliRunner().invoke(camera_app, list(words), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def run_json(*words: str) -> dict:
    return json.loads(run(*words, "--json"))


def test_list_finds_every_camera_by_broadcast_without_a_library(
    gige: GigeCamera, another_address: str, pattern: CheckedPattern
) -> None:
    with GigeCamera(pattern, another_address, serial="SECOND"):
        found = run_json("list", *LO)
        assert found["schema"] == "slabcell.camera-list/1"
        serials = {camera["serial"]: camera["address"] for camera in found["cameras"]}
        assert serials[gige.device.serial] == gige.address
        assert serials["SECOND"] == another_address
        assert gige.device.serial in run("list", *LO)


def test_force_ip_gives_a_camera_another_address(gige: GigeCamera, another_address: str) -> None:
    run("force-ip", gige.device.mac_text, another_address, "--subnet", "255.0.0.0", *LO)
    assert gige.address == another_address
    found = run_json("list", *LO)
    assert [c["address"] for c in found["cameras"] if c["serial"] == gige.device.serial] == [another_address]


def test_force_ip_refuses_what_the_camera_cannot_take(
    gige: GigeCamera, another_address: str, pattern: CheckedPattern
) -> None:
    with pytest.raises(UnavailableError, match=r"did not take 10\.0\.0\.9, it answered INVALID_PARAMETER"):
        run("force-ip", gige.device.mac_text, "10.0.0.9", *LO)
    with (
        GigeCamera(pattern, another_address, serial="SECOND"),
        pytest.raises(UsageError, match="taken by camera SECOND"),
    ):
        run("force-ip", gige.device.mac_text, another_address, *LO)
    before = gige.address
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind((another_address, 3956))  # by something that is no camera
        with pytest.raises(UnavailableError, match="did not answer"):
            run("force-ip", gige.device.mac_text, another_address, *LO)
    assert gige.address == before


def test_a_camera_that_is_not_there_is_unavailable() -> None:
    with pytest.raises(UnavailableError, match="camera list"):
        run("force-ip", "NO-SUCH-CAMERA", "127.0.0.9", *LO)


def test_an_unknown_interface_and_a_bad_address_are_wrong_usage(gige: GigeCamera) -> None:
    with pytest.raises(UsageError, match=r"there are .*lo"):
        run("list", "--interface", "nowhere0")
    with pytest.raises(UsageError, match="no IPv4 address"):
        run("force-ip", gige.address, "127.0.0.999", *LO)


def test_info_reads_features_and_set_writes_them(aravis: AravisLibrary, gige: GigeCamera) -> None:
    found = run_json("info", gige.device.serial, *LO)
    features = {feature["name"]: feature for feature in found["features"]}
    assert features["Width"]["value"] == 640
    assert features["ExposureTime"] | {"category": ""} == {
        "name": "ExposureTime", "category": "", "kind": "float", "access": "RW", "value": 5000.0, "minimum": 15.0,
        "maximum": 1_000_000.0, "increment": None, "choices": [],
    }  # fmt: skip
    assert features["Width"]["increment"] == 4
    assert "BayerRG8" in features["PixelFormat"]["choices"]
    done = run_json(
        "set", gige.address, "ExposureTime=1234.5", "PixelFormat=Mono12p", "GevSCPD=0x10", "DeviceUserID=north",
        "GevPersistentIPAddress=192.168.10.5", "AcquisitionFrameRateEnable=on", *LO,
    )  # fmt: skip
    assert [feature["value"] for feature in done["features"]] == [
        1234.5, "Mono12p", 16, "north", 0xC0A80A05, True,
    ]  # fmt: skip
    assert gige.settings.exposure_us == 1234.5
    assert gige.settings.packet_delay_ns == 16


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("ExposureTime=1", r"ExposureTime = 1 is refused: it must be 15 to 1000000; `slabcell camera info"),
        ("ExposureTime=long", r"ExposureTime = 'long' is no number: it must be 15 to 1000000"),
        ("Width=638", r"Width = 638 is refused: it must be 4 to 640 in steps of 4; .* shows what it has and takes"),
        ("PixelFormat=Mono9", r"PixelFormat = Mono9 is refused: it takes Mono8, .*RGB8"),
        ("AcquisitionFrameRateEnable=maybe", r"'maybe' is no truth value: it takes true and false"),
        ("SensorWidth=3", r"SensorWidth = 3 is refused: it can only be read now"),
        ("Sharpness=1", r"has no feature Sharpness; `slabcell camera info"),
    ],
)
def test_what_cannot_be_set_is_named_with_value_range_and_remedy(
    aravis: AravisLibrary, gige: GigeCamera, assignment: str, message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        run("set", gige.address, assignment, *LO)


def test_an_assignment_without_a_value_is_wrong_usage_and_a_command_needs_none(
    aravis: AravisLibrary, gige: GigeCamera
) -> None:
    for assignment in ("Width", "=3"):
        with pytest.raises(UsageError, match="write NAME=VALUE"):
            run("set", gige.address, assignment, *LO)
    assert "done" in run("set", gige.address, "GevTimestampControlLatch", *LO)


def test_a_camera_in_use_can_be_looked_at_but_not_set(aravis: AravisLibrary, gige: GigeCamera) -> None:
    device = AravisDevice(aravis, gige.address, CameraSettings(), CameraStatistics())
    device.connect()
    try:
        assert run_json("info", gige.address, "Width", *LO)["features"][0]["value"] == 640
        with pytest.raises(TemporaryError, match="another client"):
            run("set", gige.address, "Width=320", *LO)
        with pytest.raises(TemporaryError, match="a client controls it"):
            run("force-ip", gige.address, "127.0.0.9", *LO)
    finally:
        device.close()


def test_grab_writes_a_lossless_picture_and_says_how_it_was_taken(
    aravis: AravisLibrary, gige: GigeCamera, pattern: CheckedPattern, tmp_path: Path
) -> None:
    out = tmp_path / "picture.png"
    document = run_json("grab", gige.address, "--out", str(out), "--packet-size", "8000", *LO)
    picture = cv2.imread(str(out), cv2.IMREAD_UNCHANGED)
    assert pattern.number_of(picture) == gige.counts.triggers
    assert json.loads(out.with_suffix(".json").read_text()) == document
    assert (document["width"], document["height"], document["pixel_format"]) == (640, 480, "Mono8")


def test_stream_test_measures_and_counts_what_was_lost(aravis: AravisLibrary, gige: GigeCamera) -> None:
    words = ["stream-test", gige.address, "--duration-s", "0.4", "--timeout-s", "5", "--packet-size", "8000", *LO]
    good = run_json(*words)
    assert good["frames"] > 0
    assert good["frames"] + good["failed"] == good["triggers"]
    assert good["packet_size"] == 8000
    assert good["path"]["interface"] == "lo"
    gige.faults.apply("loss 0.1")
    result = CliRunner().invoke(camera_app, [*words, "--json"], catch_exceptions=False)
    lossy = json.loads(result.stdout)
    assert result.exit_code == (1 if lossy["failed"] else 0)
    assert lossy["statistics"]["packets_resent"] + lossy["statistics"]["packets_missing"] > 0
    assert lossy["advice"]


def test_a_stream_of_which_nothing_arrives_says_so(aravis: AravisLibrary, gige: GigeCamera) -> None:
    gige.faults.apply("loss 1")
    with pytest.raises(SlabcellError, match=gige.address):
        run("grab", gige.address, "--timeout-s", "2", *LO)


def test_sim_camera_shows_a_folder_and_obeys_faults_from_its_input(
    aravis: AravisLibrary, address: str, another_address: str, tmp_path: Path, program: Callable[..., object]
) -> None:
    first, second = address, f"{address.rpartition('.')[0]}.{int(address.rpartition('.')[2]) + 1}"
    assert second == another_address
    for number in range(2):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((60, 80), 50 + number, np.uint8))
    running = program("--address", first, "--count", "2", "--serial", "BOX", "--images", str(tmp_path))
    found = {c["serial"]: c["address"] for c in run_json("list", *LO)["cameras"]}
    assert (found["BOX"], found["BOX-2"]) == (first, second)
    out = tmp_path / "out" / "seen.png"
    out.parent.mkdir()
    run("grab", first, "--out", str(out), *LO)
    assert set(np.unique(cv2.imread(str(out), cv2.IMREAD_UNCHANGED))) <= {50, 51}
    running.do("dark on")
    run("grab", first, "--out", str(out), *LO)
    assert cv2.imread(str(out), cv2.IMREAD_UNCHANGED).max() < 10
    running.signal(signal.SIGTERM)


def test_a_camera_that_is_out_of_focus_or_stuck_sends_such_pictures(
    aravis: AravisLibrary, address: str, tmp_path: Path, program: Callable[..., object]
) -> None:
    for number in range(5):
        picture = np.full((60, 80), 20 + number, np.uint8)
        picture[:, 40:] = 200
        cv2.imwrite(str(tmp_path / f"{number}.png"), picture)
    running = program("--address", address, "--images", str(tmp_path))
    out = tmp_path / "out" / "seen.png"
    out.parent.mkdir()

    def seen() -> np.ndarray:
        run("grab", address, "--out", str(out), *LO)
        return cv2.imread(str(out), cv2.IMREAD_UNCHANGED)

    def steepest(picture: np.ndarray) -> int:
        return int(np.abs(np.diff(picture[30].astype(int))).max())

    sharp = seen()
    assert steepest(sharp) > 150
    running.do("stuck on")
    assert np.array_equal(seen(), sharp)
    assert np.array_equal(seen(), sharp)
    running.do("stuck off")
    assert any(not np.array_equal(seen(), sharp) for _ in range(3))
    running.do("blur on")
    assert steepest(seen()) < 100
    running.signal(signal.SIGTERM)


@pytest.mark.parametrize(
    ("words", "message", "code"),
    [
        (("--address", "10.0.0.1"), "loopback", 69),
        (("--fault", "explode"), "is not known", 2),
        (("--images", "/nonexistent"), "holds no picture", 2),
        (("--scene", "nowhere"), "nowhere", 2),
    ],
)
def test_sim_camera_names_what_it_cannot_do(words: tuple[str, ...], message: str, code: int) -> None:
    with pytest.raises(SlabcellError, match=message) as caught:
        CliRunner().invoke(sim_app, ["camera", *words], catch_exceptions=False)
    assert caught.value.exit_code == code
