"""Are the packets of the camera in software what GVSP says, and do its faults do what they say?"""

import struct

import numpy as np
import pytest

from slabcell_drivers.simulation.gige import CheckedPattern, FaultError, Faults
from slabcell_drivers.simulation.gige.gvsp import (
    OVERHEAD_BYTES,
    FrameHead,
    FramePackets,
    next_block,
    probe_packet,
    unavailable_packet,
)

pytestmark = pytest.mark.unit

HEAD = FrameHead(block=0xABCD, timestamp_ns=123_456_789_012, format_code=0x0108_0001, width=100, height=50)


def test_a_frame_is_a_leader_payload_and_a_trailer():
    data = np.arange(5000, dtype=np.uint32).astype(np.uint8)
    packets = [bytes(packet) for packet in FramePackets(HEAD, data, 1500)]
    kinds = [packet[4] for packet in packets]
    assert kinds == [1, *[3] * 4, 2]
    assert [int.from_bytes(packet[5:8], "big") for packet in packets] == list(range(6))
    assert all(packet[2:4] == b"\xab\xcd" for packet in packets)
    assert b"".join(packet[8:] for packet in packets[1:-1]) == data.tobytes()
    assert len(packets[1]) == 1500 - OVERHEAD_BYTES + 8
    payload_type, stamp, code, width, height = struct.unpack(">xxHQIII", packets[0][8:32])
    assert (payload_type, stamp, code, width, height) == (1, 123_456_789_012, 0x0108_0001, 100, 50)
    assert struct.unpack(">xxHI", packets[-1][8:]) == (1, 50)


@pytest.mark.parametrize("count", [1, 1464, 1465, 2928])
def test_the_last_packet_is_as_short_as_the_rest_of_the_data(count: int):
    data = np.full(count, 7, np.uint8)
    packets = FramePackets(HEAD, data, 1500)
    assert sum(len(packet) - 8 for packet in list(packets)[1:-1]) == count


def test_memory_taken_over_from_an_older_frame_holds_only_the_new_one():
    old = FramePackets(HEAD, np.full(5000, 1, np.uint8), 1500)
    new = FramePackets(FrameHead(2, 0, 0x0108_0001, 100, 50), np.full(5000, 2, np.uint8), 1500, old)
    assert {bytes(packet[2:4]) for packet in new} == {b"\0\x02"}
    assert {value for packet in list(new)[1:-1] for value in packet[8:]} == {2}


def test_block_ids_go_from_65535_to_1():
    assert [next_block(65_534), next_block(65_535), next_block(1)] == [65_535, 1, 2]


def test_a_test_packet_fills_the_packet_size_less_ip_and_udp():
    assert len(probe_packet(8000)) == 8000 - 28


def test_a_packet_that_is_gone_is_answered_with_its_status():
    assert struct.unpack(">HH", unavailable_packet(9, 4)[:4]) == (0x800C, 9)


def test_the_pattern_knows_its_own_number_and_sees_one_wrong_byte():
    pattern = CheckedPattern(64, 16)
    picture = pattern(300)
    assert pattern.number_of(picture) == 300
    picture[7, 7] ^= 1
    assert pattern.number_of(picture) is None


def test_the_pattern_sees_a_packet_left_over_from_the_frame_before():
    pattern = CheckedPattern(64, 16)
    picture = pattern(8)
    picture[10, :32] = pattern(7)[10, :32]
    assert pattern.number_of(picture) is None


def test_fault_verbs_switch_count_and_end():
    faults = Faults()
    for line in ("drop 2", "truncate 1", "size 3", "dark on", "loss 0.5", "late 0.2", "reset-ids"):
        faults.apply(line)
    hits = [faults.begin_frame() for _ in range(4)]
    assert [hit.dropped for hit in hits] == [False, True, False, False]
    assert [hit.truncated for hit in hits] == [True, False, False, False]
    assert [hit.half_height for hit in hits] == [False, False, True, False]
    assert faults.is_on("dark")
    assert (faults.take_next_block(), faults.take_next_block()) == (1, None)
    assert 300 < sum(faults.lose() for _ in range(1000)) < 700
    faults.apply("mend")
    assert not faults.is_on("dark")
    assert not any(faults.lose() for _ in range(100))


@pytest.mark.parametrize("line", ["", "explode", "loss", "loss 2", "loss x", "dark maybe", "drop 0", "reset-ids 70000"])
def test_a_fault_verb_that_is_not_understood_shows_how_it_is_written(line: str):
    with pytest.raises(FaultError, match=r"not known|write "):
        Faults().apply(line)
