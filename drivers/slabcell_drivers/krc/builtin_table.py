"""What is a function of the controller's own to a KRL program?"""

from collections.abc import Callable
from dataclasses import dataclass, field

from slabcell_drivers.krc.cells import Trait
from slabcell_drivers.krc.values import Value

__all__ = ["BUILTIN_FIRST", "Builtin"]

BUILTIN_FIRST = frozenset(
    {
        "BAS",
        "IR_STOPM",
        "SVEL_JOINT",
        "SVEL_CP",
        "STOOL2",
        "SBASE",
        "SIPO_MODE",
        "SLOAD",
        "SACC_JOINT",
        "SACC_CP",
        "SET_CD_PARAMS",
        "USE_CM_PRO_VALUES",
    }
)
"""Ours even where a project brings its own: a controller's copies use data that backups lack."""


@dataclass(frozen=True, slots=True)
class Builtin:
    """A function.  ``outs`` are the positions of arguments that it writes; those come as places, others as values."""

    function: Callable[..., Value]
    least: int = 0
    most: int = 0
    outs: frozenset[int] = frozenset()
    rest_out: bool = False  # every argument from the first of ``outs`` on is written
    result: str = ""
    traits: frozenset[Trait] = field(default=frozenset())
    waits: Callable[..., bool] | None = None  # the program stands after the call until this holds
