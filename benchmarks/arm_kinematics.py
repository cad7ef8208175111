"""How fast and how exact are the arm's kinematics, beside py-opw-kinematics?

``python benchmarks/arm_kinematics.py [POSES] [SEED]`` prints, for each, microseconds for a pose, the worst error of a
round trip, and how many of the usual home positions (A5 = 0) are solved.
"""

import random
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
from py_opw_kinematics import KinematicModel, Robot
from scipy.spatial.transform import RigidTransform

from slabcell_drivers.robot.arm import KR3_R540, Axes

REPEATS = 5


def microseconds(call: Callable[[int], object], count: int) -> float:
    """Return the median over repeats of the mean time of one call."""
    times: list[float] = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        for i in range(count):
            call(i)
        times.append((time.perf_counter() - begin) / count * 1e6)
    return statistics.median(times)


def main() -> None:
    """Measure and print."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    rng = random.Random(seed)
    arm, d = KR3_R540, KR3_R540.dimensions
    ranges = list(zip(arm.axis_min_deg, arm.axis_max_deg, strict=True))
    axes: list[Axes] = [tuple(rng.uniform(*r) for r in ranges) for _ in range(count)]
    homes: list[Axes] = [(a1, -90.0, 90.0, 0.0, 0.0, a6) for a1 in (-90.0, 0.0, 45.0) for a6 in (0.0, 90.0)]

    peer = Robot(
        KinematicModel(
            a1=d.shoulder_mm,
            a2=-d.forearm_z_mm,
            c1=d.base_height_mm,
            c2=d.upper_arm_mm,
            c3=d.forearm_x_mm,
            c4=d.flange_mm,
            offsets=(0, -90, 0, 0, 0, 0),
            flip_axes=(True, False, False, True, False, True),
        )
    )
    frames = [arm.forward(q) for q in axes]
    poses = [arm.forward_pose(q) for q in axes]
    matrices = [frame.matrix for frame in frames]
    transforms = [RigidTransform.from_matrix(m) for m in matrices]

    def ours_error(q: Axes) -> float:
        status, turn = arm.status_turn(q)
        back = arm.forward(arm.inverse(arm.forward(q), near=q, status=status, turn=turn))
        return float(np.abs(np.subtract(back.as_tuple()[:3], arm.forward(q).as_tuple()[:3])).max())

    def peer_error(q: Axes) -> float:
        pose = peer.forward(q)
        solutions = peer.inverse(pose)
        nearest = min(solutions, key=lambda s: np.abs((np.subtract(s, q) + 180.0) % 360.0 - 180.0).max())
        return float(np.abs(peer.forward(nearest).as_matrix()[:3, 3] - pose.as_matrix()[:3, 3]).max())

    def peer_solves(q: Axes) -> bool:
        return any(abs(s[4]) < 1e-6 for s in peer.inverse(peer.forward(q)))

    few = axes[: min(count, 500)]
    print(f"{'seed ' + str(seed):38}{'slabcell':>14}{'py-opw':>14}")
    rows = (
        ("forward to a pose, us", lambda i: arm.forward_pose(axes[i]), lambda i: peer.forward(axes[i])),
        ("forward to X Y Z A B C or a matrix, us", lambda i: arm.forward(axes[i]), lambda i: peer.forward(axes[i])),
        ("inverse from a pose, us", lambda i: arm.inverse(poses[i]), lambda i: peer.inverse(transforms[i])),
        (
            "inverse from X Y Z A B C or a matrix, us",
            lambda i: arm.inverse(frames[i]),
            lambda i: peer.inverse(RigidTransform.from_matrix(matrices[i])),
        ),
    )
    for name, ours, theirs in rows:
        print(f"{name:38}{microseconds(ours, count):14.1f}{microseconds(theirs, count):14.1f}")
    print(f"{'worst round trip, mm':38}{max(map(ours_error, few)):14.1e}{max(map(peer_error, few)):14.1e}")
    solved = sum(arm.inverse(arm.forward(q), near=q)[4] == 0.0 for q in homes)
    print(f"{'homes with A5 = 0 solved':38}{solved:11d}/{len(homes)}{sum(map(peer_solves, homes)):12d}/{len(homes)}")


if __name__ == "__main__":
    main()
