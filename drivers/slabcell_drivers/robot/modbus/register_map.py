"""What stands in which register?  The register map as values, and numbers to registers and back; pure.

A map has four areas.  The PLC writes ``plc_life`` and ``request``, the cell writes ``cell_life`` and ``answer``.
Request and answer are telegrams: every register of one belongs together.  Three things say so, whoever copies registers
in between and in however many pieces: the number at its beginning and again at its end, the check words, and the toggle
that is written last.

*Words* are register values as the PLC sees them; *wire words* differ from them where the map swaps bytes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

__all__ = [
    "MAP_VERSION",
    "MAX_READ_WORDS",
    "MAX_WRITE_WORDS",
    "Area",
    "Bits",
    "Layout",
    "Order",
    "Register",
    "RegisterMap",
    "RegisterType",
    "RegisterValueError",
    "Value",
    "check_words",
]

MAP_VERSION = 1
MAX_READ_WORDS, MAX_WRITE_WORDS = 125, 123
"""The most registers that one request reads or writes (MODBUS application protocol V1.1b3, 6.3 and 6.12)."""

Value = float | str
"""What a register holds, in its unit; whole where the scale is 1."""


class RegisterValueError(ValueError):
    """A value that its register cannot hold, or must not."""


class RegisterType(StrEnum):
    """What the bits of a register mean."""

    UINT16 = "uint16"
    INT32 = "int32"
    UINT32 = "uint32"
    TEXT = "text"


class Area(StrEnum):
    """Registers that lie together and have one writer."""

    PLC_LIFE = "plc_life"
    REQUEST = "request"
    CELL_LIFE = "cell_life"
    ANSWER = "answer"

    @property
    def written_by_plc(self) -> bool:
        """Whether the PLC writes here; the cell does otherwise."""
        return self in (Area.PLC_LIFE, Area.REQUEST)


class Order(StrEnum):
    """Which part comes first, at the lower address or in the first byte."""

    HIGH_FIRST = "high-first"
    LOW_FIRST = "low-first"


@dataclass(frozen=True, slots=True)
class Layout:
    """How registers travel: unit id, what is added to an address on the wire, word order, byte order."""

    unit_id: int = 1
    address_offset: int = 0
    word_order: Order = Order.HIGH_FIRST
    byte_order: Order = Order.HIGH_FIRST


@dataclass(frozen=True, slots=True)
class Register:
    """One value of the map; ``address`` is as the PLC counts, ``low`` and ``high`` are limits in ``unit``."""

    area: Area
    address: int
    name: str
    type: RegisterType
    words: int
    meaning: str
    scale: int = 1
    unit: str = ""
    low: float = 0
    high: float = 0

    @property
    def end(self) -> int:
        """The address behind it."""
        return self.address + self.words

    def raw(self, value: Value) -> int:
        """Return the scaled whole number of a value.  Raises RegisterValueError."""
        try:
            raw = round(float(value) * self.scale)
        except (ValueError, OverflowError) as error:  # NaN, infinity
            raise RegisterValueError(f"{self.area}.{self.name} = {value}: not a number") from error
        if not self.low * self.scale <= raw <= self.high * self.scale:
            raise RegisterValueError(
                f"{self.area}.{self.name} = {value} {self.unit}".rstrip() + f" is outside {self.low:g} to {self.high:g}"
            )
        return raw


@dataclass(frozen=True, slots=True)
class Bits:
    """Addresses of single bits, as the PLC counts: a coil or an input for each bit of a register."""

    vacuum: int = 0
    part_present: int = 0
    interlock_closed: int = 1
    io_answers: int = 2


@dataclass(frozen=True)
class RegisterMap:
    """The whole map, checked by `load_map`."""

    layout: Layout
    registers: tuple[Register, ...]
    bits: Bits

    @cached_property
    def _areas(self) -> dict[Area, tuple[Register, ...]]:
        return {area: tuple(item for item in self.registers if item.area is area) for area in Area}

    @cached_property
    def _by_name(self) -> dict[tuple[Area, str], Register]:
        return {(item.area, item.name): item for item in self.registers}

    def area(self, area: Area) -> tuple[Register, ...]:
        """Return the registers of an area by rising address, without gaps."""
        return self._areas[area]

    def span(self, area: Area) -> tuple[int, int]:
        """Return the first address of an area, as the PLC counts, and its number of registers."""
        registers = self.area(area)
        return registers[0].address, registers[-1].end - registers[0].address

    def register(self, area: Area, name: str) -> Register:
        """Return one register; KeyError if there is none."""
        return self._by_name[area, name]

    def wire_address(self, address: int) -> int:
        """Return what stands in a request for an address."""
        return address + self.layout.address_offset

    # ---------------------------------------------------------------------------------------------- values and words

    def encode(self, area: Area, values: Mapping[str, Value]) -> list[int]:
        """Return the words of an area; check words are computed.  Raises RegisterValueError, KeyError."""
        words: list[int] = []
        for register in self.area(area):
            if register.name == "check":
                words += self._words(register, check_words(words))
            elif register.type is RegisterType.TEXT:
                words += _text_words(str(values[register.name]), register.words)
            else:
                words += self._words(register, register.raw(values[register.name]))
        return words

    def decode(self, area: Area, words: Sequence[int]) -> dict[str, Value]:
        """Return the values of an area; nothing is judged but the limits.  Raises RegisterValueError."""
        values: dict[str, Value] = {}
        start = self.span(area)[0]
        for register in self.area(area):
            part = words[register.address - start : register.end - start]
            if register.type is RegisterType.TEXT:
                values[register.name] = _text(part)
                continue
            raw = self.number(register, part)
            value = raw / register.scale if register.scale != 1 else raw
            if not register.low * register.scale <= raw <= register.high * register.scale:
                register.raw(value)
            values[register.name] = value
        return values

    def number(self, register: Register, words: Sequence[int]) -> int:
        """Return the scaled whole number that the words of a register hold."""
        if register.words == 1:
            return words[0]
        high, low = words if self.layout.word_order is Order.HIGH_FIRST else reversed(words)
        number = high << 16 | low
        return number - (1 << 32) if register.type is RegisterType.INT32 and high & 0x8000 else number

    def _words(self, register: Register, raw: int) -> list[int]:
        if register.words == 1:
            return [raw]
        pair = [raw >> 16 & 0xFFFF, raw & 0xFFFF]
        return pair if self.layout.word_order is Order.HIGH_FIRST else pair[::-1]

    # ----------------------------------------------------------------------------------------------------- wholeness

    def sound(self, area: Area, words: Sequence[int]) -> bool:
        """Whether the words of a telegram belong together: begin and end agree, and so do the check words."""
        start = self.span(area)[0]
        begin, end = ("sequence", "sequence_end") if area is Area.REQUEST else ("publication", "publication_end")
        check = self.register(area, "check")

        def number(register: Register) -> int:
            return self.number(register, words[register.address - start : register.end - start])

        if number(self.register(area, begin)) != number(self.register(area, end)):
            return False
        return number(check) == check_words(words[: check.address - start])

    # ------------------------------------------------------------------------------------------------------- the wire

    def to_wire(self, words: Sequence[int]) -> list[int]:
        """Return words as they travel."""
        if self.layout.byte_order is Order.HIGH_FIRST:
            return list(words)
        return [(word & 0xFF) << 8 | word >> 8 for word in words]

    from_wire = to_wire
    """Swapping twice swaps back."""


def check_words(words: Sequence[int]) -> int:
    """Return the check over the words, 32 bits: two running sums modulo 65536, as any PLC can compute them.

    ``a`` begins with 1 and adds each word, ``b`` begins with 0 and adds each new ``a``; the check is b·65536 + a.
    Unlike a plain sum it notices words that have changed places.  (Fletcher, "An arithmetic checksum for serial
    transmissions", IEEE Transactions on Communications 30, 1982.)
    """
    a, b = 1, 0
    for word in words:
        a = (a + word) & 0xFFFF
        b = (b + a) & 0xFFFF
    return b << 16 | a


def _text_words(text: str, count: int) -> list[int]:
    raw = text.encode("ascii", "replace")[: 2 * count].ljust(2 * count, b"\0")
    return [raw[at] << 8 | raw[at + 1] for at in range(0, len(raw), 2)]


def _text(words: Sequence[int]) -> str:
    raw = b"".join(word.to_bytes(2, "big") for word in words)
    return raw.split(b"\0", 1)[0].decode("ascii", "replace")
