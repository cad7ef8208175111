"""How is a register map read from its file, and what is said when it is wrong?  TOML to a checked `RegisterMap`."""

import difflib
import itertools
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from slabcell_drivers.robot.modbus.register_map import (
    MAX_READ_WORDS,
    MAX_WRITE_WORDS,
    Area,
    Bits,
    Layout,
    Order,
    Register,
    RegisterMap,
    RegisterType,
)

__all__ = ["NAMES", "ModbusMapError", "load_map", "parse_map"]

SCHEMA = "slabcell.modbus_map/1"
MAX_BYTES = 1 << 18
_FRAME = "xyzabc"
NAMES: dict[Area, tuple[str, ...]] = {
    Area.PLC_LIFE: ("watchdog", "io_command"),
    Area.REQUEST: (
        *("version", "sequence", "session", "command", "job_id", "model", "ack_result_id", "ack_state"),
        *("mode", "tool", "base", "gripper", "robot_error"),
        *(f"tcp_{key}" for key in _FRAME),
        *(f"axis_{axis}" for axis in range(1, 7)),
        *("sequence_end", "check", "toggle"),
    ),
    Area.CELL_LIFE: ("watchdog", "watchdog_echo", "status", "io_state"),
    Area.ANSWER: (
        *("publication", "version", "session", "sequence", "ack_sequence", "code", "error_number"),
        *("result_id", "index", "left", "trigger_sequence"),
        *(f"pick_{key}" for key in _FRAME),
        *(f"place_{key}" for key in _FRAME),
        *("slot", "grip", "score", "message", "publication_end", "check", "toggle"),
    ),
}
"""What every map must hold, by area; the map says where and how."""
_ENDS = {Area.REQUEST: ("sequence_end", "check", "toggle"), Area.ANSWER: ("publication_end", "check", "toggle")}
_LIMITS = {
    RegisterType.UINT16: (0, 0xFFFF),
    RegisterType.INT32: (-(1 << 31), (1 << 31) - 1),
    RegisterType.UINT32: (0, (1 << 32) - 1),
}
_WORDS = {RegisterType.UINT16: 1, RegisterType.INT32: 2, RegisterType.UINT32: 2}

_Address = Annotated[int, Field(ge=0, le=65_535)]


class ModbusMapError(ValueError):
    """A register map is wrong; the message names file, key, value and remedy."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Layout(_Table):
    unit_id: Annotated[int, Field(ge=1, le=247)] = 1
    address_offset: Annotated[int, Field(ge=-65_535, le=65_535)] = 0
    word_order: Order = Order.HIGH_FIRST
    byte_order: Order = Order.HIGH_FIRST


class _Register(_Table):
    address: _Address
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,39}$")]
    type: RegisterType
    meaning: Annotated[str, Field(min_length=1, max_length=200)]
    words: Annotated[int, Field(ge=1, le=60)] | None = None
    scale: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    unit: Annotated[str, Field(max_length=10)] = ""
    low: float | None = None
    high: float | None = None


class _AreaTable(_Table):
    registers: Annotated[list[_Register], Field(min_length=1, max_length=MAX_READ_WORDS)]


class _Coils(_Table):
    vacuum: _Address


class _Inputs(_Table):
    part_present: _Address
    interlock_closed: _Address
    io_answers: _Address


class _Document(_Table):
    schema_: Annotated[Literal["slabcell.modbus_map/1"], Field(alias="schema")]
    layout: _Layout = _Layout()
    plc_life: _AreaTable
    request: _AreaTable
    cell_life: _AreaTable
    answer: _AreaTable
    coils: _Coils
    inputs: _Inputs

    def registers(self) -> Iterable[tuple[Area, _Register]]:
        tables = (self.plc_life, self.request, self.cell_life, self.answer)
        for area, table in zip(Area, tables, strict=True):
            for register in table.registers:
                yield area, register


def load_map(path: Path, layout: Layout | None = None) -> RegisterMap:
    """Return the map of a file, with another layout if one is given.  Raises ModbusMapError."""
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise ModbusMapError(f"{path}: cannot be read: {error.strerror}") from error
    if len(raw) > MAX_BYTES:
        raise ModbusMapError(f"{path}: is larger than {MAX_BYTES >> 10} KiB, which no register map is")
    try:
        return parse_map(raw.decode("utf-8"), layout)
    except UnicodeDecodeError as error:
        raise ModbusMapError(f"{path}: holds a byte that is not UTF-8; save the file as UTF-8") from error
    except ModbusMapError as error:
        raise ModbusMapError("\n".join(f"{path}: {line}" for line in str(error).splitlines())) from error


def parse_map(text: str, layout: Layout | None = None) -> RegisterMap:
    """Return the map of a TOML text.  Raises ModbusMapError with a line for each thing that is wrong."""
    try:
        document = _Document.model_validate(tomllib.loads(text))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ModbusMapError(f"is not TOML: {error}") from error
    except ValidationError as error:
        lines = [f"{'.'.join(map(str, item['loc']))} = {item['input']!r:.60}: {item['msg']}" for item in error.errors()]
        raise ModbusMapError("\n".join(lines)) from error
    problems: list[str] = []
    registers = tuple(
        sorted(
            (_register(area, entry, problems) for area, entry in document.registers()),
            key=lambda register: register.address,
        )
    )
    found = document.layout
    bits = Bits(document.coils.vacuum, **document.inputs.model_dump())
    register_map = RegisterMap(
        layout or Layout(found.unit_id, found.address_offset, found.word_order, found.byte_order), registers, bits
    )
    problems += [*_name_problems(register_map), *_overlaps(register_map)]
    if not problems:
        problems += [*_place_problems(register_map), *_bit_problems(register_map)]
    if problems:
        raise ModbusMapError("\n".join(problems))
    return register_map


def _register(area: Area, entry: _Register, problems: list[str]) -> Register:
    where = f"{area}.{entry.name}"
    if entry.type is RegisterType.TEXT:
        if entry.words is None:
            problems.append(f"{where}: a text needs words = NUMBER OF REGISTERS")
        if entry.scale != 1 or entry.low is not None or entry.high is not None:
            problems.append(f"{where}: a text has no scale and no limits")
        return Register(area, entry.address, entry.name, entry.type, entry.words or 1, entry.meaning)
    words = _WORDS[entry.type]
    if entry.words not in (None, words):
        problems.append(f"{where}: words = {entry.words}, but {entry.type} takes {words}; leave words out")
    lowest, highest = (limit / entry.scale for limit in _LIMITS[entry.type])
    low = lowest if entry.low is None else entry.low
    high = highest if entry.high is None else entry.high
    if not lowest <= low <= high <= highest:
        problems.append(
            f"{where}: low {low:g} and high {high:g} must rise, and lie within {lowest:g} to {highest:g},"
            f" what {entry.type} holds at scale {entry.scale}"
        )
    if not low <= 0 <= high:
        problems.append(f"{where}: low {low:g} to high {high:g} leaves 0 out, which every register begins with")
    return Register(
        area, entry.address, entry.name, entry.type, words, entry.meaning, entry.scale, entry.unit, low, high
    )


def _name_problems(register_map: RegisterMap) -> Iterable[str]:
    for area, known in NAMES.items():
        names = [register.name for register in register_map.area(area)]
        for name in sorted(set(names)):
            if names.count(name) > 1:
                yield f"{area}.{name}: stands {names.count(name)} times"
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1)
                hint = f"did you mean {near[0]!r}?" if near else f"known here: {', '.join(known)}"
                yield f"{area}.{name}: unknown register: {hint}"
        for name in known:
            if name not in names:
                yield f"{area}.{name}: is missing"


def _overlaps(register_map: RegisterMap) -> Iterable[str]:
    offset = register_map.layout.address_offset
    registers = register_map.registers
    for before, after in itertools.pairwise(registers):
        if before.end > after.address:
            yield (
                f"{after.area}.{after.name}: address {after.address} lies in {before.area}.{before.name}, which takes"
                f" {before.address} to {before.end - 1}"
            )
    for register in registers:
        if register.address + offset < 0 or register.end - 1 + offset > 65_535:
            yield f"{register.area}.{register.name}: address {register.address} + offset {offset} is outside 0 to 65535"


def _place_problems(register_map: RegisterMap) -> Iterable[str]:
    for area in Area:
        registers = register_map.area(area)
        for before, after in itertools.pairwise(registers):
            if before.end != after.address:
                yield f"{area}.{after.name}: address {after.address} leaves a gap behind {before.name}: areas are whole"
        count = register_map.span(area)[1]
        if count > MAX_WRITE_WORDS:
            yield f"{area}: takes {count} registers; one request writes {MAX_WRITE_WORDS} at most"
        ends = _ENDS.get(area)
        if ends and tuple(register.name for register in registers[-3:]) != ends:
            yield f"{area}: must end with {', '.join(ends)}, in this order: what is read last says that it is whole"
    if register_map.area(Area.ANSWER)[0].name != "publication":
        yield "answer: must begin with publication: what is read first says whether it is whole"


def _bit_problems(register_map: RegisterMap) -> Iterable[str]:
    bits = register_map.bits
    inputs = (bits.part_present, bits.interlock_closed, bits.io_answers)
    if len(set(inputs)) != len(inputs):
        yield f"inputs: addresses {', '.join(map(str, inputs))}: each input needs one of its own"
    for address in (bits.vacuum, *inputs):
        offset = register_map.layout.address_offset
        if not 0 <= address + offset <= 65_535:
            yield f"coils, inputs: address {address} + offset {offset} is outside 0 to 65535"
