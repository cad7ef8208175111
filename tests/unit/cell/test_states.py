"""Does the machine do what its table says, and nothing else?"""

import itertools

import pytest

from slabcell.cell.states import TABLE, CellEvent, CellState, EventRefusedError, StateMachine

pytestmark = pytest.mark.unit

LEAVES = [state for state in CellState if state is not CellState.SINGLE_EXECUTION]


def destination(state: CellState, event: CellEvent) -> CellState | None:
    """Read the table as a person does: a line for the state itself, or for the state that it is part of."""
    for row in TABLE:
        if row.event is event and any(state == source or state.startswith(source + ".") for source in row.sources):
            return row.destination
    return None


@pytest.mark.parametrize(("state", "event"), list(itertools.product(LEAVES, CellEvent)))
async def test_every_event_in_every_state_does_what_the_table_says(state, event):
    machine = StateMachine()
    machine.current = state.value
    expected = destination(state, event)
    if expected is None:
        with pytest.raises(EventRefusedError, match=f"{event} is refused in state {state}; possible here: "):
            await machine.fire(event, "test")
        assert machine.state is state
    else:
        for _ in range(2):  # the second time from what is remembered
            machine.current = state.value
            await machine.fire(event, "test")
            assert machine.state is expected


def test_no_event_has_two_ways_out_of_a_state():
    for state, event in itertools.product(LEAVES, CellEvent):
        rows = [
            row
            for row in TABLE
            if row.event is event and any(state == source or state.startswith(source + ".") for source in row.sources)
        ]
        assert len(rows) <= 1


def test_every_state_can_be_reached_and_left():
    reached = {CellState.PREOPERATIONAL} | {row.destination for row in TABLE}
    assert reached == set(LEAVES)
    for state in LEAVES:
        assert any(destination(state, event) is not None for event in CellEvent)


async def test_a_change_is_told_with_its_cause():
    told = []
    machine = StateMachine(lambda *change: told.append(change))
    await machine.fire(CellEvent.INITIALIZE, "devices are there")
    assert told == [(CellState.PREOPERATIONAL, CellState.INITIALIZED, "devices are there")]
