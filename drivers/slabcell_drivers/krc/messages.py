"""With which number and text does the controller stop a program?

1422 and 1123 are the controller's own, seen in public reports; 1430 is in public copies of its BAS.SRC.  The others are
not public: ours, above its range.  The texts name what to look at.
"""

from enum import IntEnum

__all__ = ["KrlError", "RunMessage"]


class RunMessage(IntEnum):
    """The messages of the interpreter."""

    APPROXIMATION_NOT_POSSIBLE = 1123
    VALUE_INVALID = 1422
    INDEX = 91001
    DIVISION = 91002
    OVERFLOW = 91003
    TYPE = 91004
    UNDECLARED = 91005
    ARGUMENTS = 91006
    READ_ONLY = 91007
    RANGE = 91008
    CALL_DEPTH = 91009
    NO_RESULT = 91010
    RESUME = 91011
    FIRST_MOTION = 91012
    INTERRUPT = 1430
    NOT_SUPPORTED = 91014
    NOT_TAUGHT = 91015
    SYNTAX = 91020
    NO_PROGRAM = 91021
    MODE_CHANGED = 91034
    POWER_LOST = 91035
    HALT = 91030
    CANCELLED = 91031
    DEADLINE = 91032
    EMERGENCY_STOP = 91033


class KrlError(Exception):
    """A runtime error of a program, with the number and the text of the message."""

    def __init__(self, number: int, text: str) -> None:
        super().__init__(f"{int(number)} {text}")
        self.number = int(number)
        self.text = text
