"""What does the compiler ask of the project?  Protocols of names, types and routines, so that it knows no loading."""

from collections.abc import Callable, Mapping
from typing import Protocol

from slabcell_drivers.krc.builtin_table import Builtin
from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.syntax import Declarator, Routine, Statement
from slabcell_drivers.krc.values import KrlType, Value

__all__ = ["ModuleNames", "ProjectNames"]


class ModuleNames(Protocol):
    """One module, as far as its names go."""

    name: str
    data: dict[str, Place]
    types: dict[str, KrlType]
    routines: dict[str, Routine]
    externals: set[str]

    def file_of(self, routine: Routine) -> str:
        """Return the file that a routine stands in."""
        ...


class ProjectNames(Protocol):
    """All names of a project."""

    @property
    def builtins(self) -> Mapping[str, Builtin]:
        """The functions of the controller itself."""
        ...

    def find(self, name: str, module: ModuleNames | None) -> Place | None:
        """Return the variable that a name means in a module; None if it is not declared."""
        ...

    def find_type(self, name: str, module: ModuleNames | None) -> KrlType | None:
        """Return the type of this name as a module sees it; None if it is not declared."""
        ...

    def coercer(self, type_: KrlType) -> Callable[[Value], Value]:
        """Return the conversion to a type."""
        ...

    def declare(self, statement: Statement, scope: ModuleNames, *, is_system: bool = False) -> None:
        """Declare a type or a signal."""
        ...

    def declared_type(self, type_name: str, declarator: Declarator, scope: ModuleNames) -> KrlType | None:
        """Return the type of a declared name; None where its type is unknown.  Raises KrlError for a wrong size."""
        ...

    def routine(self, name: str, module: ModuleNames | None) -> tuple[Routine, ModuleNames] | None:
        """Return the KRL routine that a name means in a module; None where it means one of the controller's own."""
        ...
