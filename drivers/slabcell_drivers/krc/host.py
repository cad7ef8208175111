"""What do functions of KRL and the interpreter ask of the controller around them?"""

import random
from collections.abc import Callable
from typing import Protocol

from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.code import Activation
from slabcell_drivers.krc.eki import EkiStatus, EthernetKrl
from slabcell_drivers.krc.io_state import InputsOutputs
from slabcell_drivers.krc.messages import KrlError
from slabcell_drivers.krc.motion_runner import MotionRunner
from slabcell_drivers.krc.names import ProjectNames
from slabcell_drivers.krc.smartpad import MessageWindow
from slabcell_drivers.krc.values import Value

__all__ = ["Host", "HostVariables"]


class HostVariables(Protocol):
    """System variables, read and written from the controller's side."""

    def read(self, name: str) -> Value:
        """Return the value of a system variable, None if it was never set."""
        ...

    def write(self, name: str, value: Value) -> None:
        """Set a system variable."""
        ...


class Host(Protocol):
    """The controller around a program."""

    rng: random.Random
    io: InputsOutputs
    messages: MessageWindow
    motion: MotionRunner
    eki: EthernetKrl
    error_text: str
    open_dialog: tuple[int, Place] | None

    @property
    def project(self) -> ProjectNames:
        """The names of the project."""
        ...

    @property
    def system(self) -> HostVariables:
        """The system variables."""
        ...

    def schedule(self, seconds: float, action: Callable[[], None]) -> None:
        """Do something after so much virtual time."""
        ...

    def expect_network(self) -> None:
        """Note that the program waits for the network."""
        ...

    def expect_operator(self, *, waits: bool) -> None:
        """Note whether the program waits for the operator."""
        ...

    def open_channel(self, name: str) -> EkiStatus:
        """Open an EKI channel; time goes on meanwhile."""
        ...

    def halt(self, a: Activation) -> None:
        """HALT."""
        ...

    def command(self, command: str) -> bool:
        """Carry out a command such as ``CANCEL 1``; return whether this controller can."""
        ...

    def confirm(self, message: Value) -> None:
        """CONFIRM: acknowledge one message, or all."""
        ...

    def set_error(self, error: KrlError, file: str, line: int, routine: str) -> None:
        """Set $ERR, for ON_ERROR_PROCEED."""
        ...

    def clear_error(self) -> None:
        """Reset $ERR."""
        ...

    def data_or_none(self, name: str) -> Value:
        """Return global data, None if it is not declared or was never set."""
        ...

    def variable_state(self, name: str) -> str:
        """Return DECLARED, INITIALIZED or UNKNOWN, for VARSTATE."""
        ...

    def evaluate_text(self, content: str) -> Value:
        """Return the value of an expression given as a text.  Raises KrlError."""
        ...
