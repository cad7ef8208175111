"""How long from trigger to pixels, beside bare Aravis and bare Harvesters, and is every frame whole?

    python benchmarks/camera_trigger.py [--frames N] [--driver aravis|harvesters|both] [--loss SHARE] [--json]

The camera is `slabcell sim camera` in a process of its own on loopback: 1920x1200 Mono8, packets of 8000 bytes,
exposure 5 ms.  Every byte of a picture tells its number, so a wrong byte is seen.  The drivers and their bare libraries
take turns, so that load on the machine meets both alike.
"""

import argparse
import asyncio
import contextlib
import ctypes
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from slabcell_drivers.camera import CameraError, CameraState
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.aravis_library import AravisLibrary
from slabcell_drivers.camera.harvesters import HarvestersCamera
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.camera.supervision import SupervisedCamera
from slabcell_drivers.gentl import build
from slabcell_drivers.simulation.gige import CheckedPattern

# At 5 ms the camera shows a picture unchanged, so that every byte can be compared.
SETTINGS = CameraSettings(packet_size=8000, exposure_us=5000.0)
WARM_UP = 20


@contextlib.contextmanager
def camera_program(address: str, serial: str, *faults: str) -> Iterator[None]:
    """Run a camera as a program."""
    command = [str(Path(sys.executable).parent / "slabcell"), "sim", "camera", "--address", address, "--serial", serial]
    for fault in faults:
        command += ["--fault", fault]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert "ready" in process.stdout.readline()
        try:
            yield
        finally:
            process.terminate()


class BareAravis:
    """The fewest calls that give a copy of a picture; nothing is checked but the buffer's status."""

    def __init__(self, address: str) -> None:
        self.library = AravisLibrary()
        call = self.library.call
        self.camera = call("arv_camera_new", address.encode())
        device = call("arv_camera_get_device", self.camera)
        call("arv_camera_gv_set_stream_options", self.camera, 1)
        call("arv_camera_gv_set_packet_size_adjustment", self.camera, 0)
        call("arv_device_set_integer_feature_value", device, b"GevSCPSPacketSize", 8000)
        for name, value in ((b"TriggerMode", b"On"), (b"TriggerSource", b"Software")):
            call("arv_device_set_string_feature_value", device, name, value)
        call("arv_device_set_float_feature_value", device, b"ExposureTime", ctypes.c_double(5000.0))
        self.stream = call("arv_camera_create_stream", self.camera, None, None)
        self.library.set_properties(self.stream, socket_buffer=0, socket_buffer_size=16 << 20)
        payload = call("arv_camera_get_payload", self.camera)
        for _ in range(6):
            call("arv_stream_push_buffer", self.stream, call("arv_buffer_new_allocate", payload))
        call("arv_camera_start_acquisition", self.camera)

    def snap(self) -> float | None:
        """Return the seconds that a picture took, None if it was not whole."""
        call = self.library.call
        began_s = time.perf_counter()
        call("arv_camera_software_trigger", self.camera)
        buffer = call("arv_stream_timeout_pop_buffer", self.stream, 2_000_000)
        if not buffer:
            return None
        good = call("arv_buffer_get_status", buffer) == 0
        self.library.data(buffer).copy()
        took_s = time.perf_counter() - began_s
        call("arv_stream_push_buffer", self.stream, buffer)
        return took_s if good else None

    def close(self) -> None:
        """Give the camera back."""
        self.library.call("arv_camera_stop_acquisition", self.camera)
        self.library.unref(self.stream)
        self.library.unref(self.camera)


class BareHarvesters:
    """Harvesters as its documentation shows it, in this process."""

    def __init__(self, producer: str, serial: str) -> None:
        from harvesters.core import Harvester  # noqa: PLC0415 - optional

        self.harvester: Any = Harvester()
        self.harvester.add_file(producer)
        self.harvester.update()
        self.acquirer: Any = self.harvester.create({"serial_number": serial})
        self.acquirer.num_buffers = 6
        self.nodes = self.acquirer.remote_device.node_map
        self.nodes.GevSCPSPacketSize.value = 8000
        self.nodes.TriggerMode.value = "On"
        self.nodes.TriggerSource.value = "Software"
        self.nodes.ExposureTime.value = 5000.0
        self.acquirer.start()

    def snap(self) -> float | None:
        """Return the seconds that a picture took, None if it was not whole."""
        began_s = time.perf_counter()
        self.nodes.TriggerSoftware.execute()
        buffer = self.acquirer.try_fetch(timeout=2.0)
        if buffer is None:
            return None
        buffer.payload.components[0].data.copy()
        took_s = time.perf_counter() - began_s
        buffer.queue()
        return took_s

    def close(self) -> None:
        """Give the camera back."""
        self.acquirer.stop()
        self.acquirer.destroy()
        self.harvester.reset()


class Watch:
    """Resident memory, threads and descriptors of this process, and how long the event loop was held up."""

    def __init__(self) -> None:
        self.samples: list[tuple[int, int, int, int]] = []
        self.stall_s = 0.0

    def sample(self, count: int) -> None:
        """Take the figures after so many frames."""
        status = Path("/proc/self/status").read_text()
        fields = dict(line.split(":", 1) for line in status.splitlines())
        descriptors = len(list(Path("/proc/self/fd").iterdir()))
        self.samples.append((count, int(fields["VmRSS"].split()[0]), int(fields["Threads"]), descriptors))

    async def feel(self) -> None:
        """Notice when the loop comes late."""
        while True:
            began_s = time.perf_counter()
            await asyncio.sleep(0.005)
            self.stall_s = max(self.stall_s, time.perf_counter() - began_s - 0.005)

    def slopes(self) -> dict[str, float]:
        """Return growth for a thousand frames over the second half of the run: kB, threads, descriptors."""
        later = np.array(self.samples[len(self.samples) // 2 :], float)
        if len(later) < 3:
            return {}
        names = ("rss_kb", "threads", "descriptors")
        return {name: float(np.polyfit(later[:, 0] / 1000, later[:, i + 1], 1)[0]) for i, name in enumerate(names)}


async def own(
    camera: SupervisedCamera, pattern: CheckedPattern, frames: int, bare: Callable[[], float | None] | None
) -> dict:
    """Take pictures by turns with our driver and the bare library, and say how both did."""
    watch = Watch()
    feeler = asyncio.create_task(watch.feel())
    ours: list[float] = []
    theirs: list[float] = []
    wrong = out_of_order = failed = 0
    last = 0
    for count in range(frames + WARM_UP):
        began_s = time.perf_counter()
        try:
            frame = await camera.snap(5.0)
        except CameraError:
            failed += 1
            while camera.state is not CameraState.READY:
                await camera.until(CameraState.READY)
            continue
        took_s = time.perf_counter() - began_s
        number = pattern.number_of(frame.pixels)
        if number is None:
            wrong += 1
        else:
            out_of_order += number <= last
            last = number
        other = await asyncio.to_thread(bare) if bare is not None else None
        if count >= WARM_UP:
            ours.append(took_s)
            if other is not None:
                theirs.append(other)
        if count % max(1, frames // 40) == 0:
            watch.sample(count)
    feeler.cancel()
    result = {
        "frames": len(ours), "failed": failed, "wrong_pixels": wrong, "out_of_order": out_of_order,
        "median_ms": float(np.median(ours)) * 1e3, "p99_ms": float(np.percentile(ours, 99)) * 1e3,
        "loop_stall_max_ms": watch.stall_s * 1e3, "growth_per_1000_frames": watch.slopes(),
        "statistics": {
            name: getattr(camera.statistics, name) for name in ("retries", "incomplete", "stale", "packets_resent")
        },
    }  # fmt: skip
    if theirs:
        result |= {
            "bare_median_ms": float(np.median(theirs)) * 1e3,
            "bare_p99_ms": float(np.percentile(theirs, 99)) * 1e3,
        }
        result["overhead_ms"] = result["median_ms"] - result["bare_median_ms"]
        result["overhead_percent"] = 100 * result["overhead_ms"] / result["bare_median_ms"]
    return result


async def run(driver: str, frames: int, loss: float, *, beside: bool) -> dict:
    """Measure one driver."""
    pattern = CheckedPattern()
    faults = (f"loss {loss}",) if loss else ()
    settings = SETTINGS
    with camera_program("127.0.0.91", "BENCH-1", *faults), camera_program("127.0.0.92", "BENCH-2"):
        bare: BareAravis | BareHarvesters | None = None
        if driver == "aravis":
            camera: SupervisedCamera = AravisCamera("127.0.0.91", settings)
            bare = BareAravis("127.0.0.92") if beside else None
        else:
            camera = HarvestersCamera("127.0.0.91", [build()], settings)
            bare = BareHarvesters(str(build()), "BENCH-2") if beside else None
        await camera.open(15.0)
        try:
            return await own(camera, pattern, frames, bare.snap if bare else None)
        finally:
            await camera.close()
            if bare is not None:
                bare.close()


def main() -> None:
    """Measure the drivers that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--driver", choices=("aravis", "harvesters", "both"), default="both")
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--alone", action="store_true", help="without the bare library beside it")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    for driver in ("aravis", "harvesters") if options.driver == "both" else (options.driver,):
        result = asyncio.run(run(driver, options.frames, options.loss, beside=not options.alone))
        print(json.dumps({"driver": driver, **result}) if options.json else f"{driver}: {json.dumps(result, indent=2)}")


if __name__ == "__main__":
    main()
