"""How does a family of light controllers speak?  `Preset`, from data; commands to bytes and replies to values; pure."""

import re
import string
import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from slabcell_drivers.light.protocol import LightConfigError, LightRefused, LightSetting

__all__ = ["Preset", "PresetError", "load_presets"]

SCHEMA = "slabcell.lights/1"
MAX_BYTES = 1 << 18
MAX_REPLY_BYTES = 512
MAX_PULSE_US = 1_000_000.0
_FIELDS = {"channel", "percent", "level", "width_ms", "delay_ms", "width_code", "on"}
_Command = Annotated[str, Field(min_length=1, max_length=80)]
_Commands = _Command | Annotated[list[_Command], Field(min_length=1, max_length=8)]


class PresetError(ValueError):
    """A file of presets is wrong; the message names file, family, key and value."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _CommandTable(_Table):
    check: _Command
    on: _Commands
    off: _Commands
    strobe: _Commands | None = None
    trigger: _Command | None = None

    @field_validator("*")
    @classmethod
    def _known_fields(cls, value: str | list[str] | None) -> str | list[str] | None:
        for command in [value] if isinstance(value, str) else value or []:
            if not command.isascii():
                raise ValueError(f"{command!r}: ASCII only")
            for _, name, _, _ in string.Formatter().parse(command):
                if name is not None and name not in _FIELDS:
                    raise ValueError(f"{command!r}: {{{name}}} is unknown; known are {', '.join(sorted(_FIELDS))}")
        return value


class Preset(_Table):
    """One family.  `commands_for` gives what to send, `judge` what a reply means."""

    name: str
    title: str
    source: str
    baud_rate: Annotated[int, Field(ge=300, le=1_000_000)] | None = None
    command_end: Annotated[str, Field(min_length=1, max_length=4)]
    reply_end: Annotated[str, Field(min_length=1, max_length=4)]
    reply: str
    checksum: Literal["none", "sum8-hex"] = "none"
    first_channel: Annotated[int, Field(ge=0, le=1)]
    channels: Annotated[int, Field(ge=1, le=64)]
    levels: Annotated[int, Field(ge=1, le=65_535)] = 100
    reply_timeout_ms: Annotated[int, Field(ge=10, le=10_000)]
    pause_ms: Annotated[int, Field(ge=0, le=1000)] = 0
    warnings: tuple[str, ...] = ()
    errors: dict[str, str] = {}
    limits: tuple[tuple[float, float], ...] = ()
    widths_us: tuple[float, ...] = ()
    commands: _CommandTable

    @field_validator("reply")
    @classmethod
    def _compiles(cls, value: str) -> str:
        try:
            groups = re.compile(value).groupindex
        except re.error as error:
            raise ValueError(f"is no regular expression: {error}") from error
        if "error" not in groups:
            raise ValueError("needs a group (?P<error>...) for the controller's error code")
        return value

    # ----------------------------------------------------------------------------------------------------- commands

    def check_command(self, channel: int, *, on: bool) -> bytes:
        """Return what the controller answers without changing anything."""
        return self._encoded(self.commands.check, LightSetting(channel), on=on)

    def commands_for(self, setting: LightSetting) -> list[bytes]:
        """Return what sets a channel.  Raises LightConfigError that names value and range."""
        self._check_range(setting)
        if setting.strobe_width_us is None:
            return self._all(self.commands.on, setting)
        if self.commands.strobe is None:
            raise LightConfigError(f"{self.title}: knows no strobe; leave strobe_width_us out")
        return self._all(self.commands.strobe, setting)

    def off_commands(self, channel: int) -> list[bytes]:
        """Return what turns a channel off.  Raises LightConfigError."""
        self._check_range(LightSetting(channel))
        return self._all(self.commands.off, LightSetting(channel))

    def trigger_command(self, channel: int) -> bytes:
        """Return what makes one pulse.  Raises LightConfigError."""
        self._check_range(LightSetting(channel))
        if self.commands.trigger is None:
            raise LightConfigError(f"{self.title}: knows no trigger by command; wire the camera's output to its input")
        return self._encoded(self.commands.trigger, LightSetting(channel), on=True)

    def _check_range(self, setting: LightSetting) -> None:
        if not 1 <= setting.channel <= self.channels:
            raise LightConfigError(f"{self.title}: channel {setting.channel} is outside 1 to {self.channels}")
        width_us, percent = setting.strobe_width_us, setting.intensity_percent
        strongest = max((limit[0] for limit in self.limits), default=100.0) if width_us is not None else 100.0
        if not 0.0 <= percent <= strongest:
            raise LightConfigError(f"{self.title}: intensity {percent:g} % is outside 0 % to {strongest:g} %")
        if width_us is None:
            return
        if self.widths_us and width_us not in self.widths_us:
            known = ", ".join(f"{width:g}" for width in self.widths_us)
            raise LightConfigError(f"{self.title}: a pulse of {width_us:g} us; it has {known} us")
        longest_ms = next((limit_ms for up_to, limit_ms in self.limits if percent <= up_to), None)
        longest_us = MAX_PULSE_US if longest_ms is None else 1000.0 * longest_ms
        if not 1.0 <= width_us <= longest_us:
            raise LightConfigError(
                f"{self.title}: a pulse of {width_us:g} us at {percent:g} % is outside 1 us to {longest_us:g} us"
            )
        if not 0.0 <= setting.strobe_delay_us <= MAX_PULSE_US:
            raise LightConfigError(
                f"{self.title}: a delay of {setting.strobe_delay_us:g} us is outside 0 to {MAX_PULSE_US:g} us"
            )

    def _all(self, commands: str | list[str], setting: LightSetting) -> list[bytes]:
        listed = [commands] if isinstance(commands, str) else commands
        return [self._encoded(command, setting, on=True) for command in listed]

    def _encoded(self, command: str, setting: LightSetting, *, on: bool) -> bytes:
        width_us = setting.strobe_width_us or 0.0
        text = command.format(
            channel=setting.channel - 1 + self.first_channel,
            percent=f"{setting.intensity_percent:g}",
            level=round(setting.intensity_percent / 100.0 * self.levels),
            width_ms=f"{width_us / 1000.0:g}",
            delay_ms=f"{setting.strobe_delay_us / 1000.0:g}",
            width_code=self.widths_us.index(width_us) + 1 if width_us in self.widths_us else 0,
            on=int(on),
        )
        return (text + self._sum(text) + self.command_end).encode("ascii")

    # ------------------------------------------------------------------------------------------------------ replies

    def judge(self, reply: str, command: bytes) -> str:
        """Return the text of a reply, without its end.  Raises LightRefused, or ValueError if it is no reply."""
        if self.checksum != "none":
            reply, found = reply[:-2], reply[-2:]
            if found.upper() != self._sum(reply):
                raise ValueError(f"checksum {found!r}, and the characters add up to {self._sum(reply)}")
        match = re.fullmatch(self.reply, reply)
        if match is None:
            raise ValueError("no reply of this family")
        code = match.group("error")
        if code is not None and code not in self.warnings:
            meaning = self.errors.get(code, "see the controller's manual")
            sent = command.decode("ascii").strip()
            raise LightRefused(f"{self.title}: error {code} to {sent!r}: {meaning}")
        return reply.strip()

    def _sum(self, text: str) -> str:
        return f"{sum(text.encode('ascii', 'replace')) % 256:02X}" if self.checksum == "sum8-hex" else ""


def load_presets(path: Path) -> dict[str, Preset]:
    """Return the families of a file by name.  Raises PresetError with a line for each thing that is wrong."""
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise PresetError(f"{path}: cannot be read: {error.strerror}") from error
    if len(raw) > MAX_BYTES:
        raise PresetError(f"{path}: is larger than {MAX_BYTES >> 10} KiB")
    try:
        document = tomllib.loads(raw.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise PresetError(f"{path}: is not TOML in UTF-8: {error}") from error
    if document.pop("schema", None) != SCHEMA:
        raise PresetError(f'{path}: schema is not "{SCHEMA}"')
    presets: dict[str, Preset] = {}
    for name, table in document.items():
        if not isinstance(table, dict):
            raise PresetError(f"{path}: {name} = {table!r}: must be a table [{name}]")
        try:
            presets[name] = Preset.model_validate({"name": name, **table})
        except ValidationError as error:
            lines = [f"{path}: [{name}] {'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()]
            raise PresetError("\n".join(lines)) from error
    return presets
