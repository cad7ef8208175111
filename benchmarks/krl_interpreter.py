"""How fast is the software KRC?  Parsing, statements a second, and a job of twelve slabs in virtual time.

``python benchmarks/krl_interpreter.py`` prints lines parsed and statements executed in a second of processor time, for
loops of several kinds, and the wall time of one job of twelve slabs with the shipped programs over EKI on loopback,
without camera.
"""

import asyncio
import logging
import statistics
import time
from pathlib import Path

import structlog

from slabcell_drivers.krc import SoftwareKrc, parse, read_project
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.eki import EkiServer
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import AckState, Answer, Offer, Request, RequestType, ResultCode

KRL = Path(__file__).parents[1] / "krl"
REPEATS = 5
SLABS = 12
LOOPS = {
    "integer arithmetic": "n=n+i*2-1",
    "comparison and branch": "IF (i>5) AND NOT b THEN\nn=n+1\nENDIF",
    "array and structure": "a[1]=a[2]+1\nf.X=f.Y+1.5",
    "call with two parameters": "twice(i,n)",
    "function in an expression": "n=half(i)+1",
    "frame product": "f=f:{X 1,Y 0,Z 0,A 1,B 0,C 0}",
}
SUBPROGRAMS = """DEF twice(a:IN,b:OUT)
INT a,b
b=a+a
END
DEFFCT INT half(a:IN)
INT a
RETURN a/2
ENDFCT
"""


def statements_per_second(body: str, turns: int = 20000) -> float:
    """Return the median over repeats."""
    data = "DEFDAT t\nINT n=0\nBOOL b=FALSE\nINT a[2]\na[2]=1\nFRAME f={X 0,Y 0,Z 0,A 0,B 0,C 0}\nENDDAT\n"
    program = f"DEF t()\nINT i\nFOR i=1 TO {turns}\n{body}\nENDFOR\nEND\n{SUBPROGRAMS}"
    speeds: list[float] = []
    for _ in range(REPEATS):
        krc = SoftwareKrc({"t.src": program.encode(), "t.dat": data.encode()}, robot=KR3_R540)
        begin = time.process_time()
        result = krc.run("t", max_wall_s=60)
        speeds.append(result.statements / (time.process_time() - begin))
        assert result.status == "done", result
    return statistics.median(speeds)


def lines_per_second() -> float:
    """Return the median over repeats of parsing the shipped programs."""
    sources = read_project(KRL)
    lines = sum(source.count(b"\n") for source in sources.values())
    speeds: list[float] = []
    for _ in range(REPEATS):
        begin = time.process_time()
        for name, source in sources.items():
            assert not parse(source, name).diagnostics
        speeds.append(lines / (time.process_time() - begin))
    return statistics.median(speeds)


class Cell:
    """Offers twelve pairs, one picture for all."""

    def __init__(self) -> None:
        self.left = list(range(101, 101 + SLABS))
        self.trigger = 0

    async def __call__(self, request: Request) -> Answer:
        """Answer one request."""
        offer = None
        code = ResultCode.OK
        if request.type is RequestType.TRIGGER:
            self.trigger = request.sequence
            code = ResultCode.OK if self.left else ResultCode.JOB_COMPLETE
        elif request.type is RequestType.NEXT:
            number = self.left[0] - 100
            pick = Frame(200 + 15 * number, -200 + 10 * number, 10, 7 * number, 0, 180)
            place = Frame(200 + 12 * number, 100 + 5 * number, 10, -5 * number, 0, 180)
            offer = Offer(self.left[0], 0, 0, pick, place, 1.0)
        elif request.type is RequestType.ACK and request.ack_state is AckState.PLACED:
            self.left.remove(request.ack_result_id)
        return Answer(
            session=1,
            sequence=request.sequence,
            acknowledges=request.sequence,
            code=code,
            left=len(self.left) if self.trigger else 0,
            trigger_sequence=self.trigger,
            offer=offer,
        )


class Gripper:
    """Holds a part whenever the vacuum is on."""

    krc: SoftwareKrc

    def output_changed(self, index: int, value: bool, tcp: Frame) -> None:  # noqa: FBT001  # a bit is a value
        """Answer the vacuum with the sensor."""
        del tcp
        if index == 1:
            self.krc.set_input(1, value)

    def moved(self, tcp: Frame) -> None:
        """Take no notice of the way."""


async def job() -> tuple[float, float, int]:
    """Return wall seconds, virtual seconds and statements of one job."""
    link, gripper = EkiServer("127.0.0.1", 0), Gripper()
    await link.start(Cell())
    try:
        with SoftwareKrc(
            read_project(KRL),
            robot=KR3_R540,
            eki_configs={"SlabCell": (KRL / "SlabCell.xml").read_bytes()},
            eki_addresses={"SlabCell": link.address},
            io=gripper,
        ) as krc:
            gripper.krc = krc
            for name, frame in (
                ("TOOL_DATA[1]", Frame(z_mm=200.0)),
                ("BASE_DATA[1]", Frame()),
                ("BASE_DATA[2]", Frame()),
            ):
                krc.set_data("", name, frame)
            begin = time.perf_counter()
            result = await asyncio.to_thread(krc.run, "SlabCell", max_wall_s=60)
            wall_s = time.perf_counter() - begin
    finally:
        await link.stop()
    assert result.status == "done", (result, krc.messages)
    return wall_s, result.virtual_time_s, result.statements


def main() -> None:
    """Measure and print."""
    print(f"parsing: {lines_per_second():,.0f} lines/s")
    for name, body in LOOPS.items():
        print(f"{name}: {statements_per_second(body):,.0f} statements/s")
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    jobs = [asyncio.run(job()) for _ in range(REPEATS)]
    wall_s = statistics.median(wall for wall, _, _ in jobs)
    print(f"job of {SLABS} slabs: {wall_s:.2f} s wall, {jobs[0][1]:.1f} s of the robot, {jobs[0][2]} statements")


if __name__ == "__main__":
    main()
