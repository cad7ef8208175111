"""The service's unit forbids a lot: does the cell work under exactly these limits, and are they limits?"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slabcell_drivers.camera.aravis_library import AravisLibrary, AravisMissingError
from slabcell_drivers.simulation.gige import GigeCamera, SensorLimits

from .confinement import UNIT, allowed_calls, confined, directives, missing

pytestmark = [pytest.mark.faults, pytest.mark.timeout(180)]

LIMIT_S = 120.0

PROBE = """
import ctypes, json, mmap, os, socket, sys, time
def tried(work):
    try:
        work()
    except OSError as error:
        return type(error).__name__ if not error.errno else os.strerror(error.errno)
    return "allowed"
libc = ctypes.CDLL(None, use_errno=True)
def called(number_of_call, *words):
    if libc[number_of_call](*words) == -1:
        raise OSError(ctypes.get_errno(), "")
status = dict(line.split(":\\t", 1) for line in open("/proc/self/status").read().splitlines() if ":\\t" in line)
print(json.dumps({
    "status": {key: status[key] for key in ("CapEff", "CapPrm", "CapBnd", "NoNewPrivs", "Seccomp", "Uid")},
    "writable code": tried(lambda: mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)),
    "packet socket": tried(lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW)),
    "raw socket": tried(lambda: socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_ICMP)),
    "bluetooth": tried(lambda: socket.socket(31, socket.SOCK_RAW)),
    "new namespace": tried(lambda: called("unshare", 0x10000000)),
    "mount": tried(lambda: called("mount", b"none", b"/mnt", b"tmpfs", 0, None)),
    "set-user-id bit": tried(lambda: os.chmod(sys.argv[1], 0o4755)),
    "realtime": tried(lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))),
    "reboot": tried(lambda: called("reboot", 0)),
    "set the clock": tried(lambda: time.clock_settime(time.CLOCK_REALTIME, time.time())),
    "write to /etc": tried(lambda: open("/etc/slabcell-was-here", "w")),
    "kernel tunables": os.path.exists("/proc/sys"),
    "other processes": [name for name in os.listdir("/proc") if name.isdigit() and int(name) > 50],
}))
"""

CAMERA = """
import asyncio, json, sys
import cv2, numpy, scipy.optimize, shapely
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.settings import CameraSettings
async def main():
    camera = AravisCamera(sys.argv[1], CameraSettings(packet_size=8000))
    info = await camera.open(30.0)
    frames = [await camera.snap(20.0) for _ in range(3)]
    await camera.close()
    return info, frames
info, frames = asyncio.run(main())
level, mask = cv2.threshold(cv2.GaussianBlur(frames[-1].pixels, (5, 5), 0), 0, 255, cv2.THRESH_OTSU)
solved = numpy.linalg.lstsq(numpy.random.default_rng(1).normal(size=(400, 200)), numpy.ones(400), rcond=None)
print(json.dumps({
    "serial": info.serial, "frames": [list(frame.pixels.shape) for frame in frames],
    "sum": int(frames[-1].pixels.sum()), "light": int((mask > 0).sum()), "rank": int(solved[2]),
    "threads": cv2.getNumThreads(),
}))
"""


def run_confined(folder: Path, script: str, *words: str) -> dict:
    with confined(folder, folder) as (limits, descriptors):
        done = subprocess.run(
            [*limits, sys.executable, "-c", script, *words],
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            pass_fds=descriptors,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_limits_are_limits(tmp_path):
    (tmp_path / "file").write_text("")
    found = run_confined(tmp_path, PROBE, str(tmp_path / "file"))
    status = found.pop("status")
    assert {status[key].strip("0") for key in ("CapEff", "CapPrm", "CapBnd")} == {""}
    assert (status["NoNewPrivs"], status["Seccomp"]) == ("1", "2")
    assert status["Uid"].split()[0] != "0"
    assert found.pop("kernel tunables") is False
    assert found.pop("other processes") == []
    assert found.pop("write to /etc") == "Read-only file system"
    assert found.pop("packet socket") == found.pop("bluetooth") == "Address family not supported by protocol"
    assert set(found.values()) == {"Operation not permitted"}, found


def test_camera_opencv_and_numpy_work_within_the_limits(tmp_path):
    try:
        AravisLibrary()
    except AravisMissingError as error:
        missing(str(error))
    picture = np.random.default_rng(3).integers(0, 255, (480, 640), dtype=np.uint8)
    host = 1 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    limits = SensorLimits(640, 480)
    with GigeCamera(lambda _: picture, f"127.0.23.{host}", serial="CONFINED", limits=limits) as camera:
        found = run_confined(tmp_path, CAMERA, camera.address)
    assert found["serial"] == "CONFINED"
    assert found["frames"] == [[480, 640]] * 3
    assert found["sum"] == int(picture.sum())
    assert 0 < found["light"] < picture.size
    assert found["rank"] == 200


def test_the_daemon_lays_the_pattern_within_the_limits(cell, tmp_path):
    """The whole of it: Aravis, vision, planning, ledger, bundles and control API, under the limits of the unit."""
    state = tmp_path / "state"
    state.mkdir()
    with (
        confined(tmp_path, state) as (limits, descriptors),
        cell.daemon(limits=limits, pass_fds=descriptors) as daemon,
    ):
        cell.wait_for_log("camera open")
        with cell.world.controller(daemon.address, seed=1) as controller:
            result = controller.run("SlabCell", max_wall_s=LIMIT_S)
        assert (result.status, result.message) == ("done", "")
        assert daemon.client.get("/v1/status")["state"] == "ready"
        assert daemon.client.fetch("/v1/frames/latest.jpg").media_type == "image/jpeg"
        assert daemon.client.post("/v1/vision/preview", {"everywhere": True})["located"] is not None
    assert list((state / "bundles").iterdir())


def test_the_unit_lets_no_privileged_call_through():
    calls = allowed_calls()
    assert {"read", "openat", "socket", "futex", "mmap", "clone"} <= calls
    assert not calls & {"mount", "reboot", "init_module", "setuid", "chroot", "settimeofday", "ptrace", "bpf", "swapon"}
    assert directives()["CapabilityBoundingSet"] == [""]
    assert "CAP_" not in "".join(line for line in UNIT.read_text().splitlines() if not line.startswith("#"))
