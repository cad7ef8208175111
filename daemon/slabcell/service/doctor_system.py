"""Are the PC, its network, the camera and the service in order?"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from importlib import resources
from ipaddress import IPv4Address, ip_network
from pathlib import Path

from slabcell.errors import SlabcellError
from slabcell.service.api.client import ApiClient
from slabcell.service.devices import api_socket
from slabcell.service.doctor import Patient, Severity
from slabcell.service.install_release import interpreter
from slabcell_drivers.camera.aravis_library import AravisLibrary, AravisMissingError
from slabcell_drivers.camera.discovery import Interface, find_camera, interfaces
from slabcell_drivers.camera.gvcp import Device
from slabcell_drivers.camera.probe import Sight, look

__all__ = ["look_at_buffers", "look_at_camera", "look_at_daemon", "look_at_link", "look_at_unit"]

Answers = Iterator[tuple[Severity, str, str]]

FIND_S = 1.0
SMALL_FRAME_BYTES = 1 << 20
JUMBO = 8000  # a packet that needs jumbo frames
GIGABIT = 1000
DEFAULT_SOCKET = Path("/run/slabcell/api.sock")


def look_at_camera(patient: Patient) -> Answers:
    """Find the camera, and ask whom it obeys."""
    if patient.config is None:
        return
    camera = patient.config.camera
    if camera.driver in {"replay", "simulated"}:
        yield Severity.NOTE, f"driver {camera.driver}: there is no camera to look for", ""
        return
    if camera.driver == "aravis":
        try:
            AravisLibrary()
        except AravisMissingError as error:
            yield Severity.ERROR, str(error), "apt-get install libaravis-0.8-0"
    found = find_camera(camera.camera, FIND_S)
    if found is None:
        how = "check power and cable; `slabcell camera list` shows what answers, `camera force-ip` gives an address"
        yield Severity.ERROR, f"camera {camera.camera}: does not answer", how
        return
    yield Severity.OK, f"camera {found.vendor} {found.model} {found.serial} at {found.address}", ""
    yield from _address_of(found)
    calibration = patient.calibration
    if calibration is not None and calibration.camera.serial not in {"", found.serial}:
        how = (
            "name this camera's calibration in the configuration; to make one, take the old one out of it and"
            " active-calibration.json out of the state directory, start the daemon anew, and use page Calibrate"
        )
        detail = f"the calibration is of camera {calibration.camera.serial}, this one is {found.serial}"
        yield Severity.ERROR, detail, how
    if asyncio.run(look(str(found.address), FIND_S)) is Sight.CONTROLLED:
        whose = "the daemon, if it runs; otherwise close the other program"
        yield Severity.NOTE, f"camera {found.serial} is controlled by a client", whose


def _address_of(camera: Device) -> Answers:
    """Tell whether the camera can be spoken to from one of our interfaces."""
    network = ip_network(f"{camera.address}/{camera.subnet}", strict=False)
    mine = [item for item in interfaces() if IPv4Address(item.address) in network]
    if not mine:
        ours = ", ".join(f"{item.name} {item.address}" for item in interfaces())
        how = f"give an interface an address in {network}, or the camera one in yours: `slabcell camera force-ip`"
        yield Severity.ERROR, f"no interface is in the camera's network {network}; there are {ours}", how


def look_at_link(patient: Patient) -> Answers:
    """Look at the interface through which the camera sends: link, speed, packet size."""
    if patient.config is None or patient.config.camera.driver in {"replay", "simulated"}:
        return
    found = find_camera(patient.config.camera.camera, FIND_S)
    if found is None:
        return
    network = ip_network(f"{found.address}/{found.subnet}", strict=False)
    for item in interfaces():
        if IPv4Address(item.address) in network:
            yield from _link(item, patient.config.camera.packet_size or JUMBO)


def _link(item: Interface, packet_size: int) -> Answers:
    folder = Path("/sys/class/net") / item.name
    mtu = int((folder / "mtu").read_text())
    if (folder / "operstate").read_text().strip() == "down":
        yield Severity.ERROR, f"{item.name}: no link", "check the cable, and the switch"
        return
    try:
        speed = int((folder / "speed").read_text())
    except OSError:  # a loopback or a virtual interface has none
        speed = 0
    if 0 < speed < GIGABIT:
        how = "use a gigabit switch and a cable of category 5e or better"
        yield Severity.WARNING, f"{item.name}: runs at {speed} Mbit/s", how
    if mtu < packet_size:
        how = f"ip link set {item.name} mtu 9000 (and the switch), or a smaller packet_size"
        yield Severity.WARNING, f"{item.name}: MTU {mtu}; packets of {packet_size} bytes do not pass", how
    else:
        yield Severity.OK, f"{item.name}: up, MTU {mtu}", ""


def look_at_buffers(patient: Patient) -> Answers:
    """Compare the largest socket buffer with what a frame needs."""
    needed = SMALL_FRAME_BYTES
    if patient.calibration is not None:
        needed = patient.calibration.camera.width * patient.calibration.camera.height
    here = int((patient.root / "proc/sys/net/core/rmem_max").read_text())
    if here < needed:
        how = "install the service's sysctl.d/60-slabcell.conf (`slabcell install`), then `sysctl --system`"
        yield Severity.WARNING, f"net.core.rmem_max is {here}; a frame has {needed} bytes: packets will get lost", how
    else:
        yield Severity.OK, f"net.core.rmem_max is {here}; a frame has {needed} bytes", ""


def look_at_unit(patient: Patient) -> Answers:
    """Look whether the service is installed as this version ships it, and enabled."""
    unit = patient.root / "etc/systemd/system/slabcell.service"
    if not unit.exists():
        yield Severity.WARNING, f"{unit}: the service is not installed", "slabcell install"
        return
    shipped = (resources.files("slabcell") / "data" / "systemd" / "slabcell.service").read_bytes()
    if unit.read_bytes() != shipped:
        how = "slabcell install; put changes of your own into a drop-in: systemctl edit slabcell"
        yield Severity.WARNING, f"{unit}: is not the one of this version", how
    wanted = patient.root / "etc/systemd/system/multi-user.target.wants/slabcell.service"
    if not wanted.is_symlink():
        how = "systemctl enable --now slabcell.service"
        yield Severity.WARNING, "the service is not enabled: it does not start with the PC", how
    else:
        yield Severity.OK, f"{unit}: installed and enabled", ""
    runs_on = interpreter()
    if str(runs_on).startswith(("/home/", "/root/")):
        how = "install with the system's Python: PYTHON=/usr/bin/python3 ./run install"
        yield Severity.ERROR, f"the interpreter {runs_on} lies where the service cannot see it", how


def look_at_daemon(patient: Patient) -> Answers:
    """Ask the daemon how it is."""
    socket_path = DEFAULT_SOCKET
    if patient.config is not None and patient.config.api.socket is not None:
        socket_path = patient.config.api.socket
    elif patient.state is not None and not DEFAULT_SOCKET.exists():
        socket_path = api_socket(None, patient.state)
    try:
        status = ApiClient(socket_path, timeout_s=5.0).get("/v1/status")
    except SlabcellError as error:
        yield (
            Severity.WARNING,
            f"the daemon does not answer: {error}",
            "systemctl start slabcell; journalctl -u slabcell",
        )
        return
    yield Severity.OK, f"the daemon runs (process {status['pid']}), state {status['state']}", ""
    for link in status["links"]:
        if link["state"] != "up":
            yield Severity.WARNING, f"its link to the {link['name']} is {link['state']}: {link['detail']}", ""
    if status["held"]:
        yield Severity.WARNING, f"the cell holds: {status['held']}", "slabcell alarms list"
