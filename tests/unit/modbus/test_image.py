"""What a peer may read and write, and what its writes can never do."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slabcell_drivers.robot.modbus.codec import encode_request
from slabcell_drivers.robot.modbus.image import ExceptionCode, RefusedError, RegisterImage
from slabcell_drivers.robot.modbus.pdu import answer_pdu
from slabcell_drivers.robot.modbus.register_map import Area, RegisterType
from slabcell_drivers.robot.modbus.server import PLC_AREAS
from slabcell_drivers.robot.protocol import Request, RequestType

pytestmark = pytest.mark.unit


@pytest.fixture
def image(any_map):
    return RegisterImage(any_map, peer_writes=PLC_AREAS)


def test_what_is_written_whole_is_read_whole(image, any_map):
    words = encode_request(any_map, Request(RequestType.HELLO, 0, 1), 1)
    seen = []
    image.written = seen.append
    image.write(any_map.wire_address(2), any_map.to_wire(words))
    assert image.get(Area.REQUEST) == words
    assert any_map.from_wire(image.read(any_map.wire_address(2), 48)) == words
    assert [{register.area for register in touched} for touched in seen] == [{Area.REQUEST}]


@pytest.mark.parametrize(("address", "count"), [(50, 1), (99, 1), (49, 2), (193, 1), (60_000, 1), (100, 94)])
def test_an_address_without_a_register_is_refused(image, any_map, address, count):
    with pytest.raises(RefusedError) as caught:
        image.read(any_map.wire_address(address), count)
    assert caught.value.code is ExceptionCode.ILLEGAL_ADDRESS


@pytest.mark.parametrize("address", [100, 104, 150, 192, 49])
def test_a_write_that_touches_what_is_ours_changes_nothing(image, any_map, address):
    before = [image.get(area) for area in Area]
    with pytest.raises(RefusedError):
        image.write(any_map.wire_address(address), any_map.to_wire([1, 1, 1] if address == 49 else [1]))
    assert [image.get(area) for area in Area] == before


@pytest.mark.parametrize(("address", "words"), [(7, [7]), (49, [2]), (3, [0x8000, 0]), (2, [1, 0xFFFF, 0, 0, 0, 1])])
def test_a_value_outside_its_limits_changes_nothing(image, any_map, address, words):
    if any_map.layout.word_order.value == "low-first" and address in (2, 3):
        words = words[::-1] if address == 3 else [1, 0, 0xFFFF, 0, 0, 1]
    with pytest.raises(RefusedError) as caught:
        image.write(any_map.wire_address(address), any_map.to_wire(words))
    assert caught.value.code is ExceptionCode.ILLEGAL_VALUE
    assert not any(image.get(Area.REQUEST))


def test_coils_and_inputs_are_the_bits_of_the_registers(image, any_map):
    at = any_map.wire_address
    image.write_coils(at(0), [True])
    assert image.value(Area.PLC_LIFE, "io_command") == 1
    assert image.read_coils(at(0), 1) == [True]
    image.set_value(Area.CELL_LIFE, "io_state", 0b110)
    assert image.read_inputs(at(0), 3) == [False, True, True]
    for refused in (lambda: image.read_inputs(at(1), 3), lambda: image.write_coils(at(0), [True, True])):
        with pytest.raises(RefusedError):
            refused()


PDUS = st.binary(max_size=253) | st.tuples(
    st.sampled_from([1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43]),
    st.integers(0, 200) | st.integers(0, 65_535),
    st.integers(0, 130) | st.integers(0, 65_535),
    st.binary(max_size=240),
).map(lambda t: bytes((t[0],)) + t[1].to_bytes(2, "big") + t[2].to_bytes(2, "big") + t[3])


@given(pdus=st.lists(PDUS, min_size=1, max_size=8))
def test_whatever_is_asked_every_register_stays_within_its_limits(shipped, pdus):
    image = RegisterImage(shipped, peer_writes=PLC_AREAS)
    ours = [image.get(area) for area in (Area.CELL_LIFE, Area.ANSWER)]
    for pdu in pdus:
        before = [image.get(area) for area in Area]
        answer = answer_pdu(image, pdu, lambda: True)
        assert 2 <= len(answer) <= 253
        if answer[0] & 0x80:
            assert [image.get(area) for area in Area] == before
            assert answer[1] in set(ExceptionCode)
    assert [image.get(area) for area in (Area.CELL_LIFE, Area.ANSWER)] == ours
    for register in shipped.registers:
        if register.type is not RegisterType.TEXT:
            assert register.low * register.scale <= image.value(register.area, register.name)
            assert image.value(register.area, register.name) <= register.high * register.scale


def test_nobody_writes_who_may_not(shipped):
    image = RegisterImage(shipped, peer_writes=PLC_AREAS)
    for pdu in (b"\x06\0\0\0\1", b"\x10\0\0\0\1\2\0\1", b"\x05\0\0\xff\0", b"\x17\0\0\0\1\0\0\0\1\2\0\1"):
        assert answer_pdu(image, pdu, lambda: False) == bytes((pdu[0] | 0x80, ExceptionCode.DEVICE_BUSY))
        assert not any(image.get(Area.PLC_LIFE))
        assert not answer_pdu(image, pdu, lambda: True)[0] & 0x80
        image.set(Area.PLC_LIFE, [0, 0])
