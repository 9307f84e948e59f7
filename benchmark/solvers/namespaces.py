"""A program's own namespaces (namespaces(7)): a root with nothing but what it is given, no network, separate processes.

They are entered between fork and exec, by a process that has loaded nothing but the standard library
(`benchmark.solvers.guardian`). Three processes result: the one outside passes on how the program ended; the first one inside
ends what the program leaves behind; the third becomes the program. The steps are those of bubblewrap
(https://github.com/containers/bubblewrap).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import signal
from pathlib import Path

CLONE_NEWNS, CLONE_NEWIPC, CLONE_NEWUSER, CLONE_NEWPID, CLONE_NEWNET = (
    0x20000, 0x8000000, 0x10000000, 0x20000000, 0x40000000,
)  # fmt: skip
MS_RDONLY, MS_NOSUID, MS_NODEV, MS_NOEXEC, MS_REMOUNT, MS_BIND, MS_REC, MS_PRIVATE = (
    1,
    2,
    4,
    8,
    32,
    4096,
    16384,
    1 << 18,
)
MNT_DETACH = 2
PR_SET_PDEATHSIG, PR_CAPBSET_DROP, PR_SET_NO_NEW_PRIVS = 1, 24, 38
LAST_CAPABILITY = 63
"""Beyond those of any kernel; the kernel refuses the surplus."""
PIVOT_ROOT = {"x86_64": 155, "aarch64": 41}
"""Number of the system call, which the C library does not wrap."""
DEVICES = ("null", "zero", "full", "random", "urandom")
MOST_WRITTEN_BYTES = 512 * 2**20
"""Limit for all files together that a program writes, which no limit of its address space covers."""
MOST_FILES = 20_000
"""Limit for the number of files that a program writes, including the mount points of what it sees."""
STAGE = "/tmp"
"""Where the new root is assembled, hiding what is there; any folder that every system has."""
_FLAGS_OF_STATVFS = {2: MS_NOSUID, 4: MS_NODEV, 8: MS_NOEXEC, 1024: 1024, 2048: 2048, 4096: 1 << 21}
"""Mount flags that may not be cleared: nosuid, nodev, noexec, noatime, nodiratime, relatime."""
_libc = ctypes.CDLL(None, use_errno=True)


def enter(places: dict[str, str], folder: str, memory_bytes: int) -> None:
    """Return in the process inside that is to become the program; the other processes never return.

    Parameters
    ----------
    places : dict of str to str
        Folders and files visible inside, read-only: absolute name inside to absolute name outside, without links.
    folder : str
        Working folder inside.
    memory_bytes : int
        Memory limit of the program. What it writes is kept in memory too, and may not exceed this or `MOST_WRITTEN_BYTES`.

    Raises
    ------
    OSError
        The system does not allow it.
    """
    uid, gid = os.getuid(), os.getgid()
    _call("unshare", CLONE_NEWUSER | CLONE_NEWNS | CLONE_NEWIPC | CLONE_NEWPID | CLONE_NEWNET)
    for name, text in (("setgroups", "deny"), ("uid_map", f"{uid} {uid} 1"), ("gid_map", f"{gid} {gid} 1")):
        Path("/proc/self", name).write_text(text, encoding="ascii")
    hearing, telling = os.pipe()
    nowhere = os.open(os.devnull, os.O_RDWR)  # the process outside loses its root to the one inside
    inner = os.fork()
    if inner:
        _hand_on(inner, hearing, nowhere)
    _call("prctl", PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    _make_root(places, min(memory_bytes, MOST_WRITTEN_BYTES))
    os.chdir(folder)
    program = os.fork()
    if program:
        _be_first(program, telling, nowhere)
    for handle in (hearing, telling, nowhere):
        os.close(handle)
    _call("prctl", PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    # No capabilities inside: mounts stay as they are, including the read-only ones.
    for number in range(LAST_CAPABILITY + 1):
        _libc.prctl(PR_CAPBSET_DROP, number, 0, 0, 0)
    _call("prctl", PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)


def _hand_on(inner: int, hearing: int, nowhere: int) -> None:
    """Outside: end in the same way as the program."""
    _leave_all(hearing, nowhere)
    told = os.read(hearing, 16)
    os.waitpid(inner, 0)
    status = int(told) if told else signal.SIGKILL
    if os.WIFSIGNALED(status):
        with contextlib.suppress(OSError, ValueError):
            signal.signal(os.WTERMSIG(status), signal.SIG_DFL)
        os.kill(os.getpid(), os.WTERMSIG(status))
    os._exit(os.waitstatus_to_exitcode(status) & 255)


def _be_first(program: int, telling: int, nowhere: int) -> None:
    """Inside, as the parent of all orphans: wait for the program, and end together with everything else."""
    _leave_all(telling, nowhere)
    while True:
        reaped, status = os.wait()
        if reaped == program:
            os.write(telling, b"%d" % status)
            os._exit(0)


def _leave_all(kept: int, nowhere: int) -> None:
    """Close all descriptors but one, so that only the program holds its streams and whatever else is open."""
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)
    os.closerange(3, kept)
    os.closerange(kept + 1, os.sysconf("SC_OPEN_MAX"))


def _make_root(places: dict[str, str], written_bytes: int) -> None:
    """Assemble the new root, and detach the old one."""
    _mount(None, "/", None, MS_REC | MS_PRIVATE)
    _mount("tmpfs", STAGE, "tmpfs", MS_NOSUID | MS_NODEV, "mode=755,size=1m")
    for name in ("old", "new"):
        Path(STAGE, name).mkdir()
    _pivot(STAGE, f"{STAGE}/old")
    os.chdir("/")
    # One file system for everything that can be written to: the root, /tmp and /dev/shm.
    limits = f"size={written_bytes},nr_inodes={MOST_FILES}"
    _mount("tmpfs", "/new", "tmpfs", MS_NOSUID | MS_NODEV, f"mode=755,{limits}")
    for inside in sorted(places):
        _show(f"/old{places[inside]}", f"/new{inside}")
    for name in ("bin", "sbin", "lib", "lib32", "lib64"):
        if Path("/old", name).is_symlink():
            Path("/new", name).symlink_to(os.readlink(f"/old/{name}"))
        elif Path("/old", name).is_dir():
            _show(f"/old/{name}", f"/new/{name}")
    for name in ("proc", "dev/shm", "tmp"):
        Path("/new", name).mkdir(parents=True, exist_ok=True)
    _mount("proc", "/new/proc", "proc", MS_NOSUID | MS_NODEV | MS_NOEXEC)
    for name in DEVICES:
        _show(f"/old/dev/{name}", f"/new/dev/{name}", read_only=False)
    Path("/new/dev/fd").symlink_to("/proc/self/fd")
    os.chdir("/new")
    _pivot(".", ".")
    _call("umount2", b".", MNT_DETACH)
    os.chdir("/")


def _show(outside: str, inside: str, read_only: bool = True) -> None:
    """Make a folder or a file of the old root visible in the new one."""
    if Path(outside).is_dir():
        Path(inside).mkdir(parents=True, exist_ok=True)
    else:
        Path(inside).parent.mkdir(parents=True, exist_ok=True)
        if not Path(inside).exists():
            Path(inside).touch()
    _mount(outside, inside, None, MS_BIND | MS_REC)
    if read_only:
        kept = os.statvfs(inside).f_flag
        locked = sum(flag for bit, flag in _FLAGS_OF_STATVFS.items() if kept & bit)
        _mount(None, inside, None, MS_BIND | MS_REMOUNT | MS_RDONLY | locked)


def _mount(source: str | None, target: str, kind: str | None, flags: int, options: str = "") -> None:
    names = [None if name is None else os.fsencode(name) for name in (source, target, kind)]
    _call("mount", *names, ctypes.c_ulong(flags), options.encode() or None)


def _pivot(new: str, old: str) -> None:
    _call("syscall", PIVOT_ROOT[platform.machine()], os.fsencode(new), os.fsencode(old))


def _call(name: str, *arguments: object) -> None:
    """Call the C library. Raises OSError."""
    if getattr(_libc, name)(*arguments) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{name}: {os.strerror(number)}")
