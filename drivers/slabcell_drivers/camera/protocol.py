"""What is a camera to the cell?  The `Camera` protocol, the frame it delivers, and the errors it may raise."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np
import numpy.typing as npt

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
    "CameraUnlit",
    "ImageFrame",
    "Pixels",
]


Pixels = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
"""A picture: (height, width), or (height, width, 3) in BGR order.  16-bit values are at full scale: white is 65535."""


class CameraError(Exception):
    """Root of what a camera may raise; the message names the camera and what to do."""


class CameraTimeout(CameraError):
    """No complete frame came before the deadline."""


class CameraIncomplete(CameraError):
    """A frame came with packets missing or with the wrong size; its pixels are not delivered."""


class CameraLost(CameraError):
    """The camera no longer answers, or was never there."""


class CameraBusy(CameraError):
    """Another client controls the camera."""


class CameraConfigError(CameraError):
    """A setting was refused; the message names the setting, the value and the range."""


class CameraUnlit(CameraError):
    """No picture, because its light could not be set."""


class CameraState(StrEnum):
    """Where a camera stands."""

    CLOSED = "closed"
    OPENING = "opening"
    READY = "ready"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """Which camera this is, and what its pictures look like."""

    vendor: str
    model: str
    serial: str
    width: int
    height: int
    pixel_format: str


@dataclass(frozen=True, slots=True, eq=False)
class ImageFrame:
    """One complete picture and when it was taken.

    ``pixels`` owns its memory and is not written again.  The times are of the host's monotonic clock, in seconds;
    ``device_timestamp_ns`` is the camera's own clock where it has one.  ``said`` is what else the producer says of the
    frame, under the producer's own names.
    """

    pixels: Pixels
    pixel_format: str
    frame_id: int
    triggered_s: float
    received_s: float
    device_timestamp_ns: int | None = None
    said: Mapping[str, str | int | float] = field(default_factory=dict[str, str | int | float])


class Camera(Protocol):
    """A camera that takes one picture for each trigger.  Every call ends by its deadline."""

    @property
    def state(self) -> CameraState:
        """Where the camera stands now."""
        ...

    async def open(self, timeout_s: float) -> CameraInfo:
        """Connect, take control and apply the settings.  Raises `CameraError`."""
        ...

    async def snap(self, timeout_s: float) -> ImageFrame:
        """Trigger, and return the complete frame that was exposed after this call began.  Raises `CameraError`."""
        ...

    async def close(self) -> None:
        """Give the camera back; may be called twice."""
        ...
