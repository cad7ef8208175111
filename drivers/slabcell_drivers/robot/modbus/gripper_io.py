"""How is a gripper reached that hangs on the cell PC?  `ModbusGripper`: an I/O coupler with a coil and two inputs.

The vacuum is a coil of the coupler, "part present" and the interlock are inputs.  Nothing is switched before somebody
wishes for it, and a coupler that was away is set as is wished now: a restart of the cell drops no part.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

import structlog
from pymodbus.exceptions import ModbusException

from slabcell_drivers.robot.modbus.client import AnyClient, MakeClient, PollError
from slabcell_drivers.robot.modbus.gripper import state_bits

__all__ = ["GripperAddresses", "ModbusGripper"]

RETRY_S = 0.5

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class GripperAddresses:
    """Where the coupler has what, as it goes over the wire; no interlock counts as closed."""

    unit_id: int = 1
    vacuum_coil: int = 0
    part_present_input: int = 0
    interlock_input: int | None = None


class ModbusGripper:
    """The gripper's I/O: a `PeerGripper`, kept up to date by `run`."""

    def __init__(self, make: MakeClient, addresses: GripperAddresses, *, poll_s: float = 0.02) -> None:
        self._make, self._addresses, self._poll_s = make, addresses, poll_s
        self._changed: list[Callable[[], None]] = []
        self._wished: bool | None = None
        self._set: bool | None = None
        self.part_present = False
        """What the input said last."""
        self.interlock_closed = addresses.interlock_input is None
        self.answers = False
        """Whether the coupler answers."""

    @property
    def state_bits(self) -> int:
        """The io_state register."""
        return state_bits(part_present=self.part_present, interlock_closed=self.interlock_closed, answers=self.answers)

    def wish(self, *, vacuum: bool) -> None:
        """Take note of what the PLC wants; it is done with the next poll."""
        self._wished = vacuum

    def subscribe(self, changed: Callable[[], None]) -> None:
        """Have ``changed`` called after each change of `state_bits`."""
        self._changed.append(changed)

    async def run(self) -> None:
        """Poll the coupler, and connect to it again, until cancelled."""
        while True:
            lost = asyncio.Event()
            client = self._make(lambda connected, lost=lost: None if connected else lost.set())
            self._set = None
            try:
                connected = await client.connect()
                while connected and not lost.is_set():
                    await self._poll(client)
                    await asyncio.sleep(self._poll_s)
            except (PollError, ModbusException, OSError) as error:
                if self.answers:
                    _log.warning("gripper.io_lost", error=str(error))
            finally:
                client.close()
                self._note(part_present=self.part_present, interlock_closed=self.interlock_closed, answers=False)
            await asyncio.sleep(RETRY_S)

    async def _poll(self, client: AnyClient) -> None:
        at, unit = self._addresses, self._addresses.unit_id
        wished = self._wished
        if wished is not None and wished is not self._set:
            response = await client.write_coil(at.vacuum_coil, wished, device_id=unit)
            if response.isError():
                raise PollError(f"coil {at.vacuum_coil}: exception {response.exception_code}")
            self._set = wished
        part_present = await self._input(client, at.part_present_input)
        closed = at.interlock_input is None or await self._input(client, at.interlock_input)
        self._note(part_present=part_present, interlock_closed=closed, answers=True)

    async def _input(self, client: AnyClient, address: int) -> bool:
        response = await client.read_discrete_inputs(address, count=1, device_id=self._addresses.unit_id)
        if response.isError() or not response.bits:
            raise PollError(f"input {address}: exception {response.exception_code}")
        return response.bits[0]

    def _note(self, *, part_present: bool, interlock_closed: bool, answers: bool) -> None:
        before = self.state_bits
        self.part_present, self.interlock_closed, self.answers = part_present, interlock_closed, answers
        if self.state_bits != before:
            for changed in self._changed:
                changed()
