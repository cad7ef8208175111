"""Where does a GenTL producer come from when no vendor's is installed?  Ours, over Aravis, built once by this machine.

The source is C and travels with the package; `build` compiles it with the system's compiler into a cache, named by what
it was made of, so that a new version is built again and an old one never used by mistake.
"""

import hashlib
import os
import shlex
import shutil
import subprocess
import tempfile
from importlib.resources import as_file, files
from pathlib import Path
from typing import Final

__all__ = ["ProducerBuildError", "build"]

NAME: Final = "slabcell_aravis.cti"
REMEDY: Final = "apt-get install --no-install-recommends gcc pkg-config libaravis-dev libglib2.0-dev"
BUILD_S: Final = 120.0
_FLAGS: Final = ("-std=c11", "-O2", "-Wall", "-Wextra", "-fPIC", "-fvisibility=hidden", "-shared")
# nodelete: GLib cannot be loaded twice, and Harvester.update() unloads a producer to load it again.
_LINK: Final = ("-laravis-0.8", "-Wl,-z,nodelete", "-Wl,--no-undefined")
_INCLUDE: Final = "-I/usr/include/aravis-0.8"


class ProducerBuildError(Exception):
    """The producer could not be built; the message says what is missing."""


def build(cache: Path | None = None) -> Path:
    """Return the producer (.cti), built now if it was not before.  Raises ProducerBuildError.

    The compiler is ``CC`` or cc.  Aravis' own pkg-config file is not asked: it wants libusb's headers, which are not
    needed.
    """
    folder = cache if cache is not None else _cache()
    with as_file(files("slabcell_drivers.gentl") / "source") as source:
        sources = sorted(source.glob("*.c"))
        digest = hashlib.sha256(" ".join((*_FLAGS, *_LINK)).encode())
        for path in sorted(source.glob("*.[ch]")):
            digest.update(path.name.encode() + b"\0" + path.read_bytes())
        target = folder / digest.hexdigest()[:16] / NAME
        if not target.is_file():
            _compile(sources, target)
    return target


def _cache() -> Path:
    base = os.environ.get("CACHE_DIRECTORY") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base.split(":")[0]) / "slabcell" / "gentl"


def _compile(sources: list[Path], target: Path) -> None:
    compiler = shlex.split(os.environ.get("CC", "cc"))
    for needed in (compiler[0], "pkg-config"):
        if shutil.which(needed) is None:
            raise ProducerBuildError(f"the GenTL producer cannot be built: {needed} is not installed; {REMEDY}")
    flags = _run(["pkg-config", "--cflags", "--libs", "gio-2.0"]).split()
    target.parent.mkdir(parents=True, exist_ok=True)
    # Built beside its place and moved there whole: two processes may build at once.
    with tempfile.TemporaryDirectory(dir=target.parent) as scratch:
        made = Path(scratch) / NAME
        _run([*compiler, *_FLAGS, _INCLUDE, "-o", str(made), *map(str, sources), *flags, *_LINK])
        made.replace(target)


def _run(command: list[str]) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=BUILD_S, check=False)  # noqa: S603
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ProducerBuildError(f"the GenTL producer cannot be built: {command[0]}: {error}; {REMEDY}") from error
    if done.returncode:
        words = done.stderr.strip().splitlines()
        reason = next((line for line in words if "error" in line), words[0] if words else "no reason given")
        raise ProducerBuildError(f"the GenTL producer cannot be built: {reason}; {REMEDY}")
    return done.stdout
