"""Do channel files, KRL programs and telegram schema say the same?  Findings for a set of project files.

Checked for every channel: a path in an EKI call is configured, on the right side, with the right type; what is
configured is sent and read, because EKI leaves out an element that was never set and closes the connection when a
memory that nobody reads is full (not where a program computes its paths).  Checked for our own channel besides: its
elements are exactly those of the schema, and its flags are those of the programs.  The rules of the language are not
this module's question.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import Literal

from slabcell_drivers.robot.eki.channel_file import ChannelFile, ChannelFileError, ConfiguredElement, read_channel_file
from slabcell_drivers.robot.eki.schema import ATTRIBUTES_OF_FRAME, HEARTBEAT_ROOT, ROBOT, VIS

__all__ = ["Finding", "check"]

MAX_FILES = 10_000


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that does not fit; ``line`` counts from 1, 0 = the whole file."""

    file: str
    line: int
    severity: Literal["error", "warning"]
    rule: str
    message: str


@dataclass(frozen=True, slots=True)
class _Call:
    file: str
    line: int
    verb: str  # "Get", "Set", "Send", "CheckBuffer", "ClearBuffer"
    type: str  # "INT" and so on, "" where the call has none
    channels: frozenset[str]  # upper case; empty = any
    path: str


_CALL = re.compile(
    r"\bEKI_(?P<verb>GET|SET|SEND|CHECKBUFFER|CLEARBUFFER)(?P<type>INT|REAL|BOOL|STRING|FRAME)?(?:ARRAY)?"
    r'\s*\(\s*(?P<channel>"[^"]*"|[A-Z_$][\w$]*\s*\[\s*\])\s*,\s*"(?P<path>[^"]*)"',
    re.IGNORECASE,
)
_CALL_WITH_VARIABLE_PATH = re.compile(r'\bEKI_(?:GET|SET)\w+\s*\(\s*[^,()]+,\s*[^"\s]', re.IGNORECASE)
_TEXT_VALUE = re.compile(r'\b([A-Z_$][\w$]*)\s*\[\s*\]\s*=\s*"([^"]*)"', re.IGNORECASE)
_INT_VALUE = re.compile(r"\bINT\s+([A-Z_$][\w$]*)\s*=\s*([0-9]+)", re.IGNORECASE)


def check(files: Mapping[str, bytes]) -> list[Finding]:
    """Return what does not fit, by file and line.

    ``files`` maps a name or path to the raw bytes of every .src, .dat, .sub and .xml file of the project; others are
    passed over, and so are XML files that are no EKI channel.
    """
    findings: list[Finding] = []
    channels: list[ChannelFile] = []
    sources: dict[str, str] = {}
    for name, raw in list(files.items())[:MAX_FILES]:
        suffix = PurePath(name).suffix.lower()
        if suffix in {".src", ".dat", ".sub"}:
            sources[name] = raw.decode("latin-1")
        elif suffix == ".xml":
            try:
                channel = read_channel_file(name, raw)
            except ChannelFileError as error:
                findings.append(Finding(name, error.line, "error", "channel-file", str(error)))
            else:
                if channel is not None:
                    channels.append(channel)
    calls = _calls(sources)
    computed_paths = any(_CALL_WITH_VARIABLE_PATH.search(_without_comments(text)) for text in sources.values())
    for channel in channels:
        if _is_ours(channel):
            findings += _against_schema(channel)
            findings += _flags(channel, sources)
        if not computed_paths:
            findings += _unused(channel, channels, calls)
    if channels:
        findings += [finding for call in calls for finding in _against_channels(call, channels)]
    return sorted(findings, key=lambda finding: (finding.file, finding.line, finding.message))


def _calls(sources: Mapping[str, str]) -> list[_Call]:
    names: dict[str, set[str]] = {}
    for text in sources.values():
        for match in _TEXT_VALUE.finditer(_without_comments(text)):
            names.setdefault(match[1].upper(), set()).add(match[2].upper())
    calls: list[_Call] = []
    for file, text in sources.items():
        for number, line in enumerate(_without_comments(text).splitlines(), 1):
            for match in _CALL.finditer(line):
                written = match["channel"]
                known = (
                    {written[1:-1].upper()}
                    if written.startswith('"')
                    else names.get(written.split("[")[0].strip().upper(), set[str]())
                )
                verb = match["verb"].upper()
                calls.append(_Call(file, number, verb, (match["type"] or "").upper(), frozenset(known), match["path"]))
    return calls


def _without_comments(text: str) -> str:
    """Return the text with comments blanked, line by line; a ``;`` within a string begins none."""
    return re.sub(r'("[^"\n]*")|;[^\n]*', lambda match: match[1] or "", text)


def _is_ours(channel: ChannelFile) -> bool:
    paths = {element.path for element in (*channel.received, *channel.sent)}
    return any(path.startswith(f"{VIS.root}/") for path in paths) and any(p.startswith(f"{ROBOT.root}/") for p in paths)


def _meant_for(call: _Call, channel: ChannelFile, channels: list[ChannelFile]) -> bool:
    """Whether the call is on this channel.  Our two roles count as one: one of their files is used at a time."""
    if not call.channels or channel.name.upper() in call.channels:
        return True
    return _is_ours(channel) and any(other.name.upper() in call.channels for other in channels if _is_ours(other))


def _against_channels(call: _Call, channels: list[ChannelFile]) -> list[Finding]:
    mine = [channel for channel in channels if _meant_for(call, channel, channels)]
    if not mine:
        wanted = ", ".join(sorted(call.channels))
        return [
            Finding(
                call.file, call.line, "warning", "no-channel-file", f"no channel file {wanted}.xml is among the files"
            )
        ]
    problems = [_problem(call, channel) for channel in mine]
    if not all(problems) and not call.channels:
        return []  # which channel is meant is not known, and one of them fits
    return [
        Finding(call.file, call.line, "error", "path", f"{problem} in {channel.file}")
        for problem, channel in zip(problems, mine, strict=True)
        if problem
    ]


def _problem(call: _Call, channel: ChannelFile) -> str:
    """Return what is wrong with the call on this channel, or nothing."""
    if call.verb == "SEND":
        root = call.path.split("/")[0]
        known = any(element.path == call.path or element.path.startswith(f"{call.path}/") for element in channel.sent)
        # What is not configured is sent word for word; a path of a configured tree is a slip.
        slip = not call.path.startswith("<") and any(element.path.split("/")[0] == root for element in channel.sent)
        return f'"{call.path}" is not among the SEND elements' if slip and not known else ""
    side, elements = ("SEND", channel.sent) if call.verb == "SET" else ("RECEIVE", channel.received)
    if call.verb == "CLEARBUFFER" or (call.verb == "CHECKBUFFER" and call.path):
        known = any(element.path == call.path or element.path.startswith(f"{call.path}/") for element in elements)
        return "" if known else f'"{call.path}" is not among the {side} elements'
    exact = next((element for element in elements if element.path == call.path), None)
    if call.type == "FRAME":
        return "" if exact is not None and exact.type == "FRAME" else _frame_problem(call, side, elements)
    if exact is None:
        return f'"{call.path}" is not among the {side} elements'
    if call.verb == "GET" and exact.type != call.type:
        return f'EKI_Get{call.type.title()} reads "{call.path}", which is {exact.type or "an event without a value"}'
    return ""


def _frame_problem(call: _Call, side: str, elements: tuple[ConfiguredElement, ...]) -> str:
    paths = {element.path for element in elements}
    missing = [key for key in ATTRIBUTES_OF_FRAME if f"{call.path}/@{key}" not in paths]
    if not missing:
        return ""
    return f'"{call.path}" is no frame among the {side} elements: it lacks {", ".join(f"@{key}" for key in missing)}'


def _unused(channel: ChannelFile, channels: list[ChannelFile], calls: list[_Call]) -> list[Finding]:
    mine = [call for call in calls if _meant_for(call, channel, channels)]
    got = _touched([call for call in mine if call.verb == "GET"])
    put = _touched([call for call in mine if call.verb == "SET"])
    if not got and not put:
        return []  # the programs of this channel are not among the files
    findings = [
        Finding(
            channel.file,
            element.line,
            "warning",
            "never-read",
            f"{element.path} has a memory that no program reads: when it is full, EKI closes the connection",
        )
        for element in channel.received
        if element.type and element.path not in got
    ]
    findings += [
        Finding(channel.file, element.line, "warning", "never-set", f"{element.path} is never set: EKI leaves it out")
        for element in channel.sent
        if element.path not in put
    ]
    return findings


def _touched(calls: list[_Call]) -> set[str]:
    paths = {call.path for call in calls}
    return paths | {f"{call.path}/@{key}" for call in calls if call.type == "FRAME" for key in ATTRIBUTES_OF_FRAME}


def _against_schema(channel: ChannelFile) -> list[Finding]:
    findings: list[Finding] = []
    wanted = {VIS.path(element): element.type.value for element in VIS.elements}
    wanted |= {VIS.root: "", HEARTBEAT_ROOT: ""}
    for side, have, want in (
        ("RECEIVE", channel.received, wanted),
        ("SEND", channel.sent, {ROBOT.path(element): "" for element in ROBOT.elements}),
    ):
        seen: set[str] = set()
        for element in have:
            if element.path not in want:
                message = f"{element.path} is not in the telegram schema"
                findings.append(Finding(channel.file, element.line, "error", "schema", message))
            elif element.path in seen:
                findings.append(Finding(channel.file, element.line, "error", "schema", f"{element.path} stands twice"))
            elif side == "RECEIVE" and element.type != want[element.path]:
                message = (
                    f"{element.path} has type {element.type or 'none'}, the schema says {want[element.path] or 'none'}"
                )
                findings.append(Finding(channel.file, element.line, "error", "schema", message))
            seen.add(element.path)
        findings += [
            Finding(channel.file, 0, "error", "schema", f"{path} is missing from {side}")
            for path in want
            if path not in seen
        ]
    return findings


def _flags(channel: ChannelFile, sources: Mapping[str, str]) -> list[Finding]:
    flags = {element.path: element.flag for element in channel.received}
    wanted = {"FLAGRX": flags.get(VIS.root, 0), "FLAGHB": flags.get(HEARTBEAT_ROOT, 0), "FLAGALIVE": channel.alive_flag}
    findings: list[Finding] = []
    for file, text in sources.items():
        for number, line in enumerate(_without_comments(text).splitlines(), 1):
            for match in _INT_VALUE.finditer(line):
                name = match[1].upper().rpartition("_")[2]
                if name in wanted and wanted[name] != int(match[2]):
                    message = f"{match[1]} is {match[2]}, but {channel.file} sets flag {wanted[name] or 'none'}"
                    findings.append(Finding(file, number, "error", "flag", message))
    return findings
