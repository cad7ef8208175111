"""How do IF, SWITCH and the loops become jumps?"""

from collections.abc import Sequence

from slabcell_drivers.krc.code import Activation
from slabcell_drivers.krc.compile_calls import CallCompiler
from slabcell_drivers.krc.jumps import branch_unless, jump_to
from slabcell_drivers.krc.operators import BINARY
from slabcell_drivers.krc.syntax import Expr, For, If, Statement, Switch
from slabcell_drivers.krc.values import INT

__all__ = ["BlockCompiler"]


class BlockCompiler(CallCompiler):
    """Compiles blocks.  ``exits`` has the jumps out of each loop that is open, to be given their targets."""

    exits: list[list[int]]

    def compile_if(self, statement: If) -> None:
        """Compile IF."""
        condition = self.expr(statement.condition)[0]
        branch = self.emit_synchronized(jump_to(0))
        self.block(statement.then)
        if statement.otherwise:
            self.line = statement.place.line
            skip = self.emit(jump_to(0))
            self.code.operations[branch] = branch_unless(condition, self.position)
            self.block(statement.otherwise)
            self.code.operations[skip] = jump_to(self.position)
        else:
            self.code.operations[branch] = branch_unless(condition, self.position)

    def compile_switch(self, statement: Switch) -> None:
        """Compile SWITCH."""
        subject = self.expr(statement.subject)[0]
        choices = [[self.expr(value)[0] for value in case.values] for case in statement.cases]
        chooser = self.emit_synchronized(jump_to(0))
        targets: list[int] = []
        ends: list[int] = []
        for case in statement.cases:
            targets.append(self.position)
            self.block(case.body)
            self.line = case.place.line
            ends.append(self.emit(jump_to(0)))
        end = self.position
        for position in ends:
            self.code.operations[position] = jump_to(end)
        equal = BINARY["=="]
        table = [(values, target) for values, target in zip(choices, targets, strict=True) if values]
        default = next((t for values, t in zip(choices, targets, strict=True) if not values), end)

        def choose(a: Activation) -> None:
            value = subject(a)
            for values, target in table:
                if any(equal(value, candidate(a)) for candidate in values):
                    a.pc = target
                    return
            a.pc = default

        self.code.operations[chooser] = choose

    def compile_for(self, statement: For) -> None:
        """Compile FOR: end and step are computed once, before the first turn."""
        variable = self.place(statement.variable)
        start, end = self.expr(statement.start)[0], self.expr(statement.end)[0]
        step = self.expr(statement.step)[0] if statement.step is not None else None
        end_index, step_index = self.add_local("", INT), self.add_local("", INT)
        first = self.emit_synchronized(jump_to(0))
        body = self.position
        self.exits.append([])
        self.block(statement.body)
        self.line = statement.place.line
        repeat = self.emit(jump_to(0))
        after = self.position

        def begin(a: Activation) -> None:
            place = variable(a)
            place.set(start(a))
            limit, stride = end(a), 1 if step is None else step(a)
            a.cells[end_index].set(limit)
            a.cells[step_index].set(stride)
            if (place.value > limit) if stride > 0 else (place.value < limit):
                a.pc = after

        def go_on(a: Activation) -> None:
            place = variable(a)
            stride, limit = a.cells[step_index].value, a.cells[end_index].value
            place.set(place.value + stride)
            if (place.value <= limit) if stride > 0 else (place.value >= limit):
                a.pc = body

        self.code.operations[first] = begin
        self.code.operations[repeat] = go_on
        self._patch_exits()

    def compile_loop(self, body: Sequence[Statement], *, before: Expr | None = None, after: Expr | None = None) -> None:
        """Compile a loop with a condition before its body (WHILE), after it (REPEAT) or none (LOOP)."""
        start = self.position
        line = self.line
        check = -1
        condition = None
        if before is not None:
            condition = self.expr(before)[0]
            check = self.emit_synchronized(jump_to(0))
        self.exits.append([])
        self.block(body)
        self.line = line
        if after is not None:
            self.traits.clear()
            until = self.expr(after)[0]
            self.emit_synchronized(branch_unless(until, start))
        else:
            self.emit(jump_to(start))
        if condition is not None:
            self.code.operations[check] = branch_unless(condition, self.position)
        self._patch_exits()

    def _patch_exits(self) -> None:
        for position in self.exits.pop():
            self.code.operations[position] = jump_to(self.position)
