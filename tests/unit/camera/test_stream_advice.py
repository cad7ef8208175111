"""Does a stream test say what to change, and nothing when all is well?"""

from dataclasses import replace

import pytest

from slabcell_drivers.camera.settings import CameraStatistics
from slabcell_drivers.camera.stream_test import NetworkPath, StreamReport, advise, advise_failure

pytestmark = pytest.mark.unit

GOOD = StreamReport(
    duration_s=10.0, triggers=400, frames=400, failed=0, frame_bytes=2_304_000, packet_size=8996, packet_delay_ns=0,
    latency_median_ms=7.0, latency_p99_ms=12.0, path=NetworkPath("eno1", 9000, 33_554_432),
    statistics=CameraStatistics(frames=400),
)  # fmt: skip


def only(report: StreamReport) -> str:
    (line,) = advise(report)
    return line


def test_a_good_stream_needs_no_advice_and_has_a_rate():
    assert advise(GOOD) == []
    assert abs(GOOD.megabytes_per_s - 92.16) < 0.01


def test_a_small_kernel_buffer_is_named_with_the_command_that_raises_it():
    report = replace(GOOD, path=replace(GOOD.path, rmem_max=212_992))
    assert "sysctl -w net.core.rmem_max=33554432" in only(report)


def test_a_small_mtu_is_named_with_the_command_that_raises_it():
    report = replace(GOOD, packet_size=1500, path=replace(GOOD.path, mtu=1500))
    assert "ip link set eno1 mtu 9000" in only(report)


def test_small_packets_on_a_large_mtu_are_named():
    assert "1500 bytes" in only(replace(GOOD, packet_size=1500))


@pytest.mark.parametrize(("delay_ns", "words"), [(0, "GevSCPD"), (20_000, "ethtool -S eno1")])
def test_lost_packets_ask_for_a_delay_first_and_for_the_cable_next(delay_ns: int, words: str):
    report = replace(GOOD, packet_delay_ns=delay_ns, failed=3, statistics=CameraStatistics(incomplete=5))
    assert words in only(report)


def test_resent_packets_and_missing_buffers_are_told():
    assert "7 packets had to be sent again" in only(replace(GOOD, statistics=CameraStatistics(packets_resent=7)))
    assert "2 frames found no buffer" in only(replace(GOOD, statistics=CameraStatistics(underruns=2)))


def test_when_nothing_arrives_firewall_and_packet_size_are_named():
    lines = advise_failure(9000, NetworkPath("eno1", 1500, 1))
    assert "firewall" in lines[0]
    assert "MTU 1500" in lines[1]
