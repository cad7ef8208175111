"""How is a model file opened and run?  With onnxruntime on the CPU, bounded in size and time.

A run that lasts beyond its deadline is ended by onnxruntime between two operations of the model.
"""

import importlib
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from slabcell.errors import ImageError
from slabcell.vision.promptable.errors import ModelError

__all__ = ["Deadline", "Model", "Tensor", "open_model"]

Array = npt.NDArray[Any]

# The largest encoder of the family (SAM ViT-H) has 2.5 GB.
MAX_FILE_BYTES: Final = 4 << 30
# VISION_SLOW in the error catalogue.
SLOW: Final = 1504
TYPES: Final = {"tensor(float)": np.dtype(np.float32), "tensor(int64)": np.dtype(np.int64)}


@dataclass(frozen=True, slots=True)
class Tensor:
    """An input or output of a model: its type, and its shape with None where the model leaves a size open."""

    name: str
    kind: str
    shape: tuple[int | None, ...]

    def __str__(self) -> str:
        sizes = ", ".join("?" if size is None else str(size) for size in self.shape)
        return f"{self.name}({sizes})"


class Deadline:
    """A moment on the monotonic clock by which all runs together must have ended."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._end = time.monotonic() + seconds

    def remaining_s(self) -> float:
        """Return the seconds that are left, 0 when it has passed."""
        return max(0.0, self._end - time.monotonic())

    def passed(self) -> ImageError:
        """Return the error to raise when it has passed."""
        msg = (
            f"the promptable model was not done within {self._seconds:g} s, the limit 'max_seconds' of"
            " [segmentation.promptable]; take a smaller model, fewer prompts, or raise the limit"
        )
        return ImageError(msg, number=SLOW)


class Model:
    """An opened model file."""

    def __init__(self, path: Path, runtime: Any, session: Any) -> None:
        self.path = path
        self._runtime = runtime
        self._session = session
        self.inputs = {item.name: item for item in map(_tensor, session.get_inputs())}
        self.outputs = {item.name: item for item in map(_tensor, session.get_outputs())}

    def run(self, feeds: Mapping[str, Array], outputs: list[str], deadline: Deadline) -> list[Array]:
        """Return the outputs of these names.  Raises ImageError after the deadline, ModelError if the model fails."""
        left = deadline.remaining_s()
        if left <= 0.0:
            raise deadline.passed()
        options = self._runtime.RunOptions()
        options.log_severity_level = 4
        ended = threading.Event()

        def end() -> None:
            ended.set()
            options.terminate = True

        timer = threading.Timer(left, end)
        timer.daemon = True
        timer.start()
        try:
            found: list[Any] = self._session.run(outputs, dict(feeds), options)
        except Exception as error:  # onnxruntime's errors have no common base of their own
            if ended.is_set():
                raise deadline.passed() from error
            msg = f"{self.path}: the model failed: {_short(error)}; export it again, or take another"
            raise ModelError(msg) from error
        finally:
            timer.cancel()
        return [np.asarray(item) for item in found]


def open_model(path: Path, threads: int) -> Model:
    """Return the model of a file; ``threads`` 0 means all cores.  Raises ModelError."""
    try:
        runtime: Any = importlib.import_module("onnxruntime")
    except ImportError as error:
        msg = f"a promptable model needs onnxruntime, which is not installed ({error}): pip install 'slabcell[sam]'"
        raise ModelError(msg) from error
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            begin = stream.read(1)
    except OSError as error:
        msg = f"{path}: the model file cannot be read: {error.strerror}; give the path of an .onnx file"
        raise ModelError(msg) from error
    if not begin or size > MAX_FILE_BYTES:
        msg = f"{path}: has {size} bytes; a model file has between 1 and {MAX_FILE_BYTES}"
        raise ModelError(msg)
    options = runtime.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Threads that spin after a run would take the cores from the camera.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        session = runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors have no common base of their own
        msg = f"{path}: is no ONNX model that onnxruntime {runtime.__version__} can load: {_short(error)}"
        raise ModelError(msg) from error
    return Model(path, runtime, session)


def _tensor(item: Any) -> Tensor:
    shape = tuple(size if isinstance(size, int) and size > 0 else None for size in item.shape)
    return Tensor(str(item.name), str(item.type), shape)


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:300]
