"""The robot: what it says (`protocol`), how poses are written (`frame`), what its arm can reach (`arm`), its links."""

from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import (
    AckState,
    Answer,
    Handler,
    LinkState,
    Offer,
    Request,
    RequestType,
    ResultCode,
    RobotLink,
    RobotStatus,
)

__all__ = [
    "AckState",
    "Answer",
    "Frame",
    "Handler",
    "LinkState",
    "Offer",
    "Request",
    "RequestType",
    "ResultCode",
    "RobotLink",
    "RobotStatus",
]
