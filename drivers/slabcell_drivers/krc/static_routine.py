"""What would a controller's compiler complain about in one routine?"""

from collections.abc import Sequence

from slabcell_drivers.krc.argument_types import builtin_misfits, misfits
from slabcell_drivers.krc.compile_expressions import describe
from slabcell_drivers.krc.messages import KrlError
from slabcell_drivers.krc.scope import ModuleScope, Project
from slabcell_drivers.krc.static_splines import spline_problems
from slabcell_drivers.krc.static_types import Names, fits, is_text, type_of
from slabcell_drivers.krc.syntax import (
    Assign,
    Binary,
    Call,
    CallStatement,
    Channel,
    Declaration,
    Diagnostic,
    EnumDecl,
    Expr,
    External,
    For,
    Goto,
    If,
    Import,
    Index,
    InterruptDecl,
    Keyword,
    Label,
    Literal,
    Loop,
    Member,
    Name,
    Node,
    Place,
    Repeat,
    Return,
    Routine,
    Signal,
    Spline,
    Statement,
    Struct,
    Switch,
    Wait,
    While,
)
from slabcell_drivers.krc.values import BOOL, CHAR, INT, REAL, ArrayType, EnumType, KrlType, StructType
from slabcell_drivers.krc.walk import walk

__all__ = ["RoutineChecker"]

_DECLARATIONS = (Declaration, Struct, EnumDecl, Signal, External, Import, Channel)
_LOGICAL = frozenset({"AND", "OR", "EXOR"})
_RELATIONS = frozenset({"==", "<>", "<", ">", "<=", ">="})
PRIORITIES = frozenset({1, 2, *range(4, 40), *range(81, 129), 3})
"""Interrupt priorities that a program may use; 3 is that of the stop message in generated programs."""


class RoutineChecker:
    """Checks one routine."""

    def __init__(self, file: str, routine: Routine, project: Project, scope: ModuleScope, *, has_config: bool) -> None:
        self._file = file
        self._routine = routine
        self._project = project
        self._scope = scope
        self._has_config = has_config
        self._locals: dict[str, KrlType | None] = {}
        self._declared_at: dict[str, Place] = {}
        self._constants: set[str] = set()
        self._found: list[Diagnostic] = []

    def check(self) -> list[Diagnostic]:
        """Return what is wrong, in no particular order."""
        self._declare()
        self._check_order(self._routine.body)
        self._check_labels()
        self._check_statements(self._routine.body, loops=0)
        for node in walk(self._routine.body):
            self._check_node(node)
        if self._routine.result_type and not any(isinstance(n, Return) for n in walk(self._routine.body)):
            self._error(self._routine.place, "return", f"{self._routine.name} is a function without RETURN")
        return self._found

    # --- reporting ----------------------------------------------------------------------------------------------

    def _error(self, place: Place, code: str, message: str) -> None:
        self._found.append(Diagnostic(self._file, place.line, place.column, "error", code, message))

    def _warn(self, place: Place, code: str, message: str) -> None:
        self._found.append(Diagnostic(self._file, place.line, place.column, "warning", code, message))

    def _undeclared(self, place: Place, what: str) -> None:
        if self._has_config:
            self._error(place, "undeclared", f"{what} is not declared")
        else:
            self._warn(place, "undeclared", f"{what} is not declared in these files; $config.dat is not among them")

    # --- declarations -------------------------------------------------------------------------------------------

    def _declare(self) -> None:
        for parameter in self._routine.parameters:
            type_ = self._project.find_type(parameter.type_name, self._scope) if parameter.type_name else None
            self._add(parameter.name, parameter.place, type_)
        names = {parameter.name for parameter in self._routine.parameters}
        for statement in self._routine.body:
            if isinstance(statement, Struct | EnumDecl):
                self._project.declare(statement, self._scope)
        for statement in self._routine.body:
            if not isinstance(statement, Declaration):
                continue
            if self._project.find_type(statement.type_name, self._scope) is None:
                self._undeclared(statement.place, f"the type {statement.type_name}")
            for declarator in statement.names:
                try:
                    type_ = self._project.declared_type(statement.type_name, declarator, self._scope)
                except KrlError:
                    type_ = None
                if declarator.name in names:
                    names.discard(declarator.name)
                    self._locals[declarator.name] = type_
                else:
                    self._add(declarator.name, declarator.place, type_)
                if statement.is_const:
                    self._constants.add(declarator.name)

    def _add(self, name: str, place: Place, type_: KrlType | None) -> None:
        before = self._declared_at.get(name)
        if before is not None:
            self._error(place, "duplicate", f"{name} is declared in line {before.line} already")
        self._declared_at.setdefault(name, place)
        self._locals[name] = type_

    def _check_order(self, body: Sequence[Statement]) -> None:
        begun = 0
        for statement in body:
            if isinstance(statement, _DECLARATIONS):
                if begun:
                    message = f"a declaration after the first statement (line {begun})"
                    self._error(statement.place, "declaration-order", message)
            elif not begun and not isinstance(statement, InterruptDecl):
                begun = statement.place.line
            if not isinstance(statement, _DECLARATIONS):
                for node in walk(statement):
                    if node is not statement and isinstance(node, _DECLARATIONS):
                        self._error(node.place, "declaration-order", "a declaration within a block of statements")

    # --- control flow -------------------------------------------------------------------------------------------

    def _check_labels(self) -> None:
        labels: dict[str, Place] = {}
        for node in walk(self._routine.body):
            if isinstance(node, Label):
                if node.name in labels:
                    self._error(
                        node.place, "duplicate", f"label {node.name} is in line {labels[node.name].line} already"
                    )
                labels.setdefault(node.name, node.place)
        for node in walk(self._routine.body):
            if isinstance(node, Goto) and node.label not in labels:
                self._error(node.place, "label", f"there is no label {node.label} in this routine")

    def _check_statements(self, body: Sequence[Statement], *, loops: int) -> None:
        for statement in body:
            match statement:
                case Keyword(word="EXIT") if not loops:
                    self._error(statement.place, "exit", "EXIT stands in no loop")
                case If(then=then, otherwise=otherwise):
                    self._check_statements(then, loops=loops)
                    self._check_statements(otherwise, loops=loops)
                case Switch(cases=cases):
                    for case in cases:
                        self._check_statements(case.body, loops=loops)
                case For(body=inner) | While(body=inner) | Repeat(body=inner) | Loop(body=inner):
                    self._check_statements(inner, loops=loops + 1)
                case Spline(body=inner):
                    self._check_statements(inner, loops=loops)
                case Return(value=value):
                    self._check_return(statement.place, value)
                case _:
                    pass

    def _check_return(self, place: Place, value: Expr | None) -> None:
        if value is not None and not self._routine.result_type:
            self._error(place, "return", f"RETURN with a value in {self._routine.name}, which is a DEF and no DEFFCT")
        elif value is None and self._routine.result_type:
            self._error(place, "return", f"RETURN without a value in the function {self._routine.name}")

    # --- expressions --------------------------------------------------------------------------------------------

    @property
    def _names(self) -> Names:
        return Names(self._project, self._scope, self._locals)

    def _check_node(self, node: Node) -> None:
        match node:
            case Name(name=name):
                self._check_name(node, name)
            case CallStatement(call=call):
                self._check_procedure(call)
            case Call():
                self._check_call(node)
            case Assign(target=target, value=value):
                self._check_assign(node, target, value)
            case If(condition=condition) | While(condition=condition) | Repeat(condition=condition):
                self._check_condition(condition)
            case Wait(kind="FOR", value=value):
                self._check_condition(value)
            case InterruptDecl(number=number, condition=condition):
                self._check_condition(condition)
                self._check_event(condition)
                if isinstance(number, Literal) and number.value not in PRIORITIES:
                    message = f"priority {number.value}: 1, 2, 4 to 39 and 81 to 128 are free for programs"
                    self._warn(node.place, "priority", message)
            case Binary():
                self._check_ranks(node)
                self._check_operands(node)
            case Member(base=base, name=name):
                type_ = type_of(base, self._names)
                if isinstance(type_, StructType) and name not in type_.members:
                    self._error(node.place, "member", f"{type_.name} has no member {name}")
            case Switch(subject=subject):
                type_ = type_of(subject, self._names)
                if type_ is not None and type_ not in (INT, CHAR) and not isinstance(type_, EnumType):
                    message = f"SWITCH takes INT, CHAR or an enumeration; {describe(subject)} is {type_.name}"
                    self._error(subject.place, "switch", message)
            case Spline():
                for found, code, message in spline_problems(node):
                    self._error(found.place, code, message)
            case _:
                pass

    def _check_name(self, node: Name, name: str) -> None:
        if name.startswith((":", "$")) or name in self._locals:
            return
        if self._project.find(name, self._scope) is None:
            self._undeclared(node.place, name)

    def _check_procedure(self, call: Call) -> None:
        found = self._project.routine(call.name, self._scope)
        if found is not None and found[0].result_type:
            self._warn(call.place, "result", f"the value of the function {call.name} is not used")

    def _check_call(self, call: Call) -> None:
        found = self._project.routine(call.name, self._scope)
        count = len(call.arguments)
        if found is None:
            builtin = self._project.builtins.get(call.name)
            if builtin is None:
                if not self._is_external(call.name):
                    self._undeclared(call.place, f"{call.name}()")
            elif not builtin.least <= count <= builtin.most:
                expected = str(builtin.least) if builtin.least == builtin.most else f"{builtin.least} to {builtin.most}"
                self._error(call.place, "arguments", f"{call.name}() takes {expected} arguments, {count} are given")
            for misfit in builtin_misfits(call, self._names):
                self._error(misfit.argument.place, "argument-type", f"{call.name}(): {misfit}")
            return
        routine, module = found
        for misfit in misfits(call, routine, module, self._names):
            self._error(misfit.argument.place, "argument-type", f"{call.name}(): {misfit}")
        message = f"{call.name}() takes {len(routine.parameters)} arguments, {count} are given"
        if count > len(routine.parameters):
            self._error(call.place, "arguments", message)
        elif count < len(routine.parameters):
            self._warn(call.place, "arguments", f"{message}; those left out have no value")
        for argument, parameter in zip(call.arguments, routine.parameters, strict=False):
            if parameter.mode == "OUT" and argument is not None and not isinstance(argument, Name | Index | Member):
                message = f"{call.name}() writes to its parameter {parameter.name}; {describe(argument)} is no variable"
                self._error(argument.place, "arguments", message)

    def _is_external(self, name: str) -> bool:
        statements = list(self._routine.body)
        return any(isinstance(s, External) and s.name == name for s in statements) or name in self._scope.externals

    def _check_assign(self, node: Assign, target: Expr, value: Expr) -> None:
        if isinstance(target, Name):
            is_const = target.name in self._constants or (
                target.name not in self._locals
                and getattr(self._project.find(target.name, self._scope), "is_const", False)
            )
            if is_const:
                self._error(node.place, "constant", f"{target.name} is a constant")
        target_type, value_type = type_of(target, self._names), type_of(value, self._names)
        if not fits(value_type, target_type):
            shown = value_type.name if value_type is not None and value_type.name else "this value"
            message = f"{describe(target)} is {target_type.name if target_type else '?'}, {shown} does not fit"
            self._error(node.place, "type", message)
        if (
            isinstance(value, Literal)
            and isinstance(value.value, str)
            and isinstance(target_type, ArrayType)
            and is_text(target_type)
            and len(target_type.sizes) == 1
            and 0 < target_type.sizes[0] < len(value.value)
        ):
            message = f"the text has {len(value.value)} characters, {describe(target)} holds {target_type.sizes[0]}"
            self._error(node.place, "text-length", message)

    def _check_condition(self, condition: Expr) -> None:
        type_ = type_of(condition, self._names)
        if type_ is not None and type_ is not BOOL:
            shown = type_.name or "an enumeration value"
            self._error(condition.place, "condition", f"a condition has to be BOOL; {describe(condition)} is {shown}")

    def _check_event(self, condition: Expr) -> None:
        for node in walk(condition):
            if isinstance(node, Call):
                message = f"the condition of an interrupt calls {node.name}(): not confirmed on a controller"
                self._warn(node.place, "condition-call", message)

    def _check_operands(self, node: Binary) -> None:
        if node.operator not in {"+", "-", "*", "/"}:
            return
        for side in (node.left, node.right):
            type_ = type_of(side, self._names)
            if type_ is not None and type_ not in (INT, REAL, CHAR):
                shown = type_.name or "an enumeration value"
                self._error(side.place, "operand", f"{node.operator} takes numbers; {describe(side)} is {shown}")

    def _check_ranks(self, node: Binary) -> None:
        """Warn of ``a==5 AND b==6``: comparisons bind weakest in KRL, so that it means ``a==(5 AND b)==6``."""
        if node.operator not in _RELATIONS:
            return
        for side in (node.left, node.right):
            if isinstance(side, Binary) and not side.parenthesized and side.operator in _LOGICAL:
                message = (
                    f"{side.operator} binds more tightly than {node.operator} in KRL: "
                    f"put the comparisons, or what is compared, into parentheses"
                )
                self._warn(side.place, "parentheses", message)
