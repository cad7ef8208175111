"""The reverse role: the cell connects to a robot that waits, and comes back when the robot does."""

import asyncio
import contextlib

import pytest

from slabcell_drivers.robot.eki import EkiClient, EndReason
from slabcell_drivers.robot.eki.codec import decode_answer, encode_request
from slabcell_drivers.robot.eki.framing import Framer
from slabcell_drivers.robot.protocol import Answer, LinkState, Request, RequestType

pytestmark = pytest.mark.integration


async def echo(request):
    return Answer(request.session, 1, request.sequence)


class WaitingRobot:
    """A controller's port: hands out one connection after the other."""

    def __init__(self):
        self.connections = asyncio.Queue()
        self.server = None

    @classmethod
    @contextlib.asynccontextmanager
    async def listening(cls, port=0):
        robot = cls()
        robot.server = await asyncio.start_server(lambda r, w: robot.connections.put_nowait((r, w)), "127.0.0.1", port)
        try:
            yield robot
        finally:
            robot.server.close()
            while not robot.connections.empty():
                robot.connections.get_nowait()[1].close()
            await robot.server.wait_closed()

    @property
    def port(self):
        return self.server.sockets[0].getsockname()[1]


@contextlib.asynccontextmanager
async def link_to(port, **options):
    link = EkiClient("127.0.0.1", port, retry_s=0.01, **options)
    await link.start(echo)
    try:
        yield link
    finally:
        await link.stop()
    assert link.state is LinkState.CLOSED


async def ask(reader, writer, sequence):
    writer.write(encode_request(Request(RequestType.NEXT, 5, sequence)))
    framer, events = Framer("Vis"), []
    while not events:
        events = framer.feed(await reader.read(4096))
    return decode_answer(events[0])


async def test_the_robot_asks_and_the_cell_answers_in_the_reverse_role_too():
    async with WaitingRobot.listening() as robot, link_to(robot.port) as link:
        reader, writer = await robot.connections.get()
        assert (await ask(reader, writer, 7)).acknowledges == 7
        assert link.state is LinkState.CONNECTED
        writer.close()


async def test_after_a_loss_the_cell_connects_again():
    async with WaitingRobot.listening() as robot, link_to(robot.port) as link:
        for sequence in (1, 2, 3):
            reader, writer = await robot.connections.get()
            assert (await ask(reader, writer, sequence)).acknowledges == sequence
            writer.close()
            await writer.wait_closed()
        reader, writer = await robot.connections.get()
        assert link.last_end is EndReason.PEER_CLOSED
        writer.close()


async def test_a_robot_that_does_not_listen_yet_is_waited_for():
    async with WaitingRobot.listening() as robot:
        port = robot.port
    states = asyncio.Queue()
    async with link_to(port, on_state=states.put_nowait):
        assert await states.get() is LinkState.LISTENING
        async with WaitingRobot.listening(port) as robot:
            reader, writer = await robot.connections.get()
            assert await states.get() is LinkState.CONNECTED
            assert (await ask(reader, writer, 4)).acknowledges == 4
            writer.close()
            await writer.wait_closed()


async def test_stop_ends_the_waiting_and_may_be_called_twice():
    async with WaitingRobot.listening() as robot:
        port = robot.port
    link = EkiClient("127.0.0.1", port, retry_s=600.0)
    await link.stop()
    await link.start(echo)
    with pytest.raises(RuntimeError, match="already started"):
        await link.start(echo)
    await link.stop()
    await link.stop()
    assert link.state is LinkState.CLOSED
