"""What do compiled operations ask of the interpreter that runs them?"""

from typing import Protocol

from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.clock import Clock
from slabcell_drivers.krc.code import Activation, Code, Function, Pause
from slabcell_drivers.krc.cyclic_value import CyclicValue
from slabcell_drivers.krc.host import Host
from slabcell_drivers.krc.interrupts import Interrupts
from slabcell_drivers.krc.motion_runner import MotionRunner
from slabcell_drivers.krc.names import ModuleNames, ProjectNames
from slabcell_drivers.krc.syntax import Routine
from slabcell_drivers.krc.values import Value

__all__ = ["Machine"]


class Machine(Protocol):
    """The interpreter, as operations see it."""

    host: Host
    project: ProjectNames
    motion: MotionRunner
    clock: Clock
    interrupts: Interrupts
    may_move: bool

    def resolve(self, name: str, module: ModuleNames) -> tuple[Routine, ModuleNames] | None:
        """Return the KRL routine that a name means in a module, None where it means one of the controller's own."""
        ...

    def code_of(self, routine: Routine, module: ModuleNames) -> Code:
        """Return the compiled routine."""
        ...

    def enter(self, code: Code, arguments: list[Place], result: Place | None) -> None:
        """Call a routine."""
        ...

    def leave(self, value: Value) -> None:
        """Return from the routine, or from the action of an interrupt."""
        ...

    def evaluate(self, a: Activation, pc: int) -> Value:
        """Return what the operations from ``pc`` on leave, looked at beside the program."""
        ...

    def end_waits(self, a: Activation) -> bool:
        """Tell whether the program has to wait at its end, because the arm still moves."""
        ...

    def synchronize(self, a: Activation) -> Pause | None:
        """Wait until the main run has caught up: the stop of the advance run."""
        ...

    def proceed_on_error(self, a: Activation, span: list[int]) -> None:
        """Let an error of the next statement set $ERR instead of stopping the program."""
        ...

    @property
    def served_priority(self) -> int:
        """The number of the interrupt that is being served, 0 if there is none."""
        ...

    def brake(self, *, fast: bool) -> None:
        """Stop the motion."""
        ...

    def resume(self) -> None:
        """Leave the interrupt and all routines down to the one that declared it."""
        ...

    def assign_cyclically(self, target: Place, cyclic: CyclicValue | None) -> None:
        """Store a value once every tick from now on; None ends it."""
        ...

    def set_cycflag(self, number: Value, function: Function, activation: Activation) -> None:
        """Evaluate a cyclic flag from now on, once every tick."""
        ...
