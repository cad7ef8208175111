"""Which name means what?  Modules with their data lists, public data, types, routines, and the system's variables.

A name is looked for in the module's own data list, then among the global data (``GLOBAL`` in a data list, everything in
``$CONFIG`` and the other system data lists), then among the system variables; last, so that programs of many houses
run, among the data of lists that are PUBLIC without the variable being GLOBAL.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from slabcell_drivers.krc.builtin_table import BUILTIN_FIRST, Builtin
from slabcell_drivers.krc.cells import Cell, ComputedCell, Container, Place, Trait
from slabcell_drivers.krc.code import Activation, Code
from slabcell_drivers.krc.compile_expressions import ExpressionCompiler
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.names import ModuleNames
from slabcell_drivers.krc.syntax import (
    Assign,
    Channel,
    DataList,
    Declaration,
    Declarator,
    Diagnostic,
    EnumDecl,
    Expr,
    External,
    Import,
    Index,
    Literal,
    Module,
    Name,
    Routine,
    Signal,
    Statement,
    Struct,
)
from slabcell_drivers.krc.values import (
    BOOL,
    CHAR,
    INT,
    REAL,
    ArrayType,
    EnumType,
    KrlType,
    ScalarType,
    StructType,
    Value,
    coercer,
)

__all__ = ["ModuleScope", "Project", "SystemScope"]

_SCALARS: dict[str, KrlType] = {"INT": INT, "REAL": REAL, "BOOL": BOOL, "CHAR": CHAR}


class SystemScope(Protocol):
    """The system variables, as names see them."""

    def find(self, name: str) -> Place:
        """Return a system variable; one unknown to this software is made."""
        ...


class ModuleScope:
    """One module: a .src with its .dat."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.data: dict[str, Place] = {}
        self.types: dict[str, KrlType] = {}
        self.routines: dict[str, Routine] = {}
        self.main: Routine | None = None
        self.data_file = ""
        self.program_file = ""
        self.externals: set[str] = set()

    def file_of(self, routine: Routine) -> str:
        """Return the file that a routine stands in."""
        return self.program_file if routine.name in self.routines else self.data_file


class Project:
    """All modules of a controller."""

    def __init__(self, system: SystemScope, builtins: Mapping[str, Builtin]) -> None:
        self.system = system
        self.builtins = builtins
        self.modules: dict[str, ModuleScope] = {}
        self.globals: dict[str, Place] = {}
        self.types: dict[str, KrlType] = {}
        self.routines: dict[str, tuple[Routine, ModuleNames]] = {}
        self.public: dict[str, Place] = {}
        self.problems: list[Diagnostic] = []
        self._structs: dict[str, tuple[Struct, ModuleNames]] = {}
        self._coercers: dict[int, Callable[[Value], Value]] = {}
        self._kept: list[KrlType] = []

    # --- loading ------------------------------------------------------------------------------------------------

    def load(self, modules: Iterable[tuple[str, Module]]) -> None:
        """Take modules in, each with the name of its file without ending: first all types, then data, then values."""
        scopes: list[tuple[ModuleScope, Module]] = []
        for stem, module in modules:
            scope = self.modules.setdefault(stem.upper(), ModuleScope(stem.upper()))
            scopes.append((scope, module))
            self._add_routines(scope, module)
        for scope, module in scopes:
            if module.data is not None:
                scope.data_file = module.file
                self._declare_types(scope, module.data)
        for scope, module in scopes:
            if module.data is not None:
                self._declare_data(scope, module.data, module.file)
        for scope, module in scopes:
            if module.data is not None:
                self._set_values(scope, module.data, module.file)

    def _add_routines(self, scope: ModuleScope, module: Module) -> None:
        for position, routine in enumerate(module.routines):
            scope.program_file = module.file
            scope.routines.setdefault(routine.name, routine)
            if position == 0:
                scope.main = routine
            if routine.is_global or position == 0:
                self.routines.setdefault(routine.name, (routine, scope))

    def _declare_types(self, scope: ModuleScope, data: DataList) -> None:
        for statement in data.body:
            if isinstance(statement, Struct | EnumDecl):
                self.declare(statement, scope, is_system=_is_system(data.name))

    def _declare_data(self, scope: ModuleScope, data: DataList, file: str) -> None:
        for statement in data.body:
            try:
                if isinstance(statement, External):
                    scope.externals.add(statement.name)
                elif isinstance(statement, Declaration):
                    self._declare_variables(statement, scope, data)
                elif isinstance(statement, Signal):
                    self.declare(statement, scope, is_system=_is_system(data.name))
            except KrlError as error:
                self._problem(file, statement, error)

    def _declare_variables(self, statement: Declaration, scope: ModuleScope, data: DataList) -> None:
        for declarator in statement.names:
            name = declarator.name
            type_ = self.declared_type(statement.type_name, declarator, scope)
            if name.startswith("$"):
                continue  # the system has it, or makes it when it is used
            cell = Cell(name, type_)
            scope.data[name] = cell
            if statement.is_const and declarator.value is not None:
                self._store(cell, declarator.value, scope)  # the sizes of arrays after it may be made of it
                cell.is_const = True
            if _is_system(data.name) or (statement.is_global and data.is_public):
                self.globals[name] = cell
            elif data.is_public or statement.is_global:
                self.public[name] = cell

    def _set_values(self, scope: ModuleScope, data: DataList, file: str) -> None:
        for statement in data.body:
            try:
                if isinstance(statement, Declaration):
                    for declarator in statement.names:
                        place = self.find(declarator.name, scope)
                        if declarator.value is not None and not getattr(place, "is_const", False):
                            assert place is not None  # noqa: S101  # declared before
                            self._store(place, declarator.value, scope)
                elif isinstance(statement, Assign):
                    compiler = ExpressionCompiler(self, scope, Code("", file))
                    nowhere = Activation(compiler.code, [])
                    target = compiler.place(statement.target)(nowhere)
                    target.set(compiler.expr(statement.value)[0](nowhere))
                elif isinstance(statement, Import):
                    source = self.modules.get(statement.module)
                    if source is not None and statement.source in source.data:
                        scope.data[statement.name] = source.data[statement.source]
            except KrlError as error:
                self._problem(file, statement, error)

    def _store(self, place: Place, value: Expr, scope: ModuleScope) -> None:
        compiler = ExpressionCompiler(self, scope, Code("", ""))
        place.set(compiler.expr(value)[0](Activation(compiler.code, [])))

    def _problem(self, file: str, statement: Statement, error: KrlError) -> None:
        place = statement.place
        self.problems.append(Diagnostic(file, place.line, place.column, "warning", "data", error.text))

    # --- declarations -------------------------------------------------------------------------------------------

    def declare(self, statement: Statement, scope: ModuleNames, *, is_system: bool = False) -> None:
        """Declare a type or a signal."""
        match statement:
            case Struct(name=name):
                self._structs[f"{scope.name}/{name}"] = (statement, scope)
                if statement.is_global or is_system:
                    self._structs[f"/{name}"] = (statement, scope)
                    self.types.pop(name, None)  # a project's own declaration takes the place of ours
                else:
                    self._structs.setdefault(f"?/{name}", (statement, scope))
            case EnumDecl(name=name, values=values):
                scope.types[name] = EnumType(name, frozenset(values))
                if statement.is_global or is_system:
                    self.types[name] = scope.types[name]
                    self._structs.pop(f"/{name}", None)
                else:
                    self.types.setdefault(name, scope.types[name])
            case Signal(name=name):
                place = self._signal(statement, scope)
                if name.startswith("$"):
                    return
                scope.data[name] = place
                if statement.is_global or is_system:
                    self.globals[name] = place
                else:
                    self.public.setdefault(name, place)
            case Channel() | _:
                pass

    def _signal(self, statement: Signal, scope: ModuleNames) -> Place:
        if statement.first is None:
            return Cell(statement.name, None)
        name, first = self._bit(statement.first, scope)
        source = self.find(name, None)
        traits: frozenset[Trait] = getattr(source, "traits", frozenset[Trait]())
        bits: Container = source.value if source is not None else _NoBits()
        if statement.last is None:
            key = (first,)
            type_ = REAL if name in {"$ANIN", "$ANOUT"} else BOOL
            return ComputedCell(statement.name, type_, lambda: bits.get(key), lambda v: bits.set(key, v), traits=traits)
        _, last = self._bit(statement.last, scope)
        numbers = range(first, last + 1)
        if not 1 <= len(numbers) <= 32:
            raise KrlError(RunMessage.RANGE, f"{statement.name}: a signal has 1 to 32 bits, not {len(numbers)}")

        def read() -> int:
            return sum(bool(bits.get((n,))) << i for i, n in enumerate(numbers))

        def write(value: Value) -> None:
            for i, n in enumerate(numbers):
                bits.set((n,), bool(value >> i & 1))

        return ComputedCell(statement.name, INT, read, write, traits=traits)

    def _bit(self, node: Expr, scope: ModuleNames) -> tuple[str, int]:
        if isinstance(node, Index) and isinstance(node.base, Name) and len(node.indices) == 1 and node.indices[0]:
            number = self._constant(node.indices[0], scope)
            if isinstance(number, int):
                return node.base.name, number
        raise KrlError(RunMessage.TYPE, "a signal is $IN[n], $OUT[n], $ANIN[n] or $ANOUT[n]")

    def _constant(self, node: Expr, scope: ModuleNames) -> Value:
        if isinstance(node, Literal):
            return node.value
        compiler = ExpressionCompiler(self, scope, Code("", ""))
        return compiler.expr(node)[0](Activation(compiler.code, []))

    def declared_type(self, type_name: str, declarator: Declarator, scope: ModuleNames) -> KrlType | None:
        """Return the type of a declared name; None where its type is unknown."""
        type_ = self.find_type(type_name, scope)
        if type_ is None or not declarator.dimensions:
            return type_
        sizes: list[int] = []
        for dimension in declarator.dimensions:
            size = 0 if dimension is None else self._constant(dimension, scope)
            if not isinstance(size, int) or size < 0:
                raise KrlError(RunMessage.RANGE, f"{declarator.name}: the size {size} of an array is no positive INT")
            sizes.append(size)
        if type_ is CHAR and len(sizes) > 1:
            return ArrayType(ArrayType(CHAR, (sizes[-1],)), tuple(sizes[:-1]))
        return ArrayType(type_, tuple(sizes))

    # --- finding ------------------------------------------------------------------------------------------------

    def find(self, name: str, module: ModuleNames | None) -> Place | None:
        """Return the variable that a name means in a module; None if it is not declared."""
        if module is not None:
            found = module.data.get(name)
            if found is not None:
                return found
        found = self.globals.get(name)
        if found is not None:
            return found
        if name.startswith("$"):
            return self.system.find(name)
        return self.public.get(name)

    def find_type(self, name: str, module: ModuleNames | None) -> KrlType | None:
        """Return the type of this name as a module sees it; None if it is not declared."""
        scalar = _SCALARS.get(name)
        if scalar is not None:
            return scalar
        if module is not None:
            found = module.types.get(name) or self._resolve_struct(f"{module.name}/{name}")
            if found is not None:
                return found
        return self.types.get(name) or self._resolve_struct(f"/{name}") or self._resolve_struct(f"?/{name}")

    def _resolve_struct(self, key: str) -> KrlType | None:
        found = self._structs.get(key)
        if found is None:
            return None
        node, scope = found
        known = scope.types.get(node.name)
        if isinstance(known, StructType):
            return known
        members: dict[str, KrlType] = {}
        result = StructType(node.name, members, is_flat=False)
        scope.types[node.name] = result  # before its members: a structure that contains itself ends here
        for type_name, declarator in node.members:
            type_ = self.declared_type(type_name, declarator, scope)
            members[declarator.name] = type_ if type_ is not None else EnumType(type_name, frozenset())
        if all(isinstance(member, ScalarType | EnumType) for member in members.values()):
            object.__setattr__(result, "is_flat", True)
        return result

    def coercer(self, type_: KrlType) -> Callable[[Value], Value]:
        """Return the conversion to a type."""
        return coercer(type_)

    def routine(self, name: str, module: ModuleNames | None) -> tuple[Routine, ModuleNames] | None:
        """Return the KRL routine that a name means in a module; None where it means one of the controller's own."""
        if name in BUILTIN_FIRST:
            return None
        if module is not None:
            own = module.routines.get(name)
            if own is not None:
                return own, module
        return self.routines.get(name)


class _NoBits:
    def get(self, indices: tuple[Value, ...]) -> Value:
        del indices

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        del indices, value


def _is_system(name: str) -> bool:
    """Tell whether everything in a data list is global: the data lists of the system itself."""
    return name.startswith("$") or name == "OPERATE"
