"""Other people's channel files: LIFO, frames on a node, repeated elements, RAW bytes and streams."""

import random
import socket

import pytest

from slabcell_drivers.krc.eki import EthernetKrl
from slabcell_drivers.krc.eki_config import ElementType
from slabcell_drivers.krc.eki_messages import EkiMessage
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.integration


def config(receive: str, send: str = "<XML/>", buffering: str = '<BUFFERING Limit="8"/>') -> bytes:
    return (
        "<ETHERNETKRL><CONFIGURATION><EXTERNAL><IP>127.0.0.1</IP><PORT>1</PORT></EXTERNAL>"
        f'<INTERNAL>{buffering}<ALIVE Set_Out="7"/></INTERNAL></CONFIGURATION>'
        f"<RECEIVE>{receive}</RECEIVE><SEND>{send}</SEND></ETHERNETKRL>"
    ).encode()


class Linked:
    def __init__(self, raw: bytes) -> None:
        self.flags: dict[int, bool] = {}
        self.outputs: dict[int, bool] = {}
        with socket.create_server(("127.0.0.1", 0)) as listener:
            listener.settimeout(5.0)
            self.eki = EthernetKrl(
                {"C": raw},
                set_flag=self.flags.__setitem__,
                set_out=self.outputs.__setitem__,
                addresses={"C": listener.getsockname()},
                rng=random.Random(1),
            )
            self.eki.init("C")
            assert self.eki.open("C").connected
            self.peer, _ = listener.accept()
        self.peer.settimeout(5.0)

    def deliver(self, data: bytes) -> None:
        """Send data and poll until it has been taken."""
        self.peer.sendall(data)
        while not self.eki.poll(1.0):
            pass

    def close(self) -> None:
        self.eki.close_all()
        self.peer.close()


@pytest.fixture
def link():
    made: list[Linked] = []

    def make(raw: bytes) -> Linked:
        made.append(Linked(raw))
        return made[-1]

    yield make
    for linked in made:
        linked.close()


def test_the_output_of_alive_follows_the_connection(link) -> None:
    linked = link(config("<XML/>"))
    assert linked.outputs == {7: True}
    linked.eki.close("C")
    assert linked.outputs == {7: False}


def test_repeated_elements_fill_the_memory_with_one_entry_each(link) -> None:
    six = "".join(f'<ELEMENT Tag="res/tags/le/pose/@{key}" Type="REAL"/>' for key in "XYZABC")
    linked = link(config(f'<XML>{six}<ELEMENT Tag="res" Set_Flag="5"/></XML>'))
    poses = "".join(f'<le><pose X="{x}" Y="0" Z="0" A="0" B="0" C="0"/></le>' for x in (1, 2, 3))
    linked.deliver(f"<res><tags>{poses}</tags></res>".encode())
    assert linked.flags == {5: True}
    assert linked.eki.check_buffer("C", "res/tags/le/pose").buff == 3
    status, frames = linked.eki.get_array("C", "res/tags/le/pose", ElementType.FRAME, 5)
    assert [frame.x_mm for frame in frames if isinstance(frame, Frame)] == [1.0, 2.0, 3.0]
    assert (status.read, status.counter) == (3, 1)
    linked.eki.clear_buffer("C", "res")
    assert linked.eki.check_buffer("C", "res/tags/le/pose").buff == 0


def test_a_frame_element_reads_its_six_attributes(link) -> None:
    linked = link(config('<XML><ELEMENT Tag="S/Read/xyzabc" Type="FRAME" Set_Out="9"/></XML>'))
    linked.deliver(b'<S><Read><xyzabc C="6" B="5" A="4" Z="3" Y="2" X="1"/></Read></S>')
    assert linked.outputs[9]
    assert linked.eki.get_value("C", "S/Read/xyzabc", ElementType.FRAME)[1] == Frame(1, 2, 3, 4, 5, 6)


def test_a_lifo_gives_the_newest_and_two_telegrams_mix_unless_locked(link) -> None:
    receive = '<XML><ELEMENT Tag="S/X" Type="INT"/><ELEMENT Tag="S/Y" Type="INT"/></XML>'
    linked = link(config(receive, buffering='<BUFFERING Mode="LIFO" Limit="8"/>'))

    def read(path: str) -> tuple[object, int]:
        status, value = linked.eki.get_value("C", path, ElementType.INT)
        return value, status.counter

    linked.deliver(b"<S><X>1</X><Y>1</Y></S>")
    assert read("S/X") == (1, 1)
    linked.deliver(b"<S><X>2</X><Y>2</Y></S>")
    assert read("S/Y") == (2, 2)  # not of the record that X came from
    linked.eki.clear_buffer("C", "S")
    linked.deliver(b"<S><X>3</X><Y>3</Y></S>")
    linked.eki.lock("C")
    assert read("S/X") == (3, 3)
    linked.deliver(b"<S><X>4</X><Y>4</Y></S>")
    assert read("S/Y") == (3, 3)
    linked.eki.unlock("C")
    assert read("S/X") == (4, 4)


def test_an_array_of_several_telegrams_has_the_counter_zero(link) -> None:
    linked = link(config('<XML><ELEMENT Tag="S/X" Type="REAL"/></XML>'))
    linked.deliver(b"<S><X>1.5</X></S><S><X>2.5</X></S>")
    status, values = linked.eki.get_array("C", "S/X", ElementType.REAL, 8)
    assert (values, status.counter, status.read) == ([1.5, 2.5], 0, 2)


def test_raw_bytes_of_fixed_size_are_read_and_sent_as_text(link) -> None:
    linked = link(
        config(
            '<RAW><ELEMENT Tag="Buffer" Type="BYTE" Size="4" Set_Flag="3"/></RAW>',
            '<RAW><ELEMENT Tag="Buffer" Type="BYTE" Size="4"/></RAW>',
        )
    )
    linked.deliver(b"abcd\xe4")
    assert linked.flags == {3: True}
    assert linked.eki.get_value("C", "Buffer", ElementType.STRING)[1] == "abcd"
    assert linked.eki.get_value("C", "Buffer", ElementType.STRING)[0].msg_no == EkiMessage.EMPTY_MEMORY
    linked.deliver(b"xyz")
    assert linked.eki.get_value("C", "Buffer", ElementType.STRING)[1] == "\xe4xyz"
    linked.eki.send("C", "hello\xff", 6)
    assert linked.peer.recv(10) == b"hello\xff"


def test_a_raw_stream_is_cut_at_its_ending(link) -> None:
    linked = link(config('<RAW><ELEMENT Tag="S" Type="STREAM" EOS="13,10" Size="64"/></RAW>'))
    linked.deliver(b"first\r\nsec")
    linked.deliver(b"ond\r\n")
    _, values = linked.eki.get_array("C", "S", ElementType.STRING, 5)
    assert values == ["first", "second"]


def test_seventeen_connections_are_one_too_many() -> None:
    raw = config("<XML/>")
    with socket.create_server(("127.0.0.1", 0), backlog=20) as listener:
        address = listener.getsockname()
        names = [f"C{i}" for i in range(17)]
        eki = EthernetKrl(
            dict.fromkeys(names, raw),
            set_flag=lambda *_: None,
            set_out=lambda *_: None,
            addresses=dict.fromkeys(names, address),
            rng=random.Random(1),
        )
        for name in names:
            eki.init(name)
        assert [eki.open(name).msg_no for name in names] == [0] * 16 + [EkiMessage.NOT_ESTABLISHED]
        eki.close_all()


@pytest.mark.parametrize("telegrams", [200, pytest.param(20_000, marks=pytest.mark.slow)])
def test_any_stream_of_good_and_broken_telegrams_leaves_whole_records_only(link, telegrams: int) -> None:
    """Every record that reaches the memories is one that was sent whole: X and Y always belong together."""
    receive = '<XML><ELEMENT Tag="S/X" Type="INT"/><ELEMENT Tag="S/Y" Type="INT"/><ELEMENT Tag="S" Set_Flag="1"/></XML>'
    linked = link(config(receive, buffering='<BUFFERING Limit="512"/><BUFFSIZE Limit="65534"/>'))
    seed = random.SystemRandom().randrange(2**32)
    print(f"seed {seed}")
    rng = random.Random(seed)
    good = 0
    for number in range(telegrams):
        telegram = f"<S><X>{number}</X><Y>{number}</Y></S>".encode()
        if rng.random() < 0.2:  # broken where it can be told: a tag that is no name
            at = rng.randrange(4, len(telegram) - 4)
            telegram = telegram[:at] + b"<&>" + telegram[at:]
        else:
            good += 1
        cut = rng.randrange(len(telegram))
        linked.deliver(telegram[:cut] or b" ")
        linked.deliver(telegram[cut:])
        while linked.eki.poll():
            pass
        _, xs = linked.eki.get_array("C", "S/X", ElementType.INT, 9)
        _, ys = linked.eki.get_array("C", "S/Y", ElementType.INT, 9)
        assert xs == ys
        assert xs in ([], [number])
        good -= len(xs)
    assert good == 0
