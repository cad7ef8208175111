"""A GigE Vision camera in software: GVCP and GVSP on loopback, without root, with faults on demand.

`control`, `gvsp`, `features` and `xml` are pure; `camera` and `stream` hold the sockets and threads.
"""

from slabcell_drivers.simulation.gige.camera import GigeCamera, GigeCameraError
from slabcell_drivers.simulation.gige.faults import FAULT_VERBS, FaultError, Faults
from slabcell_drivers.simulation.gige.features import SensorLimits
from slabcell_drivers.simulation.gige.patterns import CheckedPattern
from slabcell_drivers.simulation.gige.sensor import Render

__all__ = [
    "FAULT_VERBS",
    "CheckedPattern",
    "FaultError",
    "Faults",
    "GigeCamera",
    "GigeCameraError",
    "Render",
    "SensorLimits",
]
