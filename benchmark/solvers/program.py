"""A program under test in its own process: one JSON line in, one out, within limits of time and memory.

The program may do anything: hang, crash, print garbage, print without end, take all memory, start other programs. Whatever it
does costs it the frame and never the run: it is killed with all its descendants, and restarted for the next frame. A guardian
process (`benchmark.solvers.guardian`) ensures this even when this process is itself killed.
"""

import contextlib
import json
import os
import select
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from benchmark.errors import SolverError
from benchmark.solvers.guardian import MOST_PROCESSES
from benchmark.solvers.isolation import places_words
from benchmark.solvers.memory import peak_mib, reset_peak
from benchmark.solvers.messages import PROTOCOL, hello

LONGEST_REPLY_BYTES = 16_000_000
PASSED_ON = frozenset(
    {
        "HOME", "LANG", "LD_LIBRARY_PATH", "LOGNAME", "PATH", "PYTHONPATH", "TMPDIR", "TZ", "USER", "VIRTUAL_ENV",
        "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME",
    }
)  # fmt: skip
"""Environment variables that a program receives, besides those that begin with `PASSED_ON_PREFIXES`."""
PASSED_ON_PREFIXES = ("LC_", "SOLVER_")
_GUARDIAN = Path(__file__).with_name("guardian.py")
_ENDING_S = 2.0
"""Time allowed between the end of a program's output and its own end."""
_END_S = 10.0
"""A guardian that takes longer to end its program has itself been stopped."""
_KEPT_STDERR_BYTES = 4_000
_CHUNK = 65_536
# Programs are asked to use one thread: times are compared, and the benchmark runs several frames in parallel.
_ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "OPENCV_FOR_THREADS_NUM",
        "RAYON_NUM_THREADS",
    ),
    "1",
)  # fmt: skip


@dataclass(frozen=True)
class Limits:
    """Resources that a program may use.

    Attributes
    ----------
    time_s : float
        Wall-clock time per frame, for all requests about it together.
    memory_mib : int
        Address space of each of its processes (RLIMIT_AS), and memory of all of them together, files in memory included.
    start_s : float
        Wall-clock time until it sends its hello.
    """

    time_s: float = 10.0
    memory_mib: int = 4096
    start_s: float = 120.0


@dataclass(frozen=True)
class Exchange:
    """A reply and its cost: wall-clock time, and peak resident memory (None where the system does not report it)."""

    message: dict[str, Any]
    time_ms: float
    peak_memory_mib: float | None


class ProgramFailedError(Exception):
    """A program gave no usable reply; it has been killed.

    Attributes
    ----------
    time_ms : float
        Time from the request to the failure.
    """

    def __init__(self, reason: str, time_ms: float) -> None:
        super().__init__(reason)
        self.time_ms = time_ms


class ProgramSession:
    """A running program: `start` it, `ask` it frame by frame, and `close` it.

    Parameters
    ----------
    command : sequence of str
    folder : Path
        Folder in which it is started.
    limits : Limits
    on_stderr : callable, optional
        Called with what it writes to its standard error, as it arrives.
    places : mapping of str to str, optional
        If not empty, it runs in its own namespaces and sees only these (`benchmark.solvers.isolation`).
    """

    def __init__(
        self,
        command: Sequence[str],
        folder: Path,
        limits: Limits,
        on_stderr: Callable[[bytes], None] | None = None,
        places: Mapping[str, str] | None = None,
    ) -> None:
        self._command = list(command)
        self._places = dict(places or {})
        self._folder = folder
        self.limits = limits
        self._on_stderr = on_stderr
        self._process: subprocess.Popen[bytes] | None = None
        self._pid = 0
        self._lifeline = self._status = -1
        self._selector = selectors.DefaultSelector()
        self._received = b""
        self._stderr = b""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def running(self) -> bool:
        """Whether it has been started and neither closed nor killed."""
        return self._process is not None

    def start(self) -> dict[str, Any]:
        """Start the program and return its hello.

        Raises
        ------
        SolverError
            It cannot be started, or does not send a valid hello in time.
        """
        self.close()
        process = self._process = self._guarded()
        word, _, number = self._heard_of_guardian().partition(" ")
        if word != "started":
            words = self._last_words() if self._places else ""
            self.close()
            why = os.strerror(int(number)) if word == "failed" else "no process can be guarded here"
            raise SolverError(f"{self._command[0]}: cannot be started ({why}){words}")
        self._pid = int(number)
        self._selector = selectors.DefaultSelector()
        for stream in (process.stdin, process.stdout, process.stderr):
            assert stream is not None
            os.set_blocking(stream.fileno(), False)
        assert process.stdout is not None
        assert process.stderr is not None
        self._selector.register(process.stdout, selectors.EVENT_READ, "stdout")
        self._selector.register(process.stderr, selectors.EVENT_READ, "stderr")
        try:
            greeting = self._exchange(hello(), self.limits.start_s)
        except ProgramFailedError as error:
            raise SolverError(f"{' '.join(self._command)}: did not start: {error}") from error
        if greeting.get("type") != "hello" or greeting.get("protocol") != PROTOCOL:
            self.close()
            raise SolverError(f"{' '.join(self._command)}: does not speak {PROTOCOL} (docs/solver_protocol.md)")
        return greeting

    def ask(self, request: Mapping[str, Any], spent_s: float = 0.0) -> Exchange:
        """Send a request and wait for the reply.

        Parameters
        ----------
        request : mapping of str to object
        spent_s : float
            Part of the frame's time that earlier requests have used.

        Raises
        ------
        ProgramFailedError
            It hung, crashed, or did not answer with a JSON object; it has been killed.
        """
        assert self._process is not None, "start the program first"
        known = reset_peak(self._pid)
        started = time.perf_counter()
        message = self._exchange(request, self.limits.time_s, spent_s)
        elapsed_ms = 1000.0 * (time.perf_counter() - started)
        return Exchange(message, elapsed_ms, peak_mib(self._pid) if known else None)

    def close(self) -> None:
        """End the program and everything that it has started."""
        process, self._process = self._process, None
        self._received = self._stderr = b""
        if process is None:
            return
        os.close(self._lifeline)
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        os.close(self._status)
        self._selector.close()
        for stream in (process.stdin, process.stdout, process.stderr):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()

    def _guarded(self) -> subprocess.Popen[bytes]:
        """Start the program under a guardian; returns the guardian's process."""
        held, self._lifeline = os.pipe()
        self._status, told = os.pipe()
        memory = str(self.limits.memory_mib * 2**20)
        inside = [str(len(self._places)), *places_words(self._places)]
        try:
            return subprocess.Popen(
                [sys.executable, "-I", "-S", str(_GUARDIAN), str(held), str(told), memory, *inside, *self._command],
                cwd=self._folder,
                env=_environment() | _ONE_THREAD,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                start_new_session=True,
                pass_fds=(held, told),
            )
        except OSError as error:
            os.close(self._lifeline)
            os.close(self._status)
            raise SolverError(f"{self._folder}: no program can be started there ({error.strerror})") from error
        finally:
            os.close(held)
            os.close(told)

    def _heard_of_guardian(self, wait_s: float | None = None) -> str:
        """Next line from the guardian; empty where there is none within the time."""
        line = b""
        while not line.endswith(b"\n"):
            if not select.select([self._status], [], [], wait_s)[0] or not (byte := os.read(self._status, 1)):
                return ""
            line += byte
        return line.decode("ascii")

    def _exchange(self, request: Mapping[str, Any], limit_s: float, spent_s: float = 0.0) -> dict[str, Any]:
        started = time.perf_counter()
        try:
            if self._received or self._printed_since():
                raise _MisbehavedError("printed more than its answer")
            words = json.dumps(request, allow_nan=False).encode() + b"\n"
            line = self._converse(words, started + limit_s - spent_s, limit_s)
            return _json_object(line)
        except _MisbehavedError as error:
            reason = f"error: {error}{self._last_words()}"
            self.close()
            raise ProgramFailedError(reason, 1000.0 * (time.perf_counter() - started)) from error

    def _printed_since(self) -> bool:
        """Whether it has printed anything since its answer was read; it would be taken for the next answer."""
        assert self._process is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BlockingIOError):
            # At the end of its output nothing is read either; the exchange tells how it ended.
            return bool(os.read(self._process.stdout.fileno(), _CHUNK))
        return False

    def _converse(self, pending: bytes, deadline: float, limit_s: float) -> bytes:
        """Write all of `pending` and read one line, in whatever order the program wants."""
        assert self._process is not None
        assert self._process.stdin is not None
        stdin = self._process.stdin
        self._selector.register(stdin, selectors.EVENT_WRITE, "stdin")
        try:
            while b"\n" not in self._received:
                left = deadline - time.perf_counter()
                if left <= 0.0:
                    raise _MisbehavedError(f"no answer within {limit_s:g} s")
                for key, _ in self._selector.select(left):
                    if key.data == "stdin":
                        try:
                            pending = pending[os.write(stdin.fileno(), pending[:_CHUNK]) :]
                        except OSError as error:
                            raise _MisbehavedError(self._end()) from error
                        if not pending:
                            self._selector.unregister(stdin)
                        continue
                    chunk = os.read(key.fd, _CHUNK)
                    if key.data == "stderr":
                        self._hear(chunk)
                        if not chunk:
                            self._selector.unregister(key.fileobj)
                        continue
                    self._received += chunk
                    if not chunk:
                        raise _MisbehavedError(self._end())
                    if len(self._received) > LONGEST_REPLY_BYTES:
                        raise _MisbehavedError(f"answered with more than {LONGEST_REPLY_BYTES} bytes")
        finally:
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(stdin)
        line, _, self._received = self._received.partition(b"\n")
        return line

    def _end(self) -> str:
        """Describe how the program ended."""
        status = self._heard_of_guardian(_ENDING_S).partition(" ")[2].strip()
        if not status:
            return "closed its output"
        if status == "processes":
            return f"ran more than {MOST_PROCESSES} processes at once"
        if status == "memory":
            return f"held more than {self.limits.memory_mib} MiB with the processes that it started"
        code = int(status)
        if code < 0:
            return f"ended by signal {_name_of_signal(-code)}"
        return f"ended with exit status {code}"

    def _hear(self, words: bytes) -> None:
        """Keep the end of what it writes to standard error."""
        self._stderr = (self._stderr + words)[-_KEPT_STDERR_BYTES:]
        if words and self._on_stderr is not None:
            self._on_stderr(words)

    def _last_words(self) -> str:
        """The last line that it wrote to standard error."""
        assert self._process is not None
        assert self._process.stderr is not None
        with contextlib.suppress(OSError):
            self._hear(os.read(self._process.stderr.fileno(), _CHUNK) or b"")
        lines = self._stderr.decode("utf-8", "replace").split("\n")
        words = [" ".join(line.split()) for line in lines if line.strip()]
        return f" ({words[-1][:120]})" if words else ""


def _environment() -> dict[str, str]:
    """Environment variables for a program: none that could contain private data of the user."""
    return {
        name: value for name, value in os.environ.items() if name in PASSED_ON or name.startswith(PASSED_ON_PREFIXES)
    }


class _MisbehavedError(Exception):
    """Forbidden behaviour of a program."""


def _name_of_signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # real-time signals other than their first and last have no names
        return str(number)


def _json_object(line: bytes) -> dict[str, Any]:
    try:
        message = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise _MisbehavedError(f"answered with a line that is not JSON: {line[:40]!r}") from error
    if not isinstance(message, dict):
        raise _MisbehavedError("answered with JSON that is no object")
    return message
