"""Cameras: the protocol (`protocol`) and one module for each way to get a picture."""

from slabcell_drivers.camera.protocol import (
    Camera,
    CameraBusy,
    CameraConfigError,
    CameraError,
    CameraIncomplete,
    CameraInfo,
    CameraLost,
    CameraState,
    CameraTimeout,
    ImageFrame,
    Pixels,
)
from slabcell_drivers.camera.replay import ReplayCamera, ReplayMode
from slabcell_drivers.camera.simulated import CameraFault, SimulatedCamera

__all__ = [
    "Camera",
    "CameraBusy",
    "CameraConfigError",
    "CameraError",
    "CameraFault",
    "CameraIncomplete",
    "CameraInfo",
    "CameraLost",
    "CameraState",
    "CameraTimeout",
    "ImageFrame",
    "Pixels",
    "ReplayCamera",
    "ReplayMode",
    "SimulatedCamera",
]
