"""How does the cell speak with a PLC or gateway?  ``[robot.modbus]`` of the configuration, and the link it means."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from slabcell.errors import ConfigurationError
from slabcell.toml_file import TomlTable
from slabcell_drivers.robot import LinkState
from slabcell_drivers.robot.link_events import TelegramHook
from slabcell_drivers.robot.modbus import (
    Access,
    GripperAddresses,
    Layout,
    ModbusClient,
    ModbusGripper,
    ModbusMapError,
    ModbusRtuServer,
    ModbusTcpServer,
    Order,
    RegisterClient,
    RegisterMap,
    SerialSettings,
    load_map,
    serial_client,
    tcp_client,
)

__all__ = ["GripperConfig", "ModbusConfig", "ModbusLink", "make_gripper", "make_modbus_link", "shipped_map"]

ModbusLink = ModbusTcpServer | ModbusRtuServer | ModbusClient
_Port = Annotated[int, Field(ge=1, le=65_535)]
_Address = Annotated[int, Field(ge=0, le=65_535)]
_Unit = Annotated[int, Field(ge=1, le=247)]
_PARITY: dict[str, Literal["N", "E", "O"]] = {"none": "N", "even": "E", "odd": "O"}


class GripperConfig(TomlTable):
    """``[robot.modbus.gripper]``: the I/O coupler of a gripper that hangs on the cell PC."""

    host: str = Field(max_length=253, description="address of the I/O coupler")
    port: _Port = Field(default=502, description="TCP port of the I/O coupler")
    unit_id: _Unit = Field(default=1, description="unit of the I/O coupler")
    vacuum_coil: _Address = Field(default=0, description="coil that turns the suction on, as it goes over the wire")
    part_present_input: _Address = Field(default=0, description="input that says that a part is held")
    interlock_input: _Address | None = Field(default=None, description="input that is on while the interlock is closed")
    poll_ms: Annotated[int, Field(ge=5, le=1000)] = Field(default=20, description="pause between two polls")


class ModbusConfig(TomlTable):
    """``[robot.modbus]``: for ``link = "modbus-tcp"`` and ``"modbus-rtu"``."""

    role: Literal["server", "client"] = Field(
        default="server", description="server: the PLC polls the cell; client: the cell polls the PLC or gateway"
    )
    host: str = Field(
        default="127.0.0.1", max_length=253, description="server: address to listen on; client: the PLC's"
    )
    port: Annotated[int, Field(ge=0, le=65_535)] = Field(
        default=1502, description="TCP port; ports below 1024, such as 502, need a right of their own"
    )
    peers: list[str] = Field(
        default=[], max_length=32, description="server: who may connect, addresses or networks; others are turned away"
    )
    max_connections: Annotated[int, Field(ge=1, le=64)] = Field(default=4, description="server: so many at once")
    device: str = Field(default="", max_length=200, description="serial line, for modbus-rtu: /dev/ttyUSB0")
    baud_rate: Annotated[int, Field(ge=300, le=1_000_000)] = Field(default=19_200, description="of the serial line")
    parity: Literal["none", "even", "odd"] = Field(default="even", description="of the serial line")
    stop_bits: Literal[1, 2] = Field(default=1, description="of the serial line")
    map: Path | None = Field(default=None, description="register map of your own, relative to this file")
    unit_id: _Unit | None = Field(default=None, description="unit id; the default is the map's, like the next three")
    address_offset: Annotated[int, Field(ge=-65_535, le=65_535)] | None = Field(
        default=None, description="added to each address on the wire: -1 for a PLC that counts from 1"
    )
    word_order: Order | None = Field(default=None, description="of 32-bit values: high-first or low-first")
    byte_order: Order | None = Field(default=None, description="within a register: high-first or low-first")
    poll_ms: Annotated[int, Field(ge=2, le=1000)] = Field(default=10, description="client: pause between two polls")
    timeout_ms: Annotated[int, Field(ge=10, le=10_000)] = Field(default=500, description="client: of one request")
    watchdog_s: Annotated[float, Field(gt=0, le=60)] = Field(
        default=3.0, description="a PLC whose watchdog register stands still for this long is lost"
    )
    gripper: GripperConfig | None = Field(default=None, description="where the gripper hangs on the cell PC")

    @model_validator(mode="after")
    def _is_guarded(self) -> Self:
        if self.role == "server" and not self.peers and self.host not in ("127.0.0.1", "::1", "localhost"):
            msg = f'peers is empty, and host {self.host} can be reached from outside: name the PLC, peers = ["ADDRESS"]'
            raise ValueError(msg)
        for peer in self.peers:
            ipaddress.ip_network(peer)  # its ValueError says what is wrong
        return self


def shipped_map(layout: Layout | None = None) -> RegisterMap:
    """Return the register map that is shipped."""
    with as_file(files("slabcell") / "data" / "config" / "modbus_map.toml") as path:
        return load_map(path, layout)


def _register_map(config: ModbusConfig) -> RegisterMap:
    try:
        found = load_map(config.map) if config.map else shipped_map()
        base = found.layout
        layout = Layout(
            base.unit_id if config.unit_id is None else config.unit_id,
            base.address_offset if config.address_offset is None else config.address_offset,
            config.word_order or base.word_order,
            config.byte_order or base.byte_order,
        )
        return load_map(config.map, layout) if config.map else shipped_map(layout)
    except ModbusMapError as error:
        raise ConfigurationError(f"[robot.modbus] {error}") from error


def make_gripper(config: GripperConfig) -> ModbusGripper:
    """Return the gripper's I/O; `ModbusGripper.run` keeps it up to date."""
    addresses = GripperAddresses(config.unit_id, config.vacuum_coil, config.part_present_input, config.interlock_input)
    return ModbusGripper(tcp_client(config.host, config.port, 0.5), addresses, poll_s=config.poll_ms / 1000.0)


def make_modbus_link(
    kind: Literal["modbus-tcp", "modbus-rtu"],
    config: ModbusConfig,
    gripper: ModbusGripper | None,
    on_state: Callable[[LinkState], None],
    on_telegram: TelegramHook | None = None,
) -> ModbusLink:
    """Return the link, not yet started.  Raises ConfigurationError."""
    register_map = _register_map(config)
    line = SerialSettings(config.device, config.baud_rate, _PARITY[config.parity], config.stop_bits)
    if kind == "modbus-rtu" and not config.device:
        msg = '[robot.modbus] link = "modbus-rtu" needs device = "/dev/..."'
        raise ConfigurationError(msg)
    if config.role == "client":
        timeout_s = config.timeout_ms / 1000.0
        make = (
            tcp_client(config.host, config.port, timeout_s) if kind == "modbus-tcp" else serial_client(line, timeout_s)
        )
        return ModbusClient(
            RegisterClient(make, register_map, timeout_s=timeout_s),
            register_map,
            poll_s=config.poll_ms / 1000.0,
            heartbeat_timeout_s=config.watchdog_s,
            gripper=gripper,
            on_telegram=on_telegram,
            on_state=on_state,
        )
    if kind == "modbus-rtu":
        return ModbusRtuServer(
            line,
            register_map,
            heartbeat_timeout_s=config.watchdog_s,
            gripper=gripper,
            on_telegram=on_telegram,
            on_state=on_state,
        )
    return ModbusTcpServer(
        config.host,
        config.port,
        register_map,
        access=Access(config.peers, max_connections=config.max_connections),
        heartbeat_timeout_s=config.watchdog_s,
        gripper=gripper,
        on_telegram=on_telegram,
        on_state=on_state,
    )
