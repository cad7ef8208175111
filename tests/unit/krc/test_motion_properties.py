"""Any path, from anywhere to anywhere: it is refused by name, or it keeps what it promises."""

import random

import numpy as np
import pytest

from slabcell_drivers.krc.motion import (
    INTERPOLATION_TICK_S,
    MotionError,
    MotionKind,
    PathLimits,
    Trajectory,
    plan_circ,
    plan_lin,
)
from slabcell_drivers.krc.motion_joint import plan_lin_joint
from slabcell_drivers.robot.arm import KR3_R540, Axes
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

TOOLS = (Frame(), Frame(z_mm=260.0), Frame(30.0, -20.0, 150.0, 20.0, -40.0, 70.0))


def random_axes(rng: random.Random) -> Axes:
    return tuple(rng.uniform(*limits) for limits in zip(KR3_R540.axis_min_deg, KR3_R540.axis_max_deg, strict=True))


def near(rng: random.Random, frame: Frame, mm: float, deg: float) -> Frame:
    x, y, z, a, b, c = frame.as_tuple()
    shifted = (v + rng.uniform(-mm, mm) for v in (x, y, z))
    turned = (v + rng.uniform(-deg, deg) for v in (a, b, c))
    return Frame(*shifted, *turned)


def check(move: Trajectory, start: Axes, goal: Frame, limits: PathLimits) -> None:
    times = np.linspace(0.0, move.duration_s, 60)
    axes = np.array([move.axes_at(t) for t in times])
    assert (axes >= np.array(KR3_R540.axis_min_deg) - 1e-6).all()
    assert (axes <= np.array(KR3_R540.axis_max_deg) + 1e-6).all()
    assert tuple(axes[0]) == start
    assert np.abs((move.frame_at(move.duration_s) @ move.tool).matrix - goal.matrix).max() < 1e-6
    if move.duration_s == 0.0:
        return
    ticks = np.linspace(0.0, move.duration_s, max(2, int(move.duration_s / INTERPOLATION_TICK_S)))
    speed = np.abs(np.diff([move.axes_at(t) for t in ticks], axis=0)) / np.diff(ticks)[:, None]
    # checked in thirds of a tick; a tick that lies across them may hold one part of a third more on either side
    assert (speed.max(axis=0) <= np.array(KR3_R540.axis_speed_deg_s) * 4.0 / 3.0 + 1e-3).all()
    way = np.array([move.tcp_at(t).position for t in times])
    path_speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / np.diff(times)
    assert path_speed.max() <= limits.speed_m_s * 1000.0 * 1.001 + 1e-6
    if move.kind is MotionKind.LIN:
        begin, end = way[0], way[-1]
        length = np.linalg.norm(end - begin)
        along = (way - begin) @ ((end - begin) / max(length, 1e-9))
        aside = np.linalg.norm((way - begin) - along[:, None] * (end - begin) / max(length, 1e-9), axis=1)
        assert aside.max() < 1e-5
        assert (np.diff(along) >= -1e-6).all()


@pytest.mark.parametrize("count", [60, pytest.param(3000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("planner", ["lin", "joint", "circ"])
def test_a_random_path_is_refused_by_name_or_keeps_its_promises(planner: str, count: int) -> None:
    seed = random.SystemRandom().randrange(2**32)
    print(f"seed {seed}")
    rng = random.Random(seed)
    planned = 0
    for _ in range(count):
        tool, start = rng.choice(TOOLS), random_axes(rng)
        here = KR3_R540.forward(start) @ tool
        goal = near(rng, here, rng.choice([0.0, 20.0, 150.0]), rng.choice([0.0, 10.0, 60.0]))
        limits = PathLimits(rng.choice([0.02, 0.25, 1.0]), rng.choice([0.5, 2.3, 10.0]))
        try:
            if planner == "circ":
                aux = near(rng, here, 60.0, 0.0)
                move = plan_circ(KR3_R540, start, aux, goal, limits, tool=tool)
            elif planner == "joint":
                move = plan_lin_joint(KR3_R540, start, goal, limits, tool=tool)
            else:
                move = plan_lin(KR3_R540, start, goal, limits, tool=tool)
        except MotionError as error:
            refusals = ("Software limit", "Work envelope", "Singularity", "Command velocity", "CIRC not possible")
            if not error.text.startswith(refusals):
                raise
            continue
        planned += 1
        check(move, start, goal, limits)
    assert planned > count // 10
