"""How fast are the robot's telegrams: to read, to write, and as question and answer over TCP loopback?

``python benchmarks/eki_link.py`` prints medians.  The peer is the XML parser of the standard library alone
(`xml.etree.ElementTree`), which reads the same bytes without types, bounds or sums.
"""

import asyncio
import statistics
import time
from collections.abc import Callable
from xml.etree import ElementTree

from slabcell_drivers.robot import Answer, Frame, Offer, Request, RequestType
from slabcell_drivers.robot.eki import EkiServer
from slabcell_drivers.robot.eki.codec import decode_answer, decode_request, encode_answer, encode_request

REQUEST = Request(RequestType.NEXT, 3, 17, tcp=Frame(312.5, -80.25, 90.0, 12.5, 0.0, 180.0))
ANSWER = Answer(
    3, 9, 17, left=3, trigger_sequence=5, offer=Offer(105, 1, 4, Frame(312.5, -80, 10), Frame(44, 25, 10), 0.99)
)
ROUNDS = 2000


def median_us(call: Callable[[], object]) -> float:
    """Return the median time of one call."""
    times: list[float] = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return statistics.median(times) * 1e6


async def round_trips() -> float:
    """Return the median time from asking to the whole answer, in milliseconds."""

    async def handler(_: Request) -> Answer:
        return ANSWER

    link = EkiServer("127.0.0.1", 0)
    await link.start(handler)
    reader, writer = await asyncio.open_connection(*link.address)
    request = encode_request(REQUEST)
    times: list[float] = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        writer.write(request)
        await reader.readuntil(b"</Vis>")
        times.append(time.perf_counter() - began)
    writer.close()
    await writer.wait_closed()
    await link.stop()
    return statistics.median(times) * 1e3


def main() -> None:
    """Measure and print."""
    request, answer = encode_request(REQUEST), encode_answer(ANSWER)
    print(f"decode request  {median_us(lambda: decode_request(request)):7.1f} us   ({len(request)} bytes)")
    print(f"  ElementTree   {median_us(lambda: ElementTree.fromstring(request)):7.1f} us")  # noqa: S314 - our own bytes
    print(f"encode answer   {median_us(lambda: encode_answer(ANSWER)):7.1f} us   ({len(answer)} bytes)")
    print(f"decode answer   {median_us(lambda: decode_answer(answer)):7.1f} us")
    print(f"question and answer over TCP loopback {asyncio.run(round_trips()):7.3f} ms")


if __name__ == "__main__":
    main()
