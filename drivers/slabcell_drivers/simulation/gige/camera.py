"""How is the camera in software switched on?  `GigeCamera`: sockets and threads around control, sensor and stream.

It answers on UDP port 3956 of one loopback address, without root; several live side by side on 127.0.0.x.
It is *not* responsible for what it sees: that is the function it is given.
"""

import hashlib
import selectors
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from ipaddress import IPv4Address
from types import TracebackType
from typing import Final

from slabcell_drivers.camera.gvcp import PORT, Device
from slabcell_drivers.simulation.gige.control import LOOPBACK, Action, AddressForced, Control, Effect, ResendWanted
from slabcell_drivers.simulation.gige.faults import Faults
from slabcell_drivers.simulation.gige.features import SensorLimits
from slabcell_drivers.simulation.gige.registers import StreamSettings
from slabcell_drivers.simulation.gige.sensor import Render, Sensor
from slabcell_drivers.simulation.gige.stream import Streamer, StreamerCounts

__all__ = ["GigeCamera", "GigeCameraError"]

_BROADCASTS: Final = ("255.255.255.255", "127.255.255.255")
_TICK_S: Final = 0.05
MAX_SERIAL_BYTES: Final = 15
"""The register has 16, and the last is zero."""


class GigeCameraError(Exception):
    """The camera in software cannot be switched on; the message says why."""


class GigeCamera:
    """A GigE Vision camera.  Use it as a context manager, or call `start` and `close`."""

    def __init__(
        self,
        render: Render,
        address: str = "127.0.0.1",
        *,
        serial: str = "SIM-0001",
        vendor: str = "slabcell",
        model: str = "Software GigE",
        limits: SensorLimits | None = None,
        seed: int = 0,
    ) -> None:
        place = IPv4Address(address)
        if place not in LOOPBACK:
            raise GigeCameraError(f"{address} is not a loopback address; a camera in software lives in {LOOPBACK}")
        if not 0 < len(serial.encode()) <= MAX_SERIAL_BYTES:
            raise GigeCameraError(f"serial number '{serial}' is refused: it must have 1 to {MAX_SERIAL_BYTES} bytes")
        mac = b"\x02" + hashlib.blake2b(serial.encode(), digest_size=5).digest()  # 02: locally administered
        device = Device(vendor, model, serial, place, mac, version="1.0")
        self.faults = Faults(seed)
        self._render = render
        self._control = Control(device, limits or SensorLimits(), started_s=time.monotonic())
        self._lock = threading.RLock()
        self._selector = selectors.DefaultSelector()
        self._waker: tuple[socket.socket, socket.socket] | None = None
        self._unicast: socket.socket | None = None
        self._streamer: Streamer | None = None
        self._thread: threading.Thread | None = None

    @property
    def address(self) -> str:
        """The IPv4 address that the camera lives at now."""
        return str(self._control.device.address)

    @property
    def device(self) -> Device:
        """Who the camera says it is."""
        return self._control.device

    @property
    def controller(self) -> tuple[str, int] | None:
        """The client in control, None if there is none."""
        return self._control.controller

    @property
    def settings(self) -> StreamSettings:
        """What the registers say at this moment."""
        with self._lock:
            return self._control.settings

    @property
    def counts(self) -> StreamerCounts:
        """What the camera has done so far."""
        return self._streamer.counts if self._streamer else StreamerCounts()

    def pulse(self) -> None:
        """Take a frame that no client asked for, as a pulse on the camera's trigger line would."""
        if self._streamer is not None:
            self._streamer.trigger()

    def start(self) -> None:
        """Switch on; discovery is answered when this returns.  Raises GigeCameraError."""
        try:
            self._unicast = _bind(self.address)
            self._selector.register(self._unicast, selectors.EVENT_READ, data=False)
            for broadcast in _BROADCASTS:
                self._selector.register(_bind(broadcast, shared=True), selectors.EVENT_READ, data=True)
        except OSError as error:
            self._close_sockets()
            raise GigeCameraError(
                f"UDP port {PORT} of {self.address} cannot be taken ({error.strerror}): is another camera there?"
            ) from error
        self._waker = socket.socketpair()
        self._selector.register(self._waker[0], selectors.EVENT_READ)
        self._streamer = Streamer(Sensor(self._render, self.faults), lambda: self.settings, self.faults, self.address)
        self._thread = threading.Thread(target=self._serve, name=f"gige-control-{self.address}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Switch off; may be called twice."""
        if self._thread is None or self._waker is None:
            return
        self._waker[1].send(b"x")
        self._thread.join()
        self._thread = None
        if self._streamer is not None:
            self._streamer.close()
        self._waker[1].close()
        self._close_sockets()

    def __enter__(self) -> "GigeCamera":
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _close_sockets(self) -> None:
        for key in list(self._selector.get_map().values()):
            self._selector.unregister(key.fileobj)
            if isinstance(key.fileobj, socket.socket):
                key.fileobj.close()
        self._selector.close()

    def _serve(self) -> None:
        while True:
            events = self._selector.select(_TICK_S if self._control.controller else None)
            for key, _ in events:
                found = key.fileobj
                if not isinstance(found, socket.socket) or (self._waker and found is self._waker[0]):
                    return
                self._receive(found, broadcast=bool(key.data))
            with self._lock:
                lost = self._control.expire(time.monotonic())
            if lost and self._streamer is not None:
                self._streamer.stop()

    def _receive(self, source: socket.socket, *, broadcast: bool) -> None:
        try:
            datagram, peer = source.recvfrom(2048)
        except OSError:
            return  # a client's closed port answered an earlier packet of ours; there is nothing to read
        if self.faults.is_on("freeze") or IPv4Address(peer[0]) not in LOOPBACK or self._unicast is None:
            return
        with self._lock:
            reaction = self._control.handle(datagram, (peer[0], peer[1]), time.monotonic(), broadcast=broadcast)
            if not self._control.streaming and self._streamer is not None:
                self._streamer.stop()
        # An acquisition runs, and a new address is in place, before the client hears so: it may use them at once.
        early = [effect for effect in reaction.effects if effect is Action.START or isinstance(effect, AddressForced)]
        done = self._act(early)
        if done and reaction.answer is not None:
            self._unicast.sendto(reaction.answer, peer)
        self._act([effect for effect in reaction.effects if effect not in early])

    def _act(self, effects: Sequence[Effect]) -> bool:
        """Do it; False if an address could not be taken, which no client hears of, as from cameras."""
        streamer = self._streamer
        if streamer is None:
            return False
        for effect in effects:
            match effect:
                case Action.START:
                    streamer.start()
                case Action.STOP | Action.RESET:
                    streamer.stop()
                case Action.TRIGGER:
                    streamer.trigger()
                case Action.TEST_PACKET:
                    streamer.send_test_packet()
                case ResendWanted():
                    streamer.resend(effect)
                case AddressForced():
                    if not self._move(effect):
                        return False
        return True

    def _move(self, forced: AddressForced) -> bool:
        """Take another address, if nobody has it; a camera that cannot stays where it is."""
        if self._unicast is None or self._streamer is None:
            return False
        if str(forced.address) == self.address:
            return True
        try:
            moved = _bind(str(forced.address))
        except OSError:
            return False
        self._selector.unregister(self._unicast)
        self._unicast.close()
        self._unicast = moved
        self._selector.register(moved, selectors.EVENT_READ, data=False)
        with self._lock:
            device = replace(self._control.device, address=forced.address, subnet=forced.subnet, gateway=forced.gateway)
            self._control.readdress(device)
        self._streamer.stop()
        self._streamer.readdress(str(forced.address))
        return True


def _bind(host: str, *, shared: bool = False) -> socket.socket:
    """Return a UDP socket on the control port.  A broadcast address may be shared by several cameras."""
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if shared:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        found.bind((host, PORT))
    except OSError:
        found.close()
        raise
    return found
