"""Is it known which frame answers a trigger?"""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slabcell_drivers.camera.sequence import FrameSequence, Verdict

pytestmark = pytest.mark.unit


def after(frame_id: int) -> FrameSequence:
    sequence = FrameSequence()
    assert sequence.judge(frame_id) is Verdict.OWN
    return sequence


def test_the_id_after_65535_is_1():
    assert after(65_535).judge(1) is Verdict.OWN
    assert after(65_535).judge(0) is not Verdict.OWN


def test_extended_ids_do_not_wrap():
    sequence = after(65_534)
    assert [sequence.judge(65_534 + step) for step in range(1, 5)] == [Verdict.OWN] * 4
    assert sequence.judge(1) is Verdict.BROKEN
    assert sequence.judge(65_537) is Verdict.STALE
    assert sequence.missed(65_541) == 2


@pytest.mark.parametrize(("last", "came"), [(10, 10), (10, 9), (2, 65_535), (1, 65_300)])
def test_an_id_shortly_before_the_expected_one_is_stale(last: int, came: int):
    assert after(last).judge(came) is Verdict.STALE


@pytest.mark.parametrize(("last", "came", "missed"), [(10, 12, 1), (65_534, 2, 2), (5000, 1, 0), (10, 40_000, 0)])
def test_any_other_id_is_a_broken_count_and_says_how_many_are_missing(last: int, came: int, missed: int):
    sequence = after(last)
    assert sequence.missed(came) == missed
    assert sequence.judge(came) is Verdict.BROKEN


@settings(deadline=None)
@given(st.integers(1, 65_535), st.integers(1, 200))
def test_a_whole_count_is_always_the_triggers_own(first: int, length: int):
    sequence = FrameSequence()
    for step in range(length):
        assert sequence.judge((first - 1 + step) % 65_535 + 1) is Verdict.OWN


@settings(deadline=None)
@given(st.integers(1, 65_535), st.integers(0, 65_535))
def test_a_refused_frame_does_not_change_what_is_expected(last: int, came: int):
    sequence = after(last)
    expected = sequence.expected
    if sequence.judge(came) is not Verdict.OWN:
        assert sequence.expected == expected
