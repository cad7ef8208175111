"""How do motions, spline blocks and triggers become operations?"""

from collections.abc import Callable, Sequence
from functools import partial

from slabcell_drivers.krc.cells import Place, Trait
from slabcell_drivers.krc.code import Activation, Function, Pause
from slabcell_drivers.krc.emitter import StatementEmitter
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.motion_orders import MoveOrder, PathOrder, TriggerOrder
from slabcell_drivers.krc.motion_settings import applied
from slabcell_drivers.krc.syntax import Expr, Index, Member, Motion, Name, Spline, SplineCondition, Trigger
from slabcell_drivers.krc.values import Value

__all__ = ["compile_motion", "compile_path_order", "compile_spline", "compile_trigger"]

_NO_ROOM = Pause.MOTION


def _root_name(node: Expr) -> str:
    while isinstance(node, Index | Member):
        node = node.base
    return node.name if isinstance(node, Name) else ""


def _settings(
    compiler: StatementEmitter, pairs: Sequence[tuple[Expr, Expr]]
) -> Callable[[Activation], tuple[tuple[str, Place, Value], ...]]:
    """Return what evaluates the settings behind WITH."""
    parts = [(_root_name(target), compiler.place(target), compiler.expr(value)[0]) for target, value in pairs]
    return lambda a: tuple((name, place(a), value(a)) for name, place, value in parts)


def compile_motion(compiler: StatementEmitter, node: Motion) -> None:
    """Emit one motion: an operation that plans it as soon as the advance run has room for it."""
    if not compiler.interpreter.may_move:
        raise KrlError(RunMessage.NOT_SUPPORTED, f"{node.kind}: a submit program may not move the robot")
    if not node.points:
        raise KrlError(RunMessage.NOT_TAUGHT, f"{node.kind} !: this point was never taught")
    points = [compiler.expr(point)[0] for point in node.points]
    angle = compiler.expr(node.angle)[0] if node.angle is not None else None
    settings = _settings(compiler, node.settings)
    runner = compiler.interpreter.motion
    kind, approximation, reference = node.kind, node.approximation, node.reference
    file, line = compiler.code.file, node.place.line

    def move(a: Activation) -> Pause | None:
        if not runner.has_room:
            a.pc -= 1
            return _NO_ROOM
        given = settings(a)
        with applied(given):
            runner.move(
                MoveOrder(
                    kind=kind,
                    points=tuple(point(a) for point in points),
                    angle_deg=None if angle is None else angle(a),
                    approximation=approximation,
                    reference=reference,
                    settings=given,
                    file=file,
                    line=line,
                )
            )
        return None

    compiler.emit_synchronized(move)
    compiler.emit_synchronized(runner.wait_without_advance)


def compile_spline(compiler: StatementEmitter, node: Spline) -> None:
    """Emit a spline block: its segments pass into each other without a stop."""
    settings = _settings(compiler, node.settings)
    runner = compiler.interpreter.motion
    order = MoveOrder(node.kind, (), approximation=node.approximation, file=compiler.code.file, line=node.place.line)

    def begin(a: Activation) -> Pause | None:
        if not runner.has_room:
            a.pc -= 1
            return _NO_ROOM
        runner.begin_spline(settings(a))
        return None

    def end(_: Activation) -> None:
        runner.end_spline(order)

    compiler.emit_synchronized(begin)
    compiler.block(node.body)
    compiler.emit_synchronized(end)
    compiler.emit_synchronized(runner.wait_without_advance)


def compile_trigger(compiler: StatementEmitter, node: Trigger) -> None:
    """Emit a trigger: it belongs to the next motion that is planned."""
    position = compiler.expr(node.position)[0]
    delay = compiler.expr(node.delay)[0] if node.delay is not None else None
    priority = compiler.expr(node.priority)[0] if node.priority is not None else None
    compiler.traits.clear()  # what the action touches is touched in the main run
    label = compiler.action(node.action)
    interpreter = compiler.interpreter
    runner, kind, on_start = interpreter.motion, node.kind, node.on_start

    def arm(a: Activation) -> None:
        if interpreter.served_priority or not interpreter.may_move:
            raise KrlError(RunMessage.TRIGGER_PLACE, f"TRIGGER WHEN {kind}")
        runner.add_trigger(
            TriggerOrder(
                kind=kind,
                position=float(position(a)),
                on_start=on_start,
                delay_s=0.0 if delay is None else float(delay(a)) / 1000.0,
                priority=0 if priority is None else int(priority(a)),
                activation=a,
                label=label,
            )
        )

    compiler.emit_synchronized(arm)


def _is_true(condition: Function, a: Activation) -> bool:
    return condition(a) is True


def compile_path_order(compiler: StatementEmitter, node: SplineCondition) -> None:
    """Emit TIME_BLOCK, CONST_VEL or STOP WHEN PATH: what is ordered of the path of the block, or of the next motion."""
    value = compiler.expr(node.value)[0] if node.value is not None else None
    compiler.traits.clear()
    condition = compiler.condition(node.condition) if node.condition is not None else None
    uses_time = Trait.TIME in compiler.traits
    compiler.traits.clear()  # what the condition looks at is looked at in the main run
    runner = compiler.interpreter.motion
    where = f"{compiler.code.file} line {node.place.line}"

    def order(a: Activation) -> None:
        runner.add_path_order(
            PathOrder(
                kind=node.kind,
                verb=node.verb,
                value=0.0 if value is None else float(value(a)),
                on_start=node.on_start,
                where=where,
                holds=None if condition is None else partial(_is_true, condition, a),
                uses_time=uses_time,
            )
        )

    compiler.emit(order)
