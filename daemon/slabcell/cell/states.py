"""Which states has the cell, and what moves it from one to another?  One table, from which the diagram is drawn too.

The names are those of OPC 40100-1 (machine vision).  Beside the state stand two conditions, as PackML has them: *held*
(our cause) and *suspended* (a cause outside of the cell); they say why the cell does not get on, and change no state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import structlog
from transitions.core import MachineError
from transitions.extensions.asyncio import HierarchicalAsyncMachine, NestedAsyncState

from slabcell.cell.afterwards import at_once
from slabcell.errors import SlabcellError

__all__ = [
    "TABLE",
    "CellEvent",
    "CellState",
    "Conditions",
    "EventRefusedError",
    "HeldCause",
    "Row",
    "StateMachine",
    "SuspendedCause",
]


class CellState(StrEnum):
    """Where the cell stands.  A full stop parts a state from its sub-state."""

    PREOPERATIONAL = "preoperational"
    HALTED = "halted"
    ERROR = "error"
    INITIALIZED = "initialized"
    READY = "ready"
    SINGLE_EXECUTION = "single_execution"
    ACQUIRING = "single_execution.acquiring"
    LOCATING = "single_execution.locating"
    OFFERING = "single_execution.offering"
    VERIFYING = "single_execution.verifying"

    @property
    def leaf(self) -> str:
        """The innermost name."""
        return self.value.rpartition(".")[2]

    @property
    def is_executing(self) -> bool:
        """Whether a cycle is on its way."""
        return self.value.startswith(CellState.SINGLE_EXECUTION.value)


class CellEvent(StrEnum):
    """What can happen to the cell."""

    INITIALIZE = "initialize"
    PREPARE = "prepare"
    UNPREPARE = "unprepare"
    ACQUIRE = "acquire"
    LOCATE = "locate"
    OFFER = "offer"
    VERIFY = "verify"
    FINISH = "finish"
    ABANDON = "abandon"
    FAULT = "fault"
    CLEAR = "clear"
    HALT = "halt"
    STOP = "stop"


class HeldCause(StrEnum):
    """Why the cell holds: a cause of our own."""

    NO_MATCH = "no_match"
    CAMERA = "camera"
    OPERATOR = "operator"  # a person has to look at something first
    CALIBRATION = "calibration"  # there is none: pixels are no millimetres


class SuspendedCause(StrEnum):
    """Why the cell waits: a cause outside of it."""

    ROBOT_ABSENT = "robot_absent"
    NOTHING_ON_TABLE = "nothing_on_table"


@dataclass(slots=True)
class Conditions:
    """What stands beside the state."""

    held: HeldCause | None = None
    suspended: SuspendedCause | None = None


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table: in any of ``sources``, ``event`` leads to ``destination``; ``meaning`` says when."""

    event: CellEvent
    sources: tuple[CellState, ...]
    destination: CellState
    meaning: str


_S, _E = CellState, CellEvent

TABLE: tuple[Row, ...] = (
    Row(_E.INITIALIZE, (_S.PREOPERATIONAL, _S.HALTED), _S.INITIALIZED, "ledger and devices are there"),
    Row(_E.PREPARE, (_S.INITIALIZED,), _S.READY, "recipe and calibration are checked"),
    Row(_E.UNPREPARE, (_S.READY,), _S.INITIALIZED, "the recipe is taken out"),
    Row(_E.ACQUIRE, (_S.READY,), _S.ACQUIRING, "the robot asks for a picture"),
    Row(_E.LOCATE, (_S.ACQUIRING,), _S.LOCATING, "a complete frame is there"),
    Row(_E.OFFER, (_S.LOCATING, _S.READY), _S.OFFERING, "results are in the ledger"),
    Row(_E.VERIFY, (_S.ACQUIRING,), _S.VERIFYING, "every slot is filled; the frame shows how"),
    Row(_E.FINISH, (_S.LOCATING, _S.OFFERING, _S.VERIFYING), _S.READY, "nothing of the cycle is left to do"),
    Row(_E.ABANDON, (_S.SINGLE_EXECUTION,), _S.READY, "no frame, or the robot gave the cycle up"),
    Row(
        _E.FAULT,
        (_S.PREOPERATIONAL, _S.INITIALIZED, _S.READY, _S.SINGLE_EXECUTION, _S.HALTED),
        _S.ERROR,
        "the cell cannot go on safely",
    ),
    Row(_E.CLEAR, (_S.ERROR,), _S.INITIALIZED, "a person removed the cause"),
    Row(_E.HALT, (_S.INITIALIZED, _S.READY, _S.SINGLE_EXECUTION), _S.HALTED, "a person halts the cell"),
    Row(
        _E.STOP,
        (_S.INITIALIZED, _S.READY, _S.SINGLE_EXECUTION, _S.ERROR, _S.HALTED),
        _S.PREOPERATIONAL,
        "the service ends",
    ),
)


class EventRefusedError(SlabcellError):
    """The event has no line in the table for the state the cell is in."""

    def __init__(self, event: CellEvent, state: CellState) -> None:
        allowed = ", ".join(row.event for row in TABLE if _covers(row, state))
        super().__init__(f"{event} is refused in state {state}; possible here: {allowed}")
        self.event = event
        self.state = state


def _covers(row: Row, state: CellState) -> bool:
    return any(state is source or state.startswith(f"{source}.") for source in row.sources)


class _State(NestedAsyncState):
    separator = "."  # the names themselves hold underscores, the library's default separator


class _Machine(HierarchicalAsyncMachine):
    state_cls = _State


class StateMachine:
    """The table at work.  ``on_change`` is called after each transition with the old state, the new one and the cause.

    Log lines are handed to ``later``.

    The table has neither conditions nor callbacks, so where an event leads is a matter of state and event alone: the
    library, which needs a third of a millisecond, is asked once for each.  Calls must not overlap: the owner serialises
    them.
    """

    def __init__(
        self,
        on_change: Callable[[CellState, CellState, str], None] | None = None,
        *,
        later: Callable[[Callable[[], None]], None] = at_once,
    ) -> None:
        self.current: str = CellState.PREOPERATIONAL.value
        self._on_change = on_change
        self._later = later
        self._led_to: dict[tuple[CellState, CellEvent], str] = {}
        self._log = structlog.stdlib.get_logger("slabcell.cell")
        self._machine = _Machine(
            model=self,
            model_attribute="current",
            initial=CellState.PREOPERATIONAL.value,
            states=[
                *(state.value for state in CellState if not state.is_executing),
                {
                    "name": CellState.SINGLE_EXECUTION.value,
                    "initial": CellState.ACQUIRING.leaf,
                    "children": [
                        state.leaf for state in CellState if state.is_executing and state is not _S.SINGLE_EXECUTION
                    ],
                },
            ],
            transitions=[
                {
                    "trigger": row.event.value,
                    "source": [source.value for source in row.sources],
                    "dest": row.destination.value,
                }
                for row in TABLE
            ],
            auto_transitions=False,
        )

    @property
    def state(self) -> CellState:
        """The state now, the innermost one."""
        return CellState(self.current)

    async def fire(self, event: CellEvent, cause: str) -> None:
        """Move on.  ``cause`` is logged.  Raises `EventRefusedError` if the table has no such line."""
        before = self.state
        known = self._led_to.get((before, event))
        if known is not None:
            self.current = known
        else:
            try:
                await self._machine.trigger_event(self, event.value)
            except MachineError as error:
                self._log.warning("event refused", cell_event=event.value, state=before.value, cause=cause)
                raise EventRefusedError(event, before) from error
            self._led_to[before, event] = self.current
        about = {"before": before.value, "after": self.current, "cell_event": event.value, "cause": cause}
        self._later(lambda: self._log.info("state", **about))
        if self._on_change is not None:
            self._on_change(before, self.state, cause)
