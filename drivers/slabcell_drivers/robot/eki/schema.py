"""Which elements do the two EKI telegrams have?  The one table from which everything else follows.

The codec, the EKI configuration files under ``krl/``, the constants of ``krl/VT.dat`` and the page
``docs/reference/eki-channel.md`` are all made from the tables below (`slabcell_drivers.robot.eki.generate`).

The robot's telegram has the root ``Robot``, the cell's has the root ``Vis``.  Every element stands in every telegram,
because EKI keeps one memory per element and loses track of what arrived together when one is missing; a telegram
carries at most one result, because a repeated element fills its memory, and a full memory closes the connection.

``Check`` holds sums over the values.  They tell whether the values that a program reads from EKI's memories, one by
one, come from one telegram and arrived as they were sent.

Sources: KUKA.EthernetKRL 2.2 manual (19.12.2012), chapters "Configuration" and "Programming"; the public channel files
of ros-industrial/kuka_experimental and of the rc_visard EKI bridge.
"""

from dataclasses import dataclass, field
from enum import StrEnum

from slabcell_drivers.robot.message import MAX_MESSAGE_CHARS

__all__ = [
    "ATTRIBUTES_OF_FRAME",
    "CHANNEL",
    "CHECK_NODE",
    "EMPTY_TEXT",
    "HEARTBEAT_ROOT",
    "MAX_TEXT_CHARS",
    "PROTOCOL_VERSION",
    "ROBOT",
    "VIS",
    "Channel",
    "Element",
    "ElementType",
    "Node",
    "Telegram",
]

PROTOCOL_VERSION = 1
MAX_TEXT_CHARS = MAX_MESSAGE_CHARS
"""Longest text in a telegram."""
EMPTY_TEXT = "-"
"""Stands for "no text": EKI's behaviour with a string of no characters is not documented."""
HEARTBEAT_ROOT = "VisHb"
CHECK_NODE = "Check"
ATTRIBUTES_OF_FRAME = ("X", "Y", "Z", "A", "B", "C")


class ElementType(StrEnum):
    """What EKI reads an element as."""

    INT = "INT"
    REAL = "REAL"
    BOOL = "BOOL"
    STRING = "STRING"


@dataclass(frozen=True, slots=True)
class Element:
    """One value: an attribute of its node, or the node's text where ``attribute`` is empty."""

    node: str
    attribute: str
    type: ElementType
    meaning: str
    path: str = field(init=False)
    """The path below the root, as EKI writes it: ``Head/@Seq`` or ``Msg``."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", f"{self.node}/@{self.attribute}" if self.attribute else self.node)


@dataclass(frozen=True, slots=True)
class Node:
    """A child of the root, and its values in the order in which they are written."""

    name: str
    elements: tuple[Element, ...]

    @property
    def is_frame(self) -> bool:
        """Whether EKI_GetFrame and EKI_SetFrame work on this node."""
        return tuple(element.attribute for element in self.elements) == ATTRIBUTES_OF_FRAME


@dataclass(frozen=True, slots=True)
class Telegram:
    """The telegram of one direction."""

    root: str
    nodes: tuple[Node, ...]
    elements: tuple[Element, ...] = field(init=False)
    """Every value of the telegram."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "elements", tuple(element for node in self.nodes for element in node.elements))

    def summed(self, kind: ElementType) -> tuple[str, ...]:
        """Return the paths of the values of one type that ``Check`` holds the sum of."""
        return tuple(item.path for item in self.elements if item.type is kind and item.node != CHECK_NODE)

    def path(self, element: Element) -> str:
        """Return the full path of an element: ``Robot/Head/@Seq``."""
        return f"{self.root}/{element.path}"


@dataclass(frozen=True, slots=True)
class Channel:
    """The settings of the EKI channel that are not elements."""

    name: str = "SlabCell"
    server_name: str = "SlabCellServer"
    cell_ip: str = "192.168.1.10"
    cell_port: int = 54600
    robot_ip: str = "192.168.1.147"
    robot_port: int = 54600
    buffering_limit: int = 16
    buffer_bytes: int = 16384
    connect_timeout_ms: int = 5000
    ping_s: int = 5
    flag_heartbeat: int = 996
    flag_alive: int = 997
    flag_received: int = 998


CHANNEL = Channel()
"""The channel of the reference cell; `slabcell krl export` fills in the addresses of yours."""


def _node(name: str, type_: ElementType, *attributes: tuple[str, str]) -> Node:
    return Node(name, tuple(Element(name, attribute, type_, meaning) for attribute, meaning in attributes))


def _frame(name: str, what: str) -> Node:
    units = dict.fromkeys("XYZ", "mm") | dict.fromkeys("ABC", "°")
    return _node(name, ElementType.REAL, *((key, f"{what}, {key} in {units[key]}") for key in ATTRIBUTES_OF_FRAME))


_INT = ElementType.INT

ROBOT = Telegram(
    "Robot",
    (
        _node(
            "Head",
            _INT,
            ("Ver", f"version of this protocol: {PROTOCOL_VERSION}"),
            ("Ses", "session, as the answer to HELLO gave it; 0 in HELLO"),
            ("Seq", "sequence number of the request; the same number again is the same request again"),
            ("Type", "1 HELLO, 2 TRIGGER, 3 NEXT, 4 ACK, 5 HEARTBEAT, 6 BYE"),
        ),
        _node("Job", _INT, ("Id", "number of the job, 0 = the cell's"), ("Model", "number of the template, 0 = any")),
        _frame("Pose", "tool centre point in the robot's root frame"),
        _node("Axis", ElementType.REAL, *((f"A{axis}", f"axis {axis} of the arm in °") for axis in range(1, 7))),
        _node(
            "Ack",
            _INT,
            ("ResId", "result the robot acted on last"),
            ("State", "0 none, 1 accepted, 2 grasped, 3 placed, 4 pick failed, 5 unreachable, 6 aborted"),
        ),
        _node(
            "Stat",
            _INT,
            ("Mode", "operating mode: 0 unknown, 1 T1, 2 T2, 3 AUT, 4 EXT"),
            ("Tool", "number of the active tool"),
            ("Base", "number of the active base"),
            ("Grip", "1 while the gripper holds a part"),
            ("Err", "number of the robot's last own error, 0 = none"),
        ),
        Node("Check", (Element("Check", "Ints", _INT, "sum of every other INT of this telegram"),)),
    ),
)

VIS = Telegram(
    "Vis",
    (
        _node(
            "Head",
            _INT,
            ("Ver", f"version of this protocol: {PROTOCOL_VERSION}"),
            ("Ses", "session: changes with every start of the cell"),
            ("Seq", "sequence number of the answer"),
            ("Ack", "sequence number of the request that this answers"),
        ),
        _node(
            "Res",
            _INT,
            ("Code", "0 ok, 1 job complete, 2 nothing left, 3 bad request, 4 busy, from 1000 an error number"),
            ("ResId", "number of the result; 0 = this answer carries none"),
            ("Idx", "index of the result within its trigger, from 0"),
            ("Left", "results still to be fetched, this one included"),
            ("TrigSeq", "sequence number of the trigger that the result comes from"),
        ),
        _frame("Pick", "where to pick, in BASE_DATA of the table"),
        _frame("Place", "where to place, in BASE_DATA of the assembly"),
        Node(
            "Part",
            (
                Element("Part", "Slot", _INT, "slot of the template, from 0"),
                Element("Part", "Score", ElementType.REAL, "score of the match, 0 to 1"),
                Element("Part", "Grip", _INT, "which gripper to use, 0 = the only one"),
            ),
        ),
        Node(
            "Check",
            (
                Element("Check", "Ints", _INT, "sum of every other INT of this telegram"),
                Element("Check", "Reals", ElementType.REAL, "sum of every other REAL of this telegram"),
            ),
        ),
        Node("Msg", (Element("Msg", "", ElementType.STRING, f'text for the operator; "{EMPTY_TEXT}" = none'),)),
    ),
)
