import random
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slabcell_drivers.krc.eki_config import Buffering, ElementType, ReceiveElement
from slabcell_drivers.krc.eki_memory import ElementMemories, Entry
from slabcell_drivers.krc.eki_raw import RawSplitter
from slabcell_drivers.krc.eki_wire import ReceivedElement, read_value, received_elements, write_branch
from slabcell_drivers.krc.eki_xml import DocumentSplitter, XmlError, parse_document
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

TAGS = ("R/Head/@Seq", "R/Head/@Type", "R/Pose/@X", "R/Pose/@Y", "R/Text", "R/Deep/Er/Node", "R/Frame")


def test_a_branch_is_wrapped_in_its_ancestors_in_the_order_of_the_configuration() -> None:
    values = {"R/Pose/@Y": 2.0, "R/Pose/@X": 1.0, "R/Text": "x", "R/Deep/Er/Node": True}
    assert write_branch(TAGS, "R", values) == (
        b'<R><Pose X="1.000000" Y="2.000000"></Pose><Text>x</Text><Deep><Er><Node>1</Node></Er></Deep>'
        b"<Frame></Frame></R>"
    )
    assert write_branch(TAGS, "R/Deep/Er", values) == b"<R><Deep><Er><Node>1</Node></Er></Deep></R>"
    with pytest.raises(ValueError, match="not configured"):
        write_branch(TAGS, "Q", {})


def test_a_frame_on_a_node_is_written_as_its_six_attributes() -> None:
    sent = write_branch(TAGS, "R/Frame", {"R/Frame": Frame(1, 2, 3, 4, 5, 6)})
    assert b'<Frame X="1.000000" Y="2.000000" Z="3.000000" A="4.000000" B="5.000000" C="6.000000">' in sent


def test_shuffled_attributes_are_the_same_attributes() -> None:
    values = {"R/Head/@Seq": 1, "R/Head/@Type": 2}
    sent = {write_branch(TAGS, "R/Head", values, shuffle=random.Random(seed)) for seed in range(8)}
    assert sent == {b'<R><Head Seq="1" Type="2"></Head></R>', b'<R><Head Type="2" Seq="1"></Head></R>'}


@given(st.text(alphabet=st.characters(codec="utf-8", exclude_categories=("Cc", "Cs", "Cn"))))
@settings(max_examples=50, deadline=None)
def test_any_text_survives_being_sent_and_read(text: str) -> None:
    root = parse_document(write_branch(("R/T", "R/@A"), "R", {"R/T": text, "R/@A": text}))
    found = {element.path: element for element in received_elements(root)}
    assert found["R/T"].text == text
    assert found["R/@A"].text == " ".join(text.split(" "))


def test_received_elements_come_when_they_are_complete_and_the_root_last() -> None:
    root = parse_document(b'<A q="1"><B r="2"><C>x</C></B><B/>tail</A>')
    assert [element.path for element in received_elements(root)] == ["A/@q", "A/B/@r", "A/B/C", "A/B", "A/B", "A"]


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (ElementType.BOOL, " 1 ", True),
        (ElementType.BOOL, "FALSE", False),
        (ElementType.INT, "-2147483648", -(2**31)),
        (ElementType.REAL, "1e-3", pytest.approx(1e-3)),
        (ElementType.REAL, "0.1", 0.10000000149011612),  # 32 bits
        (ElementType.STRING, " as it is ", " as it is "),
    ],
)
def test_values_read_as_their_type(kind: ElementType, text: str, value: object) -> None:
    assert read_value(ReceivedElement("A", text, {}), kind) == value


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (ElementType.BOOL, "yes"),
        (ElementType.INT, "2147483648"),
        (ElementType.INT, "1_0"),
        (ElementType.INT, "١"),
        (ElementType.REAL, "nan"),
        (ElementType.REAL, "1e39"),
        (ElementType.REAL, "1_0.0"),
        (ElementType.REAL, "9" * 50),
        (ElementType.STRING, "x" * 3601),
    ],
)
def test_values_that_do_not_read_as_their_type_are_refused(kind: ElementType, text: str) -> None:
    with pytest.raises(ValueError, match="A: "):
        read_value(ReceivedElement("A", text, {}), kind)


DOCUMENTS = (
    b'<Vis a="1>2"><B/><!-- </Vis> --><![CDATA[</Vis>]]><C>x</C></Vis>',
    b"<?xml version='1.0'?><Hb/>",
    b"<Vis><Vis>nested</Vis></Vis>",
)


@given(st.lists(st.integers(1, 20), max_size=40), st.sampled_from([b"", b"\0\0", b"\r\n ", b"\n"]))
@settings(max_examples=100, deadline=None)
def test_documents_are_found_however_the_stream_is_cut(cuts: list[int], between: bytes) -> None:
    stream = between.join([*DOCUMENTS, b""])
    splitter = DocumentSplitter()
    found: list[bytes] = []
    position = 0
    for size in [*cuts, len(stream)]:
        found += splitter.feed(stream[position : position + size])
        position += size
    assert found == list(DOCUMENTS)
    assert splitter.pending_bytes == 0


@given(st.binary(max_size=300))
@settings(max_examples=200, deadline=None)
def test_after_any_garbage_the_splitter_finds_a_telegram_once_garbage_is_closed(garbage: bytes) -> None:
    splitter = DocumentSplitter()
    for piece in splitter.feed(garbage):
        with suppress(XmlError):
            parse_document(piece)
    splitter.clear()
    assert splitter.feed(b"<A/>") == [b"<A/>"]


@pytest.mark.parametrize("raw", [b"<a" * 50_000, b'<a "' * 20_000, b"<" * 60_000, b"<!--" * 20_000])
def test_a_hostile_stream_is_scanned_in_reasonable_time(raw: bytes) -> None:
    assert DocumentSplitter().feed(raw) == []


@pytest.mark.parametrize(
    "raw", [b"<a>" * 40 + b"</a>" * 40, b"<a/><b/>", b"<a", b"\xff<a/>", b"<?xml version='1.0' encoding='foo'?><a/>"]
)
def test_xml_out_of_bounds_or_broken_is_refused(raw: bytes) -> None:
    with pytest.raises(XmlError):
        parse_document(raw)


def element(tag: str, kind: ElementType = ElementType.INT, mode: Buffering = Buffering.FIFO) -> ReceiveElement:
    return ReceiveElement(tag, kind, mode)


def test_a_fifo_gives_the_oldest_and_a_lifo_the_newest_first() -> None:
    memories = ElementMemories((element("A/F"), element("A/L", mode=Buffering.LIFO)), 5)
    for telegram in (1, 2, 3):
        memories.store("A/F", Entry(telegram, telegram))
        memories.store("A/L", Entry(telegram, telegram))
    assert [e.value for e in memories.take(("A/F",)) or ()] == [1]
    assert [e.value for e in memories.take(("A/L",)) or ()] == [3]
    assert memories.count("A") == 2


def test_a_memory_holds_one_more_than_its_limit_and_no_more() -> None:
    memories = ElementMemories((element("A"),), 2)
    assert [memories.store("A", Entry(i, i)) for i in range(4)] == [True, True, False, False]
    assert memories.count("A") == 3


def test_six_memories_make_a_frame_only_when_all_have_a_value() -> None:
    six = tuple(element(f"P/@{key}", ElementType.REAL) for key in "XYZABC")
    memories = ElementMemories(six, 5)
    tags = memories.tags_of("P", ElementType.FRAME)
    assert tags is not None
    for tag in tags[:-1]:
        memories.store(tag, Entry(1.0, 1))
    assert memories.take(tags) is None
    assert memories.count("P/@X") == 1
    memories.store(tags[-1], Entry(1.0, 1))
    assert len(memories.take(tags) or ()) == 6
    assert memories.tags_of("P", ElementType.INT) is None


def test_raw_bytes_are_cut_by_size() -> None:
    splitter = RawSplitter(ReceiveElement("B", ElementType.BYTE, Buffering.FIFO, size=4))
    assert splitter.feed(b"abcdef") == [b"abcd"]
    assert splitter.feed(b"gh") == [b"efgh"]
    assert splitter.pending_bytes == 0


def test_a_raw_stream_is_cut_at_the_first_of_its_endings() -> None:
    ending = (bytes([123, 134]), b"\r\n")
    splitter = RawSplitter(ReceiveElement("S", ElementType.STREAM, Buffering.FIFO, size=10, end_of_stream=ending))
    assert splitter.feed(b"one\r\ntwo" + ending[0] + b"three\r") == [b"one", b"two"]
    assert splitter.feed(b"\n" + b"x" * 12) == [b"three", b"x" * 10]


def test_a_raw_stream_without_ending_or_size_is_taken_as_it_comes() -> None:
    splitter = RawSplitter(ReceiveElement("S", ElementType.STREAM, Buffering.FIFO))
    assert splitter.feed(b"abc") == [b"abc"]
