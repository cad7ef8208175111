"""Where are the registers, seen from a PLC?  `RegisterPort`: in the cell, which the PLC polls, or in its own memory."""

from typing import Protocol

from slabcell_drivers.robot.modbus.image import RegisterImage

__all__ = ["OwnRegisters", "RegisterPort"]


class RegisterPort(Protocol):
    """Words at addresses, as the PLC counts.  A call that fails raises OSError."""

    @property
    def connected(self) -> bool:
        """Whether the registers can be reached at all."""
        ...

    async def connect(self) -> None:
        """Connect anew."""
        ...

    async def read(self, address: int, count: int) -> list[int]:
        """Return words."""
        ...

    async def write(self, address: int, words: list[int]) -> None:
        """Write words."""
        ...


class OwnRegisters:
    """The PLC's own memory, in which the cell reads and writes."""

    connected = True

    def __init__(self, image: RegisterImage) -> None:
        self._image = image

    async def connect(self) -> None:
        """Nothing is to be connected."""

    async def read(self, address: int, count: int) -> list[int]:
        """Return words."""
        return self._image.peek(address, count)

    async def write(self, address: int, words: list[int]) -> None:
        """Write words."""
        self._image.put(address, words)
