"""How does a KR C4 behave?  In software: KRL parser, interpreter in virtual time, motion and EthernetKRL."""

from slabcell_drivers.krc.controller import CellIo, RunResult, SoftwareKrc, TraceEvent, read_project
from slabcell_drivers.krc.messages import KrlError
from slabcell_drivers.krc.parser import parse

__all__ = ["CellIo", "KrlError", "RunResult", "SoftwareKrc", "TraceEvent", "parse", "read_project"]
