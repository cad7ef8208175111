"""How is the compiled code built?  By the C compiler of the machine, when the package is built or installed.

Hatchling calls this hook for wheels and for editable installs.  Where no C compiler is found, or it fails, the package
is built without compiled code and says so: vision and planning then run the same computation in Python, more slowly.

``python hatch_build.py`` builds everything in place.
"""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

# A library is made of the sources beside it.
KERNEL = Path("daemon/slabcell/vision/native/_kernel.so")
DESCENT = Path("drivers/slabcell_drivers/robot/native/_descent.so")
# The kernel for x86 processors with these instructions; which one is used is decided where it runs.
FAST_KERNEL = KERNEL.with_name("_kernel_v3.so")
FAST_FLAGS = ["-mavx2", "-mfma", "-mbmi2"]
# Sums may be reordered, which lets the compiler use vector instructions; NaN and infinity keep their meaning.
FLAGS = [
    "-std=c11", "-O3", "-fPIC", "-shared", "-Wall", "-Wextra",
    "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math",
]  # fmt: skip
TIMEOUT_S = 120


class CustomBuildHook(BuildHookInterface[Any]):
    """Compiles, and adds the libraries to what is built."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and mark the wheel as one of this platform where that worked."""
        del version
        root = Path(self.root)
        problem = compile_all(root)
        if problem:
            self.app.display_warning(f"slabcell: built without compiled code: {problem}")
            return
        if self.target_name == "wheel":
            libraries = (KERNEL, FAST_KERNEL, DESCENT)
            build_data["artifacts"] += [str(made) for made in libraries if (root / made).exists()]
            # They are called through ctypes: any Python 3 of this platform can use them.
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{_platform()}"


def compile_all(root: Path) -> str:
    """Build each library beside its sources; return why not, or nothing."""
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if not compiler:
        return "no C compiler found (cc, gcc or clang)"
    libraries: list[tuple[Path, list[str]]] = [(KERNEL, []), (DESCENT, [])]
    if platform.machine() == "x86_64":
        libraries.append((FAST_KERNEL, FAST_FLAGS))
    for library, flags in libraries:
        problem = _compile(root, compiler, library, flags)
        if problem:
            return problem
    return ""


def _compile(root: Path, compiler: str, library: Path, flags: list[str]) -> str:
    made = root / library
    temporary = made.with_suffix(f".{os.getpid()}.part")
    sources = [str(source) for source in sorted((root / library.parent).glob("*.c"))]
    command = [*compiler.split(), *FLAGS, *flags, "-o", str(temporary), *sources, "-lm"]
    try:
        # The command is the user's own C compiler on our own files.
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)  # noqa: S603
        if done.returncode:
            return f"{command[0]} failed: {done.stderr.strip()[-2000:]}"
        temporary.replace(made)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{command[0]} could not be run: {error}"
    finally:
        temporary.unlink(missing_ok=True)
    return ""


def _platform() -> str:
    import sysconfig  # noqa: PLC0415 - needed for wheels alone

    return sysconfig.get_platform().replace("-", "_").replace(".", "_")


if __name__ == "__main__":
    sys.exit(compile_all(Path(__file__).parent) or 0)
