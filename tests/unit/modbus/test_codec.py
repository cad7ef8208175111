"""Requests and answers survive their registers, whatever the orders; what does not fit is refused by name."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.modbus.codec import (
    InvalidRequestError,
    decode_answer,
    decode_request,
    encode_answer,
    encode_request,
)
from slabcell_drivers.robot.modbus.register_map import Area, RegisterValueError, check_words
from slabcell_drivers.robot.protocol import AckState, Answer, Offer, Request, RequestType, RobotStatus

pytestmark = pytest.mark.unit

INTS = st.integers(0, 2**31 - 1)
WORDS = st.integers(0, 65_535)
THOUSANDTHS_MM = st.integers(-20_000_000, 20_000_000).map(lambda raw: raw / 1000)
THOUSANDTHS_DEG = st.integers(-360_000, 360_000).map(lambda raw: raw / 1000)
FRAMES = st.builds(Frame, *[THOUSANDTHS_MM] * 3, *[THOUSANDTHS_DEG] * 3)
REQUESTS = st.builds(
    Request,
    *(st.sampled_from(RequestType), INTS, INTS),
    job_id=INTS,
    model=INTS,
    tcp=FRAMES,
    axes_deg=st.tuples(*[THOUSANDTHS_DEG] * 6),
    ack_result_id=INTS,
    ack_state=st.sampled_from(AckState),
    status=st.builds(RobotStatus, st.integers(0, 4), WORDS, WORDS, st.booleans(), INTS),
)
TEXTS = st.from_regex(r"[!-~]([ -~]{0,78}[!-~])?", fullmatch=True).filter(lambda text: "  " not in text) | st.just("")
OFFERS = st.builds(
    Offer,
    st.integers(1, 2**31 - 1),
    *(WORDS, WORDS, FRAMES, FRAMES, st.integers(0, 10_000).map(lambda raw: raw / 10_000), WORDS),
)
ANSWERS = st.builds(
    Answer,
    *(INTS, INTS, INTS, st.integers(0, 4) | st.integers(1000, 65_535), WORDS, INTS, st.none() | OFFERS, TEXTS),
)


@given(request=REQUESTS, toggle=st.integers(0, 1))
def test_a_request_reads_as_it_was_written(any_map, request, toggle):
    words = encode_request(any_map, request, toggle)
    assert any_map.sound(Area.REQUEST, words)
    assert words[-1] == toggle
    assert decode_request(any_map, any_map.from_wire(any_map.to_wire(words))) == request


@given(answer=ANSWERS, publication=st.integers(0, 2**32 - 1))
def test_an_answer_reads_as_it_was_written(any_map, answer, publication):
    words = encode_answer(any_map, answer, publication=publication, toggle=1)
    assert any_map.sound(Area.ANSWER, words)
    assert decode_answer(any_map, any_map.from_wire(any_map.to_wire(words))) == answer


@given(one=ANSWERS, other=ANSWERS, publication=st.integers(0, 2**32 - 2), cut=st.integers(1, 87))
def test_no_mixture_of_two_answers_counts_as_whole(shipped, one, other, publication, cut):
    """Read in two requests with a publication in between, in either order."""
    before = encode_answer(shipped, one, publication=publication, toggle=0)
    after = encode_answer(shipped, other, publication=publication + 1, toggle=0)
    for mixed in (before[:cut] + after[cut:], after[:cut] + before[cut:]):
        whole = [words for words in (before, after) if words[:-1] == mixed[:-1]]
        assert whole or not shipped.sound(Area.ANSWER, mixed)


@given(request=REQUESTS, at=st.integers(0, 46), flip=st.integers(1, 65_535))
def test_no_request_with_a_changed_register_counts_as_whole(shipped, request, at, flip):
    words = encode_request(shipped, request, 1)
    words[at] ^= flip
    assert not shipped.sound(Area.REQUEST, words)


def test_words_that_have_changed_places_are_noticed():
    assert check_words([1, 2, 3]) != check_words([1, 3, 2])
    assert check_words([0] * 40) != 0


def test_known_words_stay_as_they_are(shipped):
    """What a PLC was programmed against: these must not change within a version of the map."""
    request = Request(RequestType.ACK, 7, 42, ack_result_id=105, ack_state=AckState.GRASPED, tcp=Frame(x_mm=-1.5))
    words = encode_request(shipped, request, 1)
    assert words[:7] == [1, 0, 42, 0, 7, 4, 0]
    assert words[19:21] == [0xFFFF, 0xFA24]
    assert words[-5:] == [0, 42, *divmod(check_words(words[:45]), 65_536), 1]
    assert check_words([1, 2, 3]) == (2 + 4 + 7) << 16 | 7


@pytest.mark.parametrize("x_mm", [math.nan, math.inf, -math.inf, 20_000.001, 1e300])
def test_a_pose_that_does_not_fit_is_refused_by_name(shipped, x_mm):
    offer = Offer(1, 0, 0, Frame(x_mm), Frame(), 1.0)
    with pytest.raises(RegisterValueError, match=r"answer\.pick_x = "):
        encode_answer(shipped, Answer(1, 1, 1, offer=offer), publication=1, toggle=1)


def test_a_pose_is_rounded_to_thousandths(shipped):
    offer = Offer(1, 0, 0, Frame(1.23449, 0, 0, 179.99961), Frame(-0.0004), 0.98765)
    words = encode_answer(shipped, Answer(1, 1, 1, offer=offer), publication=1, toggle=1)
    got = decode_answer(shipped, words).offer
    assert got is not None
    assert got.pick.as_tuple() == (1.234, 0, 0, 180.0, 0, 0)
    assert got.place.x_mm == 0
    assert got.score == pytest.approx(0.9876, abs=1e-4)


@pytest.mark.parametrize(
    ("at", "value", "said"),
    [(0, 3, "version"), (5, 0, "0 is not a valid RequestType"), (5, 9, "command"), (12, 99, "ack_state")],
)
def test_a_whole_request_with_a_wrong_value_names_it(shipped, at, value, said):
    words = encode_request(shipped, Request(RequestType.NEXT, 5, 9), 1)
    words[at] = value
    check = check_words(words[:45])
    words[45:47] = [check >> 16, check & 0xFFFF]
    with pytest.raises(InvalidRequestError, match=said) as caught:
        decode_request(shipped, words)
    assert (caught.value.session, caught.value.sequence) == (5, 9)


def test_a_text_is_cut_and_made_ascii(shipped):
    answer = Answer(1, 1, 1, message="Gruß\n" + "x" * 100)
    words = encode_answer(shipped, answer, publication=1, toggle=1)
    assert decode_answer(shipped, words) == dataclasses.replace(answer, message="Gru? " + "x" * 75)
