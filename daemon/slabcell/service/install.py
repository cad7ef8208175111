"""How does a release come to lie on the cell PC, and how is it taken away again?

The release goes to ``/opt/slabcell/releases/VERSION``, and the link ``/opt/slabcell/current`` is turned to it in one
step.  What people edit lies in ``/etc/slabcell`` and is never overwritten: where we have something newer than a file
that was edited, it is laid beside it as ``.new``.  What was laid, and with which content, stands in
``/opt/slabcell/installed.json``; uninstalling removes exactly that.  The state in ``/var/lib/slabcell`` is not touched
by either.

Nothing is started or enabled: the report names the commands.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import dataclass, field
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path, PurePosixPath

from slabcell import __version__
from slabcell.errors import NotPermittedError, SlabcellError
from slabcell.service.install_release import build_release, fingerprint, interpreter

__all__ = ["Report", "install", "uninstall"]

SCHEMA = "slabcell.install/1"
HOME = PurePosixPath("opt/slabcell")
MANIFEST = HOME / "installed.json"
COMMAND = PurePosixPath("usr/local/bin/slabcell")
HIDDEN = ("/home", "/root", "/run/user")
"""Folders that the service does not see (ProtectHome=)."""

SYSTEM_FILES = {
    "slabcell.service": "etc/systemd/system/slabcell.service",
    "slabcell-hmi.service": "etc/systemd/system/slabcell-hmi.service",
    "sysusers.d/slabcell.conf": "etc/sysusers.d/slabcell.conf",
    "tmpfiles.d/slabcell.conf": "etc/tmpfiles.d/slabcell.conf",
    "sysctl.d/60-slabcell.conf": "etc/sysctl.d/60-slabcell.conf",
}
EDITED_FOLDERS = ("recipes", "templates")


@dataclass(slots=True)
class Report:
    """What was done, by path below the root; ``warnings`` are for a person to read, ``next_steps`` are commands."""

    laid: list[str] = field(default_factory=list[str])
    kept: list[str] = field(default_factory=list[str])
    removed: list[str] = field(default_factory=list[str])
    warnings: list[str] = field(default_factory=list[str])
    next_steps: list[str] = field(default_factory=list[str])


def install(root: Path = Path("/")) -> Report:
    """Lay the running version out below ``root``; doing it again changes nothing.

    Raises NotPermittedError without the right to write there, and SlabcellError on any other trouble with files.
    """
    report = Report()
    try:
        before = _read_manifest(root)
        files = dict(before)
        _lay_release(root, report)
        for source, target in SYSTEM_FILES.items():
            content = (resources.files("slabcell") / "data" / "systemd" / source).read_bytes()
            if _write(root / target, content):
                report.laid.append(target)
            files[target] = _sha256(content)
        for target, content in _edited_files():
            _lay_edited(root, target, content, before, report)
            files[target] = _sha256(content)
        for folder, mode in (("etc/slabcell/cell.toml.d", 0o755), ("etc/slabcell/credentials", 0o700)):
            (root / folder).mkdir(mode=mode, parents=True, exist_ok=True)
        if _link(root / COMMAND, f"/{HOME}/current/bin/slabcell"):
            report.laid.append(str(COMMAND))
        manifest = {"schema": SCHEMA, "version": __version__, "files": dict(sorted(files.items()))}
        _write(root / MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())
    except OSError as error:
        raise _named(error, root) from error
    _advise(root, report)
    return report


def uninstall(root: Path = Path("/")) -> Report:
    """Take away what `install` laid below ``root``; files that were edited since, and the state, stay.

    Raises as `install` does, and SlabcellError if nothing is installed there.
    """
    report = Report()
    try:
        files = _read_manifest(root)
        if not (root / MANIFEST).exists():
            msg = f"{root / MANIFEST}: is not there: nothing was installed below {root}"
            raise SlabcellError(msg)
        for target, sha256 in files.items():
            path = root / target
            if not path.exists():
                continue
            if _sha256(path.read_bytes()) != sha256:
                report.kept.append(target)
                continue
            path.unlink()
            report.removed.append(target)
        if (root / COMMAND).is_symlink():
            (root / COMMAND).unlink()
            report.removed.append(str(COMMAND))
        for name in ("current", "releases", "installed.json"):
            path = root / HOME / name
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
        report.removed.append(str(HOME))
        for folder in (
            "etc/slabcell/cell.toml.d",
            "etc/slabcell/credentials",
            *_edited_dirs(),
            "etc/slabcell",
            str(HOME),
        ):
            _remove_if_empty(root / folder)
    except OSError as error:
        raise _named(error, root) from error
    units = "slabcell-hmi.service slabcell.service"
    report.next_steps = [f"systemctl stop {units}", f"systemctl disable {units}", "systemctl daemon-reload"]
    return report


def _lay_release(root: Path, report: Report) -> None:
    """Build the release unless it is there already, and turn ``current`` to it."""
    folder = root / HOME / "releases" / __version__
    stamp = folder / "fingerprint"
    wanted = fingerprint()
    if not stamp.exists() or stamp.read_text(encoding="ascii") != wanted:
        building, old = folder.with_suffix(".part"), folder.with_suffix(".old")
        for leftover in (building, old):
            shutil.rmtree(leftover, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        build_release(building)
        (building / "fingerprint").write_text(wanted, encoding="ascii")
        if folder.exists():
            folder.rename(old)
        building.rename(folder)
        shutil.rmtree(old, ignore_errors=True)
        report.laid.append(str(HOME / "releases" / __version__))
    if _link(root / HOME / "current", f"releases/{__version__}"):
        report.laid.append(str(HOME / "current"))
    if str(interpreter()).startswith(HIDDEN):
        report.warnings.append(
            f"the interpreter {interpreter()} lies where the service cannot see it (ProtectHome=): install with the"
            " system's Python, for example with PYTHON=/usr/bin/python3 ./run install"
        )


def _edited_files() -> list[tuple[str, bytes]]:
    """Return the files that people edit, by their place below the root."""
    config = resources.files("slabcell") / "data" / "config"
    found = [("etc/slabcell/cell.toml", (config / "cell.toml").read_bytes())]
    for name in EDITED_FOLDERS:
        items: list[Traversable] = sorted((config / name).iterdir(), key=lambda item: item.name)
        found += [(f"etc/slabcell/{name}/{item.name}", item.read_bytes()) for item in items if item.is_file()]
    return found


def _edited_dirs() -> tuple[str, ...]:
    return tuple(f"etc/slabcell/{name}" for name in EDITED_FOLDERS)


def _lay_edited(root: Path, target: str, content: bytes, before: dict[str, str], report: Report) -> None:
    path = root / target
    if not path.exists() and target not in before:
        _write(path, content)
        report.laid.append(target)
        return
    here = _sha256(path.read_bytes()) if path.exists() else ""
    shipped, laid = _sha256(content), before.get(target)
    if here == shipped:
        return
    if here and here == laid:  # as we laid it: nobody has edited it
        _write(path, content)
        report.laid.append(target)
        return
    report.kept.append(target)
    if laid != shipped and _write(path.with_name(path.name + ".new"), content):
        report.laid.append(f"{target}.new")


def _advise(root: Path, report: Report) -> None:
    """Add the commands that make the installation work; below another root they belong to that system."""
    report.next_steps = [
        "systemd-sysusers",
        "systemd-tmpfiles --create",
        "sysctl --system",
        "systemctl daemon-reload",
        "slabcell doctor --config /etc/slabcell/cell.toml",
        "systemctl enable --now slabcell.service",
        "systemctl enable --now slabcell-hmi.service    # the web pages; its log names the token of the first start",
    ]
    if root.resolve() != Path("/"):
        report.warnings.append(f"laid below {root}: the commands are for the system that has it as its root")


def _read_manifest(root: Path) -> dict[str, str]:
    path = root / MANIFEST
    if not path.exists():
        return {}
    problem = f"has not the schema {SCHEMA}"
    try:
        document = json.loads(path.read_bytes())
        if document["schema"] == SCHEMA:
            return {str(target): str(sha256) for target, sha256 in document["files"].items()}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        problem = f"is damaged: {error}"
    msg = f"{path}: {problem}; move it away and install again, then compare /etc/slabcell by hand"
    raise SlabcellError(msg)


def _write(path: Path, content: bytes) -> bool:
    """Write a file in one step; return whether it is another one now."""
    if path.exists() and path.read_bytes() == content:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.part")
    with temporary.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    temporary.chmod(0o644)
    temporary.replace(path)
    return True


def _link(path: Path, target: str) -> bool:
    """Make a link in one step; return whether it is another one now."""
    if path.is_symlink() and str(path.readlink()) == target:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.part")
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(target)
    temporary.replace(path)
    return True


def _remove_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _named(error: OSError, root: Path) -> SlabcellError:
    where = error.filename or root
    if isinstance(error, PermissionError):
        return NotPermittedError(f"{where}: may not be written: run it as root, or give --root a folder of your own")
    return SlabcellError(f"{where}: {error.strerror or error}; nothing that was there has been lost: run it again")
