"""Does the camera in software keep to GigE Vision on its control channel?  Pure: datagrams in, datagrams out."""

import struct
from ipaddress import IPv4Address
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slabcell_drivers.camera.gvcp import (
    Command,
    Device,
    GvcpError,
    Register,
    Request,
    Status,
    decode_answer,
    decode_device,
    decode_request,
    encode_device,
    encode_force_ip,
    encode_request,
)
from slabcell_drivers.simulation.gige.control import Action, AddressForced, Control, ResendWanted
from slabcell_drivers.simulation.gige.features import Place, SensorLimits

pytestmark = pytest.mark.unit

CLIENT, OTHER = ("127.0.0.1", 50_000), ("127.0.0.1", 50_001)
DEVICE = Device("vendor", "model", "S-1", IPv4Address("127.0.0.9"), bytes.fromhex("020000000009"), "top", "1.0")


class Client:
    def __init__(self, control: Control, address: tuple[str, int] = CLIENT) -> None:
        self.control, self.address, self.now_s = control, address, 0.0

    def ask(self, command: int, body: bytes = b"", *, broadcast: bool = False):
        request = encode_request(Request(command, 7, body))
        reaction = self.control.handle(request, self.address, self.now_s, broadcast=broadcast)
        assert reaction.answer is not None
        answer = decode_answer(reaction.answer)
        assert answer.number == 7
        assert answer.command == command + 1
        return answer, reaction.effects

    def write(self, address: int, value: int):
        answer, effects = self.ask(Command.WRITE_REGISTER, struct.pack(">II", address, value))
        return Status(answer.status), effects

    def read(self, address: int) -> int:
        answer, _ = self.ask(Command.READ_REGISTER, struct.pack(">I", address))
        assert answer.status == Status.SUCCESS
        return int.from_bytes(answer.body, "big")


@pytest.fixture
def control() -> Control:
    return Control(DEVICE, SensorLimits())


@pytest.fixture
def client(control: Control) -> Client:
    found = Client(control)
    assert found.write(Register.CONTROL_PRIVILEGE, 2)[0] is Status.SUCCESS
    return found


def test_discovery_tells_who_the_camera_is(control: Control):
    answer, _ = Client(control).ask(Command.DISCOVERY, broadcast=True)
    assert decode_device(answer.body) == DEVICE


def test_a_device_survives_its_own_encoding():
    assert decode_device(encode_device(DEVICE)) == DEVICE


def test_the_first_url_leads_to_an_xml_that_lists_every_feature_it_describes(control: Control):
    client = Client(control)
    answer, _ = client.ask(Command.READ_MEMORY, struct.pack(">IxxH", Register.FIRST_URL, 512))
    place, size = answer.body[4:].split(b"\0")[0].split(b";")[1:]
    address, left, xml = int(place, 16), int(size, 16), b""
    while left > 0:
        count = min(512, left)
        answer, _ = client.ask(Command.READ_MEMORY, struct.pack(">IxxH", address + len(xml), (count + 3) // 4 * 4))
        assert answer.status == Status.SUCCESS
        xml += answer.body[4 : 4 + count]
        left -= count
    root = ElementTree.fromstring(xml)  # noqa: S314 - our own camera wrote it
    names = {node.get("Name") for node in root}
    listed = {node.text for node in root.iter("{http://www.genicam.org/GenApi/Version_1_1}pFeature")}
    assert listed <= names
    assert {"Width", "PixelFormat", "TriggerSoftware", "ExposureTime", "GevSCPSPacketSize"} <= listed


def test_only_the_client_in_control_may_write(client: Client, control: Control):
    other = Client(control, OTHER)
    assert other.write(Place.WIDTH, 640)[0] is Status.ACCESS_DENIED
    assert other.write(Register.CONTROL_PRIVILEGE, 2)[0] is Status.ACCESS_DENIED
    assert other.read(Place.WIDTH) == 1920
    assert client.write(Place.WIDTH, 640)[0] is Status.SUCCESS
    assert client.read(Place.WIDTH) == 640


def test_exclusive_control_keeps_others_from_reading_too(control: Control):
    client, other = Client(control), Client(control, OTHER)
    client.write(Register.CONTROL_PRIVILEGE, 1)
    answer, _ = other.ask(Command.READ_REGISTER, struct.pack(">I", Place.WIDTH))
    assert answer.status == Status.ACCESS_DENIED


def test_a_silent_client_loses_control_after_the_heartbeat_timeout_and_the_stream_ends(
    client: Client, control: Control
):
    client.write(Register.HEARTBEAT_TIMEOUT, 1000)
    client.write(Register.STREAM_PORT, 6000)
    client.write(Place.ACQUISITION_START, 1)
    assert not control.expire(0.99)
    assert control.streaming
    assert control.expire(1.0)
    assert control.controller is None
    assert not control.streaming
    assert Client(control, OTHER).write(Register.CONTROL_PRIVILEGE, 2)[0] is Status.SUCCESS


def test_any_request_of_the_client_keeps_its_control_alive(client: Client, control: Control):
    for second in range(1, 10):
        client.now_s = second * 2.9
        client.read(Register.CONTROL_PRIVILEGE)
    assert control.controller == CLIENT


@pytest.mark.parametrize(
    ("address", "value", "status"),
    [
        (Place.WIDTH, 642, Status.INVALID_PARAMETER),  # not a multiple of 4
        (Place.WIDTH, 1924, Status.INVALID_PARAMETER),
        (Place.OFFSET_X, 4, Status.INVALID_PARAMETER),  # the picture would leave the sensor
        (Place.PIXEL_FORMAT, 0x0108_00FF, Status.INVALID_PARAMETER),
        (Place.EXPOSURE_TIME, struct.unpack(">I", struct.pack(">f", 2e6))[0], Status.INVALID_PARAMETER),
        (Register.STREAM_PACKET_SIZE, 100, Status.INVALID_PARAMETER),
        (Place.SENSOR_WIDTH, 1, Status.WRITE_PROTECT),
        (0x00F0_0000, 1, Status.INVALID_ADDRESS),
        (Place.WIDTH + 2, 1, Status.BAD_ALIGNMENT),
    ],
)
def test_what_a_register_does_not_take_is_refused(client: Client, address: int, value: int, status: Status):
    assert client.write(address, value)[0] is status


def test_size_and_format_cannot_change_while_streaming(client: Client):
    client.write(Register.STREAM_PORT, 6000)
    assert client.write(Place.ACQUISITION_START, 1) == (Status.SUCCESS, (Action.START,))
    assert client.write(Place.WIDTH, 640)[0] is Status.BUSY
    assert client.write(Place.ACQUISITION_STOP, 1) == (Status.SUCCESS, (Action.STOP,))
    assert client.write(Place.WIDTH, 640)[0] is Status.SUCCESS


def test_the_payload_size_follows_size_and_format(client: Client):
    client.write(Place.WIDTH, 640)
    client.write(Place.HEIGHT, 480)
    client.write(Place.PIXEL_FORMAT, 0x010C_0047)
    assert client.read(Place.PAYLOAD_SIZE) == 640 * 480 * 3 // 2


def test_trigger_resend_and_test_packet_are_passed_on(client: Client, control: Control):
    assert client.write(Place.TRIGGER_SOFTWARE, 1)[1] == (Action.TRIGGER,)
    assert client.write(Register.STREAM_PACKET_SIZE, 0x8000_0000 | 8000)[1] == (Action.TEST_PACKET,)
    assert client.read(Register.STREAM_PACKET_SIZE) == 8000
    resend = encode_request(Request(Command.PACKET_RESEND, 1, struct.pack(">HHII", 0, 9, 3, 5), flags=0))
    assert control.handle(resend, CLIENT, 0.0).effects == (ResendWanted(9, 3, 5),)
    assert control.handle(resend, (CLIENT[0], 50_002), 0.0).effects == (ResendWanted(9, 3, 5),)  # its stream's socket
    assert control.handle(resend, ("127.0.0.2", 50_000), 0.0).effects == ()


def test_force_ip_moves_only_the_camera_that_is_meant(control: Control):
    place = (IPv4Address("127.0.0.20"), IPv4Address("255.0.0.0"), IPv4Address(0))
    _, effects = Client(control).ask(Command.FORCE_IP, encode_force_ip(DEVICE.mac, *place), broadcast=True)
    assert effects == (AddressForced(*place),)
    other = encode_request(Request(Command.FORCE_IP, 1, encode_force_ip(b"\0" * 6, *place)))
    assert control.handle(other, CLIENT, 0.0, broadcast=True).answer is None


def test_force_ip_of_a_camera_in_use_is_denied(client: Client):
    place = (IPv4Address("127.0.0.20"), IPv4Address("255.0.0.0"), IPv4Address(0))
    answer, effects = client.ask(Command.FORCE_IP, encode_force_ip(DEVICE.mac, *place), broadcast=True)
    assert answer.status == Status.ACCESS_DENIED
    assert effects == ()


def test_an_unknown_command_is_answered_as_not_implemented(control: Control):
    answer, _ = Client(control).ask(0x00C0)
    assert answer.status == Status.NOT_IMPLEMENTED


def test_the_device_clock_counts_nanoseconds(control: Control):
    client = Client(control)
    client.now_s = 2.5
    answer, _ = client.ask(Command.READ_MEMORY, struct.pack(">IxxH", Register.TIMESTAMP_HIGH, 8))
    assert int.from_bytes(answer.body[4:], "big") == 2_500_000_000


@settings(deadline=None)
@given(st.binary(max_size=600))
def test_no_datagram_breaks_the_camera(datagram: bytes):
    Control(DEVICE, SensorLimits()).handle(datagram, CLIENT, 0.0)


@settings(deadline=None)
@given(st.sampled_from(list(Command)), st.binary(max_size=560))
def test_no_body_of_a_known_command_breaks_the_camera(command: Command, body: bytes):
    control = Control(DEVICE, SensorLimits())
    Client(control).write(Register.CONTROL_PRIVILEGE, 2)
    control.handle(encode_request(Request(command, 1, body)), CLIENT, 0.0)
    assert control.settings.width > 0


@settings(deadline=None)
@given(st.binary(max_size=64))
def test_what_is_not_a_request_is_named(datagram: bytes):
    try:
        request = decode_request(datagram)
    except GvcpError:
        assert len(datagram) < 8 or datagram[0] != 0x42 or len(datagram) < 8 + int.from_bytes(datagram[4:6], "big")
    else:
        assert encode_request(request) == datagram[: 8 + len(request.body)]
