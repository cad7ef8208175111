"""Can the robot, or the PLC in between, reach the cell where it waits for it?"""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Iterator

from slabcell.service.config import RobotConfig
from slabcell.service.doctor import Patient, Severity
from slabcell.service.hmi_config import is_local_host
from slabcell_drivers.camera.discovery import interfaces

__all__ = ["look_at_robot"]

Answers = Iterator[tuple[Severity, str, str]]


def look_at_robot(patient: Patient) -> Answers:
    """Ask whether the robot's end of the link finds ours: address and port, or serial line."""
    if patient.config is None:
        return
    robot = patient.config.robot
    if robot.link == "eki":
        yield from _eki(robot)
    elif robot.link == "modbus-rtu":
        yield from _serial_line(robot.modbus.device)
    elif robot.modbus.role == "client":
        yield Severity.NOTE, f"the cell polls the PLC at {robot.modbus.host}:{robot.modbus.port}", ""
    else:
        yield from _listens(robot.modbus.host, robot.modbus.port, "[robot.modbus]")


def _eki(robot: RobotConfig) -> Answers:
    eki, krl = robot.eki, robot.krl
    if not krl.robot_connects:
        yield Severity.NOTE, f"the cell connects to the robot at {krl.robot_ip}:{krl.robot_port}", ""
        return
    yield from _listens(eki.host, eki.port, "[robot.eki]")
    if is_local_host(eki.host) and not is_local_host(krl.robot_ip):
        how = "name this PC's address on the robot's network in [robot.eki] host"
        yield Severity.WARNING, f"{eki.host} cannot be reached by a robot at {krl.robot_ip}", how


def _listens(host: str, port: int, table: str) -> Answers:
    """Tell whether the daemon can listen there, or another does already."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except PermissionError:
            how = "choose a port above 1023, or give the service the right: AmbientCapabilities=CAP_NET_BIND_SERVICE"
            yield Severity.ERROR, f"{host}:{port} needs a right of its own", how
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                detail = f"{host}:{port} is in use"
                yield Severity.NOTE, detail, "by the daemon, if it runs; otherwise end the other program"
            else:
                ours = ", ".join(f"{item.name} {item.address}" for item in interfaces())
                how = f"correct {table} host, or give an interface this address"
                yield Severity.ERROR, f"{host} is no address of this PC ({error.strerror}); there are {ours}", how
        else:
            yield Severity.OK, f"{host}:{port} can be listened on", ""


def _serial_line(device: str) -> Answers:
    """Tell whether the serial line is there and may be used."""
    if not os.path.exists(device):  # noqa: PTH110 - an empty name is no path
        how = "plug the adapter in, or correct [robot.modbus] device; `ls /dev/serial/by-id` shows what there is"
        yield Severity.ERROR, f"the serial line {device} is not there", how
    elif not os.access(device, os.R_OK | os.W_OK):
        how = "look as the user slabcell or as root; the service needs DeviceAllow and the group dialout"
        yield Severity.WARNING, f"you may not use the serial line {device}", how
    else:
        yield Severity.OK, f"the serial line {device} is there", ""
