"""A simulated cell as a process: its daemon lives, its robot lays when told to.  Commands come on standard input.

``lay`` runs one job to its end, ``link`` says where a robot connects, ``strew`` brings new slabs, ``off`` takes the
camera away, ``on`` brings it back, ``connect`` is a robot that says nothing, until ``disconnect``; each is answered
with one line.
"""

import asyncio
import importlib.util
import sys
from pathlib import Path

from slabcell.calibration import Calibration
from slabcell.logs import log_to_file
from slabcell.service.demo import read_demo_parts
from slabcell.service.demo_cell import DemoCellOptions, open_demo_cell
from slabcell.service.simulated import SimulatedCell
from slabcell_drivers.camera.simulated import CameraFault

KIT = Path(__file__).parents[1] / "integration" / "daemon" / "conftest.py"


class Quiet:
    """Says nothing of how far it is."""

    def stage(self, name: str, total: int | None = None) -> None:
        pass

    def advance(self, text: str) -> None:
        pass


def calibration(scene: str, seed: int) -> Calibration:
    """Return the calibration that the world's truth gives: making one takes too long here."""
    spec = importlib.util.spec_from_file_location("daemon_kit", KIT)
    assert spec is not None
    assert spec.loader is not None
    kit = importlib.util.module_from_spec(spec)
    sys.modules["daemon_kit"] = kit
    spec.loader.exec_module(kit)
    parts = read_demo_parts(scene)
    return kit.true_calibration(SimulatedCell(parts.scene, seed, parts.arm, parts.config.robot.tool.to_frame()))


async def main(out: Path, scene: str, seed: int, speed: float | None) -> None:
    """Serve commands until standard input ends."""
    options = DemoCellOptions(scene, seed, out, speed, calibration(scene, seed))
    robot: asyncio.StreamWriter | None = None
    async with open_demo_cell(options, Quiet()) as cell:
        say(f"ready {cell.socket}")
        while command := (await asyncio.to_thread(sys.stdin.readline)).strip():
            match command:
                case "lay":
                    result = await cell.lay()
                    say(f"{result.status} {result.message}")
                case "link":
                    say(f"{cell.address[0]} {cell.address[1]}")
                case "strew":
                    cell.strew()
                    say("strewn")
                case "off":
                    cell.simulated.camera.break_with(CameraFault.OFF)
                    say("off")
                case "on":
                    cell.simulated.camera.mend()
                    say("on")
                case "connect":
                    _, robot = await asyncio.open_connection(*cell.address)
                    while not cell.context.robot.connected:  # noqa: ASYNC110 - it has no event
                        await asyncio.sleep(0.01)
                    say("connected")
                case "disconnect" if robot is not None:
                    robot.close()
                    say("disconnected")
                case _:
                    say(f"unknown {command}")


def say(text: str) -> None:
    print(text, flush=True)


if __name__ == "__main__":
    folder, scene_name, seed_text, speed_text = sys.argv[1:]
    log_to_file(Path(folder) / "daemon.log")
    asyncio.run(main(Path(folder), scene_name, int(seed_text), float(speed_text) or None))
