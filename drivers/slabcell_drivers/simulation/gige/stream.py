"""When does the camera in software take and send a frame?  Its stream thread: triggers, rate, packets, resends."""

import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from slabcell_drivers.simulation.gige.control import ResendWanted
from slabcell_drivers.simulation.gige.faults import Faults, FrameFault
from slabcell_drivers.simulation.gige.gvsp import FrameHead, FramePackets, next_block, probe_packet, unavailable_packet
from slabcell_drivers.simulation.gige.registers import StreamSettings
from slabcell_drivers.simulation.gige.sensor import Sensor

__all__ = ["Streamer", "StreamerCounts"]

KEPT_FRAMES: Final = 6
MAX_RESENT_PACKETS: Final = 4096
SEND_BUFFER_BYTES: Final = 4 << 20
_SPIN_NS: Final = 120_000
"""Below this, waiting by sleeping overshoots: the kernel's timer slack is 50 us."""


@dataclass(slots=True)
class StreamerCounts:
    """What the camera did since it was switched on."""

    triggers: int = 0
    triggers_ignored: int = 0
    frames: int = 0
    packets: int = 0
    packets_lost: int = 0
    packets_resent: int = 0


class Streamer:
    """Sends frames from its own thread and socket.  ``settings`` is asked afresh for each frame."""

    def __init__(self, sensor: Sensor, settings: Callable[[], StreamSettings], faults: Faults, host: str) -> None:
        self.counts = StreamerCounts()
        self._sensor = sensor
        self._settings = settings
        self._faults = faults
        self._host = host
        self._socket = _open(host)
        self._wake = threading.Condition()
        self._running = False
        self._closing = False
        self._triggered = False
        self._exposing = False
        self._acquisition = 0
        self._block = 1
        self._number = 0
        self._kept: deque[FramePackets] = deque()
        self._free: list[FramePackets] = []
        self._send_lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name=f"gige-stream-{host}", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The UDP port that packets come from."""
        return int(self._socket.getsockname()[1])

    def start(self) -> None:
        """Begin an acquisition: block ids count from 1."""
        with self._wake:
            self._running, self._triggered, self._block = True, False, 1
            self._acquisition += 1  # a frame that is being exposed belongs to the one before, and is not sent
            self._wake.notify()
        with self._send_lock:  # ids begin again: an old frame must not be sent for a new one of the same id
            self._free.extend(self._kept)
            self._kept.clear()

    def stop(self) -> None:
        """End the acquisition; the frame being sent is sent to its end."""
        with self._wake:
            self._running = self._triggered = False
            self._wake.notify()

    def trigger(self) -> None:
        """Take one frame; a trigger that comes while one is being exposed is ignored, as cameras do."""
        with self._wake:
            if not self._running or self._triggered or self._exposing:
                self.counts.triggers_ignored += 1
                return
            self.counts.triggers += 1
            self._triggered = True
            self._wake.notify()

    def send_test_packet(self) -> None:
        """Send one packet of the size set, so that the client sees whether it passes."""
        settings = self._settings()
        if settings.destination[1]:
            self._send(probe_packet(settings.packet_size), settings.destination)

    def resend(self, wanted: ResendWanted) -> None:
        """Send packets of a recent frame again, or say that they are gone."""
        settings = self._settings()
        if self._faults.is_on("noresend") or not settings.destination[1]:
            return
        last = min(wanted.last, wanted.first + MAX_RESENT_PACKETS)
        with self._send_lock:
            frame = next((frame for frame in self._kept if frame.block == wanted.block), None)
            for number in range(wanted.first, last + 1):
                if frame is None or number >= frame.count:
                    self._send(unavailable_packet(wanted.block, number), settings.destination)
                    continue
                self._send(frame.packet(number), settings.destination)
                self.counts.packets_resent += 1

    def readdress(self, host: str) -> None:
        """Send from another address from now on."""
        with self._send_lock:
            self._socket.close()
            self._host, self._socket = host, _open(host)

    def close(self) -> None:
        """End the thread."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        due_s = 0.0
        while True:
            with self._wake:
                while not self._closing and not (self._running and (self._triggered or self._free_running())):
                    self._wake.wait()
                if self._closing:
                    return
                acquisition = self._acquisition
                self._exposing, self._triggered = self._triggered, False
            settings = self._settings()
            began_s = time.monotonic()
            if not settings.triggered:
                due_s = max(due_s + 1 / settings.frame_rate_hz, began_s)
                if not self._wait_until(due_s):
                    continue
            self._frame(settings, acquisition)
            if settings.single:
                with self._wake:
                    self._running = False

    def _free_running(self) -> bool:
        return not self._settings().triggered

    def _wait_until(self, due_s: float) -> bool:
        """Return True when it is time, False if there is nothing more to send."""
        with self._wake:
            while not self._closing and self._running:
                left = due_s - time.monotonic()
                if left <= 0:
                    return True
                self._wake.wait(left)
        return False

    def _frame(self, settings: StreamSettings, acquisition: int) -> None:
        timestamp_ns = time.monotonic_ns()
        time.sleep(settings.exposure_us / 1e6)
        self._number += 1
        data = self._sensor.expose(self._number, settings)
        with self._wake:
            # Ready for the next trigger before the first packet leaves: who has the whole frame may trigger at once.
            self._exposing = False
            if acquisition != self._acquisition:
                return
            block = self._faults.take_next_block() or self._block
            self._block = next_block(block)
        fault = self._faults.begin_frame()
        if self._faults.late_s and not self._wait_until(time.monotonic() + self._faults.late_s):
            return
        if fault.dropped or self._faults.is_on("hang") or not settings.destination[1]:
            return
        height = settings.height // 2 if fault.half_height else settings.height
        head = FrameHead(
            block, timestamp_ns, settings.pixel_format.code, settings.width, height, settings.offset_x,
            settings.offset_y,
        )  # fmt: skip
        if fault.half_height:
            data = data[: settings.pixel_format.frame_bytes(settings.width, height)]
        with self._send_lock:
            recycled = self._free.pop() if self._free else None
            packets = FramePackets(head, data, settings.packet_size, recycled)
            if not fault.truncated and acquisition == self._acquisition:
                self._kept.append(packets)
            if len(self._kept) > KEPT_FRAMES:
                self._free.append(self._kept.popleft())
        self._send_frame(packets, settings, fault)
        self.counts.frames += 1

    def _send_frame(self, packets: FramePackets, settings: StreamSettings, fault: FrameFault) -> None:
        count = packets.count // 2 if fault.truncated else packets.count
        destination, delay_ns = settings.destination, settings.packet_delay_ns
        due_ns = time.monotonic_ns()
        for number in range(count):
            if delay_ns:
                _sleep_until(due_ns)
                due_ns += delay_ns
            self._send(packets.packet(number), destination)

    def _send(self, packet: bytes | memoryview, destination: tuple[str, int]) -> None:
        self.counts.packets += 1
        if self._faults.lose():
            self.counts.packets_lost += 1
            return
        try:
            self._socket.sendto(packet, destination)
        except OSError:
            # Nobody listens there any more, or the packet is larger than the interface takes: lost, as on a cable.
            self.counts.packets_lost += 1


def _open(host: str) -> socket.socket:
    stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    stream.bind((host, 0))
    return stream


def _sleep_until(due_ns: int) -> None:
    left = due_ns - time.monotonic_ns()
    if left > _SPIN_NS:
        time.sleep((left - _SPIN_NS) / 1e9)
    while time.monotonic_ns() < due_ns:
        pass
