"""Run one program, and end it with everything that it has started, either when it ends or when its caller has gone.

    python -I -S guardian.py LIFELINE STATUS MEMORY_BYTES PLACES [INSIDE OUTSIDE …] PROGRAM [ARGUMENT …]
    python -I -S guardian.py probe INSIDE OUTSIDE [INSIDE OUTSIDE …]

LIFELINE is the reading end of a pipe whose other end the caller holds and never writes to: the pipe ends with the caller,
however the caller ends. STATUS is the writing end of another pipe, on which one line says ``started PID`` or
``failed ERRNO``, and a last one ``ended STATUS``, with a negative number for a signal, or ``ended memory`` if the program
and what it has started held more than MEMORY_BYTES together, or ``ended processes`` if they were more than `MOST_PROCESSES`.
The program has the standard streams to itself. PLACES is the
number of pairs of names that follow it: if there are any, the program runs in its own namespaces and sees only these
(`benchmark.solvers.namespaces`). The second form does the same with a program that does nothing.

Processes whose parents have died become children of the nearest ancestor that asked for them (PR_SET_CHILD_SUBREAPER, see
prctl(2)), even those in their own sessions, so killing children until there are none left reaches all of them. The module
only uses the standard library, since it is started with every program.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import resource
import select
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
BLOCK_BYTES = 512
"""Unit of st_blocks (stat(2))."""
POLL_S = 0.005
WATCH_S = 0.25
"""Time between two looks at the number and the memory of all processes."""
MOST_PROCESSES = 64
"""Largest number of processes of a program at a time, itself included; threads do not count."""
NAMESPACE_PROCESSES = 2
"""Processes that isolation adds (`benchmark.solvers.namespaces`)."""
PROBE_BYTES = 2**20


def main(lifeline: int, status: int, memory_bytes: int, places: dict[str, str], command: list[str]) -> None:
    """Start the program, wait until it or the caller ends, and leave nothing behind."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)

    folder = str(Path.cwd())

    def become_the_program() -> None:
        if places:
            _isolate(places, folder, memory_bytes)
        _, most = resource.getrlimit(resource.RLIMIT_AS)
        allowed = memory_bytes if most == resource.RLIM_INFINITY else min(memory_bytes, most)
        resource.setrlimit(resource.RLIMIT_AS, (allowed, allowed))
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)

    try:
        process = subprocess.Popen(command, preexec_fn=become_the_program)
    except OSError as error:
        _say(status, f"failed {error.errno}")
        return
    except subprocess.SubprocessError:
        _say(status, f"failed {errno.EPERM}")
        return
    _leave_the_streams()
    _say(status, f"started {_innermost(process.pid) if places else process.pid}")
    handle = os.pidfd_open(process.pid)
    most_processes = MOST_PROCESSES + (NAMESPACE_PROCESSES if places else 0)
    ready: list[int] = []
    excess = ""
    while not ready and not (excess := _excess(memory_bytes, most_processes)):
        ready, _, _ = select.select([lifeline, handle], [], [], WATCH_S)
    code = process.wait() if handle in ready else -signal.SIGKILL
    _end_children()
    _say(status, f"ended {excess or code}")


def _leave_the_streams() -> None:
    """Close the standard streams, so that the pipes end when the program does."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)


def _end_children() -> None:
    """Kill children, and those inherited from them, until there are none."""
    while True:
        for pid in _children():
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        try:
            reaped, _ = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if not reaped:
            time.sleep(POLL_S)


def _isolate(places: dict[str, str], folder: str, memory_bytes: int) -> None:
    sys.path.insert(0, str(Path(__file__).parents[2]))
    from benchmark.solvers.namespaces import enter

    try:
        enter(places, folder, memory_bytes)
    except OSError as error:
        os.write(2, f"cannot be isolated: {error}\n".encode())
        raise


def _innermost(pid: int) -> int:
    """Pid of the program among the three processes of its namespaces: the only child of the only child."""
    for _ in range(NAMESPACE_PROCESSES):
        pid = next(iter(_children(pid)), pid)
    return pid


def _children(of: int | None = None) -> list[int]:
    wanted = os.getpid() if of is None else of
    return [pid for pid, parent in _parents().items() if parent == wanted]


def _parents() -> dict[int, int]:
    """The parent of each process."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            # Fields after the name in brackets, which may contain anything: state, parent, … (proc(5)).
            found[int(stat.parent.name)] = int(stat.read_bytes().rpartition(b")")[2].split()[1])
    return found


def _excess(memory_bytes: int, most_processes: int) -> str:
    """What all processes together have more of than allowed: ``processes``, ``memory`` or nothing.

    The address space of each process is limited by RLIMIT_AS, which neither their sum nor a file in memory (memfd_create(2))
    counts against. Pages that several processes share count once (proportional set size, proc(5)), and so do those of files
    in memory that are mapped too. Resident sizes, which are faster to read and never smaller, are looked at first.
    """
    pids = _descendants()
    if len(pids) > most_processes:
        return "processes"
    files = _bytes_of_memory_files(pids)
    if files + sum(map(_resident_bytes, pids)) <= memory_bytes:
        return ""
    sizes = [_proportional_bytes(pid) for pid in pids]
    own, mapped = (sum(size[part] for size in sizes) for part in (0, 1))
    return "memory" if own + max(mapped, files) > memory_bytes else ""


def _descendants() -> list[int]:
    children: defaultdict[int, list[int]] = defaultdict(list)
    for pid, parent in _parents().items():
        children[parent].append(pid)
    found = [os.getpid()]
    for pid in found:
        found += children[pid]
    return found[1:]


def _bytes_of_memory_files(pids: Iterable[int]) -> int:
    """Memory of the files that were made by memfd_create(2) and that any of the processes holds open."""
    sizes = {}
    for pid in pids:
        with contextlib.suppress(OSError):
            for name in os.listdir(f"/proc/{pid}/fd"):
                with contextlib.suppress(OSError):
                    if os.readlink(f"/proc/{pid}/fd/{name}").startswith("/memfd:"):
                        status = os.stat(f"/proc/{pid}/fd/{name}")
                        sizes[status.st_dev, status.st_ino] = status.st_blocks * BLOCK_BYTES
    return sum(sizes.values())


def _resident_bytes(pid: int) -> int:
    with contextlib.suppress(OSError):
        return int(Path(f"/proc/{pid}/statm").read_bytes().split()[1]) * resource.getpagesize()
    return 0


def _proportional_bytes(pid: int) -> tuple[int, int]:
    """Proportional set size without and of shared memory; all counts as the former where the kernel does not say."""
    with contextlib.suppress(OSError):
        lines = Path(f"/proc/{pid}/smaps_rollup").read_bytes().splitlines()
        sizes = {words[0]: int(words[1]) * 1024 for line in lines if len(words := line.split()) == 3}
        shared = sizes.get(b"Pss_Shmem:", 0)
        return sizes[b"Pss:"] - shared, shared
    return _resident_bytes(pid), 0


def _say(status: int, words: str) -> None:
    try:
        os.write(status, f"{words}\n".encode("ascii"))
    except BrokenPipeError:  # the caller is gone
        return


def _probe(places: dict[str, str]) -> None:
    subprocess.run(
        [sys.executable, "-I", "-S", "-c", "pass"],
        preexec_fn=lambda: _isolate(places, "/", PROBE_BYTES),
        check=True,
        timeout=20,
    )


def _pairs(words: list[str]) -> dict[str, str]:
    return dict(zip(words[::2], words[1::2], strict=True))


if __name__ == "__main__":
    if sys.argv[1] == "probe":
        _probe(_pairs(sys.argv[2:]))
    else:
        rest = sys.argv[5:]
        count = 2 * int(sys.argv[4])
        main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), _pairs(rest[:count]), rest[count:])
