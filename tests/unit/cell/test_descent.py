"""Is the flange where the frames, multiplied one by one, put it?"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slabcell.cell.descent import DescentTo
from slabcell.geometry import PlanarPose
from slabcell_drivers.robot.frame import Frame

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
    for found, tcp in zip(DescentTo(base, tool, approach_mm)(pose, height_mm), (over, down), strict=True):
        matrix = base.matrix @ tcp.matrix @ flange_in_tool
        np.testing.assert_allclose(found.position, matrix[:3, 3], rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.rotation, matrix[:3, :3], rtol=0, atol=1e-12)
