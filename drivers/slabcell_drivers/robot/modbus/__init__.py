"""The robot over Modbus: a PLC or gateway stands between, with the registers here (server) or there (client)."""

from slabcell_drivers.robot.modbus.access import Access, Counters
from slabcell_drivers.robot.modbus.client import ModbusClient, RegisterClient, serial_client, tcp_client
from slabcell_drivers.robot.modbus.gripper_io import GripperAddresses, ModbusGripper
from slabcell_drivers.robot.modbus.map_file import ModbusMapError, load_map
from slabcell_drivers.robot.modbus.register_map import Layout, Order, RegisterMap
from slabcell_drivers.robot.modbus.serial_port import SerialSettings
from slabcell_drivers.robot.modbus.serial_server import ModbusRtuServer
from slabcell_drivers.robot.modbus.server import ModbusTcpServer

__all__ = [
    "Access",
    "Counters",
    "GripperAddresses",
    "Layout",
    "ModbusClient",
    "ModbusGripper",
    "ModbusMapError",
    "ModbusRtuServer",
    "ModbusTcpServer",
    "Order",
    "RegisterClient",
    "RegisterMap",
    "SerialSettings",
    "load_map",
    "serial_client",
    "tcp_client",
]
