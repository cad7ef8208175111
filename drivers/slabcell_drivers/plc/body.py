"""How does a simulated robot move and grip?  `WorldBody`: paths of the shipped programs, in a simulated world.

Motions take no time: the world is told the points of the path, so that what is carried goes along and collisions are
seen.
"""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Protocol

from slabcell_drivers.plc.handshake import PlcHandshake
from slabcell_drivers.robot.arm import ArmModel
from slabcell_drivers.robot.frame import Frame

__all__ = ["BodyWorld", "CellGripper", "WorldBody", "WorldGripper"]

APPROACH_MM = 80.0
STEPS = 8
PHOTO = Frame(0.0, -250.0, 350.0, 0.0, 0.0, 180.0)
"""Where the tool waits while a picture is taken; the simulated camera does not see the arm anyway."""
GRIP_TIMEOUT_S = 2.0


class BodyWorld(Protocol):
    """What a robot can do to the world; poses are of the cup's tip, in the robot's root frame."""

    @property
    def vacuum(self) -> bool:
        """Whether the cup holds a slab."""
        ...

    def grip(self, tcp: Frame) -> bool:
        """Turn the suction on."""
        ...

    def release(self, tcp: Frame) -> None:
        """Turn the suction off."""
        ...

    def moved(self, tcp: Frame) -> None:
        """Take note of where the tool is."""
        ...


class Gripper(Protocol):
    """Turns the suction on and off, and feels."""

    async def set(self, tcp: Frame, *, on: bool) -> None:
        """Turn the suction on or off while the tool is at ``tcp``."""
        ...

    async def holds(self) -> bool:
        """Whether a part is felt."""
        ...


class WorldGripper:
    """A gripper on the robot's own I/O."""

    def __init__(self, world: BodyWorld) -> None:
        self._world = world

    async def set(self, tcp: Frame, *, on: bool) -> None:
        """Turn the suction on or off."""
        if on:
            self._world.grip(tcp)
        else:
            self._world.release(tcp)

    async def holds(self) -> bool:
        """Whether a part is felt."""
        return self._world.vacuum


class CellGripper:
    """A gripper on the cell PC's I/O: the PLC wishes through its registers, and reads what is felt."""

    PART_PRESENT = 1

    def __init__(self, handshake: PlcHandshake, *, poll_s: float = 0.02, settle_s: float = GRIP_TIMEOUT_S) -> None:
        self._handshake = handshake
        self._poll_s, self._settle_s = poll_s, settle_s

    async def set(self, tcp: Frame, *, on: bool) -> None:
        """Wish, and poll until the part is felt, or no more; not longer than usual."""
        del tcp  # the valve does not ask where the tool is
        await self._handshake.set_vacuum(on=on)
        deadline_s = asyncio.get_running_loop().time() + self._settle_s
        felt = not on
        while felt is not on and asyncio.get_running_loop().time() < deadline_s:
            await asyncio.sleep(self._poll_s)
            felt = await self.holds()

    async def holds(self) -> bool:
        """Whether a part is felt."""
        return bool(await self._handshake.gripper_state() & self.PART_PRESENT)


class WorldBody:
    """Arm and gripper of one simulated robot."""

    def __init__(
        self,
        world: BodyWorld,
        *,
        pick_base: Frame,
        place_base: Frame,
        tool: Frame,
        arm: ArmModel | None = None,
        gripper: Gripper | None = None,
        pause: Callable[[], Awaitable[None]] | None = None,
    ) -> None:
        """Begin at the photo position.  ``pause`` is awaited at each point of a path."""
        self._world = world
        self._pick_base, self._place_base, self._tool = pick_base, place_base, tool
        self._arm = arm
        self._gripper = gripper or WorldGripper(world)
        self._pause = pause
        self._tcp = PHOTO

    @property
    def tcp(self) -> Frame:
        """Where the tool centre point is, in the robot's root frame."""
        return self._tcp

    def reaches(self, pick: Frame, place: Frame) -> bool:
        """Whether both poses, and the points above them, can be reached."""
        if self._arm is None:
            return True
        poses = (self._pick_base @ pick, self._place_base @ place)
        flanges = (pose @ self._tool.inverse() for at in poses for pose in (at, _above(at)))
        return all(self._arm.reachable(flange) for flange in flanges)

    async def to_photo(self) -> None:
        """Move out of the camera's view."""
        await self._move(PHOTO)

    async def to_pick(self, pick: Frame) -> None:
        """Move from anywhere down to a part."""
        await self._down_to(self._pick_base @ pick)

    async def to_place(self, place: Frame) -> None:
        """Move from above the table down into a slot, if the part is still held above it."""
        target = self._place_base @ place
        await self._move(_above(target))
        if await self.holds():
            await self._move(target)

    async def up(self) -> None:
        """Move straight up."""
        await self._move(_above(self._tcp))

    async def grip(self, *, on: bool) -> None:
        """Turn the suction on or off."""
        await self._gripper.set(self._tcp, on=on)

    async def holds(self) -> bool:
        """Whether the gripper feels a part."""
        return await self._gripper.holds()

    async def _down_to(self, target: Frame) -> None:
        await self._move(_above(target))
        await self._move(target)

    async def _move(self, target: Frame) -> None:
        start = self._tcp.as_tuple()
        turn = [
            _shortest(end - begin) if at >= 3 else end - begin
            for at, (begin, end) in enumerate(zip(start, target.as_tuple(), strict=True))
        ]
        for step in range(1, STEPS + 1):
            share = step / STEPS
            point = Frame(*(begin + share * way for begin, way in zip(start, turn, strict=True)))
            self._tcp = target if step == STEPS else point
            self._world.moved(self._tcp)
            if self._pause is not None:
                await self._pause()


def _above(pose: Frame) -> Frame:
    return pose @ Frame(z_mm=-APPROACH_MM)  # the tool's Z points down


def _shortest(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0
