"""Starts cells in processes of their own, quickly, so that a test can kill them: one line in, one process out.

A line on stdin names the Unix socket that the cell shall connect to and the folder of its ledger; the answer is the
process id.  The cell then reads requests from the socket, one JSON object a line, and writes its answers.
"""

import asyncio
import importlib.util
import json
import logging
import os
import signal
import sys
from pathlib import Path

import structlog

from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.protocol import AckState, Request, RequestType, RobotStatus

KIT = Path(__file__).parents[1] / "unit" / "cell" / "conftest.py"


def load_kit():
    spec = importlib.util.spec_from_file_location("cell_kit", KIT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["cell_kit"] = module
    spec.loader.exec_module(module)
    return module


async def serve(kit, socket: str, folder: Path) -> None:
    reader, writer = await asyncio.open_unix_connection(socket)
    loop = asyncio.get_running_loop()
    ledger = await Ledger.open(folder / "ledger.sqlite")
    eyes = kit.ScriptedEyes()
    cell = Cell(
        kit.ScriptedCamera(loop.time),
        kit.make_calibration(),
        kit.make_recipe(),
        arm=KR3_R540,
        settings=kit.make_settings(attempts_per_slot=10_000),
        ledger=ledger,
        eyes=eyes,
        clock=loop.time,
    )
    await cell.start()
    while line := await reader.readline():
        said = json.loads(line)
        eyes.on_table, eyes.lying = set(said["on_table"]), set(said["lying"])
        answer = await cell.handle(
            Request(
                RequestType[said["type"]],
                said["session"],
                said["sequence"],
                ack_result_id=said["result_id"],
                ack_state=AckState(said["ack"]),
                status=RobotStatus(gripper_holds_part=said["holds"]),
            )
        )
        offer = {"result_id": answer.offer.result_id, "slot": answer.offer.slot} if answer.offer else None
        words = {"session": answer.session, "code": answer.code, "left": answer.left, "offer": offer}
        writer.write(json.dumps(words).encode() + b"\n")
        await writer.drain()
    writer.close()
    await cell.stop()
    await ledger.close()


def main() -> None:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    kit = load_kit()
    for line in sys.stdin:
        socket, folder = line.rstrip("\n").split("\t")
        child = os.fork()
        if child == 0:
            sys.stdin.close()
            asyncio.run(serve(kit, socket, Path(folder)))
            os._exit(0)
        sys.stdout.write(f"{child}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
