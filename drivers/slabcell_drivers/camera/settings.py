"""How is a GenICam camera to be set, and what did it do so far?  Values that every real driver shares."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from slabcell_drivers.camera.protocol import CameraConfigError

__all__ = ["CameraSettings", "CameraStatistics", "FeatureValue"]

FeatureValue = bool | int | float | str
MIN_HEARTBEAT_MS: Final = 1500


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """What a cell wants of its camera; None leaves what the camera has.  Everything set is read back.

    ``packet_size`` None has camera and network find the largest that passes.  ``packet_delay_ns`` None is no delay
    where the kernel gives a socket buffer for a whole frame, and 50 us a packet where it does not.  ``features`` are
    set last, by their GenICam names.  ``packet_socket`` receives below the kernel's UDP where the process may
    (CAP_NET_RAW); two such streams on the loopback interface stall each other now and then.
    """

    width: int | None = None
    height: int | None = None
    offset_x: int | None = None
    offset_y: int | None = None
    pixel_format: str | None = None
    exposure_us: float | None = None
    gain_db: float | None = None
    packet_size: int | None = None
    packet_delay_ns: int | None = None
    heartbeat_ms: int = 3000
    socket_buffer_bytes: int = 16 << 20
    resend: bool = True
    packet_timeout_us: int = 20_000
    frame_retention_us: int = 100_000
    buffers: int = 6
    packet_socket: bool = False
    features: Mapping[str, FeatureValue] = field(default_factory=dict[str, FeatureValue])

    def __post_init__(self) -> None:
        if not MIN_HEARTBEAT_MS <= self.heartbeat_ms <= 600_000:
            raise CameraConfigError(
                f"heartbeat_ms = {self.heartbeat_ms} is refused: it must be {MIN_HEARTBEAT_MS} to 600000; libraries"
                " show themselves to the camera once a second, and it must miss more than one before it lets go"
            )
        if not 2 <= self.buffers <= 1000:
            raise CameraConfigError(f"buffers = {self.buffers} is refused: it must be 2 to 1000")


@dataclass(slots=True)
class CameraStatistics:
    """What happened since the driver was made; counts only grow."""

    frames: int = 0
    incomplete: int = 0
    timeouts: int = 0
    stale: int = 0
    gaps: int = 0
    retries: int = 0
    restarts: int = 0
    reconnects: int = 0
    underruns: int = 0
    packets_resent: int = 0
    packets_missing: int = 0
    latency_s: float = 0.0
    """From trigger to pixels, of the newest frame."""
    socket_buffer_bytes: int = 0
    """What the kernel gave the stream's socket, read back; 0 if that is not known."""

    def since(self, before: "CameraStatistics") -> "CameraStatistics":
        """Return what was counted after ``before``, a copy of an earlier moment."""
        counts = ("frames", "incomplete", "timeouts", "stale", "gaps", "retries", "restarts", "reconnects", "underruns",
                  "packets_resent", "packets_missing")  # fmt: skip
        return replace(self, **{name: getattr(self, name) - getattr(before, name) for name in counts})
