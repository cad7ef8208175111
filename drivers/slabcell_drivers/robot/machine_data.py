"""Which arm does a controller's ``$machine.dat`` describe?  Dimensions, limits and speeds out of a real backup.

The text is read on its own and liberally: any letter case, comments, both line ends, values in any order, other
declarations passed over.  What makes the arm another one than our kinematics can do is refused by name and value.
Structure and units (motor speed in 1/min, gear ratio as numerator and denominator) are those of KSS 8.3 backups that
are public.
"""

import math
import re
from dataclasses import dataclass

from slabcell_drivers.robot.arm import ASSUMED_RAMP_S, ArmModel, Axes
from slabcell_drivers.robot.arm_solve import Dimensions
from slabcell_drivers.robot.frame import Frame

__all__ = ["MachineData", "MachineDataError", "parse_machine_data"]

MAX_BYTES = 4 * 1024 * 1024
MAX_DIMENSION_MM = 10_000.0
MAX_VALUE = 1e9
MAX_ANGLE_DEG = 36_000.0  # an endless axis has very wide limits

_ASSIGNMENT = re.compile(
    r"^\s*(?:(?:GLOBAL|DECL|CONST)\s+)*(?:\w+\s+)?(?P<name>\$\w+)\s*(?:\[\s*(?P<index>[\d,\s]*)\])?\s*=\s*(?P<value>.+)$",
    re.IGNORECASE,
)
_MEMBER = re.compile(r"(\w+)\s+([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|#\w+)")

Fields = dict[str, float]


class MachineDataError(ValueError):
    """A ``$machine.dat`` that does not describe an arm that we can compute; ``problems`` lists all that is wrong."""

    def __init__(self, problems: tuple[str, ...]) -> None:
        super().__init__("; ".join(problems))
        self.problems = problems


@dataclass(frozen=True, slots=True)
class MachineData:
    """What the machine data say that matters here.

    ``root_in_world`` is $ROBROOT; ``home`` is $AXIS_HOME[1], or else $H_POS; the path maxima are $VEL_MA and $ACC_MA.
    """

    arm: ArmModel
    root_in_world: Frame
    home: Axes | None
    max_path_speed_m_s: float | None
    max_path_acceleration_m_s2: float | None
    max_turn_speed_deg_s: float | None
    max_turn_acceleration_deg_s2: float | None


def parse_machine_data(raw: bytes) -> MachineData:
    """Return the arm of a ``$machine.dat``.  Raises MachineDataError."""
    if len(raw) > MAX_BYTES:
        raise MachineDataError((f"{len(raw)} bytes; at most {MAX_BYTES} are read",))
    reader = _Reader(_assignments(raw.decode("latin-1")))
    data = reader.read()
    if reader.problems or data is None:
        raise MachineDataError(tuple(reader.problems))
    return data


def _assignments(text: str) -> dict[tuple[str, str], str]:
    """Return every assigned value by name in capitals and index without blanks."""
    found: dict[tuple[str, str], str] = {}
    for line in text.splitlines():
        match = _ASSIGNMENT.match(_without_comment(line))
        if match:
            index = re.sub(r"\s", "", match["index"] or "")
            found[match["name"].upper(), index] = match["value"].strip()
    return found


def _without_comment(line: str) -> str:
    quoted = False
    for position, character in enumerate(line):
        if character == '"':
            quoted = not quoted
        elif character == ";" and not quoted:
            return line[:position]
    return line


class _Reader:
    def __init__(self, values: dict[tuple[str, str], str]) -> None:
        self.problems: list[str] = []
        self._values = values

    def read(self) -> MachineData | None:
        self._expect("$KINCLASS", "#STANDARD")
        self._expect("$MAIN_AXIS", "#NR")
        self._expect("$WRIST_AXIS", "#ZEH")
        root_to_a1 = self._only("$TIRORO", {"Z"})
        forearm = self._only("$TX3P3", {"X", "Z", "B"})
        flange = self._only("$TFLWP", {"Z"})
        if forearm and not math.isclose(forearm.get("B", 0.0), 90.0):
            self.problems.append(f"$TX3P3.B is {forearm.get('B', 0.0):g}; only a wrist mounted at 90 is computed")
        upper_arm = self._number("$LENGTH_B")
        dimensions = Dimensions(
            base_height_mm=root_to_a1.get("Z", 0.0),
            shoulder_mm=self._number("$LENGTH_A"),
            upper_arm_mm=upper_arm,
            forearm_x_mm=forearm.get("X", 0.0),
            forearm_z_mm=forearm.get("Z", 0.0),
            flange_mm=flange.get("Z", 0.0),
        )
        for name, value in (("$LENGTH_B", dimensions.upper_arm_mm), ("$TX3P3.X", dimensions.forearm_x_mm)):
            if not 0.0 < value <= MAX_DIMENSION_MM and not self.problems:
                self.problems.append(f"{name} is {value:g} mm; above 0 and at most {MAX_DIMENSION_MM:g} is possible")
        low, high = self._axes("$SOFTN_END"), self._axes("$SOFTP_END")
        for i in range(6):
            if not -MAX_ANGLE_DEG <= low[i] < high[i] <= MAX_ANGLE_DEG and not self.problems:
                self.problems.append(f"axis {i + 1}: $SOFTN_END {low[i]:g} is not below $SOFTP_END {high[i]:g}")
        speeds = self._speeds()
        if self.problems:
            return None
        ramp = ASSUMED_RAMP_S
        arm = ArmModel(
            name=self._text("$TRAFONAME") or "arm of $machine.dat",
            dimensions=dimensions,
            axis_min_deg=low,
            axis_max_deg=high,
            axis_speed_deg_s=speeds,
            axis_acceleration_deg_s2=_six([speed / ramp for speed in speeds]),
        )
        speed, acceleration = self._fields("$VEL_MA"), self._fields("$ACC_MA")
        return MachineData(
            arm=arm,
            root_in_world=self._frame("$ROBROOT"),
            home=self._home(),
            max_path_speed_m_s=speed.get("CP"),
            max_path_acceleration_m_s2=acceleration.get("CP"),
            max_turn_speed_deg_s=speed.get("ORI1"),
            max_turn_acceleration_deg_s2=acceleration.get("ORI1"),
        )

    def _speeds(self) -> Axes:
        """Return the axis speeds: motor speed in 1/min, over the gear ratio, in degrees a second."""
        motor = self._axes("$VEL_AXIS_MA")
        speeds: list[float] = []
        for i in range(6):
            ratio = self._fields("$RAT_MOT_AX", str(i + 1))
            numerator, denominator = abs(ratio.get("N", 0.0)), abs(ratio.get("D", 0.0))
            if numerator == 0.0 or denominator == 0.0 or motor[i] <= 0.0:
                gear = f"$RAT_MOT_AX {numerator:g}/{denominator:g}"
                self.problems.append(f"axis {i + 1}: no speed from $VEL_AXIS_MA {motor[i]:g} and {gear}")
            else:
                speeds.append(motor[i] * 6.0 * denominator / numerator)
        return _six(speeds) if len(speeds) == 6 else _six([0.0] * 6)

    def _home(self) -> Axes | None:
        fields = self._fields("$AXIS_HOME", "1") or self._fields("$H_POS")
        values = [fields.get(f"A{axis}") for axis in range(1, 7)]
        known = [value for value in values if value is not None]
        return _six(known) if len(known) == 6 else None

    def _frame(self, name: str) -> Frame:
        fields = self._fields(name)
        return Frame(*(fields.get(key, 0.0) for key in "XYZABC"))

    def _only(self, name: str, allowed: set[str]) -> Fields:
        """Return the fields of a frame in which only these may differ from zero."""
        if (name, "") not in self._values:
            self.problems.append(f"{name} is missing")
            return {}
        fields = self._fields(name)
        for key, value in fields.items():
            if key not in allowed and value != 0.0:
                self.problems.append(f"{name}.{key} is {value:g}; only arms with 0 there are computed")
        return fields

    def _fields(self, name: str, index: str = "") -> Fields:
        """Return the numbers of an aggregate by field name in capitals."""
        value = self._values.get((name, index), "")
        fields: Fields = {}
        for key, text in _MEMBER.findall(value):
            if text.startswith("#"):
                continue
            number = float(text)
            if abs(number) > MAX_VALUE:
                self.problems.append(f"{name}.{key} is {text[:40]}, out of all proportion")
            else:
                fields[key.upper()] = number
        return fields

    def _axes(self, name: str) -> Axes:
        return _six([self._number(name, str(axis)) for axis in range(1, 7)])

    def _number(self, name: str, index: str = "") -> float:
        text = self._values.get((name, index))
        shown = f"{name}[{index}]" if index else name
        if text is None:
            self.problems.append(f"{shown} is missing")
            return 0.0
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            self.problems.append(f"{shown} is {text[:40]!r}, not a number")
            return 0.0
        return value

    def _text(self, name: str) -> str:
        return self._values.get((name, ""), "").strip('"').lstrip("#").strip()

    def _expect(self, name: str, wanted: str) -> None:
        value = self._values.get((name, ""))
        if value is not None and value.upper() != wanted:
            self.problems.append(f"{name} is {value}; only {wanted} is computed")


def _six(values: list[float]) -> Axes:
    a1, a2, a3, a4, a5, a6 = values
    return (a1, a2, a3, a4, a5, a6)
