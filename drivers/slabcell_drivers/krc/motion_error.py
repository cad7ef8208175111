"""What does the controller say when it refuses or stops a move?  One error with the number and text of its message."""

from slabcell_drivers.krc.messages import MotionMessage
from slabcell_drivers.robot.arm import ArmError, ArmFault

__all__ = ["MotionError", "as_motion_error", "singular"]


class MotionError(Exception):
    """A move that the controller would refuse or stop: ``number`` and ``text`` of its message."""

    def __init__(self, message: MotionMessage, text: str) -> None:
        super().__init__(text)
        self.number = int(message)
        self.message = message
        self.text = text


def as_motion_error(error: ArmError) -> MotionError:
    """Return the controller message for a pose that the arm cannot take."""
    if error.fault is ArmFault.AXIS_LIMIT and error.axis is not None and error.limit_deg is not None:
        sign = "+" if error.limit_deg > 0 else "-"
        text = f"Software limit switch point cannot be reached {sign}A{error.axis}: {error}"
        return MotionError(MotionMessage.AXIS_LIMIT, text)
    return MotionError(MotionMessage.UNREACHABLE, f"Work envelope exceeded: {error}")


def singular(a5_deg: float) -> MotionError:
    """Return the controller message for a path through the wrist singularity."""
    text = f"Singularity: A5 at {a5_deg:.3f}° on the path, the wrist would have to turn over; use PTP here"
    return MotionError(MotionMessage.SINGULARITY, text)
