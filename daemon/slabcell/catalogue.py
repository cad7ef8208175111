"""What does an error number mean, and what does a person do about it?  Reads the error catalogue, ``errors.toml``.

`Fault` names the numbers for the code; the words stand in the catalogue alone.
"""

import tomllib
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from functools import cache
from importlib import resources

from slabcell.errors import SlabcellError

__all__ = ["CatalogueError", "Clears", "Entry", "Fault", "Priority", "catalogue", "entry", "parse_catalogue"]

SCHEMA = "slabcell.errors/1"
ROBOT_TEXT_CHARACTERS = 80


class Fault(IntEnum):
    """Every number of the catalogue by the name that the code uses."""

    CAMERA_LOST = 1101
    CAMERA_TIMEOUT = 1102
    CAMERA_INCOMPLETE = 1103
    CAMERA_BUSY = 1104
    CAMERA_SETTING = 1105
    CAMERA_STALE = 1106
    LIGHT_LOST = 1150
    CAMERA_ERROR = 1199
    ROBOT_ABSENT = 1201
    ROBOT_SESSION = 1202
    ROBOT_SEQUENCE = 1203
    ROBOT_ACKNOWLEDGES_UNKNOWN = 1204
    ROBOT_MUST_FINISH = 1205
    GRIPPER_IO_LOST = 1206
    INTERLOCK_OPEN = 1207
    CALIBRATION_MISSING = 1301
    CALIBRATION_MISMATCH = 1302
    RECIPE_MISSING = 1401
    RECIPE_CHANGED = 1402
    TEMPLATE_BAD = 1403
    IMAGE_UNUSABLE = 1501
    NOTHING_FOUND = 1502
    NO_MATCH = 1503
    VISION_SLOW = 1504
    MODEL_UNUSABLE = 1505
    VISION_ERROR = 1599
    UNREACHABLE = 1601
    OUTSIDE_WORKSPACE = 1602
    COLLISION = 1603
    TRIED_TOO_OFTEN = 1604
    PART_LOST = 1605
    GRIPPER_NOT_EMPTY = 1606
    PLACEMENT_UNKNOWN = 1607
    LEDGER_UNWRITABLE = 1701
    LEDGER_DAMAGED = 1702
    LEDGER_NEWER = 1703
    LEDGER_ERROR = 1704
    DISK_FULL = 1705
    LEDGER_IN_USE = 1706
    BUNDLE_UNWRITABLE = 1707
    STATE_UNWRITABLE = 1708
    INTERNAL = 1801
    NOT_READY = 1802
    PLACEMENT_OUT_OF_TOLERANCE = 1901
    PLACEMENT_MISSING = 1902
    VERIFICATION_IMPOSSIBLE = 1903
    ASSEMBLY_NOT_EMPTY = 1904
    CELL_NOT_ANSWERING = 2001  # from here on: found by the robot program itself
    RESULT_REFUSED = 2002
    WRONG_VERSION = 2003
    GRIPPER_STUCK = 2004
    TAKE_SLAB_OFF = 2005


class Clears(StrEnum):
    """What ends an alarm."""

    ITSELF = "itself"
    ACKNOWLEDGE = "acknowledge"
    RESTART = "restart"


class Priority(StrEnum):
    """How soon a person has to come."""

    HIGH = "high"
    MEDIUM = "medium"
    LOW = "low"


class CatalogueError(SlabcellError):
    """The catalogue itself is wrong: it is part of the program, so this is a fault of its makers."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the catalogue; ``robot`` is ASCII and at most 80 characters, for the robot's display."""

    number: int
    name: str
    category: str
    title: str
    robot: str
    meaning: str
    action: str
    clears: Clears
    priority: Priority


def parse_catalogue(text: str) -> dict[int, Entry]:
    """Return the entries by number, in the order of the file.  Raises CatalogueError that names entry and key."""
    try:
        raw: dict[str, object] = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        msg = f"errors.toml: is not TOML: {error}"
        raise CatalogueError(msg) from error
    if raw.pop("schema", None) != SCHEMA:
        msg = f"errors.toml: 'schema' is not {SCHEMA!r}"
        raise CatalogueError(msg)
    return {entry.number: entry for entry in (_entry(key, table) for key, table in raw.items())}


def _entry(key: str, table: object) -> Entry:
    keys = ("name", "category", "title", "robot", "meaning", "action", "clears", "priority")
    if not key.isdecimal() or not isinstance(table, dict):
        msg = f"errors.toml: [{key}] is not a number's table"
        raise CatalogueError(msg)
    values: dict[str, str] = {str(name): str(value) for name, value in table.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]  (any TOML)
    if set(values) != set(keys) or not all(values.values()):
        msg = f"errors.toml: [{key}] must hold exactly the keys {', '.join(keys)}, none of them empty"
        raise CatalogueError(msg)
    robot = values["robot"]
    if not robot.isascii() or not robot.isprintable() or len(robot) > ROBOT_TEXT_CHARACTERS:
        msg = f"errors.toml: [{key}] robot: must be ASCII of at most {ROBOT_TEXT_CHARACTERS} characters: {robot!r}"
        raise CatalogueError(msg)
    try:
        clears, priority = Clears(values["clears"]), Priority(values["priority"])
    except ValueError as error:
        msg = f"errors.toml: [{key}]: {error}"
        raise CatalogueError(msg) from error
    return Entry(
        *(int(key), values["name"], values["category"], values["title"], robot, values["meaning"], values["action"]),
        *(clears, priority),
    )


@cache
def catalogue() -> dict[int, Entry]:
    """Return the entries of the shipped catalogue by number."""
    source = resources.files("slabcell") / "data" / "config" / "errors.toml"
    return parse_catalogue(source.read_text(encoding="utf-8"))


def entry(number: int) -> Entry:
    """Return one entry; a number that is not in the catalogue gives that of the internal error."""
    known = catalogue()
    return known.get(number) or known[Fault.INTERNAL]
