"""Which light shines on the table?  ``[light]`` of the cell's configuration, and the camera with its light."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from slabcell.catalogue import Fault
from slabcell.errors import ConfigurationError
from slabcell.service.links import LinkName, Links, LinkState
from slabcell.toml_file import TomlTable
from slabcell_drivers.camera import Camera
from slabcell_drivers.light import (
    LightConfigError,
    LightMode,
    LightPlan,
    LightSetting,
    LitCamera,
    Preset,
    PresetError,
    SerialLight,
    load_presets,
)

if TYPE_CHECKING:  # whoever reads a configuration, such as the pages, does without the vision that alarms lead to
    from slabcell.cell.alarms import Alarms

__all__ = ["LightConfig", "LightReport", "known_presets", "make_light", "with_light"]


class ChannelConfig(TomlTable):
    """One channel of the controller."""

    channel: Annotated[int, Field(ge=1, le=64)] = Field(default=1, description="number of the channel, from 1")
    intensity_percent: Annotated[float, Field(ge=0, le=1000)] = Field(default=100.0, description="how bright")
    strobe_width_us: Annotated[float, Field(gt=0, le=1_000_000)] | None = Field(
        default=None, description="length of the pulse, for mode strobe"
    )
    strobe_delay_us: Annotated[float, Field(ge=0, le=1_000_000)] = Field(
        default=10.0, description="from the trigger to the pulse"
    )

    def setting(self) -> LightSetting:
        """Return what the drivers know."""
        return LightSetting(self.channel, self.intensity_percent, self.strobe_width_us, self.strobe_delay_us)


class LightConfig(TomlTable):
    """``[light]``: a strobe or dimmer controller on a serial line; without this table the cell leaves lights alone."""

    url: str = Field(max_length=200, description="/dev/ttyUSB1, socket://HOST:PORT or rfc2217://HOST:PORT")
    preset: str = Field(max_length=60, description="family of the controller; `slabcell light list` shows them")
    presets: Path | None = Field(default=None, description="file with families of your own, relative to this file")
    baud_rate: Annotated[int, Field(ge=300, le=1_000_000)] | None = Field(
        default=None, description="of the line; the default is the family's"
    )
    mode: LightMode = Field(default=LightMode.CONTINUOUS, description="continuous, with-trigger or strobe")
    channels: list[ChannelConfig] = Field(default=[ChannelConfig()], min_length=1, max_length=64)
    settle_ms: Annotated[float, Field(ge=0, le=5000)] = Field(
        default=20.0, description="with-trigger: between switching on and the picture"
    )
    trigger_by_command: bool = Field(
        default=False, description="strobe: start the pulse by a command, where the camera's output is not wired"
    )


class LightReport:
    """Tells the cell's alarms how the light is; they may come later than the light."""

    def __init__(self) -> None:
        self._alarms: Alarms | None = None
        self._links: Links | None = None
        self._known = False
        self._trouble = ""

    def tell_to(self, alarms: Alarms, links: Links) -> None:
        """Tell these alarms and links from now on."""
        self._alarms, self._links = alarms, links
        if self._known:
            self.told(self._trouble)

    def told(self, trouble: str) -> None:
        """Take note of trouble, or of none."""
        self._trouble, self._known = trouble, True
        if self._alarms is None or self._links is None:
            return
        self._links.set(LinkName.LIGHT, LinkState.DOWN if trouble else LinkState.UP, trouble)
        if trouble:
            self._alarms.come(Fault.LIGHT_LOST, trouble)
        else:
            self._alarms.cease(Fault.LIGHT_LOST)


def known_presets(own: Path | None = None) -> dict[str, Preset]:
    """Return the shipped families, and those of a file.  Raises ConfigurationError."""
    try:
        with as_file(files("slabcell") / "data" / "config" / "lights.toml") as path:
            presets = load_presets(path)
        return {**presets, **load_presets(own)} if own else presets
    except PresetError as error:
        raise ConfigurationError(str(error)) from error


def make_light(url: str, preset: str, *, own: Path | None = None, baud_rate: int | None = None) -> SerialLight:
    """Return a light, not yet open.  Raises ConfigurationError."""
    presets = known_presets(own)
    if preset not in presets:
        msg = f"there is no light family {preset!r}; known are {', '.join(sorted(presets))}"
        raise ConfigurationError(msg)
    try:
        return SerialLight(url, presets[preset], baud_rate=baud_rate)
    except LightConfigError as error:
        raise ConfigurationError(str(error)) from error


def with_light(camera: Camera, config: LightConfig | None, report: LightReport) -> Camera:
    """Return the camera, with its light if it has one.  Raises ConfigurationError."""
    if config is None:
        return camera
    light = make_light(config.url, config.preset, own=config.presets, baud_rate=config.baud_rate)
    settings = tuple(channel.setting() for channel in config.channels)
    if config.mode is LightMode.STROBE and any(setting.strobe_width_us is None for setting in settings):
        msg = '[light] mode = "strobe" needs strobe_width_us in each of channels'
        raise ConfigurationError(msg)
    preset = known_presets(config.presets)[config.preset]
    try:
        for setting in settings:
            preset.commands_for(setting)
        if config.trigger_by_command:
            preset.trigger_command(settings[0].channel)
    except LightConfigError as error:
        raise ConfigurationError(f"[light] {error}") from error
    plan = LightPlan(config.mode, settings, config.settle_ms / 1000.0, config.trigger_by_command)
    return LitCamera(camera, light, plan, report.told)
