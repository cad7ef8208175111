"""Frames are found in whatever a stream or a line delivers."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slabcell_drivers.robot.modbus.framing import (
    FramingError,
    ModbusFrame,
    RtuFramer,
    TcpFramer,
    rtu_frame,
    tcp_frame,
)

pytestmark = pytest.mark.unit

REQUEST_PDUS = st.one_of(
    st.binary(min_size=4, max_size=4).flatmap(lambda b: st.sampled_from(range(1, 7)).map(lambda f: bytes((f,)) + b)),
    st.binary(min_size=1, max_size=240).map(lambda data: b"\x10\0\0\0\1" + bytes((len(data),)) + data),
)
FRAMES = st.builds(ModbusFrame, st.integers(0, 255), st.integers(0, 65_535), st.binary(min_size=1, max_size=253))


@given(frames=st.lists(FRAMES, max_size=5), cuts=st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_tcp_frames_are_found_however_the_stream_is_cut(frames, cuts):
    stream, framer, found = b"".join(map(tcp_frame, frames)), TcpFramer(), []
    for at in cuts * (1 + len(stream)):
        found += framer.feed(stream[:at])
        stream = stream[at:]
        if not stream:
            break
    assert found == frames
    assert framer.pending == 0


@pytest.mark.parametrize(
    "header", [b"\0\1\0\1\0\6\1", b"\0\1\0\0\0\1\1", b"\0\1\0\0\0\0\1", b"\0\1\0\0\1\0\1", b"GET / HTTP"]
)
def test_a_header_that_cannot_be_right_is_an_error(header):
    with pytest.raises(FramingError):
        TcpFramer().feed(header)


@given(pdus=st.lists(REQUEST_PDUS, min_size=1, max_size=4), size=st.integers(1, 30))
def test_rtu_frames_are_found_however_the_line_delivers_them(pdus, size):
    stream, framer, found = b"".join(rtu_frame(1, pdu) for pdu in pdus), RtuFramer(1), []
    for at in range(0, len(stream), size):
        found += framer.feed(stream[at : at + size])
    found += framer.silence()
    assert [frame.pdu for frame in found] == pdus


@given(garbage=st.binary(max_size=60), pdu=REQUEST_PDUS)
def test_a_good_rtu_frame_after_garbage_is_found_once_the_line_is_silent(garbage, pdu):
    framer = RtuFramer(1)
    found = framer.feed(garbage + rtu_frame(1, pdu)) + framer.silence()
    assert ModbusFrame(1, 0, pdu) in found
    assert framer.pending == 0


def test_a_frame_with_a_wrong_crc_or_for_another_unit_is_passed_over():
    framer = RtuFramer(1)
    good = rtu_frame(1, b"\3\0\0\0\1")
    assert framer.feed(good[:-1] + bytes((good[-1] ^ 1,)) + rtu_frame(2, b"\3\0\0\0\1")) == []
    assert framer.silence() == []
    assert framer.feed(good) == [ModbusFrame(1, 0, b"\3\0\0\0\1")]
    assert framer.feed(rtu_frame(0, b"\6\0\0\0\1")) == [ModbusFrame(0, 0, b"\6\0\0\0\1")]


@given(data=st.lists(st.binary(max_size=300), max_size=20))
def test_a_line_of_garbage_is_never_held_without_bound(data):
    framer = RtuFramer(1)
    for chunk in data:
        framer.feed(chunk)
        assert framer.pending <= 1000
