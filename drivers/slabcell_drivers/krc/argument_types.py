"""Does an argument fit its parameter?  Asked before a program runs, and when a call is compiled."""

from collections.abc import Iterator
from dataclasses import dataclass

from slabcell_drivers.krc.builtin_signatures import SIGNATURES
from slabcell_drivers.krc.names import ModuleNames, ProjectNames
from slabcell_drivers.krc.static_types import Names, fits, type_of
from slabcell_drivers.krc.syntax import Call, Declaration, Expr, Index, Member, Name, Routine
from slabcell_drivers.krc.values import CHAR, POSITION_FIELDS, ArrayType, EnumType, KrlType, StructType

__all__ = ["Misfit", "builtin_misfits", "misfits", "shown_type"]


@dataclass(frozen=True, slots=True)
class Misfit:
    """An argument of another type than its parameter."""

    argument: Expr
    position: int
    parameter: str
    given: KrlType
    wanted: KrlType
    writes: bool

    def __str__(self) -> str:
        """Return what is wrong, for a message."""
        verb = "writes" if self.writes else "takes"
        return (
            f"argument {self.position}{self.parameter} {verb} {shown_type(self.wanted)}, not {shown_type(self.given)}"
        )


def shown_type(type_: KrlType) -> str:
    """Return a type as a declaration would name it."""
    if isinstance(type_, ArrayType):
        return f"{shown_type(type_.element)}[{',' * (len(type_.sizes) - 1)}]"
    return type_.name or "an enumeration value"


def misfits(call: Call, routine: Routine, module: ModuleNames, names: Names) -> Iterator[Misfit]:
    """Yield the arguments of a call of a KRL routine that its parameters cannot take."""
    declared = _declared_types(routine, module, names.project)
    for position, (argument, parameter) in enumerate(zip(call.arguments, routine.parameters, strict=False), 1):
        wanted = declared.get(parameter.name)
        if argument is None or wanted is None:
            continue
        writes = parameter.mode != "IN" and isinstance(argument, Name | Index | Member)
        given = type_of(argument, names)
        if given is not None and not _passes(given, wanted, writes=writes):
            yield Misfit(argument, position, f" ({parameter.name})", given, wanted, writes)


def builtin_misfits(call: Call, names: Names) -> Iterator[Misfit]:
    """Yield the arguments that a function of the controller's own cannot take."""
    signature = SIGNATURES.get(call.name)
    if signature is None:
        return
    for position, (argument, written) in enumerate(zip(call.arguments, signature.split(","), strict=False), 1):
        type_name, _, mode = written.partition(":")
        is_array = type_name.endswith("[]")
        wanted: KrlType | None = names.project.find_type(type_name.removesuffix("[]"), None)
        if argument is None or wanted is None:
            continue
        if is_array:
            wanted = ArrayType(wanted, (0,))
        given = type_of(argument, names)
        if given is not None and not _passes(given, wanted, writes=mode == "OUT"):
            yield Misfit(argument, position, "", given, wanted, mode == "OUT")


def _declared_types(routine: Routine, module: ModuleNames, project: ProjectNames) -> dict[str, KrlType | None]:
    parameters = {parameter.name for parameter in routine.parameters}
    return {
        declarator.name: project.declared_type(statement.type_name, declarator, module)
        for statement in routine.body
        if isinstance(statement, Declaration)
        for declarator in statement.names
        if declarator.name in parameters
    }


def _passes(given: KrlType, wanted: KrlType, *, writes: bool) -> bool:
    """Tell whether a value can be handed over; what is written has to be of the parameter's own type."""
    if isinstance(wanted, ArrayType):
        if wanted.element is CHAR and given is CHAR:  # a text of one letter
            return not writes
        return isinstance(given, ArrayType) and _passes(given.element, wanted.element, writes=True)
    if not writes:
        return fits(given, wanted)
    if given is wanted:
        return True
    if isinstance(given, EnumType) and isinstance(wanted, EnumType):
        return not given.name or not wanted.name or given.name == wanted.name
    if isinstance(given, StructType) and isinstance(wanted, StructType):
        both = given.name in POSITION_FIELDS and wanted.name in POSITION_FIELDS
        return given.name == wanted.name or (both and fits(given, wanted))
    return False
