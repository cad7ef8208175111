import random
import socket
import threading

import pytest

from slabcell_drivers.krc.eki import EkiEvent, EthernetKrl
from slabcell_drivers.krc.eki_channel import Segmentation, WireOptions
from slabcell_drivers.krc.eki_config import ElementType
from slabcell_drivers.krc.eki_messages import EkiMessage
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.integration

CLIENT = b"""<ETHERNETKRL>
 <CONFIGURATION>
  <EXTERNAL><IP>127.0.0.1</IP><PORT>1</PORT><TYPE>Server</TYPE></EXTERNAL>
  <INTERNAL>
   <BUFFERING Mode="FIFO" Limit="3"/><TIMEOUT Connect="2000"/><ALIVE Set_Flag="997"/>
  </INTERNAL>
 </CONFIGURATION>
 <RECEIVE><XML>
  <ELEMENT Tag="Vis/Head/@Seq" Type="INT"/>
  <ELEMENT Tag="Vis/Pick/@X" Type="REAL"/><ELEMENT Tag="Vis/Pick/@Y" Type="REAL"/>
  <ELEMENT Tag="Vis/Pick/@Z" Type="REAL"/><ELEMENT Tag="Vis/Pick/@A" Type="REAL"/>
  <ELEMENT Tag="Vis/Pick/@B" Type="REAL"/><ELEMENT Tag="Vis/Pick/@C" Type="REAL"/>
  <ELEMENT Tag="Vis/Ok" Type="BOOL" Set_Flag="10"/>
  <ELEMENT Tag="Vis/Msg" Type="STRING"/>
  <ELEMENT Tag="Vis" Set_Flag="998"/>
  <ELEMENT Tag="VisHb" Set_Flag="996"/>
 </XML></RECEIVE>
 <SEND><XML>
  <ELEMENT Tag="Robot/Head/@Seq"/><ELEMENT Tag="Robot/Head/@Type"/>
  <ELEMENT Tag="Robot/Pose/@X"/><ELEMENT Tag="Robot/Pose/@Y"/><ELEMENT Tag="Robot/Pose/@Z"/>
  <ELEMENT Tag="Robot/Pose/@A"/><ELEMENT Tag="Robot/Pose/@B"/><ELEMENT Tag="Robot/Pose/@C"/>
  <ELEMENT Tag="Robot/Text"/>
 </XML></SEND>
</ETHERNETKRL>"""
SERVER = CLIENT.replace(b"<TYPE>Server<", b"<TYPE>Client<")
ANSWER = (
    b'<Vis><Head Seq="7"></Head><Pick X="1.5" Y="-2" Z="1e1" A="0" B="0" C="180"></Pick>'
    b"<Ok>1</Ok><Msg>hello &amp; good</Msg></Vis>"
)


class Controller:
    """The emulation with the flags it sets and the notices it gives."""

    def __init__(self, config: bytes, address: tuple[str, int], *, wire: WireOptions | None = None) -> None:
        self.flags: dict[int, bool] = {}
        self.notices: list[str] = []
        self.now = 0.0
        self.eki = EthernetKrl(
            {"Vision": config},
            set_flag=self.flags.__setitem__,
            set_out=self.flags.__setitem__,
            addresses={"Vision": address},
            rng=random.Random(3),
            wire=wire,
            on_notice=lambda _, text: self.notices.append(text),
            clock=lambda: self.now,
        )

    def poll_until(self, flag: int, value: bool = True) -> None:
        for _ in range(200):
            if self.flags.get(flag, False) is value:
                return
            self.eki.poll(0.05)
        pytest.fail(f"flag {flag} did not become {value}; notices: {self.notices}")


@pytest.fixture
def listener():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        yield server


@pytest.fixture
def linked(listener):
    """A controller that is connected as a client, and the peer's socket."""
    controller = Controller(CLIENT, listener.getsockname())
    controller.eki.init("Vision")
    assert controller.eki.open("vision").connected
    peer, _ = listener.accept()
    peer.settimeout(5.0)
    with peer:
        yield controller, peer
    controller.eki.close_all()


def test_a_client_sends_and_receives_one_telegram(linked) -> None:
    controller, peer = linked
    eki = controller.eki
    eki.set_value("Vision", "Robot/Head/@Seq", 7)
    eki.set_value("Vision", "Robot/Pose", Frame(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    eki.set_value("Vision", "Robot/Text", "a<b")
    assert eki.send("Vision", "Robot").msg_no == 0
    assert peer.recv(4096) == (
        b'<Robot><Head Seq="7"></Head><Pose X="1.000000" Y="2.000000" Z="3.000000" A="4.000000" B="5.000000" '
        b'C="6.000000"></Pose><Text>a&lt;b</Text></Robot>'
    )
    peer.sendall(ANSWER)
    controller.poll_until(998)
    assert controller.flags == {997: True, 10: True, 998: True}
    assert eki.check_buffer("Vision", "Vis/Head/@Seq").buff == 1
    status, value = eki.get_value("Vision", "Vis/Head/@Seq", ElementType.INT)
    assert (value, status.read, status.buff, status.counter) == (7, 1, 0, 1)
    assert eki.get_value("Vision", "Vis/Pick", ElementType.FRAME)[1] == Frame(1.5, -2.0, 10.0, 0.0, 0.0, 180.0)
    assert eki.get_value("Vision", "Vis/Ok", ElementType.BOOL)[1] is True
    assert eki.get_value("Vision", "Vis/Msg", ElementType.STRING)[1] == "hello & good"


def test_values_persist_between_sends_and_a_partial_path_is_wrapped_in_its_ancestors(linked) -> None:
    controller, peer = linked
    controller.eki.set_value("Vision", "Robot/Head/@Seq", 1)
    controller.eki.send("Vision", "Robot/Head")
    assert peer.recv(4096) == b'<Robot><Head Seq="1"></Head></Robot>'
    controller.eki.set_value("Vision", "Robot/Head/@Type", 5)
    controller.eki.send("Vision", "Robot/Head")
    assert peer.recv(4096) == b'<Robot><Head Seq="1" Type="5"></Head></Robot>'


def test_what_was_never_set_is_an_empty_element_or_left_out(linked) -> None:
    controller, peer = linked
    controller.eki.send("Vision", "Robot")
    assert peer.recv(4096) == b"<Robot><Text></Text></Robot>"


def test_text_that_is_no_path_goes_out_as_it_is_up_to_a_nul_or_a_length(linked) -> None:
    controller, peer = linked
    controller.eki.send("Vision", "<Robot><Hb></Hb></Robot>\0rest")
    assert peer.recv(4096) == b"<Robot><Hb></Hb></Robot>"
    controller.eki.send("Vision", "abcdef", 3)
    assert peer.recv(4096) == b"abc"
    assert controller.eki.send("Vision", "").msg_no == EkiMessage.NOTHING_TO_SEND


def test_a_flag_is_never_reset_and_an_event_only_element_keeps_nothing(linked) -> None:
    controller, peer = linked
    for _ in range(20):  # far more than the limit of a memory
        peer.sendall(b"<VisHb></VisHb>\n")
    controller.poll_until(996)
    controller.eki.poll(0.05)
    assert controller.flags[996]
    assert controller.flags[997]
    controller.flags[996] = False
    peer.sendall(b"<VisHb/>")
    controller.poll_until(996)
    assert controller.eki.check_buffer("Vision", "VisHb").buff == 0


def test_a_telegram_may_come_in_pieces_and_several_in_one(linked) -> None:
    controller, peer = linked
    for piece in (ANSWER[:30], ANSWER[30:31], ANSWER[31:] + b"\0\0\n" + ANSWER):
        peer.sendall(piece)
        controller.eki.poll(0.2)
    controller.poll_until(998)
    assert controller.eki.check_buffer("Vision", "Vis/Head/@Seq").buff == 2
    _, values = controller.eki.get_array("Vision", "Vis/Head/@Seq", ElementType.INT, 5)
    assert values == [7, 7]


def test_overflow_of_a_memory_closes_the_connection_and_keeps_one_more(linked) -> None:
    controller, peer = linked
    peer.sendall(ANSWER * 5)
    controller.poll_until(997, value=False)
    assert peer.recv(100) == b""
    status = controller.eki.check_buffer("Vision", "Vis/Head/@Seq")
    assert (status.buff, status.connected) == (4, False)
    number, text = controller.eki.check(status, "Vision")
    assert (number, text) == (EkiMessage.MEMORY_LIMIT, "EKI01792 Limit of element memory reached")
    assert controller.eki.check(status, "Vision") is None
    assert controller.eki.get_value("Vision", "Vis/Head/@Seq", ElementType.INT)[1] == 7
    assert controller.eki.send("Vision", "Robot").msg_no == EkiMessage.DISCONNECTED


def test_get_on_an_empty_memory_of_a_wrong_type_or_an_unknown_path_says_so(linked) -> None:
    controller, peer = linked
    numbers = [
        controller.eki.get_value("Vision", path, kind)[0].msg_no
        for path, kind in (
            ("Vis/Head/@Seq", ElementType.INT),
            ("Vis/Head/@Seq", ElementType.REAL),
            ("Vis/Nothing", ElementType.INT),
            ("Vis/Pick", ElementType.FRAME),
            ("Vis", ElementType.INT),
        )
    ]
    assert numbers == [15, 20, 16, 15, 20]
    assert controller.eki.set_value("Vision", "Robot/Nothing", 1).msg_no == EkiMessage.ELEMENT_NOT_FOUND
    assert controller.eki.clear_buffer("Vision", "Robot").msg_no == EkiMessage.ELEMENT_NOT_FOUND
    assert peer.fileno() >= 0


def test_a_missing_element_shifts_its_memory_against_the_others(linked) -> None:
    controller, peer = linked
    peer.sendall(b'<Vis><Head Seq="1"/></Vis><Vis><Head Seq="2"/><Ok>0</Ok></Vis>')
    controller.poll_until(10)
    controller.eki.poll(0.05)
    seq, _ = controller.eki.get_value("Vision", "Vis/Head/@Seq", ElementType.INT)
    ok, _ = controller.eki.get_value("Vision", "Vis/Ok", ElementType.BOOL)
    assert (seq.counter, ok.counter) == (1, 2)


def test_clear_buffer_of_the_root_empties_everything_below(linked) -> None:
    controller, peer = linked
    peer.sendall(ANSWER)
    controller.poll_until(998)
    assert controller.eki.clear_buffer("Vision", "Vis").msg_no == 0
    assert controller.eki.get_value("Vision", "Vis/Msg", ElementType.STRING)[0].msg_no == EkiMessage.EMPTY_MEMORY


def test_while_locked_what_arrives_stays_out_of_the_memories(linked) -> None:
    controller, peer = linked
    controller.eki.lock("Vision")
    peer.sendall(ANSWER)
    controller.eki.poll(0.5)
    assert not controller.flags.get(998, False)
    controller.eki.unlock("Vision")
    assert controller.flags[998]


def test_more_bytes_than_buffsize_while_locked_close_the_connection(listener) -> None:
    config = CLIENT.replace(b"<BUFFERING", b'<BUFFSIZE Limit="300"/><BUFFERING')
    controller = Controller(config, listener.getsockname())
    controller.eki.init("Vision")
    controller.eki.open("Vision")
    peer, _ = listener.accept()
    with peer:
        controller.eki.lock("Vision")
        peer.sendall(ANSWER * 3)
        controller.poll_until(997, value=False)
    assert controller.eki.check(controller.eki.check_buffer("Vision", "Vis"), "Vision")[0] == EkiMessage.BUFFER_LIMIT
    controller.eki.close_all()


@pytest.mark.parametrize(
    "garbage",
    [
        b"\xff\xfe garbage <",
        b"<Vis><Head></Vis>",
        b'<!DOCTYPE x [<!ENTITY a "b">]><Vis>&a;</Vis>',
        b"</Vis>",
        b"<Vis>&unknown;</Vis>",
        b"no xml at all ",
    ],
)
def test_garbage_is_reported_and_the_next_good_telegram_is_read(linked, garbage: bytes) -> None:
    controller, peer = linked
    peer.sendall(garbage)
    controller.eki.poll(0.2)
    peer.sendall(ANSWER + ANSWER)
    controller.poll_until(998)
    assert controller.eki.check_buffer("Vision", "Vis/Head/@Seq").buff >= 1
    assert controller.eki.check(controller.eki.check_buffer("Vision", "Vis"), "Vision")[0] == 1024


@pytest.mark.parametrize("bad", [b'Seq="x"', b'Seq="99999999999"', b'Seq="1.5"', b'Seq=""'])
def test_a_value_that_is_not_of_its_type_is_dropped_and_reported(linked, bad: bytes) -> None:
    controller, peer = linked
    peer.sendall(b"<Vis><Head " + bad + b"/></Vis>")
    controller.poll_until(998)
    assert controller.eki.check_buffer("Vision", "Vis/Head/@Seq").buff == 0
    assert controller.eki.check(controller.eki.check_buffer("Vision", "Vis"), "Vision")[0] == 1024


def test_elements_that_are_not_configured_are_noted(linked) -> None:
    controller, peer = linked
    peer.sendall(b"<Vis><New>1</New></Vis>")
    controller.poll_until(998)
    assert controller.notices == ["received but not configured: Vis/New"]


def test_the_peer_closing_resets_the_alive_flag_and_only_open_restores(linked, listener) -> None:
    controller, peer = linked
    peer.close()
    controller.poll_until(997, value=False)
    assert controller.eki.check(controller.eki.check_buffer("Vision", "Vis"), "Vision")[0] == 512
    assert controller.eki.open("Vision").connected
    assert controller.flags[997]


def test_init_twice_unknown_channels_and_a_bad_file_have_their_numbers(listener) -> None:
    controller = Controller(CLIENT, listener.getsockname())
    eki = controller.eki
    assert eki.open("Vision").msg_no == EkiMessage.CONNECTION_NOT_AVAILABLE
    assert eki.init("Other").msg_no == EkiMessage.FILE_ACCESS_FAILED
    assert eki.init("Vision").msg_no == 0
    assert eki.init("Vision").msg_no == EkiMessage.ALREADY_INITIALIZED
    assert eki.clear("Vision").msg_no == 0
    assert eki.clear("Vision").msg_no == EkiMessage.CONNECTION_NOT_AVAILABLE
    bad = Controller(b"<ETHERNETKRL/>", listener.getsockname())
    assert bad.eki.init("Vision").msg_no == EkiMessage.CONFIGURATION_INVALID
    assert "IP and PORT of the external system are needed" in bad.notices[0]


def test_nobody_listening_is_reported_by_open() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()
    controller = Controller(CLIENT, address)
    controller.eki.init("Vision")
    assert controller.eki.open("Vision").msg_no == EkiMessage.NOT_ESTABLISHED


def test_a_server_serves_one_client_and_listens_again_only_after_open() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = free.getsockname()
    controller = Controller(SERVER, address)
    controller.eki.init("Vision")
    status = controller.eki.open("Vision")
    assert (status.msg_no, status.connected) == (0, False)
    with socket.create_connection(address, 5.0) as peer:
        controller.poll_until(997)
        with socket.create_connection(address, 5.0) as second:
            controller.eki.poll(0.2)
            assert second.recv(10) == b""
        peer.sendall(ANSWER)
        controller.poll_until(998)
        controller.eki.send("Vision", "Robot")
        assert peer.recv(100).startswith(b"<Robot>")
    controller.poll_until(997, value=False)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(address, 5.0)
    assert controller.eki.open("Vision").msg_no == 0
    with socket.create_connection(address, 5.0):
        controller.poll_until(997)
    controller.eki.close_all()


def test_a_server_gives_up_after_its_time_limit() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = free.getsockname()
    controller = Controller(SERVER, address)
    controller.eki.init("Vision")
    controller.eki.open("Vision")
    controller.eki.poll()
    controller.now = 2.5
    controller.eki.poll()
    assert controller.eki.check(controller.eki.check_buffer("Vision", "Vis"), "Vision")[0] == 2048
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(address, 5.0)


def test_attributes_are_shuffled_and_telegrams_cut_on_request(listener) -> None:
    wire = WireOptions(shuffle_attributes=True, segmentation=Segmentation.SPLIT)
    controller = Controller(CLIENT, listener.getsockname(), wire=wire)
    controller.eki.init("Vision")
    controller.eki.open("Vision")
    controller.eki.set_value("Vision", "Robot/Pose", Frame())
    peer, _ = listener.accept()
    with peer:
        seen = set()
        for _ in range(10):
            controller.eki.send("Vision", "Robot/Pose")
            received = b""
            while not received.endswith(b"</Robot>"):
                received += peer.recv(4096)
            seen.add(received)
    assert len(seen) > 1
    controller.eki.close_all()


def test_telegrams_are_sent_together_on_request(listener) -> None:
    controller = Controller(CLIENT, listener.getsockname(), wire=WireOptions(segmentation=Segmentation.MERGED))
    controller.eki.init("Vision")
    controller.eki.open("Vision")
    peer, _ = listener.accept()
    with peer:
        controller.eki.send("Vision", "<A></A>")
        controller.eki.send("Vision", "<B></B>")
        controller.eki.poll()
        assert peer.recv(4096) == b"<A></A><B></B>"
    controller.eki.close_all()


def test_a_program_reset_deletes_the_channels_of_its_environment(linked) -> None:
    controller, peer = linked
    controller.eki.end(EkiEvent.SUBMIT_CANCEL)
    assert controller.flags[997]
    controller.eki.end(EkiEvent.PROGRAM_RESET)
    assert not controller.flags[997]
    assert controller.eki.send("Vision", "Robot").msg_no == EkiMessage.CONNECTION_NOT_AVAILABLE
    assert peer.recv(10) == b""


def test_poll_wakes_as_soon_as_something_arrives(linked) -> None:
    controller, peer = linked
    timer = threading.Timer(0.05, lambda: peer.sendall(ANSWER))
    timer.start()
    assert controller.eki.poll(30.0)
    timer.join()
    assert controller.flags[998]
