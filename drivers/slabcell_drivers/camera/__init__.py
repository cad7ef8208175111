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
)

__all__ = [
    "Camera",
    "CameraBusy",
    "CameraConfigError",
    "CameraError",
    "CameraIncomplete",
    "CameraInfo",
    "CameraLost",
    "CameraState",
    "CameraTimeout",
    "ImageFrame",
]
