"""What do we assume of the controller that no public source confirms?  Every such number and text, and nothing else.

To be checked on a real KR C4; the pages of the documentation that list them are written from here.
"""

from enum import IntEnum

__all__ = ["SINGULAR_A5_DEG", "MotionMessage"]

SINGULAR_A5_DEG = 0.01822
"""Below this magnitude of A5 the controller takes the wrist for singular."""


class MotionMessage(IntEnum):
    """Numbers of motion messages.  The controller's own numbers are not public; these are ours, above its range."""

    AXIS_LIMIT = 90001
    UNREACHABLE = 90002
    SINGULARITY = 90003
    AXIS_SPEED = 90004
    CIRCLE = 90005
    VALUE = 90006
