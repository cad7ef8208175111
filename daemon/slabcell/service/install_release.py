"""How is the running installation copied into a release of its own, which runs without this one?

A release is a virtual environment with slabcell and the packages that it needs at run time, each file as it lies here,
compiled files included.  It refers to no path but its interpreter's, so that it may be laid under another root first.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import sys
import sysconfig
import venv
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import slabcell
import slabcell_drivers

__all__ = ["build_release", "fingerprint", "interpreter"]

OWN = "slabcell"
LAUNCHER = """#!/bin/sh
# Finds the interpreter beside itself, so that the release may lie anywhere.
here=$(dirname "$(readlink -f "$0")")
exec "$here/python" -P -m slabcell "$@"
"""

_NAME = re.compile(r"\s*([A-Za-z0-9][A-Za-z0-9._-]*)\s*(?:\[([^\]]*)\])?")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)['\"]")


def interpreter() -> Path:
    """Return the interpreter that a release runs on: the one that this environment was made from."""
    return Path(getattr(sys, "_base_executable", sys.executable)).resolve()


def fingerprint() -> str:
    """Return a sum over names, sizes and times of every file of a release: the same again means nothing to do."""
    total = hashlib.sha256(str(interpreter()).encode())
    for source, target in sorted(_files(), key=lambda item: item[1]):
        status = source.stat()
        total.update(f"{target}\0{status.st_size}\0{status.st_mtime_ns}\n".encode())
    return total.hexdigest()


def build_release(folder: Path) -> None:
    """Make the release in ``folder``, which must not exist yet.  Raises OSError."""
    venv.EnvBuilder(symlinks=True, with_pip=False).create(folder)
    base = {"base": str(folder), "platbase": str(folder)}
    site = Path(sysconfig.get_path("purelib", "venv", base))
    for source, target in _files():
        copy = site / target
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, copy)  # with its time: compiled files stay valid
    # The scripts that venv makes hold the path that the folder has now; the launcher does without.
    for script in (folder / "bin").iterdir():
        if not script.name.startswith("python"):
            script.unlink()
    launcher = folder / "bin" / "slabcell"
    launcher.write_text(LAUNCHER, encoding="utf-8")
    launcher.chmod(0o755)


def _files() -> Iterator[tuple[Path, str]]:
    """Give every file of a release and its place in site-packages."""
    for package in (slabcell, slabcell_drivers):
        top = Path(package.__path__[0])
        for source in _tree(top):
            yield source, f"{top.name}/{source.relative_to(top)}"
    for dist in _needed():
        if dist.name == OWN:
            for name in ("METADATA", "entry_points.txt"):
                source = Path(str(dist.locate_file(f"{OWN}-{dist.version}.dist-info/{name}")))
                if source.exists():
                    yield source, f"{OWN}-{dist.version}.dist-info/{name}"
            continue
        for file in dist.files or ():
            source = Path(str(dist.locate_file(file)))
            # What lies outside of site-packages are scripts, which the cell does not call.
            if ".." not in file.parts and source.is_file():
                yield source, str(file)


def _tree(top: Path) -> Iterator[Path]:
    """Give the files below a folder, through links; compiled files are left out, since the sources may have changed."""
    for entry in sorted(top.iterdir()):
        if entry.is_dir():
            if entry.name != "__pycache__":
                yield from _tree(entry)
        elif entry.suffix != ".pyc":
            yield entry


def _needed() -> list[Distribution]:
    """Return slabcell's distribution and those it needs, as far as they are installed; every extra counts."""
    found: dict[str, Distribution] = {}
    waiting = [(OWN, frozenset({"*"}))]
    while waiting:
        name, extras = waiting.pop()
        plain = re.sub(r"[-_.]+", "-", name).lower()
        if plain in found:
            continue
        try:
            found[plain] = distribution(name)
        except PackageNotFoundError:  # of another platform, or an extra that is not installed
            continue
        for requirement in found[plain].requires or ():
            specifier, _, marker = requirement.partition(";")
            wanted = _EXTRA.search(marker)
            match = _NAME.match(specifier)
            if match and (wanted is None or "*" in extras or wanted[1] in extras):
                inner = frozenset(word.strip() for word in (match[2] or "").split(",") if word.strip())
                waiting.append((match[1], inner))
    return list(found.values())
