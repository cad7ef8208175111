"""Is the flange where the frames, multiplied one by one, put it, and are the compiled axes those of Python?"""

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from slabcell.cell.descent import DescentTo
from slabcell.geometry import PlanarPose
from slabcell_drivers.robot.arm import KR3_R540, KR6_R900, ArmError
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.native import native_library

pytestmark = pytest.mark.unit

LENGTHS = st.floats(-900, 900)
ANGLES = st.floats(-180, 180) | st.sampled_from([0.0, 90.0, 180.0, -90.0])
FRAMES = st.builds(Frame, LENGTHS, LENGTHS, LENGTHS, ANGLES, ANGLES, ANGLES)
POSES = st.builds(PlanarPose, LENGTHS, LENGTHS, ANGLES)


@given(FRAMES, FRAMES, POSES, st.floats(0, 100), st.floats(1, 300))
def test_the_flange_is_where_the_frames_put_it(base, tool, pose, height_mm, approach_mm):
    down = Frame(pose.x_mm, pose.y_mm, height_mm, pose.a_deg, 0.0, 180.0)
    over = Frame(pose.x_mm, pose.y_mm, height_mm + approach_mm, pose.a_deg, 0.0, 180.0)
    flange_in_tool = np.linalg.inv(tool.matrix)
    for found, tcp in zip(DescentTo(base, tool, approach_mm, KR3_R540)(pose, height_mm), (over, down), strict=True):
        matrix = base.matrix @ tcp.matrix @ flange_in_tool
        np.testing.assert_allclose(found.position, matrix[:3, 3], rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.rotation, matrix[:3, :3], rtol=0, atol=1e-12)


TILTS = st.floats(-20, 20)
NEAR_BASES = st.builds(Frame, st.floats(300, 600), st.floats(-300, 300), st.floats(-200, 400), ANGLES, TILTS, TILTS)
"""None brings a pose onto the axis of A1, where its angle is free."""

CLOSE = st.floats(-140, 140)
CLOSE_POSES = st.lists(st.builds(PlanarPose, CLOSE, CLOSE, ANGLES), min_size=1, max_size=6)


def asked(arm, way, status):
    """Return the axes above and at a pose that Python finds, and the status; None where the arm does not get there."""
    above, at = way
    others = dict.fromkeys(arm.status_turn(axes)[0] for axes in arm.all_solutions(above))  # the quickest first
    for each in others if status is None else [status]:
        try:
            over = arm.inverse(above, status=each)
            return (over, arm.inverse(at, near=over, status=each)), each
        except ArmError:
            continue
    return None, status


def half_turns(start, end):
    """Return for each axis whether both directions are equally far."""
    return np.abs(np.abs(np.subtract(end, start)) % 360 - 180) < 1e-6


@given(
    NEAR_BASES,
    st.floats(-60, 120),
    CLOSE_POSES,
    st.sampled_from([None, *range(8)]),
    st.sampled_from([KR3_R540, KR6_R900]),
)
@settings(max_examples=300)
def test_the_compiled_axes_are_those_of_python(base, length_mm, poses, status, arm):
    assert native_library() is not None, "not compiled: python hatch_build.py"
    descent = DescentTo(base, Frame(0, 0, length_mm, 30, 0, 0), 50.0, arm)
    found, used = descent.quickly([(pose, 10.0) for pose in poses], status)
    expected = status
    for pose, axes in zip(poses, found, strict=True):
        wanted, expected = asked(arm, descent(pose, 10.0), expected)
        event("reached" if axes else "not reached")
        assert (axes is None) == (wanted is None)
        if axes is not None:
            over, at = wanted
            off = np.subtract(axes, at)
            np.testing.assert_allclose(off - 360.0 * np.round(off / 360.0), 0.0, rtol=0, atol=1e-6)
            assert not (np.round(off / 360.0) * ~half_turns(np.zeros(6), over) * ~half_turns(over, at)).any()
    assert used == expected


def test_values_that_are_no_numbers_are_not_reached():
    descent = DescentTo(Frame(300, 0, 0), Frame(0, 0, 50), 50.0, KR3_R540)
    nan, inf = float("nan"), float("inf")
    poses = [PlanarPose(nan, 0, 0), PlanarPose(0, inf, 0), PlanarPose(0, 0, nan), PlanarPose(0, 0, inf)]
    for status in (None, 2):
        found, used = descent.quickly([(pose, 10.0) for pose in poses], status)
        assert found == [None] * 4
        assert used == status


def test_without_a_compiled_library_everything_has_to_be_asked(monkeypatch):
    monkeypatch.setattr("slabcell.cell.descent.native_library", lambda: None)
    descent = DescentTo(Frame(300, 0, 0), Frame(0, 0, 50), 50.0, KR3_R540)
    assert descent.quickly([(PlanarPose(0, 0, 0), 10.0)], None) == ([None], None)
