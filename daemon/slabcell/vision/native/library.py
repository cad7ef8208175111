"""Where is the compiled kernel, and which functions does it have?"""

import ctypes
from pathlib import Path
from typing import Any, Final

__all__ = ["FAST_LIBRARY", "LIBRARY", "Functions", "load"]

LIBRARY: Final = Path(__file__).with_name("_kernel.so")
FAST_LIBRARY: Final = Path(__file__).with_name("_kernel_v3.so")
FAST_LEVEL: Final = 3
# As in kernel.h.
VERSION: Final = 9

_POINTER, _SIZE, _INT, _LONG, _REAL = ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_int, ctypes.c_int64, ctypes.c_double
_PICTURE = (_POINTER, _SIZE, _INT, _INT)
_GRID = (_POINTER, _INT, _INT, _REAL)


def load(path: Path | None) -> ctypes.CDLL:
    """Return the library at a path, or the fastest that this processor can run.

    Raises OSError or AttributeError where it is missing, ValueError for another version.
    """
    library = ctypes.CDLL(str(path or LIBRARY))
    version = library.slabcell_kernel_version()
    if version != VERSION:
        msg = f"{path or LIBRARY} is version {version} of the kernel, this is {VERSION}: install slabcell again"
        raise ValueError(msg)
    if path is None and FAST_LIBRARY.exists() and library.slabcell_cpu_level() >= FAST_LEVEL:
        return load(FAST_LIBRARY)
    return library


class Functions:
    """The kernel's functions, each with the types of its arguments."""

    def __init__(self, library: ctypes.CDLL) -> None:
        def function(name: str, *arguments: Any, result: Any = None) -> Any:
            found = getattr(library, "slabcell_" + name)
            found.argtypes, found.restype = arguments, result
            return found

        self.level = int(library.slabcell_cpu_level())
        self.survey = function("survey", *_PICTURE, _INT, *[_POINTER] * 5)
        self.trace = function(
            "trace",
            *(*_PICTURE, _REAL, _INT, _INT, _REAL, _INT),
            *(_POINTER, _POINTER, _LONG, *[_POINTER] * 3, _LONG, _POINTER),
            result=_LONG,
        )
        self.to_plane = function("to_plane", *_GRID, _LONG, _POINTER, _POINTER)
        self.strip_walls = function(
            "strip_walls",
            *(*_GRID, _POINTER, _LONG, _POINTER, _POINTER),
            *(_INT, _REAL, _REAL, _POINTER, _POINTER),
            result=_INT,
        )
        self.describe = function("describe", *_GRID, _LONG, *[_POINTER] * 3, _LONG, _INT, *[_POINTER] * 10)
        self.match = function("match", _LONG, *[_POINTER] * 5, _LONG, *[_POINTER] * 12, _LONG, _POINTER, result=_LONG)
        self.local_maps = function("local_maps", _POINTER, _INT, *[_POINTER] * 2, _INT, *[_POINTER] * 3, result=_INT)
        self.to_pixels = function("to_pixels", _POINTER, _LONG, *[_POINTER] * 2, result=_INT)
        self.project = function("project", _INT, *[_POINTER] * 4, _INT, *[_POINTER] * 2)
        self.solve = function("solve", _INT, *[_POINTER] * 3, _REAL, *[_POINTER] * 4)
        self.measure = {
            kind: function(f"measure_edges_u{8 * kind}", *_PICTURE, _INT, *[_POINTER] * 4) for kind in (1, 2)
        }
        self.register = function(
            "register",
            *(*_PICTURE, _INT, *[_POINTER] * 10),
            *(_POINTER, _INT, *[_POINTER] * 3),
            *(_INT, _POINTER, _LONG, *[_POINTER] * 3),
            result=_INT,
        )
        self.poses = function("poses", _POINTER, _REAL, _INT, *[_POINTER] * 9, result=_INT)
