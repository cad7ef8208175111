"""What is in the registers now, and who may write which?  `RegisterImage`: the memory behind a Modbus server.

A write is taken whole or not at all: every register it touches must be one that the peer may write, and every value
must stay within its limits.  Reading and writing are plain calls within one thread, so that no reader ever sees half a
write.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum

from slabcell_drivers.robot.modbus.register_map import Area, Register, RegisterMap, RegisterType

__all__ = ["ExceptionCode", "RefusedError", "RegisterImage"]


class ExceptionCode(IntEnum):
    """Why a request is refused (MODBUS application protocol V1.1b3, section 7)."""

    ILLEGAL_FUNCTION = 1
    ILLEGAL_ADDRESS = 2
    ILLEGAL_VALUE = 3
    DEVICE_FAILURE = 4
    DEVICE_BUSY = 6
    NO_SUCH_UNIT = 11


class RefusedError(Exception):
    """The request is answered by an exception response."""

    def __init__(self, code: ExceptionCode) -> None:
        super().__init__(code.name)
        self.code = code


class RegisterImage:
    """The registers of one device, all zero at first.

    ``peer_writes`` are the areas that a peer may write.  ``written`` is called after each write of a peer, with the
    registers that it touched; it must not raise.
    """

    def __init__(self, register_map: RegisterMap, *, peer_writes: frozenset[Area]) -> None:
        self.map = register_map
        self.written: Callable[[frozenset[Register]], None] = lambda _registers: None
        self._peer_writes = peer_writes
        self._owner: dict[int, Register] = {
            address: register
            for register in register_map.registers
            for address in range(register.address, register.end)
        }
        self._words = dict.fromkeys(self._owner, 0)

    # ------------------------------------------------------------------------------------------------------ our side

    def get(self, area: Area) -> list[int]:
        """Return the words of an area."""
        start, count = self.map.span(area)
        return [self._words[address] for address in range(start, start + count)]

    def set(self, area: Area, words: Sequence[int]) -> None:
        """Write the words of a whole area in one step."""
        start, count = self.map.span(area)
        if len(words) != count:
            raise ValueError(f"{area} has {count} registers, not {len(words)}")
        self._words.update(zip(range(start, start + count), words, strict=True))

    def put(self, address: int, words: Sequence[int]) -> None:
        """Write some words.  Raises KeyError if an address, as the PLC counts, has no register."""
        for at in range(address, address + len(words)):
            if at not in self._owner:
                raise KeyError(at)
        self._words.update(zip(range(address, address + len(words)), words, strict=True))

    def peek(self, address: int, count: int) -> list[int]:
        """Return some words.  Raises KeyError as `put` does."""
        return [self._words[at] for at in range(address, address + count)]

    def value(self, area: Area, name: str) -> int:
        """Return one scaled whole number."""
        register = self.map.register(area, name)
        return self.map.number(register, [self._words[at] for at in range(register.address, register.end)])

    def set_value(self, area: Area, name: str, value: int) -> None:
        """Write one register of 16 bits."""
        self._words[self.map.register(area, name).address] = value & 0xFFFF

    # ---------------------------------------------------------------------------------------------------- peer's side

    def read(self, wire_address: int, count: int) -> list[int]:
        """Return wire words.  Raises RefusedError if an address has no register."""
        start = wire_address - self.map.layout.address_offset
        try:
            return self.map.to_wire([self._words[address] for address in range(start, start + count)])
        except KeyError as error:
            raise RefusedError(ExceptionCode.ILLEGAL_ADDRESS) from error

    def write(self, wire_address: int, wire_words: Sequence[int]) -> None:
        """Take a peer's write.  Raises RefusedError; nothing is changed then."""
        start = wire_address - self.map.layout.address_offset
        update = dict(zip(range(start, start + len(wire_words)), self.map.from_wire(wire_words), strict=True))
        touched: set[Register] = set()
        for address in update:
            register = self._owner.get(address)
            if register is None or register.area not in self._peer_writes:
                raise RefusedError(ExceptionCode.ILLEGAL_ADDRESS)
            touched.add(register)
        for register in touched:
            if register.type is RegisterType.TEXT:
                continue
            words = [update.get(at, self._words[at]) for at in range(register.address, register.end)]
            raw = self.map.number(register, words)
            if not register.low * register.scale <= raw <= register.high * register.scale:
                raise RefusedError(ExceptionCode.ILLEGAL_VALUE)
        self._words.update(update)
        self.written(frozenset(touched))

    def read_coils(self, wire_address: int, count: int) -> list[bool]:
        """Return the bits that the PLC writes.  Raises RefusedError."""
        return self._bits({self.map.bits.vacuum: 0}, (Area.PLC_LIFE, "io_command"), wire_address, count)

    def read_inputs(self, wire_address: int, count: int) -> list[bool]:
        """Return the bits that the cell writes.  Raises RefusedError."""
        bits = self.map.bits
        known = {bits.part_present: 0, bits.interlock_closed: 1, bits.io_answers: 2}
        return self._bits(known, (Area.CELL_LIFE, "io_state"), wire_address, count)

    def write_coils(self, wire_address: int, values: Sequence[bool]) -> None:
        """Take a peer's write of coils.  Raises RefusedError; nothing is changed then."""
        address = wire_address - self.map.layout.address_offset
        if Area.PLC_LIFE not in self._peer_writes or address != self.map.bits.vacuum or len(values) != 1:
            raise RefusedError(ExceptionCode.ILLEGAL_ADDRESS)
        self.set_value(Area.PLC_LIFE, "io_command", int(values[0]))
        self.written(frozenset({self.map.register(Area.PLC_LIFE, "io_command")}))

    def _bits(self, known: dict[int, int], register: tuple[Area, str], wire_address: int, count: int) -> list[bool]:
        start = wire_address - self.map.layout.address_offset
        word = self.value(*register)
        try:
            return [bool(word >> known[address] & 1) for address in range(start, start + count)]
        except KeyError as error:
            raise RefusedError(ExceptionCode.ILLEGAL_ADDRESS) from error
