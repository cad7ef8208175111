"""The run through sections of different speed keeps every limit and takes no longer than it must."""

import random

import pytest

from slabcell_drivers.krc.motion_profile import Trapezoid
from slabcell_drivers.krc.motion_steps import Section, SpeedSteps

pytestmark = pytest.mark.unit


def test_one_section_is_a_trapezoid() -> None:
    for length in (1.0, 10.0, 500.0):
        steps, plain = SpeedSteps.fastest([Section(length, 50.0, 20.0)]), Trapezoid.fastest(length, 50.0, 20.0)
        assert steps.duration_s == pytest.approx(plain.duration_s)
        assert steps.ramp_s == pytest.approx(plain.ramp_s)
        for k in range(21):
            assert steps.position(plain.duration_s * k / 20) == pytest.approx(plain.position(plain.duration_s * k / 20))


def test_a_slow_section_is_reached_slowed_down_and_left_speeding_up() -> None:
    steps = SpeedSteps.fastest([Section(100.0, 50.0, 100.0), Section(100.0, 10.0, 100.0), Section(100.0, 50.0, 100.0)])
    assert steps.time_at(200.0) - steps.time_at(100.0) == pytest.approx(10.0)
    assert steps.position(steps.time_at(100.0) - 0.1) < 99.0 + 1e-9


def test_a_run_without_a_way_or_a_speed_is_refused() -> None:
    for sections in ([], [Section(0.0, 1.0, 1.0)], [Section(1.0, 0.0, 1.0)], [Section(1.0, 1.0, 0.0)]):
        with pytest.raises(ValueError, match="are needed"):
            SpeedSteps.fastest(sections)


def test_any_sections_are_run_within_their_limits() -> None:
    seed = random.SystemRandom().randrange(2**32)
    print(f"seed {seed}")
    rng = random.Random(seed)
    for _ in range(100):
        sections = [
            Section(rng.choice([0.0, rng.uniform(1.0, 100.0)]), rng.uniform(1.0, 100.0), rng.uniform(10.0, 500.0))
            for _ in range(rng.randrange(1, 8))
        ]
        sections.append(Section(5.0, 10.0, 20.0))
        run = SpeedSteps.fastest(sections)
        assert run.position(run.duration_s) == pytest.approx(sum(s.length for s in sections))
        ends, end = [], 0.0
        for section in sections:
            end += section.length
            ends.append(end)
        step_s = run.duration_s / 2000
        before = 0.0
        for k in range(1, 2001):
            place = run.position(k * step_s)
            assert place >= before - 1e-9
            # a step that lies across a boundary may hold the faster of its two sections
            allowed = max(s.speed for s, e in zip(sections, ends, strict=True) if e >= before and e - s.length <= place)
            assert (place - before) / step_s <= allowed * 1.0001
            assert run.time_at(place) == pytest.approx(k * step_s, abs=max(1e-6, step_s))
            before = place
