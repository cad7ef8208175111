"""How is one Modbus request answered?  Bytes of a request to bytes of a response, over a register image; pure.

pymodbus reads and writes the messages.  What it leaves open is decided here: which functions exist (nine; diagnostics,
files and identification do not), that a message has exactly its length, and that a coil is FF00 or 0000.
"""

import struct
from collections.abc import Callable, Sequence
from typing import Protocol

from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.bit_message import (
    ReadCoilsRequest,
    ReadCoilsResponse,
    ReadDiscreteInputsRequest,
    ReadDiscreteInputsResponse,
    WriteMultipleCoilsRequest,
    WriteMultipleCoilsResponse,
    WriteSingleCoilRequest,
)
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
    ReadWriteMultipleRegistersRequest,
    ReadWriteMultipleRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
)

from slabcell_drivers.robot.modbus.framing import request_length
from slabcell_drivers.robot.modbus.image import ExceptionCode, RefusedError
from slabcell_drivers.robot.modbus.register_map import MAX_READ_WORDS, MAX_WRITE_WORDS

__all__ = ["Store", "answer_pdu"]

MAX_READ_WRITE_WORDS = 121
MAX_READ_BITS, MAX_WRITE_BITS = 2000, 1968
_COIL_VALUES = (b"\xff\x00", b"\x00\x00")


class Store(Protocol):
    """What is behind the addresses; each call may raise RefusedError, and then has changed nothing."""

    def read(self, wire_address: int, count: int) -> list[int]: ...  # noqa: D102 - see the class
    def write(self, wire_address: int, wire_words: Sequence[int]) -> None: ...  # noqa: D102
    def read_coils(self, wire_address: int, count: int) -> list[bool]: ...  # noqa: D102
    def read_inputs(self, wire_address: int, count: int) -> list[bool]: ...  # noqa: D102
    def write_coils(self, wire_address: int, values: Sequence[bool]) -> None: ...  # noqa: D102


def answer_pdu(store: Store, pdu: bytes, may_write: Callable[[], bool]) -> bytes:
    """Return the response to a request; a request that cannot be served gets an exception response.

    ``may_write`` is asked before anything is written; where it says no, the peer is told that the device is busy.
    """
    function = pdu[0] if pdu else 0
    try:
        response = _serve(store, pdu, may_write)
    except RefusedError as error:
        response = ExceptionResponse(function & 0x7F, int(error.code))
    return bytes((response.function_code,)) + response.encode()


def _serve(store: Store, pdu: bytes, may_write: Callable[[], bool]) -> ModbusPDU:
    length = request_length(pdu)
    if not pdu or length is None:
        raise RefusedError(ExceptionCode.ILLEGAL_FUNCTION)
    if length != len(pdu):
        raise RefusedError(ExceptionCode.ILLEGAL_VALUE)
    request = _decoded(_REQUESTS[pdu[0]](), pdu)
    match request:
        case ReadDiscreteInputsRequest():
            return ReadDiscreteInputsResponse(
                bits=store.read_inputs(request.address, _within(request.count, MAX_READ_BITS))
            )
        case ReadCoilsRequest():
            return ReadCoilsResponse(bits=store.read_coils(request.address, _within(request.count, MAX_READ_BITS)))
        case ReadInputRegistersRequest():
            return ReadInputRegistersResponse(
                registers=store.read(request.address, _within(request.count, MAX_READ_WORDS))
            )
        case ReadHoldingRegistersRequest():
            return ReadHoldingRegistersResponse(
                registers=store.read(request.address, _within(request.count, MAX_READ_WORDS))
            )
        case WriteSingleCoilRequest():
            if pdu[3:5] not in _COIL_VALUES:
                raise RefusedError(ExceptionCode.ILLEGAL_VALUE)
            _require(may_write)
            store.write_coils(request.address, request.bits)
            return request
        case WriteSingleRegisterRequest():
            _require(may_write)
            store.write(request.address, request.registers)
            return request
        case WriteMultipleCoilsRequest():
            if len(pdu) - 6 != (_within(request.count, MAX_WRITE_BITS) + 7) // 8:
                raise RefusedError(ExceptionCode.ILLEGAL_VALUE)
            _require(may_write)
            store.write_coils(request.address, request.bits)
            return WriteMultipleCoilsResponse(address=request.address, count=request.count)
        case WriteMultipleRegistersRequest():
            if len(pdu) - 6 != 2 * _within(request.count, MAX_WRITE_WORDS):
                raise RefusedError(ExceptionCode.ILLEGAL_VALUE)
            _require(may_write)
            store.write(request.address, request.registers)
            return WriteMultipleRegistersResponse(address=request.address, count=request.count)
        case ReadWriteMultipleRegistersRequest():
            count = _within(request.read_count, MAX_READ_WORDS)
            if len(pdu) - 10 != 2 * _within(request.write_count, MAX_READ_WRITE_WORDS):
                raise RefusedError(ExceptionCode.ILLEGAL_VALUE)
            store.read(request.read_address, count)  # an address that cannot be read: refused before it is written
            _require(may_write)
            store.write(request.write_address, request.write_registers)
            return ReadWriteMultipleRegistersResponse(registers=store.read(request.read_address, count))
        case _:
            raise RefusedError(ExceptionCode.ILLEGAL_FUNCTION)


_REQUESTS: dict[int, type[ModbusPDU]] = {
    kind.function_code: kind
    for kind in (
        *(ReadCoilsRequest, ReadDiscreteInputsRequest, ReadHoldingRegistersRequest, ReadInputRegistersRequest),
        *(WriteSingleCoilRequest, WriteSingleRegisterRequest, WriteMultipleCoilsRequest),
        *(WriteMultipleRegistersRequest, ReadWriteMultipleRegistersRequest),
    )
}


def _decoded(request: ModbusPDU, pdu: bytes) -> ModbusPDU:
    try:
        request.decode(pdu[1:])
    except (ValueError, IndexError, struct.error) as error:  # pymodbus judges counts
        raise RefusedError(ExceptionCode.ILLEGAL_VALUE) from error
    return request


def _within(count: int, limit: int) -> int:
    if not 1 <= count <= limit:
        raise RefusedError(ExceptionCode.ILLEGAL_VALUE)
    return count


def _require(may_write: Callable[[], bool]) -> None:
    if not may_write():
        raise RefusedError(ExceptionCode.DEVICE_BUSY)
