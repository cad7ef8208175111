"""How does a light controller behave, without one?  `SimulatedLight` in one process, `SimulatedController` on a line.

The controller understands the commands of a preset and nothing else; it answers what the families' manuals say it
answers.  Faults are set as attributes.
"""

import asyncio
import contextlib
import os
import re
import string
import tty
from collections.abc import Callable
from typing import Self

from slabcell_drivers.light.presets import Preset
from slabcell_drivers.light.protocol import LightInfo, LightLost, LightSetting, LightState

__all__ = ["SimulatedController", "SimulatedLight"]

READ_BYTES = 4096
MAX_COMMAND_BYTES = 256
_PATTERNS = {"percent": r"[0-9.]+", "width_ms": r"[0-9.]+", "delay_ms": r"[0-9.]+"}


class SimulatedLight:
    """A `Light` without any wire; what it shines is in ``shining``, by channel."""

    def __init__(self, preset: Preset) -> None:
        self._preset = preset
        self._state = LightState.CLOSED
        self.unplugged = False
        """While true, the controller does not answer."""
        self.shining: dict[int, LightSetting] = {}
        self.triggers = 0

    @property
    def state(self) -> LightState:
        """Where the controller stands now."""
        return self._state

    async def open(self) -> LightInfo:
        """Connect."""
        self._reach(opening=True)
        return LightInfo(self._preset.title, "simulated")

    async def on(self, setting: LightSetting) -> None:
        """Have a channel shine, or pulse with each trigger."""
        self._preset.commands_for(setting)
        self._reach()
        self.shining[setting.channel] = setting

    async def off(self, channel: int) -> None:
        """Turn a channel off."""
        self._preset.off_commands(channel)
        self._reach()
        self.shining.pop(channel, None)

    async def trigger(self, channel: int) -> None:
        """Pulse once."""
        self._preset.trigger_command(channel)
        self._reach()
        self.triggers += 1

    async def check(self) -> None:
        """See that the controller answers."""
        self._reach()

    async def close(self) -> None:
        """Give the line back."""
        self._state = LightState.CLOSED

    def _reach(self, *, opening: bool = False) -> None:
        if self._state is LightState.CLOSED and not opening:
            raise LightLost("open the light before it is used")
        if self.unplugged:
            self._state = LightState.CLOSED if opening else LightState.LOST
            raise LightLost("the simulated controller does not answer; plug it in again")
        self._state = LightState.READY


class SimulatedController:
    """Speaks a preset on a pseudo-terminal, ``device``, while its context lasts; or on bytes, through `feed`."""

    def __init__(self, preset: Preset) -> None:
        self._preset = preset
        self._commands = _patterns(preset)
        self._buffer = b""
        self._master = self._slave = -1
        self.device = ""
        self.silent = False
        """While true, nothing is answered."""
        self.garble = 0
        """So many replies are still to be damaged on their way."""
        self.refuse = ""
        """An error code with which every command is refused, if not empty."""
        self.received: list[str] = []
        """Commands as they came, without end and checksum."""

    async def __aenter__(self) -> Self:
        """Make the line."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)
        asyncio.get_running_loop().add_reader(self._master, self._readable)
        return self

    async def __aexit__(self, *_: object) -> None:
        """Take the line away."""
        self.unplug()

    def unplug(self) -> None:
        """Take the line away, as when an adapter is pulled out.  May be called twice."""
        if self._master >= 0:
            asyncio.get_running_loop().remove_reader(self._master)
            os.close(self._master)
            os.close(self._slave)
            self._master = self._slave = -1

    def feed(self, data: bytes) -> bytes:
        """Return what is answered to these bytes."""
        end = self._preset.command_end.encode("ascii")
        self._buffer = (self._buffer + data)[-MAX_COMMAND_BYTES:]
        answers = b""
        while end in self._buffer:
            command, _, self._buffer = self._buffer.partition(end)
            answers += self._answer(command.decode("ascii", "replace"))
        return answers

    def _answer(self, command: str) -> bytes:
        if self.silent:
            return b""
        body, code = command, self.refuse
        if self._preset.checksum != "none":
            body = command[:-2]
            if command[-2:] != _sum8(body):
                code = code or "02"
        if not code and not any(re.fullmatch(pattern, body) for pattern in self._commands):
            code = "2" if self._preset.checksum == "none" else "01"
        if not code:
            self.received.append(body)
        answer = _ANSWERS[self._preset.checksum](body, code, self._preset)
        if self.garble:
            self.garble -= 1
            answer = bytes((answer[0] ^ 0x15,)) + answer[1:-2] + answer[-1:]
        return answer

    def _readable(self) -> None:
        with contextlib.suppress(OSError):  # nobody has the other end open
            answer = self.feed(os.read(self._master, READ_BYTES))
            if answer:
                os.write(self._master, answer)


def _prompting(body: str, code: str, preset: Preset) -> bytes:
    """Answer as Gardasoft's controllers: text, an error or nothing, and a prompt."""
    text = f"Err {code}\r\n" if code else ("RT420-20 (HW02) V031\r\n" if body == "VR" else "")
    return (text + preset.reply_end).encode("ascii")


def _summed(body: str, code: str, preset: Preset) -> bytes:
    """Answer as VAL's controllers: header, channel, O or N with a code, id, checksum."""
    text = f"{body[:3]}{f'N{code}' if code else 'O'}00"
    return (text + _sum8(text) + preset.reply_end).encode("ascii")


_ANSWERS: dict[str, Callable[[str, str, Preset], bytes]] = {"none": _prompting, "sum8-hex": _summed}


def _sum8(text: str) -> str:
    return f"{sum(text.encode('ascii', 'replace')) % 256:02X}"


def _patterns(preset: Preset) -> list[str]:
    """Return a regular expression for each command of a preset."""
    commands = preset.commands
    listed = [commands.check, commands.on, commands.off, commands.strobe, commands.trigger]
    flat = [item for entry in listed if entry for item in ([entry] if isinstance(entry, str) else entry)]
    return ["".join(_piece(*part) for part in string.Formatter().parse(command)) for command in flat]


def _piece(literal: str, field: str | None, spec: str | None, _conversion: str | None) -> str:
    text = re.escape(literal)
    if field is None:
        return text
    digits = f"[0-9]{{{int(spec)}}}" if spec else _PATTERNS.get(field, "[0-9]+")
    return text + digits
