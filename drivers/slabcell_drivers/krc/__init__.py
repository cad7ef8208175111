"""How does a KR C4 behave?  In software: KRL parser, interpreter in virtual time, motion and EthernetKRL."""

from slabcell_drivers.krc.controller import SoftwareKrc
from slabcell_drivers.krc.loading import read_project
from slabcell_drivers.krc.messages import KrlError
from slabcell_drivers.krc.parser import parse
from slabcell_drivers.krc.run_values import CellIo, RunResult, TraceEvent

__all__ = ["CellIo", "KrlError", "RunResult", "SoftwareKrc", "TraceEvent", "parse", "read_project"]
