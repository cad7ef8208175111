"""Framing: telegrams are found in any chunking, and after any garbage."""

import itertools

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slabcell_drivers.robot.eki.framing import MAX_TELEGRAM_BYTES, Framer, FramingError

pytestmark = pytest.mark.unit
relaxed = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # the machine may be loaded

GOOD = b'<Robot><Head Ver="1" Seq="%d"></Head></Robot>'
padding = st.text(" \t\r\n\0", max_size=5).map(str.encode)
garbage = st.binary(max_size=60).filter(lambda noise: b"<" not in noise and noise.strip(b" \t\r\n\0"))


def chunks(data, cuts):
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


@relaxed
@given(st.lists(padding, min_size=1, max_size=6), st.lists(st.integers(0, 10_000), max_size=12))
def test_telegrams_come_out_whole_however_they_are_cut_merged_and_padded(paddings, cuts):
    stream = b"".join(GOOD % number + pad for number, pad in enumerate(paddings))
    framer = Framer("Robot")
    events = [event for chunk in chunks(stream, cuts) for event in framer.feed(chunk)]
    assert events == [GOOD % number for number in range(len(paddings))]
    assert framer.pending == 0


@relaxed
@given(garbage, st.lists(st.integers(0, 10_000), max_size=12))
def test_a_good_telegram_after_garbage_is_found_and_the_garbage_is_reported_once(noise, cuts):
    framer = Framer("Robot")
    events = [event for chunk in chunks(noise + GOOD % 1 + GOOD % 2, cuts) for event in framer.feed(chunk)]
    assert [type(event) for event in events] == [FramingError, bytes, bytes]
    assert events[1:] == [GOOD % 1, GOOD % 2]


@relaxed
@given(st.integers(1, len(GOOD) - 1), st.lists(st.integers(0, 10_000), max_size=12))
def test_a_torn_telegram_does_not_swallow_the_next(kept, cuts):
    torn = (GOOD % 1)[:kept]
    framer = Framer("Robot")
    events = [event for chunk in chunks(torn + GOOD % 2, cuts) for event in framer.feed(chunk)]
    assert events[-1] == GOOD % 2 or kept >= len(GOOD % 1)
    assert all(isinstance(event, FramingError) or event in {GOOD % 1, GOOD % 2} for event in events)


def test_an_end_tag_may_hold_white_space_and_be_split():
    framer = Framer("Robot")
    assert framer.feed(b"<Robot></Ro") == []
    assert framer.feed(b"bot \n") == []
    assert framer.feed(b">") == [b"<Robot></Robot \n>"]


def test_roots_with_a_common_beginning_are_told_apart():
    framer = Framer("Vis", "VisHb")
    assert framer.feed(b"<VisHb></VisHb><Vis><a></a></Vis>") == [b"<VisHb></VisHb>", b"<Vis><a></a></Vis>"]


def test_a_stream_without_an_end_is_dropped_at_the_limit_and_a_later_telegram_is_found():
    framer = Framer("Robot")
    held, errors = 0, []
    for _ in range(40):
        errors += framer.feed(b"<Robot>" + b"x" * 4096)
        held = max(held, framer.pending)
    assert errors
    assert all("limit is 65536" in str(error) for error in errors)
    assert held <= MAX_TELEGRAM_BYTES
    assert framer.feed(b"</Robot>" + GOOD % 3)[-1] == GOOD % 3


def test_many_small_chunks_of_a_large_telegram_are_scanned_once():
    framer = Framer("Robot")
    telegram = b"<Robot>" + b"<a></a>" * 8000 + b"</Robot>"
    events = [event for at in range(0, len(telegram), 7) for event in framer.feed(telegram[at : at + 7])]
    assert events == [telegram]
