"""Which operations does every routine need?  Jumps, branches, and the one that says what could not be compiled."""

from collections.abc import Callable

from slabcell_drivers.krc.code import Activation, Operation
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.values import Value

__all__ = ["branch_unless", "failing", "jump_to"]


def jump_to(target: int) -> Operation:
    """Return the operation that goes on at ``target``."""

    def jump(a: Activation) -> None:
        a.pc = target

    return jump


def branch_unless(condition: Callable[[Activation], Value], target: int) -> Operation:
    """Return the operation that goes to ``target`` unless the condition holds."""

    def branch(a: Activation) -> None:
        value = condition(a)
        if value is False:
            a.pc = target
        elif value is not True:
            raise KrlError(RunMessage.TYPE, "the condition is no BOOL")

    return branch


def failing(number: int, text: str) -> Operation:
    """Return the operation that stops the program with this message."""

    def fail(_: Activation) -> None:
        raise KrlError(number, text)

    return fail
