"""Does the camera in software send the frame that it was asked for, and only that?"""

import socket

import numpy as np
import pytest

from slabcell_drivers.camera.pixel_formats import PIXEL_FORMATS
from slabcell_drivers.simulation.gige import Faults
from slabcell_drivers.simulation.gige.control import ResendWanted
from slabcell_drivers.simulation.gige.registers import StreamSettings
from slabcell_drivers.simulation.gige.sensor import Sensor
from slabcell_drivers.simulation.gige.stream import Streamer

pytestmark = pytest.mark.integration

PACKETS = 3  # leader, one of pixels, trailer


def test_a_packet_is_sent_again_from_the_present_acquisition_not_from_an_old_frame_of_the_same_id(
    address: str,
) -> None:
    faults = Faults()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.bind((address, 0))
        client.settimeout(10.0)
        settings = StreamSettings(
            width=16, height=4, offset_x=0, offset_y=0, pixel_format=PIXEL_FORMATS["Mono8"], exposure_us=5000.0,
            gain_db=0.0, triggered=True, frame_rate_hz=10.0, single=False, destination=client.getsockname(),
            packet_size=576, packet_delay_ns=0,
        )  # fmt: skip
        sensor = Sensor(lambda number: np.full((4, 16), number, np.uint8), faults)
        streamer = Streamer(sensor, lambda: settings, faults, address)
        try:
            for acquisition in (1, 2):
                streamer.start()
                streamer.trigger()
                frame = [client.recv(1000) for _ in range(PACKETS)]
                assert {packet[2:4] for packet in frame} == {b"\0\1"}  # the ids begin at 1 each time
                assert set(frame[1][8:]) == {acquisition}
            streamer.resend(ResendWanted(block=1, first=1, last=1))
            assert set(client.recv(1000)[8:]) == {2}
        finally:
            streamer.close()
