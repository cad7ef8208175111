"""Runs a command under the limits of a systemd unit where systemd is not process 1.

What the unit says is read from the unit itself.  Calls are filtered by the kernel's seccomp with the very groups that
systemd has (`systemd-analyze syscall-filter`), through libseccomp; files, devices, users, /proc and capabilities are
those of a sandbox of Debian's bubblewrap.  Not enforced here: ProtectHome (a test's interpreter may live in a home;
the rest of it is hidden), DevicePolicy, memory and file limits.
"""

import ctypes
import errno
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
UNIT = REPOSITORY / "systemd" / "slabcell.service"

ALLOW, ERRNO = 0x7FFF0000, 0x00050000  # SCMP_ACT_ALLOW, SCMP_ACT_ERRNO(0)
NOT_EQUAL, EQUAL, GREATER_EQUAL, GREATER, MASKED_EQUAL = 1, 4, 5, 6, 7  # enum scmp_compare
WRITE, EXECUTE, SHM_EXECUTE = 2, 4, 0o100000  # PROT_WRITE, PROT_EXEC, SHM_EXEC
NAMESPACES = (0x00020000, 0x02000000, 0x04000000, 0x08000000, 0x10000000, 0x20000000, 0x40000000)  # CLONE_NEW*
SET_ID = (0o4000, 0o2000)
LARGEST_FAMILY, LARGEST_IDLE_POLICY = 46, 5


def needs() -> None:
    """Skip with the reason where the sandbox cannot be made."""
    for tool in ("bwrap", "systemd-analyze", "unshare"):
        if shutil.which(tool) is None:
            missing(f"{tool} is not installed: Debian's packages bubblewrap, systemd and util-linux have them")
    probe = subprocess.run(
        [*_around(), "bwrap", "--ro-bind", "/", "/", "--unshare-user", "true"], capture_output=True, check=False
    )
    if probe.returncode:
        pytest.skip(f"this machine lets no sandbox be made: {probe.stderr.decode().strip()[-200:]}")


def missing(reason: str) -> None:
    if os.environ.get("SLABCELL_REQUIRE_CAMERA") == "1":  # CI has to have them
        pytest.fail(reason)
    pytest.skip(reason)


def directives() -> dict[str, list[str]]:
    """Return what the unit says, each directive with its words."""
    found: dict[str, list[str]] = {}
    for line in UNIT.read_text().splitlines():
        key, equals, value = line.partition("=")
        if equals and not line.startswith(("#", ";")):
            found.setdefault(key, []).append(value)
    return found


def is_set(key: str) -> bool:
    return directives().get(key, ["no"])[-1] in {"yes", "true", "on", "1"}


class Comparison(ctypes.Structure):
    """struct scmp_arg_cmp."""

    _fields_ = (("arg", ctypes.c_uint), ("op", ctypes.c_int), ("a", ctypes.c_uint64), ("b", ctypes.c_uint64))


class Filter:
    """One filter of libseccomp."""

    def __init__(self, default: int) -> None:
        self._library = ctypes.CDLL("libseccomp.so.2")
        self._library.seccomp_init.restype = ctypes.c_void_p
        self._library.seccomp_init.argtypes = [ctypes.c_uint32]
        self._library.seccomp_rule_add_array.argtypes = [
            *(ctypes.c_void_p, ctypes.c_uint32, ctypes.c_int, ctypes.c_uint),
            ctypes.POINTER(Comparison),
        ]
        self._library.seccomp_export_bpf.argtypes = [ctypes.c_void_p, ctypes.c_int]
        self._context = self._library.seccomp_init(default)
        assert self._context

    def rule(self, action: int, call: str, *comparisons: tuple[int, int, int, int]) -> None:
        """Add a rule; calls that this machine does not have are left out, as systemd does."""
        number = self._library.seccomp_syscall_resolve_name(call.encode())
        if number < 0:
            return
        array = (Comparison * max(1, len(comparisons)))(*(Comparison(*item) for item in comparisons))
        done = self._library.seccomp_rule_add_array(self._context, action, number, len(comparisons), array)
        assert done == 0, f"{call}: {os.strerror(-done)}"

    def write(self, path: Path) -> None:
        with path.open("wb") as stream:
            assert self._library.seccomp_export_bpf(self._context, stream.fileno()) == 0


def group(name: str) -> set[str]:
    """Return the calls of one of systemd's groups."""
    shown = subprocess.run(["systemd-analyze", "syscall-filter", name], capture_output=True, text=True, check=True)
    calls: set[str] = set()
    for line in shown.stdout.splitlines():
        word = line.strip()
        if not line.startswith(" ") or not word or word.startswith("#"):
            continue
        calls |= group(word) if word.startswith("@") else {word}
    return calls


def allowed_calls() -> set[str]:
    """Return what SystemCallFilter= lets through: the first line lists what may be called, those with ~ take away."""
    calls = group("@default")
    for line in directives()["SystemCallFilter"]:
        named: set[str] = set()
        for word in line.removeprefix("~").split():
            named |= group(word) if word.startswith("@") else {word}
        calls = calls - named if line.startswith("~") else calls | named
    return calls


def call_filter() -> Filter:
    """Return the filter of SystemCallFilter=."""
    (name,) = directives()["SystemCallErrorNumber"]
    filter_ = Filter(ERRNO | getattr(errno, name))
    for call in sorted(allowed_calls()):
        filter_.rule(ALLOW, call)
    return filter_


def argument_filter() -> Filter:
    """Return the filter of what the unit forbids by the arguments of a call.

    Source of the rules: systemd's src/shared/seccomp-util.c, as its manual systemd.exec(5) describes them.
    """
    filter_ = Filter(ALLOW)
    no = ERRNO | errno.EPERM
    if is_set("MemoryDenyWriteExecute"):
        both = WRITE | EXECUTE
        filter_.rule(no, "mmap", (2, MASKED_EQUAL, both, both))
        for call in ("mprotect", "pkey_mprotect"):
            filter_.rule(no, call, (2, MASKED_EQUAL, EXECUTE, EXECUTE))
        filter_.rule(no, "shmat", (2, MASKED_EQUAL, SHM_EXECUTE, SHM_EXECUTE))
    families = {int(getattr(socket, name)) for name in directives()["RestrictAddressFamilies"][-1].split()}
    for family in range(LARGEST_FAMILY):
        if family not in families:
            filter_.rule(ERRNO | errno.EAFNOSUPPORT, "socket", (0, EQUAL, family, 0))
    filter_.rule(ERRNO | errno.EAFNOSUPPORT, "socket", (0, GREATER_EQUAL, LARGEST_FAMILY, 0))
    if is_set("RestrictNamespaces"):
        for flag in NAMESPACES:
            filter_.rule(no, "unshare", (0, MASKED_EQUAL, flag, flag))
            filter_.rule(no, "clone", (0, MASKED_EQUAL, flag, flag))
        filter_.rule(no, "setns")
        filter_.rule(ERRNO | errno.ENOSYS, "clone3")  # its flags cannot be looked at: libraries fall back to clone
    if is_set("RestrictRealtime"):
        for policy in (1, 2):  # SCHED_FIFO, SCHED_RR
            filter_.rule(no, "sched_setscheduler", (1, EQUAL, policy, 0))
        filter_.rule(no, "sched_setscheduler", (1, GREATER, LARGEST_IDLE_POLICY, 0))
    if is_set("RestrictSUIDSGID"):
        for call, argument in (("chmod", 1), ("fchmod", 1), ("fchmodat", 2), ("open", 2), ("openat", 3), ("mkdir", 1)):
            for bit in SET_ID:
                filter_.rule(no, call, (argument, MASKED_EQUAL, bit, bit))
    if is_set("LockPersonality"):
        filter_.rule(no, "personality", (0, NOT_EQUAL, 0, 0))
    return filter_


@contextmanager
def confined(folder: Path, *writable: Path, **environment: str) -> Iterator[tuple[list[str], tuple[int, ...]]]:
    """Give the words that go before a command, and the descriptors it inherits; it may write to ``writable`` only."""
    needs()
    descriptors: list[int] = []
    seccomp: list[str] = []
    for name, filter_ in (("calls", call_filter()), ("arguments", argument_filter())):
        path = folder / f"{name}.bpf"
        filter_.write(path)
        descriptors.append(os.open(path, os.O_RDONLY))
        seccomp += ["--add-seccomp-fd", str(descriptors[-1])]
    hidden = [word for home in ("/home", "/root") if Path(home).is_dir() for word in ("--tmpfs", home)]
    own_proc = folder / "proc"
    own_proc.mkdir(exist_ok=True)
    seen = {Path(sys.base_prefix), Path(sys.prefix), REPOSITORY, folder, *_links_on_the_way()}
    words = [
        *_around(f'mount -t proc -o subset=pid,hidepid=invisible proc "{own_proc}" && exec "$@"'),
        *("bwrap", "--ro-bind", "/", "/", "--dev", "/dev", "--tmpfs", "/tmp", *hidden),  # noqa: S108 - PrivateTmp=
        *(word for path in sorted(seen) for word in ("--ro-bind", str(path), str(path))),
        *(word for path in writable for word in ("--bind", str(path), str(path))),
        *("--bind", str(own_proc), "/proc"),
        *("--unshare-user", "--uid", "4711", "--gid", "4711", "--unshare-ipc", "--unshare-uts", "--cap-drop", "ALL"),
        *("--new-session", "--die-with-parent", "--chdir", str(folder), *seccomp),
        *(word for key, value in environment.items() for word in ("--setenv", key, value)),
        "--",
    ]
    try:
        yield words, tuple(descriptors)
    finally:
        for descriptor in descriptors:
            os.close(descriptor)


def _links_on_the_way() -> set[Path]:
    """Return where the interpreter really lies: a virtual environment links to it."""
    return {Path(sys.executable).resolve().parents[1]}


def _around(script: str = 'exec "$@"') -> list[str]:
    """Return the words for a mount and process namespace of one's own, in which ``script`` runs first."""
    user = [] if os.geteuid() == 0 else ["--map-root-user"]
    return ["unshare", *user, "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", script, "confined"]
