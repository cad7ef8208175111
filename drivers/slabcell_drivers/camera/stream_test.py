"""How well do pictures arrive, and what should be changed?  A measurement of one camera on this host, and advice.

The advice is a pure function of what was measured, so that each line of it is tested.
"""

import asyncio
import socket
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from slabcell_drivers.camera.aravis_device import kernel_buffer_limit
from slabcell_drivers.camera.discovery import interfaces
from slabcell_drivers.camera.gvcp import PORT
from slabcell_drivers.camera.protocol import CameraError, CameraIncomplete, CameraTimeout
from slabcell_drivers.camera.settings import CameraStatistics
from slabcell_drivers.camera.supervision import SupervisedCamera

__all__ = ["NetworkPath", "StreamReport", "advise", "advise_failure", "look_at_path", "measure_stream"]

JUMBO: Final = 9000
WANTED_BUFFER: Final = 33_554_432


@dataclass(frozen=True, slots=True)
class NetworkPath:
    """What lies between host and camera: the interface, its largest packet, and the kernel's limit for buffers."""

    interface: str
    mtu: int
    rmem_max: int


@dataclass(frozen=True, slots=True)
class StreamReport:
    """What a stream test measured."""

    duration_s: float
    triggers: int
    frames: int
    failed: int
    frame_bytes: int
    packet_size: int
    packet_delay_ns: int
    latency_median_ms: float
    latency_p99_ms: float
    path: NetworkPath
    statistics: CameraStatistics

    @property
    def megabytes_per_s(self) -> float:
        """What arrived whole."""
        return self.frames * self.frame_bytes / self.duration_s / 1e6 if self.duration_s else 0.0


def look_at_path(address: str) -> NetworkPath:
    """Return the interface that packets to a camera take."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((address, PORT))
            own = probe.getsockname()[0]
        except OSError:
            return NetworkPath("?", 0, kernel_buffer_limit())
    name = next((found.name for found in interfaces() if found.address == own), "lo" if own.startswith("127.") else "?")
    try:
        mtu = int(Path(f"/sys/class/net/{name}/mtu").read_text())
    except (OSError, ValueError):
        mtu = 0
    return NetworkPath(name, mtu, kernel_buffer_limit())


async def measure_stream(
    camera: SupervisedCamera,
    *,
    duration_s: float,
    timeout_s: float,
    packet_size: int,
    packet_delay_ns: int,
    path: NetworkPath,
) -> StreamReport:
    """Trigger an open camera again and again for a while.  Raises CameraLost; bad frames are counted."""
    latencies_s: list[float] = []
    triggers = failed = frame_bytes = 0
    before = replace(camera.statistics)  # the first picture after a start is often incomplete, and not measured
    began_s = time.monotonic()
    while time.monotonic() - began_s < duration_s:
        triggers += 1
        try:
            frame = await camera.snap(timeout_s)
        except (CameraIncomplete, CameraTimeout):
            failed += 1
            continue
        frame_bytes = frame.pixels.nbytes
        latencies_s.append(frame.received_s - frame.triggered_s)
        await asyncio.sleep(0)
    if not latencies_s:
        raise CameraError(
            f"not one of {triggers} pictures arrived whole: " + " ".join(advise_failure(packet_size, path))
        )
    return StreamReport(
        time.monotonic() - began_s,
        triggers,
        len(latencies_s),
        failed,
        frame_bytes,
        packet_size,
        packet_delay_ns,
        float(np.median(latencies_s)) * 1e3,
        float(np.percentile(latencies_s, 99)) * 1e3,
        path,
        camera.statistics.since(before),
    )


def advise_failure(packet_size: int, path: NetworkPath) -> list[str]:
    """Say what to look at when nothing arrives whole."""
    advice = ["Allow UDP from the camera through the firewall."]
    if path.mtu and packet_size > path.mtu:
        advice.append(f"Packets of {packet_size} bytes do not pass {path.interface} (MTU {path.mtu}).")
    return advice


def advise(report: StreamReport) -> list[str]:
    """Say what to change, the most useful first; empty if all is well."""
    advice: list[str] = []
    path, seen = report.path, report.statistics
    losing = report.failed > 0 or seen.incomplete > 0 or seen.packets_missing > 0
    if path.rmem_max and path.rmem_max < 1.5 * report.frame_bytes:
        advice.append(
            f"net.core.rmem_max is {path.rmem_max} bytes, a frame has {report.frame_bytes}: the kernel drops packets"
            f" when this process is busy. Run: sudo sysctl -w net.core.rmem_max={WANTED_BUFFER} (and keep it in"
            " /etc/sysctl.d)."
        )
    if path.mtu and path.mtu < JUMBO and path.interface != "lo":
        advice.append(
            f"{path.interface} has MTU {path.mtu}: {report.frame_bytes // max(1, path.mtu) + 1} packets a frame. If"
            f" camera and switch can, run: sudo ip link set {path.interface} mtu {JUMBO}, and open the camera again."
        )
    elif path.mtu and report.packet_size < min(path.mtu, JUMBO) // 2:
        advice.append(
            f"Packets have {report.packet_size} bytes, {path.interface} takes {min(path.mtu, JUMBO)}: set no size"
            " and the largest that passes is found; a camera that knows no test packet must be told it"
            f" (--packet-size {min(path.mtu, JUMBO)}). A switch in between may not take jumbo frames."
        )
    if losing and not report.packet_delay_ns:
        advice.append(
            "Packets are lost and the camera sends without a pause: give it a packet delay (GevSCPD), 20000 ns to begin"
            " with; several cameras on one link need one each."
        )
    elif losing:
        advice.append(
            f"Packets are lost in spite of a packet delay of {report.packet_delay_ns} ns: look at cable, switch and the"
            f" interface's counters (ethtool -S {path.interface})."
        )
    if seen.packets_resent and not losing:
        advice.append(
            f"{seen.packets_resent} packets had to be sent again; every frame arrived, later than it could have."
        )
    if seen.underruns:
        advice.append(f"{seen.underruns} frames found no buffer: raise the number of buffers.")
    return advice
