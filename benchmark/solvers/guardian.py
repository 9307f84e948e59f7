"""Runs one program, and ends it with everything that it has started: when it ends, or when whoever asked for it is gone.

    python -I -S guardian.py LIFELINE STATUS MEMORY_BYTES PROGRAM [ARGUMENT …]

LIFELINE is the reading end of a pipe whose other end the caller holds and never writes to: the pipe ends with the caller,
however the caller ends. STATUS is the writing end of another, on which one line says ``started PID`` or ``failed ERRNO``, and
a last one ``ended STATUS`` with a negative number for a signal. The program has the standard streams to itself.

Processes whose parents have died become children of the nearest ancestor that asked for them (PR_SET_CHILD_SUBREAPER, see
prctl(2)), also those in sessions of their own; so killing children until there are none left reaches all of them. Uses the
standard library alone, since it is started with every program.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
POLL_S = 0.005


def main(lifeline: int, status: int, memory_bytes: int, command: list[str]) -> None:
    """Start the program, wait for the end of it or of the caller, and leave nothing behind."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)

    def become_the_program() -> None:
        _, most = resource.getrlimit(resource.RLIMIT_AS)
        allowed = memory_bytes if most == resource.RLIM_INFINITY else min(memory_bytes, most)
        resource.setrlimit(resource.RLIMIT_AS, (allowed, allowed))
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)

    try:
        process = subprocess.Popen(command, preexec_fn=become_the_program)
    except OSError as error:
        _say(status, f"failed {error.errno}")
        return
    _leave_the_streams()
    _say(status, f"started {process.pid}")
    handle = os.pidfd_open(process.pid)
    ready, _, _ = select.select([lifeline, handle], [], [])
    code = process.wait() if handle in ready else -signal.SIGKILL
    _end_children()
    _say(status, f"ended {code}")


def _leave_the_streams() -> None:
    """Let the program alone hold the pipes, which end when it does."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)


def _end_children() -> None:
    """Kill children, and theirs as they are handed on, until there are none."""
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


def _children() -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            # Fields after the name in brackets, which may hold anything: state, parent, … (proc(5)).
            parent = stat.read_bytes().rpartition(b")")[2].split()[1]
            if int(parent) == os.getpid():
                found.append(int(stat.parent.name))
    return found


def _say(status: int, words: str) -> None:
    try:
        os.write(status, f"{words}\n".encode("ascii"))
    except BrokenPipeError:  # the caller is gone
        return


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
