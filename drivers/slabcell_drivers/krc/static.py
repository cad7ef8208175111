"""What would a controller's compiler complain about?  The rules of the language that the parser does not know.

`check` takes the files of a project and returns what is wrong with them.  Errors are what a controller refuses;
warnings what it takes, but hardly as it was meant.
"""

from collections import Counter
from collections.abc import Iterator, Mapping

from slabcell_drivers.krc.clock import Clock
from slabcell_drivers.krc.kernel import BUILTINS
from slabcell_drivers.krc.lexer import decode
from slabcell_drivers.krc.loading import ENDINGS, load_predefined, load_sources, stem_of
from slabcell_drivers.krc.scope import ModuleScope, Project
from slabcell_drivers.krc.static_routine import RoutineChecker
from slabcell_drivers.krc.syntax import (
    DataList,
    Declaration,
    Diagnostic,
    EnumDecl,
    Module,
    Node,
    Place,
    Routine,
    Signal,
    Statement,
    Struct,
)
from slabcell_drivers.krc.system_names import SystemNames
from slabcell_drivers.krc.walk import walk

__all__ = ["MAX_NAME", "check"]

MAX_NAME = 24


def check(sources: Mapping[str, bytes]) -> list[Diagnostic]:
    """Return everything that is wrong with the files of a project, by file and line."""
    programs = {name: source for name, source in sources.items() if f".{name.rpartition('.')[2].lower()}" in ENDINGS}
    project = Project(SystemNames(Clock()), BUILTINS)
    load_predefined(project)
    modules = load_sources(project, programs)
    has_config = "$CONFIG" in project.modules
    found: list[Diagnostic] = list(project.problems)
    for module in modules:
        found.extend(module.diagnostics)
        found.extend(_check_text(module.file, programs[module.file]))
        scope = project.modules[stem_of(module.file)]
        found.extend(_check_module(module, project, scope, has_config=has_config))
    order = {name: position for position, name in enumerate(programs)}
    return sorted(set(found), key=lambda d: (order.get(d.file, 0), d.line, d.column, d.code))


def _check_text(file: str, source: bytes) -> Iterator[Diagnostic]:
    text = decode(source)
    depth: list[int] = []
    for number, line in enumerate(text.split("\n"), 1):
        words = line.lstrip().upper()
        if words.startswith(";FOLD"):
            depth.append(number)
        elif words.startswith(";ENDFOLD"):
            if not depth:
                yield Diagnostic(file, number, 1, "warning", "fold", "ENDFOLD closes no FOLD")
            else:
                depth.pop()
    for number in depth:
        yield Diagnostic(file, number, 1, "warning", "fold", "this FOLD is never closed")
    try:
        source.decode("ascii")
    except UnicodeDecodeError:
        try:
            source.decode("utf-8")
        except UnicodeDecodeError:
            return
        message = "the file is UTF-8; a controller reads latin-1 and shows other letters"
        yield Diagnostic(file, 1, 1, "warning", "encoding", message)


def _check_module(module: Module, project: Project, scope: ModuleScope, *, has_config: bool) -> Iterator[Diagnostic]:
    file = module.file
    stem = stem_of(file)

    def error(place: Place, code: str, message: str) -> Diagnostic:
        return Diagnostic(file, place.line, place.column, "error", code, message)

    yield from _check_names(module)
    for statement in module.loose:
        yield error(statement.place, "outside", "a statement outside of DEF and DEFDAT")
    if module.routines and module.routines[0].name != stem and not file.lower().endswith(".dat"):
        first = module.routines[0]
        yield error(
            first.place, "first-def", f"the first routine is {first.name}; it has to have the file's name, {stem}"
        )
    # $OPERATE stands in operate.dat, as other data lists of the system do in files without the $
    if module.data is not None and module.data.name.lstrip("$") != stem.lstrip("$"):
        yield error(module.data.place, "data-name", f"the data list is {module.data.name}; the file is {stem}")
    names = Counter(routine.name for routine in module.routines)
    for routine in module.routines:
        if names[routine.name] > 1:
            yield error(
                routine.place, "duplicate", f"{routine.name} is defined {names[routine.name]} times in this file"
            )
        yield from RoutineChecker(file, routine, project, scope, has_config=has_config).check()
    if module.data is not None:
        yield from _check_data(file, module.data)


def _check_data(file: str, data: DataList) -> Iterator[Diagnostic]:
    seen: dict[str, int] = {}
    for statement in data.body:
        for name, place in _declared(statement):
            if name in seen:
                message = f"{name} is declared in line {seen[name]} already"
                yield Diagnostic(file, place.line, place.column, "error", "duplicate", message)
            seen.setdefault(name, place.line)


def _declared(statement: Statement) -> Iterator[tuple[str, Place]]:
    match statement:
        case Declaration(names=names):
            for declarator in names:
                if not declarator.name.startswith("$"):
                    yield declarator.name, declarator.place
        case Signal(name=name, place=place):
            yield name, place
        case Struct(name=name, place=place) | EnumDecl(name=name, place=place):
            yield f"type {name}", place
        case _:
            return


def _check_names(module: Module) -> Iterator[Diagnostic]:
    for name, place in _written_names(module):
        bare = name.lstrip("$")
        if len(name) > MAX_NAME:
            message = f"{name} has {len(name)} characters; a name has at most {MAX_NAME}"
            yield Diagnostic(module.file, place.line, place.column, "error", "name-length", message)
        if not bare.isascii() or not bare.replace("_", "a").isalnum() or bare[0].isdigit():
            message = f"{name} is no name: letters, digits and _ only, and no digit first"
            yield Diagnostic(module.file, place.line, place.column, "error", "name", message)


def _written_names(module: Module) -> Iterator[tuple[str, Place]]:
    for routine in module.routines:
        yield routine.name, routine.place
        for parameter in routine.parameters:
            yield parameter.name, parameter.place
        yield from _names_in(routine)
    if module.data is not None:
        yield module.data.name, module.data.place
        yield from _names_in(module.data)


def _names_in(node: Routine | DataList) -> Iterator[tuple[str, Place]]:
    for item in walk(node.body):
        yield from _names_of(item)


def _names_of(item: Node) -> Iterator[tuple[str, Place]]:
    match item:
        case Declaration(names=names):
            for declarator in names:
                yield declarator.name, declarator.place
        case Struct(name=name, members=members, place=place):
            yield name, place
            for _, declarator in members:
                yield declarator.name, declarator.place
        case EnumDecl(name=name, values=values, place=place):
            yield name, place
            for value in values:
                yield value, place
        case Signal(name=name, place=place):
            yield name, place
        case _:
            return
