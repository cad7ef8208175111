"""How does one run KRL programs without a robot?  `SoftwareKrc`: a KR C4 in software as a library.

It loads a project of .src and .dat files, runs a program in virtual time, and tells the cell around it what the
outputs and the tool do.  It is *not* a safety controller and not a substitute for a test run in T1.
"""

import random
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Self

from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.clock import Clock
from slabcell_drivers.krc.code import Activation, Code
from slabcell_drivers.krc.compile_expressions import ExpressionCompiler
from slabcell_drivers.krc.data_values import to_krl, to_python
from slabcell_drivers.krc.eki import EkiEvent, EthernetKrl
from slabcell_drivers.krc.eki_channel import TelegramDirection, WireOptions
from slabcell_drivers.krc.eki_transport import Link
from slabcell_drivers.krc.io_state import InputsOutputs
from slabcell_drivers.krc.kernel import STATEMENT_S, Hooks, Kernel
from slabcell_drivers.krc.loading import load_predefined, load_sources, read_project, stem_of
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.motion import Trajectory
from slabcell_drivers.krc.motion_move import Move
from slabcell_drivers.krc.parser import parse
from slabcell_drivers.krc.run_values import CellIo, RunResult, TraceEvent
from slabcell_drivers.krc.scope import ModuleScope
from slabcell_drivers.krc.smartpad import ShownMessage
from slabcell_drivers.krc.syntax import Assign, DataList, Diagnostic, Routine
from slabcell_drivers.krc.values import EnumConstant
from slabcell_drivers.krc.write_back import written_back
from slabcell_drivers.robot.arm import ArmModel, Axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["SoftwareKrc"]

_CAN_GO_ON = frozenset({"halted", "stopped"})
_MODES = ("T1", "T2", "AUT", "EX")
HOME: Axes = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)


class SoftwareKrc:
    """One controller with its project.  Use it as a context manager, or call `close`.

    ``speed`` 1.0 runs in real time, None as fast as possible; ``statement_s`` is the time that one statement takes.
    ``submit`` names a program, SPS for example, that the submit interpreter runs beside those that are selected.
    ``trace`` is called from the thread that runs programs.
    """

    def __init__(
        self,
        sources: Mapping[str, bytes] | Path,
        *,
        robot: ArmModel,
        eki_configs: Mapping[str, bytes] | None = None,
        eki_addresses: Mapping[str, tuple[str, int]] | None = None,
        eki_link: Link | None = None,
        eki_wire: WireOptions | None = None,
        io: CellIo | None = None,
        seed: int = 0,
        speed: float | None = None,
        trace: Callable[[TraceEvent], None] | None = None,
        trace_kinds: frozenset[str] = frozenset({"motion", "io", "telegram", "message"}),
        dialog: Callable[[ShownMessage], int] | None = None,
        on_trajectory: Callable[[Trajectory], None] | None = None,
        home_axes_deg: Axes = HOME,
        statement_s: float = STATEMENT_S,
        submit: str = "",
    ) -> None:
        self._io = io
        self._trace = trace
        self._on_trajectory = on_trajectory
        self._submit = submit
        self._kinds = trace_kinds if trace is not None else frozenset[str]()
        hooks = Hooks(
            output_changed=self._output_changed,
            moved=self._moved,
            move_started=self._move_started,
            message_shown=self._message_shown,
            dialog=dialog or _no_answer,
        )
        self._outputs_hold = False

        def make_eki(io: InputsOutputs, clock: Clock, rng: random.Random) -> EthernetKrl:
            return EthernetKrl(
                dict(eki_configs or {}),
                set_flag=io.flags.flags.put,
                set_out=io.outputs.put,
                rng=rng,
                addresses=eki_addresses,
                link=eki_link,
                wire=eki_wire,
                clock=lambda: clock.now_s,
                on_telegram=self._telegram,
                on_notice=lambda channel, text: self._emit("message", f"EKI {channel}: {text}"),
            )

        self._kernel = kernel = Kernel(
            arm=robot, home=home_axes_deg, hooks=hooks, make_eki=make_eki, seed=seed, speed=speed
        )
        kernel.statement_s = statement_s
        if "statement" in self._kinds:
            kernel.interpreter.on_statement = self._statement
        kernel.motion.reports_every_step = speed is not None or "path" in self._kinds
        found = read_project(sources) if isinstance(sources, Path) else dict(sources)
        self.diagnostics: list[Diagnostic] = []
        self._data_lists: dict[str, tuple[bytes, DataList]] = {}
        self._load(found)

    def _load(self, sources: Mapping[str, bytes]) -> None:
        project = self._kernel.project
        load_predefined(project)
        self._kernel.system.populate()
        for module in load_sources(project, sources):
            self.diagnostics.extend(module.diagnostics)
            if module.data is not None:
                self._data_lists[module.file] = (sources[module.file], module.data)
        self.diagnostics.extend(project.problems)

    # --- running ------------------------------------------------------------------------------------------------

    def run(self, program: str, *, max_wall_s: float) -> RunResult:
        """Select a program, run it to its end and deselect it.  Blocks; meant for a worker thread.

        A HALT ends the run with status ``halted``; `go_on` presses Start again.
        """
        kernel = self._kernel
        kernel.begin()
        found = self._find_program(program)
        if isinstance(found, RunResult):
            return found
        routine, module = found
        kernel.eki.end(EkiEvent.PROGRAM_RESET)
        kernel.system.reset_motion_settings()
        kernel.motion.planner.needs_axis_motion = True
        kernel.motion.discard()
        if self._submit and kernel.submit.is_done:
            background = self._find_program(self._submit)
            if isinstance(background, RunResult):
                return background
            kernel.submit.select(*background)
        kernel.interpreter.statements = 0
        kernel.interpreter.select(routine, module)
        kernel.system.write("$PRO_NAME", module.name[:24])
        kernel.system.write("$PRO_NAME1", module.name[:24])
        kernel.system.write("$PRO_STATE1", EnumConstant("P_ACTIVE"))
        return self._run_on(max_wall_s)

    def go_on(self, *, max_wall_s: float) -> RunResult:
        """Press Start after a HALT, an emergency stop or a change of the mode."""
        self._kernel.begin()
        return self._run_on(max_wall_s)

    def _run_on(self, max_wall_s: float) -> RunResult:
        kernel = self._kernel
        interpreter = kernel.interpreter
        deadline = time.monotonic() + max_wall_s
        result: RunResult | None = None
        try:
            while result is None:
                pause = None if interpreter.is_done else interpreter.run_slice(kernel.quota)
                if kernel.ending is not None:
                    result = self._result(kernel.ending.status, kernel.ending.number, kernel.ending.text)
                elif interpreter.is_done and not kernel.motion.is_busy:
                    result = self._result("done", 0, "")
                elif time.monotonic() >= deadline:
                    text = f"the program did not end within {max_wall_s:g} s"
                    if (dialog := kernel.messages.open_dialog) is not None:
                        text += f"; the dialog {dialog.text!r} was not answered"
                    result = self._result("deadline", RunMessage.DEADLINE, text)
                else:
                    kernel.tick(pause)
        except KrlError as error:
            result = self._result("error", error.number, error.text)
            kernel.messages.show("QUIT", "KRC", error.number, f"{error.text} ({result.file} {result.line})")
        if result.status not in _CAN_GO_ON:
            self._deselect()
        if result.status == "power_lost":
            self._switch_on()
        return result

    def _result(self, status: str, number: int, message: str) -> RunResult:
        kernel = self._kernel
        file, line = kernel.interpreter.place
        return RunResult(status, int(number), message, file, line, kernel.clock.now_s, kernel.interpreter.statements)

    def _deselect(self) -> None:
        kernel = self._kernel
        kernel.interpreter.deselect()
        kernel.motion.discard()
        kernel.forget_events()
        kernel.eki.end(EkiEvent.PROGRAM_RESET)
        kernel.system.write("$PRO_STATE1", EnumConstant("P_FREE"))

    def _find_program(self, program: str) -> tuple[Routine, ModuleScope] | RunResult:
        stem = stem_of(program)
        module = self._kernel.project.modules.get(stem)
        if module is None or module.main is None:
            known = ", ".join(sorted(m.name for m in self._kernel.project.modules.values() if m.main is not None))
            text = f"there is no program {program}; there are: {known or 'none'}"
            return RunResult("error", RunMessage.NO_PROGRAM, text, "", 0, self._kernel.clock.now_s, 0)
        for found in self.diagnostics:
            if found.severity == "error" and found.file == module.program_file:
                return RunResult(
                    "error", RunMessage.SYNTAX, str(found), found.file, found.line, self._kernel.clock.now_s, 0
                )
        return module.main, module

    def cancel(self) -> None:
        """Cancel the program before its next statement; from any thread."""
        self._kernel.end("cancelled", RunMessage.CANCELLED, "the program was cancelled")

    def reset(self) -> None:
        """Reset the program: it ends before its next statement and can be run again from its start."""
        self._kernel.end("reset", RunMessage.CANCELLED, "the program was reset")

    def deselect(self) -> None:
        """Deselect the program: it ends before its next statement."""
        self._kernel.end("deselected", RunMessage.CANCELLED, "the program was deselected")

    def emergency_stop(self) -> None:
        """Press the emergency stop; from any thread.  `go_on` is Start after it was released and acknowledged."""
        self._kernel.end("stopped", RunMessage.EMERGENCY_STOP, "EMERGENCY STOP")
        self._kernel.system.write("$ALARM_STOP", value=False)
        self._kernel.system.write("$STOPMESS", value=True)

    def release_emergency_stop(self) -> None:
        """Release the emergency stop and acknowledge it."""
        self._kernel.system.write("$ALARM_STOP", value=True)
        self._kernel.system.write("$STOPMESS", value=False)

    def change_mode(self, mode: str) -> None:
        """Turn the key to T1, T2, AUT or EX: a program that runs is stopped; `go_on` is Start in the new mode."""
        if mode.upper() not in _MODES:
            msg = f"{mode} is no mode of operation; there are {', '.join(_MODES)}"
            raise ValueError(msg)
        self._kernel.system.write("$MODE_OP", EnumConstant(mode.upper()))
        self._kernel.end("stopped", RunMessage.MODE_CHANGED, f"STOP due to operating mode change: {mode.upper()}")

    def power_loss(self, *, outputs_hold: bool = False) -> None:
        """Cut the power; from any thread, or from the trace of a statement, which is then not executed.

        What stands in data lists persists and so does the place of the arm; flags, timers and connections do not, and
        outputs only if ``outputs_hold``.  `run` afterwards is a start after switching on again.
        """
        self._outputs_hold = outputs_hold
        self._kernel.end("power_lost", RunMessage.POWER_LOST, "power lost")

    def _switch_on(self) -> None:
        kernel = self._kernel
        kernel.io.flags.flags.clear()
        kernel.io.timers.clear()
        if not self._outputs_hold:
            kernel.io.outputs.drop()
        kernel.eki.close_all()

    def cancel_submit(self) -> None:
        """Cancel the submit program; its channels of EKI end with it."""
        self._kernel.submit.deselect()
        self._kernel.eki.end(EkiEvent.SUBMIT_CANCEL)

    def close(self) -> None:
        """Close every connection; may be called twice."""
        self._kernel.eki.close_all()

    def __enter__(self) -> Self:
        """Return the controller."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close every connection."""
        self.close()

    # --- what the cell sees and does ----------------------------------------------------------------------------

    def set_input(self, number: int, value: bool) -> None:  # noqa: FBT001  # a bit is a value
        """Set $IN[number]; from any thread."""
        if self._kernel.io.inputs[number] is not value:
            self._kernel.io.inputs.put(number, value)
            self._emit("io", f"$IN[{number}]={'TRUE' if value else 'FALSE'}")

    def output(self, number: int) -> bool:
        """Return $OUT[number]."""
        return self._kernel.io.outputs[number]

    @property
    def tcp(self) -> Frame:
        """The tool centre point in the robot's root."""
        return self._kernel.motion.tcp

    @property
    def axes_deg(self) -> Axes:
        """The axis angles."""
        return self._kernel.motion.axes

    @property
    def virtual_time_s(self) -> float:
        """The time since the controller was switched on."""
        return self._kernel.clock.now_s

    @property
    def messages(self) -> list[ShownMessage]:
        """Every message shown so far."""
        return list(self._kernel.messages.log)

    def _emit(self, kind: str, text: str) -> None:
        if self._trace is not None and kind in self._kinds:
            file, line = self._kernel.interpreter.place
            self._trace(TraceEvent(kind, self._kernel.clock.now_s, file, line, text))

    def _output_changed(self, number: int, value: bool) -> None:  # noqa: FBT001  # a bit is a value
        self._emit("io", f"$OUT[{number}]={'TRUE' if value else 'FALSE'}")
        if self._io is not None:
            self._io.output_changed(number, value, self.tcp)

    def _moved(self, tcp: Frame) -> None:
        if self._io is not None:
            self._io.moved(tcp)
        if "path" in self._kinds:
            self._emit("path", ",".join(f"{v:.3f}" for v in tcp.as_tuple()))

    def _move_started(self, move: Move) -> None:
        if self._on_trajectory is not None:
            self._on_trajectory(move.trajectory)
        if "motion" in self._kinds and self._trace is not None:
            order = move.order
            text = f"{order.kind} {' '.join(map(repr, order.points))} {move.trajectory.duration_s:.3f} s"
            self._trace(TraceEvent("motion", self._kernel.clock.now_s, order.file, order.line, text))

    def _message_shown(self, message: ShownMessage) -> None:
        self._emit("message", str(message))

    def _telegram(self, channel: str, direction: TelegramDirection, telegram: bytes) -> None:
        if direction is TelegramDirection.RECEIVED:
            self._kernel.telegram_came()
        self._emit("telegram", f"{channel} {direction.value} {telegram.decode('latin-1')}")

    def _statement(self, file: str, line: int) -> None:
        if self._trace is not None:
            self._trace(TraceEvent("statement", self._kernel.clock.now_s, file, line, ""))

    # --- data ---------------------------------------------------------------------------------------------------

    def data(self, module: str, name: str) -> object:
        """Return a variable, ``NAME``, ``NAME[1]`` or ``NAME.X``: a number, text, Frame, dict or list; None if not set.

        ``module`` is a data list, ``$CONFIG`` or empty for global data.  Raises KrlError if it is not declared.
        """
        return to_python(self._place(module, name).value)

    def set_data(self, module: str, name: str, value: object) -> None:
        """Set a variable from a number, text, Frame, dict or list.  Raises KrlError: not declared, or not fitting."""
        self._place(module, name).set(to_krl(value))

    def assign(self, assignment: str) -> None:
        """Carry out one assignment in KRL, such as ``TOOL_DATA[1]={X 0,Y 0,Z 200,A 0,B 0,C 0}``, on global data.

        Raises KrlError if it is none, or not possible.
        """
        name, _, value = assignment.partition("=")
        self._place("", name.strip()).set(self._kernel.evaluate_text(value.strip()))

    def data_files(self) -> dict[str, bytes]:
        """Return the project's data lists with the values of now: what the controller keeps over power-off."""
        modules = self._kernel.project.modules
        return {
            file: written_back(source, data, modules[stem_of(file)].data)
            for file, (source, data) in self._data_lists.items()
        }

    def _place(self, module: str, name: str) -> Place:
        parsed = parse(f"DEF X()\n{name}=0\nEND\n", "data")
        statement = parsed.routines[0].body[0] if parsed.routines and parsed.routines[0].body else None
        if parsed.diagnostics or not isinstance(statement, Assign):
            raise KrlError(RunMessage.SYNTAX, f"{name} is no variable")
        scope = self._kernel.project.modules.get(stem_of(module)) if module else None
        compiler = ExpressionCompiler(self._kernel.project, scope, Code("", ""))
        return compiler.place(statement.target)(Activation(compiler.code, []))


def _no_answer(_: ShownMessage) -> int:
    return 0
