"""What is a light to the cell?  The `Light` protocol, its settings, and the errors it may raise."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

__all__ = [
    "Light",
    "LightConfigError",
    "LightError",
    "LightInfo",
    "LightLost",
    "LightRefused",
    "LightSetting",
    "LightState",
]


class LightError(Exception):
    """Root of what a light may raise; the message names the controller and what to do."""


class LightLost(LightError):  # noqa: N818 - as CameraLost
    """The controller no longer answers, or was never there."""


class LightRefused(LightError):  # noqa: N818 - the controller's own word
    """The controller answered with an error; the message holds its words."""


class LightConfigError(LightError):
    """A value outside its range, or something that this controller cannot do."""


class LightState(StrEnum):
    """Where a light stands."""

    CLOSED = "closed"
    READY = "ready"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class LightInfo:
    """Which controller this is, in its own words as far as it has any."""

    family: str
    identity: str


@dataclass(frozen=True, slots=True)
class LightSetting:
    """How one channel shines: steadily, or in pulses of ``strobe_width_us`` that the camera's signal starts."""

    channel: int = 1
    intensity_percent: float = 100.0
    strobe_width_us: float | None = None
    strobe_delay_us: float = 10.0


class Light(Protocol):
    """A light controller.  Channels count from 1.  Every call ends by its deadline."""

    @property
    def state(self) -> LightState:
        """Where the controller stands now."""
        ...

    async def open(self) -> LightInfo:
        """Connect, and see that the controller answers.  Raises `LightError`."""
        ...

    async def on(self, setting: LightSetting) -> None:
        """Have a channel shine, or pulse with each trigger.  Raises `LightError`; nothing has changed then."""
        ...

    async def off(self, channel: int) -> None:
        """Turn a channel off.  Raises `LightError`."""
        ...

    async def trigger(self, channel: int) -> None:
        """Have a channel that is set to strobe pulse once, without the camera's signal.  Raises `LightError`."""
        ...

    async def check(self) -> None:
        """See that the controller answers; one that was lost is set as it was before.  Raises `LightError`."""
        ...

    async def close(self) -> None:
        """Give the line back; the light stays as it is.  May be called twice."""
        ...
