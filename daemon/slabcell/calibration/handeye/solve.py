"""Where do camera and board sit?  One door to every method, by name."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from slabcell.calibration.handeye.joint import estimate_jointly
from slabcell.calibration.handeye.motion import Array, inverse, nearest_rotation, relative_motions, rigid
from slabcell.calibration.handeye.robot_world import li, shah
from slabcell.calibration.handeye.separate import horaud, park, tsai
from slabcell.calibration.handeye.simultaneous import andreff, daniilidis
from slabcell.calibration.handeye.stations import Mount, Stations

__all__ = ["HandEyeMethod", "Placement", "mean_board", "place_camera"]

HandEyeMethod = Literal["joint", "tsai", "park", "horaud", "andreff", "daniilidis", "shah", "li"]

_FROM_PAIRS: dict[str, Callable[[Array, Array], Array]] = {
    "tsai": tsai,
    "park": park,
    "horaud": horaud,
    "andreff": andreff,
    "daniilidis": daniilidis,
}
_FROM_STATIONS: dict[str, Callable[[Array, Array], tuple[Array, Array]]] = {"shah": shah, "li": li}


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """X, the camera in base or on flange, and Z, the board on flange or in base, each (4, 4).

    The joint method knows their covariance (12, 12), as local twists, and the robot's noise; others do not.
    """

    camera: Array
    board: Array
    covariance: Array | None = None
    robot_mm: float | None = None
    robot_deg: float | None = None


def place_camera(
    stations: Stations,
    mount: Mount,
    method: HandEyeMethod = "joint",
    *,
    robot_mm: float | None = None,
    robot_deg: float | None = None,
) -> Placement:
    """Return where camera and board sit; the robot's noise (one standard deviation) concerns the joint method only."""
    hands = stations.hands(mount)
    if method in _FROM_PAIRS:
        camera = _FROM_PAIRS[method](*relative_motions(hands, stations.boards))
        return Placement(camera, mean_board(hands, camera, stations.boards))
    camera, board = _FROM_STATIONS["shah" if method == "joint" else method](hands, inverse(stations.boards))
    if method != "joint":
        return Placement(camera, board)
    found = estimate_jointly(stations, mount, camera, board, robot_mm=robot_mm, robot_deg=robot_deg)
    return Placement(found.camera, found.board, found.covariance, found.robot_mm, found.robot_deg)


def mean_board(hands: Array, camera: Array, boards: Array) -> Array:
    """Return the board's place (4, 4) that the stations show on average, the camera's given."""
    places = hands @ camera @ boards
    return rigid(
        nearest_rotation(places[:, :3, :3].mean(axis=0)), np.asarray(places[:, :3, 3].mean(axis=0), np.float64)
    )
