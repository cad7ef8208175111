"""A PLC in software: the other end of the Modbus link, with a robot behind it."""

from slabcell_drivers.plc.body import WorldBody
from slabcell_drivers.plc.handshake import LinkLostError, PlcHandshake
from slabcell_drivers.plc.program import JobEnd, JobProgram, RobotMemory, Timeouts
from slabcell_drivers.plc.registers import OwnRegisters, RegisterPort

__all__ = [
    "JobEnd",
    "JobProgram",
    "LinkLostError",
    "OwnRegisters",
    "PlcHandshake",
    "RegisterPort",
    "RobotMemory",
    "Timeouts",
    "WorldBody",
]
