"""Which GigE Vision cameras are on the network?  Found, and given an address, without any SDK.

A camera answers a broadcast even when its address belongs to another network; `force_ip` then gives it a right one
until its next start.
"""

import fcntl
import secrets
import selectors
import socket
import struct
import time
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Final

from slabcell_drivers.camera.gvcp import (
    PORT,
    Command,
    Device,
    GvcpError,
    Request,
    Status,
    decode_answer,
    decode_device,
    encode_force_ip,
    encode_request,
)

__all__ = ["Interface", "discover", "find_camera", "force_ip", "interfaces"]

DISCOVERY_S: Final = 0.5
ALLOW_BROADCAST_ANSWER: Final = 0x10
_SIOCGIFADDR, _SIOCGIFBRDADDR = 0x8915, 0x8919
_EVERYBODY: Final = "255.255.255.255"


@dataclass(frozen=True, slots=True)
class Interface:
    """A network interface with an IPv4 address."""

    name: str
    address: str
    broadcast: str


NO_GATEWAY: Final = IPv4Address(0)
LOOPBACK: Final = Interface("lo", "127.0.0.1", "127.255.255.255")


def interfaces() -> tuple[Interface, ...]:
    """Return every interface that has an IPv4 address."""
    found: list[Interface] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            try:
                address, broadcast = (_ask(probe, name, what) for what in (_SIOCGIFADDR, _SIOCGIFBRDADDR))
            except OSError:
                continue  # it has no IPv4 address
            if address == LOOPBACK.address:
                broadcast = LOOPBACK.broadcast
            found.append(Interface(name, address, broadcast))
    return tuple(found)


def _ask(probe: socket.socket, name: str, what: int) -> str:
    answer = fcntl.ioctl(probe.fileno(), what, struct.pack("256s", name.encode()[:15]))
    return socket.inet_ntoa(answer[20:24])


def discover(
    timeout_s: float = DISCOVERY_S, *, on: Sequence[Interface] | None = None, ask: Iterable[str] = ()
) -> tuple[Device, ...]:
    """Return every camera that answers within the time, in the order of their addresses.

    ``on`` limits the broadcast to some interfaces; ``ask`` are addresses that are asked directly as well.
    """
    with closing(_devices(timeout_s, on, ask)) as answers:
        found = {(device.mac, device.address): device for device in answers}
    return tuple(sorted(found.values(), key=lambda device: device.address))


def find_camera(wanted: str, timeout_s: float = DISCOVERY_S, *, on: Sequence[Interface] | None = None) -> Device | None:
    """Return the camera with this address, serial number, MAC address or user-defined name, None if none answers.

    It returns as soon as that camera has answered.
    """
    try:
        ask = (str(IPv4Address(wanted)),)
    except ValueError:
        ask = ()
    with closing(_devices(timeout_s, on, ask)) as answers:
        for device in answers:
            if wanted in (str(device.address), device.serial, device.mac_text, device.user_name):
                return device
    return None


def _devices(timeout_s: float, on: Sequence[Interface] | None, ask: Iterable[str]) -> Generator[Device]:
    """Ask everybody, and yield each answer as it comes; a camera may answer more than once."""
    request = Request(Command.DISCOVERY, 1 + secrets.randbelow(0xFFFE), flags=0x01 | ALLOW_BROADCAST_ANSWER)
    datagram = encode_request(request)
    sockets = _open(interfaces() if on is None else on)
    try:
        for port, interface in sockets:
            for target in (*ask, interface.broadcast, _EVERYBODY):
                _send(port, datagram, target)
        for body in _answers([port for port, _ in sockets], request.number, timeout_s):
            try:
                yield decode_device(body)
            except GvcpError:
                continue  # somebody answers who does not speak GVCP
    finally:
        for port, _ in sockets:
            port.close()


def force_ip(
    mac: bytes,
    address: IPv4Address,
    subnet: IPv4Address,
    gateway: IPv4Address = NO_GATEWAY,
    *,
    timeout_s: float = 1.0,
    on: Sequence[Interface] | None = None,
) -> Status | None:
    """Give the camera with this MAC address an address until its next start; None if it did not answer."""
    request = Request(
        Command.FORCE_IP, 1 + secrets.randbelow(0xFFFE), encode_force_ip(mac, address, subnet, gateway), 0x11
    )
    datagram = encode_request(request)
    sockets = _open(interfaces() if on is None else on)
    found: list[Status] = []
    try:
        for port, interface in sockets:
            for target in (interface.broadcast, _EVERYBODY):
                _send(port, datagram, target)
        for answer_status in _statuses([port for port, _ in sockets], request.number, timeout_s):
            found.append(answer_status)
            if answer_status is Status.SUCCESS:
                break  # asked over two broadcasts, it answers twice: one success is enough
    finally:
        for port, _ in sockets:
            port.close()
    return found[-1] if found else None


def _open(on: Sequence[Interface]) -> list[tuple[socket.socket, Interface]]:
    sockets: list[tuple[socket.socket, Interface]] = []
    for interface in on:
        port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        port.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        port.setblocking(False)  # noqa: FBT003 - the socket's own signature
        try:
            port.bind((interface.address, 0))
        except OSError:
            port.close()  # the interface went away since it was listed
            continue
        sockets.append((port, interface))
    return sockets


def _send(port: socket.socket, datagram: bytes, target: str) -> None:
    try:
        port.sendto(datagram, (target, PORT))
    except OSError:
        return  # an interface without a route to this broadcast; the others are asked too


def _datagrams(ports: Sequence[socket.socket], timeout_s: float) -> Iterable[bytes]:
    deadline_s = time.monotonic() + timeout_s
    with selectors.DefaultSelector() as selector:
        for port in ports:
            selector.register(port, selectors.EVENT_READ, data=port)
        while (left_s := deadline_s - time.monotonic()) > 0:
            for key, _ in selector.select(left_s):
                try:
                    yield key.data.recv(2048)
                except OSError:
                    continue  # a closed port answered; others may still come


def _answers(ports: Sequence[socket.socket], number: int, timeout_s: float) -> Iterable[bytes]:
    for datagram in _datagrams(ports, timeout_s):
        try:
            answer = decode_answer(datagram)
        except GvcpError:
            continue
        if answer.number == number and answer.status == Status.SUCCESS:
            yield answer.body


def _statuses(ports: Sequence[socket.socket], number: int, timeout_s: float) -> Iterable[Status]:
    for datagram in _datagrams(ports, timeout_s):
        try:
            answer = decode_answer(datagram)
            if answer.number == number:
                yield Status(answer.status)
        except (GvcpError, ValueError):
            continue
