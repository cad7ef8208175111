"""Which files go onto the controller of one cell?  The shipped programs with that cell's numbers filled in.

Pure: texts in, texts out.  The same files are laid out twice, as a WorkVisual project expects them and as they are
copied from a USB stick; lines end as Windows ends them.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath

from slabcell_drivers.robot.eki.krl_constants import MAX_NAME_CHARS, constants_fold, splice
from slabcell_drivers.robot.eki.schema import CHANNEL, Channel
from slabcell_drivers.robot.eki.xml_files import channel_xml
from slabcell_drivers.robot.frame import Frame

__all__ = ["ExportError", "ExportSettings", "adapted_programs", "export_files"]

OWN_PREFIX = "VT"
PROGRAMS = "KRC/R1/Program/SlabCell"
CHANNELS = "Config/User/Common/EthernetKRL"
SERVER_PORTS = range(54600, 54616)

_NAME = re.compile(r"\b[A-Z_][A-Z0-9_]*\b", re.IGNORECASE)
_PREFIX = re.compile(r"[A-Z][A-Z0-9]{0,5}")
_STRING = re.compile(r'"[^"\n]*"')


class ExportError(ValueError):
    """The programs cannot be made with these values; the message names value, limit and remedy."""


@dataclass(frozen=True, slots=True)
class ExportSettings:
    """What differs from cell to cell.

    ``tool`` is given in the flange's frame, the bases in the robot's root frame.  ``robot_connects``: the robot is
    the TCP client, the cell the server; else the other way round.
    """

    channel: Channel = CHANNEL
    robot_connects: bool = True
    tool: Frame = field(default_factory=Frame)
    pick_base: Frame = field(default_factory=Frame)
    place_base: Frame = field(default_factory=Frame)
    tool_number: int = 1
    pick_base_number: int = 1
    place_base_number: int = 2
    vacuum_output: int = 1
    vacuum_input: int = 1
    blow_output: int = 0
    approach_mm: float = 80.0
    photo_axes_deg: tuple[float, float, float, float, float, float] = (120.0, -90.0, 90.0, 0.0, 90.0, 0.0)
    prefix: str = OWN_PREFIX


def adapted_programs(shipped: Mapping[str, str], settings: ExportSettings) -> dict[str, str]:
    """Return the .src and .dat files with this cell's values and prefix, by file name.  Raises ExportError.

    ``shipped`` maps the names of the files in ``krl/`` to their texts.
    """
    _check(settings)
    programs = {name: text for name, text in shipped.items() if PurePosixPath(name).suffix in {".src", ".dat"}}
    channel = settings.channel
    cell, link = programs["SlabCell.dat"], programs["VT.dat"]
    for name, value in (
        ("SC_TOOL", settings.tool_number),
        ("SC_PICKBASE", settings.pick_base_number),
        ("SC_PLACEBASE", settings.place_base_number),
        ("SC_OUTVACUUM", settings.vacuum_output),
        ("SC_INVACUUM", settings.vacuum_input),
        ("SC_OUTBLOW", settings.blow_output),
        ("SC_APPROACH", _real(settings.approach_mm)),
        ("XSC_PHOTO", _axes(settings.photo_axes_deg)),
    ):
        cell = _assign(cell, name, str(value))
    link = splice(link, constants_fold(channel))
    link = _assign_text(link, "VT_CH", channel.name if settings.robot_connects else channel.server_name)
    return _renamed(programs | {"SlabCell.dat": cell, "VT.dat": link}, settings.prefix)


def export_files(shipped: Mapping[str, str], settings: ExportSettings) -> dict[PurePosixPath, bytes]:
    """Return every file of the export by its path below the output folder.  Raises ExportError."""
    programs = adapted_programs(shipped, settings)
    channel = settings.channel
    xml_name = f"{channel.name if settings.robot_connects else channel.server_name}.xml"
    xml = channel_xml(channel, robot_is_client=settings.robot_connects)
    files: dict[str, str] = {
        "README.txt": _readme(settings, xml_name),
        "controller-data.txt": _controller_data(settings),
    }
    for name in ("sps-sub.txt", "cell-src.txt"):
        files[name] = shipped[f"snippets/{name}"]
    for name, text in programs.items():
        files[f"workvisual/{PROGRAMS}/{name}"] = text
        files[f"usb/SlabCell/{name}"] = text
    files[f"workvisual/{CHANNELS}/{xml_name}"] = xml
    files[f"usb/EthernetKRL/{xml_name}"] = xml
    return {PurePosixPath(path): text.replace("\n", "\r\n").encode("ascii") for path, text in files.items()}


def _check(settings: ExportSettings) -> None:
    channel = settings.channel
    if not _PREFIX.fullmatch(settings.prefix):
        raise ExportError(f"prefix {settings.prefix!r}: one to six of A-Z and 0-9, a letter first")
    if not settings.robot_connects and channel.robot_port not in SERVER_PORTS:
        raise ExportError(
            f"robot port {channel.robot_port}: a controller that waits for the cell opens {SERVER_PORTS[0]} to"
            f" {SERVER_PORTS[-1]} only"
        )
    if settings.robot_connects and not 1 <= channel.cell_port <= 65_534:
        raise ExportError(f"cell port {channel.cell_port}: EKI connects to 1 to 65534; give the cell a fixed port")
    if settings.robot_connects and channel.cell_ip.startswith(("127.", "0.")):
        raise ExportError(
            f"cell address {channel.cell_ip!r}: the robot needs the IPv4 address of the cell PC on its network"
        )
    for name, number, limit in (
        ("tool number", settings.tool_number, 16),
        ("pick base number", settings.pick_base_number, 32),
        ("place base number", settings.place_base_number, 32),
        ("vacuum output", settings.vacuum_output, 4096),
        ("vacuum input", settings.vacuum_input, 4096),
    ):
        if not 1 <= number <= limit:
            raise ExportError(f"{name} {number}: must be 1 to {limit}")
    if not 0 <= settings.blow_output <= 4096:
        raise ExportError(f"blow-off output {settings.blow_output}: must be 1 to 4096, or 0 for none")


def _assign(text: str, name: str, value: str) -> str:
    pattern = re.compile(rf"^(DECL GLOBAL \w+ {name}=)(\{{[^}}]*\}}|[^\s;]+)", re.MULTILINE)
    return _once(pattern, text, name, value)


def _assign_text(text: str, name: str, value: str) -> str:
    return _once(re.compile(rf'^({name}\[\]=)("[^"]*")', re.MULTILINE), text, name, f'"{value}"')


def _once(pattern: re.Pattern[str], text: str, name: str, value: str) -> str:
    changed, count = pattern.subn(lambda match: match[1] + value, text)
    if count != 1:
        raise ExportError(f"{name} is assigned {count} times in the shipped programs, expected once")
    return changed


def _renamed(programs: Mapping[str, str], prefix: str) -> dict[str, str]:
    """Return the programs with every name that begins with VT under another prefix."""
    if prefix == OWN_PREFIX:
        return dict(programs)
    names = {match[0].upper() for text in programs.values() for match in _NAME.finditer(_STRING.sub("", text))}
    own = {name for name in names if name == OWN_PREFIX or name.startswith(f"{OWN_PREFIX}_")}
    renamed = {name: prefix + name[len(OWN_PREFIX) :] for name in own}
    for name, new in renamed.items():
        if len(new) > MAX_NAME_CHARS:
            raise ExportError(f"prefix {prefix!r}: {name} would become {new}, longer than {MAX_NAME_CHARS} characters")
        if new in names:
            raise ExportError(f"prefix {prefix!r}: {name} would become {new}, which the programs already have")
    pattern = re.compile(rf"(?<![\w$]){OWN_PREFIX}(?=_|\b)")
    return {pattern.sub(prefix, name): pattern.sub(prefix, text) for name, text in programs.items()}


def _controller_data(settings: ExportSettings) -> str:
    lines = [
        "; Tool and bases as the cell's configuration has them. Compare them with the",
        "; controller's, or set them in the start-up menu; the load is yours to measure.",
        f"TOOL_DATA[{settings.tool_number}]={_frame(settings.tool)}",
        f'TOOL_NAME[{settings.tool_number},]="Suction cup"',
        f"BASE_DATA[{settings.pick_base_number}]={_frame(settings.pick_base)}",
        f'BASE_NAME[{settings.pick_base_number},]="Table"',
        f"BASE_DATA[{settings.place_base_number}]={_frame(settings.place_base)}",
        f'BASE_NAME[{settings.place_base_number},]="Assembly"',
    ]
    return "\n".join(lines) + "\n"


def _readme(settings: ExportSettings, xml_name: str) -> str:
    channel = settings.channel
    who = (
        f"The robot connects to the cell PC, {channel.cell_ip} port {channel.cell_port}."
        if settings.robot_connects
        else f"The cell PC connects to the robot, {channel.robot_ip} port {channel.robot_port}."
    )
    lines = [
        "Programs of SlabCell for this cell",
        "",
        who,
        "",
        "workvisual/  copy its content into the project's folders and deploy:",
        f"             {PROGRAMS} and {CHANNELS}",
        "usb/         SlabCell      to KRC:\\R1\\Program\\SlabCell (navigator, user group Expert)",
        f"             EthernetKRL   {xml_name} to C:\\KRC\\ROBOTER\\{CHANNELS.replace('/', chr(92))}",
        "controller-data.txt   tool and bases, to be compared with the controller's",
        "sps-sub.txt           one line for sps.sub (optional)",
        "cell-src.txt          how a PLC starts the program (optional)",
        "",
        "Then select SC_Diag in T1: it connects, and says what it found.",
    ]
    return "\n".join(lines) + "\n"


def _frame(frame: Frame) -> str:
    return "{" + ",".join(f"{key} {_real(value)}" for key, value in zip("XYZABC", frame.as_tuple(), strict=True)) + "}"


def _axes(axes_deg: tuple[float, ...]) -> str:
    inner = [f"A{axis} {_real(angle)}" for axis, angle in enumerate(axes_deg, 1)]
    return "{" + ",".join([*inner, *(f"E{axis} 0.0" for axis in range(1, 7))]) + "}"


def _real(value: float) -> str:
    text = f"{value:.4f}".rstrip("0")
    return f"{text}0" if text.endswith(".") else text
