"""The emulated controller over a faulty cable: what each end sees."""

import random
import socket

import pytest

from slabcell_drivers.krc.eki import EthernetKrl
from slabcell_drivers.krc.eki_config import ElementType
from slabcell_drivers.krc.eki_faults import Fault, LinkFaults, Way
from slabcell_drivers.krc.eki_messages import EkiMessage

pytestmark = pytest.mark.integration

CONFIG = b"""<ETHERNETKRL><CONFIGURATION>
  <EXTERNAL><IP>127.0.0.1</IP><PORT>1</PORT></EXTERNAL>
  <INTERNAL><ALIVE Set_Flag="997" Ping="5"/></INTERNAL>
 </CONFIGURATION>
 <RECEIVE><XML><ELEMENT Tag="Vis/Seq" Type="INT"/><ELEMENT Tag="Vis" Set_Flag="998"/></XML></RECEIVE>
 <SEND><XML><ELEMENT Tag="Robot/Seq"/></XML></SEND>
</ETHERNETKRL>"""


class Cell:
    """An emulated controller that is connected over a cable, and the peer."""

    def __init__(self, listener: socket.socket) -> None:
        self.now = 0.0
        self.flags: dict[int, bool] = {}
        self.cable = LinkFaults(random.Random(1), clock=lambda: self.now)
        self.listener = listener
        self.eki = EthernetKrl(
            {"V": CONFIG},
            set_flag=self.flags.__setitem__,
            set_out=self.flags.__setitem__,
            addresses={"V": listener.getsockname()},
            rng=random.Random(2),
            link=self.cable,
            clock=lambda: self.now,
        )
        self.eki.init("V")
        self.peer = self.connect()

    def connect(self) -> socket.socket:
        assert self.eki.open("V").connected
        peer, _ = self.listener.accept()
        peer.settimeout(5.0)
        return peer

    def send(self, seq: int) -> bytes:
        self.eki.set_value("V", "Robot/Seq", seq)
        assert self.eki.send("V", "Robot").msg_no == 0
        return f"<Robot><Seq>{seq}</Seq></Robot>".encode()

    def receive(self, *, polls: int = 3) -> list[object]:
        """Return the values that have come after a few polls."""
        for _ in range(polls):
            self.eki.poll(0.02)
        return self.eki.get_array("V", "Vis/Seq", ElementType.INT, 100)[1]

    def nothing_arrives_at_the_peer(self) -> bool:
        self.peer.settimeout(0.02)
        try:
            self.peer.recv(100)
        except TimeoutError:
            return True
        finally:
            self.peer.settimeout(5.0)
        return False


@pytest.fixture
def cell():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(5.0)
        made = Cell(listener)
        yield made
        made.eki.close_all()
        made.cable.close()
        made.peer.close()


def test_a_sound_cable_changes_nothing(cell) -> None:
    telegram = cell.send(1)
    assert cell.peer.recv(100) == telegram
    cell.peer.sendall(b"<Vis><Seq>1</Seq></Vis>")
    assert cell.receive() == [1]
    assert (cell.cable.passed(Way.SENT), cell.cable.passed(Way.RECEIVED)) == (1, 1)


def test_a_duplicate_comes_twice_in_either_direction(cell) -> None:
    cell.cable.plan(Way.SENT, Fault.DUPLICATE)
    cell.cable.plan(Way.RECEIVED, Fault.DUPLICATE)
    telegram = cell.send(1)
    received = b""
    while len(received) < 2 * len(telegram):
        received += cell.peer.recv(100)
    assert received == telegram * 2
    cell.peer.sendall(b"<Vis><Seq>4</Seq></Vis>")
    assert cell.receive() == [4, 4]


def test_a_delay_holds_back_what_follows_too(cell) -> None:
    cell.cable.plan(Way.SENT, Fault.DELAY, after=1)
    sent = [cell.send(seq) for seq in (1, 2, 3)]
    assert cell.peer.recv(1000) == sent[0]
    assert cell.nothing_arrives_at_the_peer()
    cell.now = 0.6
    cell.eki.poll()
    assert cell.peer.recv(1000) == sent[1] + sent[2]


def test_a_dropped_telegram_never_comes(cell) -> None:
    cell.cable.plan(Way.RECEIVED, Fault.DROP)
    cell.peer.sendall(b"<Vis><Seq>1</Seq></Vis>")
    assert cell.receive() == []
    cell.peer.sendall(b"<Vis><Seq>2</Seq></Vis>")
    assert cell.receive() == [2]


def test_a_split_telegram_is_read_whole(cell) -> None:
    cell.cable.plan(Way.RECEIVED, Fault.SPLIT)
    cell.peer.sendall(b"<Vis><Seq>1</Seq></Vis>")
    assert cell.receive() == [1]


def test_a_garbled_telegram_arrives_changed(cell) -> None:
    cell.cable.plan(Way.SENT, Fault.GARBLE)
    telegram = cell.send(1)
    received = cell.peer.recv(100)
    assert len(received) == len(telegram)
    assert received != telegram


@pytest.mark.parametrize(
    ("fault", "arrives"), [(Fault.BREAK_BEFORE, 0), (Fault.BREAK_INSIDE, 0.5), (Fault.BREAK_AFTER, 1)]
)
def test_a_connection_breaks_before_inside_or_after_a_telegram(cell, fault: Fault, arrives: float) -> None:
    cell.cable.plan(Way.SENT, fault)
    cell.eki.set_value("V", "Robot/Seq", 1)
    assert cell.eki.send("V", "Robot").msg_no == EkiMessage.SEND_FAILED
    assert not cell.flags[997]
    received = b""
    while piece := cell.peer.recv(100):
        received += piece
    assert len(received) == int(len(b"<Robot><Seq>1</Seq></Robot>") * arrives)


def test_over_a_cut_cable_nothing_passes_until_ping_notices_and_the_peer_is_not_told(cell) -> None:
    cell.cable.cut()
    cell.send(1)
    cell.peer.sendall(b"<Vis><Seq>1</Seq></Vis>")
    assert cell.receive() == []
    assert cell.nothing_arrives_at_the_peer()
    assert cell.flags[997]
    cell.now = 6.0
    cell.eki.poll()
    assert not cell.flags[997]
    assert cell.eki.check(cell.eki.check_buffer("V", "Vis"), "V")[0] == EkiMessage.PING_FAILED
    assert cell.nothing_arrives_at_the_peer()
    assert cell.eki.open("V").msg_no == EkiMessage.NOT_ESTABLISHED
    cell.cable.repair()
    assert cell.peer.recv(100) == b""
    cell.peer.close()
    cell.peer = cell.connect()
    assert cell.flags[997]


def test_a_cable_that_is_mended_in_time_loses_nothing(cell) -> None:
    cell.cable.cut()
    telegram = cell.send(1)
    cell.peer.sendall(b"<Vis><Seq>1</Seq></Vis>")
    cell.eki.poll(0.02)
    cell.cable.repair()
    assert cell.receive() == [1]
    assert cell.peer.recv(100) == telegram


def test_a_half_open_connection_is_silent_for_both_ends_and_a_new_one_works(cell) -> None:
    cell.cable.forget()
    cell.send(1)
    assert cell.nothing_arrives_at_the_peer()
    cell.now = 6.0
    cell.eki.poll()
    assert cell.flags[997]
    cell.eki.close("V")
    assert cell.nothing_arrives_at_the_peer()
    old, cell.peer = cell.peer, cell.connect()
    with old:
        telegram = cell.send(2)
        assert cell.peer.recv(100) == telegram
