"""Where was the robot?  As somebody says it, or as the robot itself does."""

from __future__ import annotations

import time
from typing import Annotated, Final, Literal

from pydantic import Field

from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document
from slabcell.service.api.endpoint import Call, Endpoint
from slabcell.service.api.problems import ProblemError
from slabcell.service.views import Pose

__all__ = ["ENDPOINTS", "Coordinate", "PoseBody", "SaidPose", "pose_said"]

POSE_AGE_S: Final = 5.0
"""A robot that stands still says where it is at least this often, as long as its program runs."""
Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
PoseBody = tuple[Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate]
SaidPose = PoseBody | Literal["robot"] | None
"""X Y Z A B C of the flange; ``robot``: where it says it is; None: unknown."""


class RobotPoseDocument(Document):
    """Where the robot says that it is."""

    schema_: Literal["slabcell.robot-pose/1"] = Field(default="slabcell.robot-pose/1", alias="schema")
    pose: Pose = Field(description="flange in the robot's base, X Y Z in mm, A B C in degrees")
    age_s: float


def pose_said(context: ApiContext, said: SaidPose) -> Pose | None:
    """Return the pose that a request gives.  Raises ProblemError 409 where the robot itself has not said it lately."""
    return _robot_pose(context).pose if said == "robot" else said


def _robot_pose(context: ApiContext) -> RobotPoseDocument:
    """Return the flange of the robot's newest telegram.  Raises ProblemError 409 if it is too old, or there is none."""
    last, age_s = context.robot.last, time.monotonic() - context.robot.last_s
    if last is None or age_s > POSE_AGE_S:
        when = "has said nothing" if last is None else f"said it {age_s:.0f} s ago"
        raise ProblemError(409, f"the robot {when}: its pose must be {POSE_AGE_S:g} s old at most; give it by hand")
    flange = last.tcp @ context.cell.settings.tool.inverse()
    return RobotPoseDocument(pose=flange.as_tuple(), age_s=round(age_s, 3))


async def _where(call: Call[ApiContext]) -> RobotPoseDocument:
    return _robot_pose(call.context)


ENDPOINTS = (
    Endpoint(
        *("GET", "/v1/calibration/robot-pose", "Where the robot says that it is", _where),
        *(RobotPoseDocument, "calibration"),
    ),
)
