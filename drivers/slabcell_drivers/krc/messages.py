"""With which number and text does the controller stop a program?

Numbers up to 9999 are the controller's own, as a public list of KSS messages has them (docs/decisions names it), and
their texts with them.  What that list lacks has a number of ours, above the controller's range.
"""

from enum import IntEnum

__all__ = ["COMPILER_NUMBERS", "KrlError", "MotionMessage", "RunMessage"]


class RunMessage(IntEnum):
    """The messages of the interpreter."""

    EMERGENCY_STOP = 1
    RESUME_GLOBAL = 72
    APPROXIMATION_NOT_POSSIBLE = 1123
    MODE_CHANGED = 1362
    READ_ONLY = 1388
    TRIGGER_PLACE = 1409
    TOOL_MISSING = 1419
    VALUE_INVALID = 1422
    CALL_DEPTH = 1424
    INTERRUPT = 1430  # of no list, but in public copies of BAS.SRC
    FIRST_MOTION = 1443
    INDEX = 1444
    ASSIGNMENT = 1446
    CYCFLAG_FUNCTION = 1608
    ARGUMENT_TYPE = 2275
    SPLINE_STATEMENT = 2923
    CONSTANT_SPEED_REDUCED = 3214
    CONSTANT_SPEED_LATE = 3216
    CONSTANT_SPEED_EARLY = 3217
    CONDITIONAL_STOP = 3230

    DIVISION = 91002
    OVERFLOW = 91003
    TYPE = 91004
    UNDECLARED = 91005
    ARGUMENTS = 91006
    RANGE = 91008
    NO_RESULT = 91010
    RESUME = 91011
    NOT_SUPPORTED = 91014
    NOT_TAUGHT = 91015
    SYNTAX = 91020
    NO_PROGRAM = 91021
    HALT = 91030
    CANCELLED = 91031
    DEADLINE = 91032
    POWER_LOST = 91035


class MotionMessage(IntEnum):
    """The messages of motions that the arm cannot carry out."""

    AXIS_SPEED = 1102
    AXIS_LIMIT = 1447
    CIRCLE = 1506

    UNREACHABLE = 90002
    SINGULARITY = 90003
    VALUE = 90006
    TIME = 90007


_CONTROLLER_TEXTS: dict[int, str] = {
    RunMessage.EMERGENCY_STOP: "EMERGENCY STOP",
    RunMessage.RESUME_GLOBAL: "RESUME inadmissible for global interrupts",
    RunMessage.MODE_CHANGED: "STOP due to operating mode change",
    RunMessage.TRIGGER_PLACE: "Trigger not allowed in interrupt or *.SUB",
    RunMessage.CALL_DEPTH: "Program stack overflow",
    RunMessage.FIRST_MOTION: "Impermissible start motion",
    RunMessage.INDEX: "Array index inadmissible",
    RunMessage.ASSIGNMENT: "Value assignment inadmissible",
    RunMessage.CYCFLAG_FUNCTION: "Assignment of function value to $CYCFLAG inadmissible",
    RunMessage.ARGUMENT_TYPE: "Current/formal parameter types incompatible",
    RunMessage.SPLINE_STATEMENT: "Statement not allowed in spline block",
    MotionMessage.CIRCLE: "Circular parameter inadmissible",
}


COMPILER_NUMBERS: dict[str, int] = {
    "declaration-order": 2038,
    "outside": 2039,
    "first-def": 2051,
    "member": 2125,
    "switch": 2255,
    "operand": 2256,
    "argument-type": 2275,
    "spline": 2359,
    "spline-approximation": 2360,
    "spline-trigger": 2363,
    "ptp-spline": 2380,
}
"""The numbers under which the controller's compiler reports what the static check finds, by the code of the check."""


class KrlError(Exception):
    """A runtime error of a program.

    ``number`` and ``text`` are those of the message, ``detail`` what the text says beyond the controller's words.
    """

    def __init__(self, number: int, detail: str) -> None:
        words = _CONTROLLER_TEXTS.get(int(number))
        self.number = int(number)
        self.detail = detail
        self.text = f"{words}: {detail}" if words and detail else words or detail
        super().__init__(f"{self.number} {self.text}")
