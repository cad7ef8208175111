"""What every link between robot and cell does, whichever wire it runs over and whichever end connects."""

import asyncio
import dataclasses

import pytest

from slabcell_drivers.robot.answering import HANDLER_FAILED_CODE
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.link_events import Direction, EndReason
from slabcell_drivers.robot.protocol import Answer, LinkState, Offer, Request, RequestType, ResultCode

from .conftest import RIGS

pytestmark = pytest.mark.integration

MODBUS_RIGS = [rig for rig in RIGS if rig.name.startswith("modbus")]


async def echo(request):
    return Answer(request.session, 1, request.sequence, left=request.job_id)


def question(sequence, type_=RequestType.NEXT, **values):
    return Request(type_, 5, sequence, **values)


class Gate:
    """A handler that waits to be released."""

    def __init__(self):
        self.started, self.release, self.seen = asyncio.Event(), asyncio.Event(), []

    async def __call__(self, request):
        self.started.set()
        await self.release.wait()
        self.seen.append(request.sequence)
        return Answer(request.session, 1, request.sequence)


async def test_a_request_arrives_as_it_was_sent_and_gets_its_answer(rig):
    offer = Offer(9, 0, 3, Frame(1.125, -2, 3, 90, 0, 180), Frame(4, 5, 6, -18.9, 0, 180), 0.5)
    seen = []

    async def handler(request):
        seen.append(request)
        return Answer(request.session, 1, request.sequence, left=2, trigger_sequence=6, offer=offer, message="Hello")

    sent = question(7, tcp=Frame(312.5, -80.25, 90, 12.5, 0, 180), axes_deg=(14.4, -71.2, 96.8, 0, 64.4, 1.9))
    async with rig.serving(handler) as link, rig.robot(link) as robot:
        answer = await robot.ask(sent)
        assert answer == Answer(5, 1, 7, left=2, trigger_sequence=6, offer=offer, message="Hello")
        assert link.state is LinkState.CONNECTED
    assert seen == [sent]


async def test_the_same_request_again_is_handed_on_again(rig):
    seen = []

    async def handler(request):
        seen.append(request.sequence)
        return await echo(request)

    async with rig.serving(handler) as link, rig.robot(link) as robot:
        for number in (3, 3, 4):
            assert (await robot.ask(question(number))).acknowledges == number
    assert seen == [3, 3, 4]


async def test_a_request_of_another_version_is_answered_as_a_bad_request(rig):
    async with rig.serving(echo) as link, rig.robot(link) as robot:
        answer = await robot.ask_in_version_2(question(4))
        assert (answer.acknowledges, answer.code) == (4, ResultCode.BAD_REQUEST)
        assert "version" in answer.message
        assert (await robot.ask(question(5))).code == ResultCode.OK


async def test_an_error_number_arrives_with_its_text(rig):
    async def handler(request):
        return Answer(request.session, 1, request.sequence, 1502, message="1502 Nothing found")

    async with rig.serving(handler) as link, rig.robot(link) as robot:
        answer = await robot.ask(question(1))
        assert (answer.code, answer.message) == (1502, "1502 Nothing found")


async def test_a_handler_that_raises_becomes_an_error_number_and_the_link_lives_on(rig):
    async def handler(request):
        if request.sequence == 1:
            raise ZeroDivisionError
        return await echo(request)

    async with rig.serving(handler) as link, rig.robot(link) as robot:
        first, second = await robot.ask(question(1)), await robot.ask(question(2))
        assert (first.acknowledges, first.code) == (1, HANDLER_FAILED_CODE)
        assert (second.acknowledges, second.code) == (2, ResultCode.OK)


@pytest.mark.parametrize("x_mm", [float("nan"), float("inf"), 1e10])
async def test_an_answer_that_cannot_be_sent_becomes_an_error_number(rig, x_mm):
    async def handler(request):
        return Answer(request.session, 1, request.sequence, offer=Offer(1, 0, 0, Frame(x_mm), Frame(), 1.0))

    async with rig.serving(handler) as link, rig.robot(link) as robot:
        answer = await robot.ask(question(1))
        assert answer.code == HANDLER_FAILED_CODE
        assert "pick" in answer.message.lower()


async def test_a_sign_of_life_is_answered_while_the_handler_works(rig):
    gate = Gate()
    async with rig.serving(gate) as link, rig.robot(link) as robot:
        asking = asyncio.create_task(robot.ask(question(1)))
        await gate.started.wait()
        if rig.name.startswith("eki"):  # one stream: read the sign of life before the answer
            asking.cancel()
            await asyncio.gather(asking, return_exceptions=True)
        await robot.beat()
        gate.release.set()
        if not asking.done():
            assert (await asking).acknowledges == 1


async def test_a_robot_whose_signs_of_life_stop_is_lost(rig, until):
    # long enough for a busy machine to answer within it: a line that answers late counts as broken, not as silent
    async with rig.serving(echo, heartbeat_timeout_s=1.5) as link, rig.robot(link) as robot:
        await robot.beat()
        await robot.beat()
        await until(lambda: link.last_end is not None)
        assert link.last_end is EndReason.SILENT


async def test_a_robot_that_connects_anew_replaces_its_old_connection(tcp_rig):
    async with tcp_rig.serving(echo) as link, tcp_rig.robot(link) as old:
        await old.ask(question(1))
        async with tcp_rig.robot(link) as new:
            assert (await new.ask(question(2))).acknowledges == 2
            await old.until_closed()
            assert link.last_end is EndReason.REPLACED
            assert link.state is LinkState.CONNECTED


async def test_a_request_under_way_is_finished_before_a_new_connection_is_heard(tcp_rig):
    gate = Gate()
    async with tcp_rig.serving(gate) as link:
        async with tcp_rig.robot(link) as old:
            asking = asyncio.create_task(old.ask(question(1)))
            await gate.started.wait()
            asking.cancel()
            await asyncio.gather(asking, return_exceptions=True)
        async with tcp_rig.robot(link) as new:
            asking = asyncio.create_task(new.ask(question(2)))
            gate.release.set()
            assert (await asking).acknowledges == 2
    assert gate.seen == [1, 2]


async def test_a_host_that_is_not_allowed_is_turned_away(tcp_rig):
    async with tcp_rig.serving(echo, hosts=("192.0.2.1",)) as link, tcp_rig.robot(link) as robot:
        await robot.until_closed()
        assert link.state is LinkState.LISTENING


async def test_stop_finishes_the_request_under_way_and_may_be_called_twice(rig):
    gate = Gate()
    async with rig.serving(gate) as link, rig.robot(link) as robot:
        asking = asyncio.create_task(robot.ask(question(1)))
        await gate.started.wait()
        stopping = asyncio.create_task(link.stop())
        gate.release.set()
        await stopping
        await link.stop()
        assert gate.seen == [1]
        assert link.state is LinkState.CLOSED
        asking.cancel()
        await asyncio.gather(asking, return_exceptions=True)


async def test_what_is_taken_already_is_an_oserror(waiting_rig):
    async with waiting_rig.serving(echo) as link:
        other = waiting_rig.another(link)
        with pytest.raises(OSError, match=r"in use|lock"):
            await other.start(echo)


async def test_a_link_is_started_once(rig):
    async with rig.serving(echo) as link:
        with pytest.raises(RuntimeError, match="already started"):
            await link.start(echo)


async def test_the_transcript_sees_both_directions_in_their_order(rig, until):
    seen = []
    async with (
        rig.serving(echo, on_telegram=lambda way, raw, at_s: seen.append((way, len(raw), at_s))) as link,
        rig.robot(link) as robot,
    ):
        await robot.ask(question(1))
        await until(lambda: len(seen) == 2)
    assert [entry[0] for entry in seen] == [Direction.RECEIVED, Direction.SENT]
    assert min(entry[1] for entry in seen) > 40
    assert seen[0][2] <= seen[1][2]


async def test_changes_of_state_are_told(rig):
    states = asyncio.Queue()
    async with rig.serving(echo, on_state=states.put_nowait, heartbeat_timeout_s=0.3) as link:
        assert await states.get() is LinkState.LISTENING
        async with rig.robot(link) as robot:
            await robot.beat()
            assert await states.get() is LinkState.CONNECTED
        assert await states.get() is LinkState.LISTENING
    left = [states.get_nowait() for _ in range(states.qsize())]
    assert left[-1] is LinkState.CLOSED


async def test_the_answer_acknowledges_the_request_whatever_the_handler_says(rig):
    async def handler(request):
        return dataclasses.replace(await echo(request), acknowledges=0)

    async with rig.serving(handler) as link, rig.robot(link) as robot:
        assert (await robot.ask(question(11))).acknowledges == 11


async def test_a_hook_that_raises_is_an_end_of_the_connection_and_not_of_the_link(rig, until):
    calls = []

    def hook(way, raw, at_s):
        calls.append(way)
        if len(calls) == 1:
            raise ValueError("disk full")

    async with rig.serving(echo, on_telegram=hook) as link:
        async with rig.robot(link) as robot:
            asking = asyncio.create_task(robot.ask(question(1)))
            await until(lambda: link.last_end is not None)
            assert link.last_end is EndReason.FAILED
            asking.cancel()
            await asyncio.gather(asking, return_exceptions=True)
            if rig.keeps_its_wire:
                assert (await robot.ask(question(2))).acknowledges == 2
                return
        async with rig.robot(link) as robot:
            assert (await robot.ask(question(2))).acknowledges == 2


@pytest.mark.parametrize("rig", MODBUS_RIGS, ids=lambda rig: rig.name)
async def test_what_a_gateway_brings_back_from_long_ago_never_reaches_the_cell(rig):
    seen = []

    async def handler(request):
        seen.append((request.type.name, request.sequence))
        return await echo(request)

    rig = rig()
    async with rig.serving(handler) as link, rig.robot(link) as robot:
        for number in (4, 5):
            await robot.ask(question(number, RequestType.HELLO))
        stale = await robot.ask(question(4, RequestType.HELLO))
        assert (stale.code, stale.sequence) == (ResultCode.BAD_REQUEST, 5)
        assert (await robot.ask(question(5, RequestType.HELLO))).code == ResultCode.OK
        assert (await robot.ask(question(6))).code == ResultCode.OK
    assert seen == [("HELLO", 4), ("HELLO", 5), ("HELLO", 5), ("NEXT", 6)]
