"""A cell that lays one job, in a process of its own, and says what it answered: one JSON object a line.

The robot's memory is a file beside the ledger, as the robot's own outlives the cell.
"""

import asyncio
import importlib.util
import json
import logging
import sys
from pathlib import Path

import structlog

from slabcell_drivers.robot.protocol import AckState

KIT = Path(__file__).parents[1] / "unit" / "cell" / "conftest.py"


def load_kit():
    spec = importlib.util.spec_from_file_location("cell_kit", KIT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["cell_kit"] = module
    spec.loader.exec_module(module)
    return module


def say(answer, said="", result=0) -> bool:
    print(json.dumps({"code": answer.code, "left": answer.left, "said": said, "result": result}), flush=True)
    return answer.code == 0


async def lay(kit, folder: Path) -> None:
    bench = kit.Bench(folder)
    memory = folder / "robot.json"
    await bench.start()
    robot = bench.robot
    if memory.exists():
        robot.result_id, ack, robot.holds, lying = json.loads(memory.read_text())
        robot.ack, bench.eyes.lying = AckState(ack), set(lying)
        bench.eyes.on_table -= bench.eyes.lying

    async def tell(state: AckState, result_id: int, slot: int) -> bool:
        if state is AckState.PLACED:
            bench.eyes.lying.add(slot)
            bench.eyes.on_table.discard(slot)
        robot.result_id, robot.ack = result_id, state
        robot.holds = state is AckState.GRASPED
        memory.write_text(json.dumps([result_id, int(state), robot.holds, sorted(bench.eyes.lying)]))
        return say(await robot.say(state), state.name.lower(), result_id)

    async def work() -> None:
        greeting = await robot.hello()
        if not say(greeting):
            return
        if greeting.offer is not None and not await tell(AckState.PLACED, robot.result_id, greeting.offer.slot):
            return
        while True:
            answer = await robot.trigger()
            if not say(answer):
                return
            for _ in range(answer.left):
                offered = await robot.next()
                if not say(offered):
                    return
                for state in (AckState.ACCEPTED, AckState.GRASPED, AckState.PLACED):
                    if not await tell(state, offered.offer.result_id, offered.offer.slot):
                        return

    await work()
    await bench.stop()


structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
asyncio.run(lay(load_kit(), Path(sys.argv[1])))
