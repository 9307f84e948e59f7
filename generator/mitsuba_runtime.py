"""Find the libraries of Mitsuba, and start it once.

Mitsuba's LLVM variants load ``libLLVM`` when first imported, from the path in the environment variable
``DRJIT_LIBLLVM_PATH``; setting it later has no effect. LLVM older than 17 aborts the process at the first real kernel,
which no ``except`` catches, so every candidate is first tried in a separate process.
"""

from __future__ import annotations

import ctypes.util
import functools
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import platformdirs

from generator.errors import RuntimeUnavailableError
from generator.files import write_bytes

LLVM_VARIANT = "llvm_ad_spectral"
CUDA_VARIANT = "cuda_ad_spectral"
VARIANTS = (LLVM_VARIANT, CUDA_VARIANT)
VARIANT_VARIABLE = "SKYBENCH_VARIANT"
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
MINIMUM_LLVM = 17
PROBE_TIMEOUT_S = 120.0
LEAST_ADDRESS_SPACE = 1_250_000_000
"""Bytes. LLVM ends the process if it runs out of memory, and a frame cannot be rendered with less."""

REMEDY = (
    "install LLVM >= 17: on Linux x86-64 `pip install karellen-llvm-core==23.1.4.post8`, elsewhere your system's package "
    f"(`apt install libllvm19`, `brew install llvm`), or point {LLVM_VARIABLE} at libLLVM"
)
LIBATOMIC = "libatomic.so.1"
LIBATOMIC_REMEDY = "install libatomic: `apt install libatomic1` (Debian, Ubuntu), `dnf install libatomic` (Fedora)"

_LLVM_PROBE = """
import ctypes, json, os, sys
library = ctypes.CDLL(sys.argv[1])
numbers = [ctypes.c_uint() for _ in range(3)]
library.LLVMGetVersion(*map(ctypes.byref, numbers))
version = ".".join(str(number.value) for number in numbers)
if numbers[0].value >= int(sys.argv[2]):
    os.environ["DRJIT_LIBLLVM_PATH"] = sys.argv[1]
    import drjit
    value = drjit.llvm.Float([1.0, 4.0])
    assert drjit.all(drjit.maximum(drjit.sqrt(value), 1.5) == drjit.llvm.Float([1.5, 2.0]))
print(json.dumps(version))
"""

_CUDA_PROBE = """
import drjit
value = drjit.cuda.Float([1.0, 4.0])
assert drjit.all(drjit.sqrt(value) == drjit.cuda.Float([1.0, 2.0]))
"""


@dataclass(frozen=True)
class LlvmLibrary:
    """A candidate LLVM library and the result of the trial.

    Attributes
    ----------
    path : str
    version : str
        Such as ``23.1.4``; empty if the library could not be loaded.
    usable : bool
    problem : str
        Why it is not usable; empty if it is.
    """

    path: str
    version: str
    usable: bool
    problem: str


def _probe(path: str) -> LlvmLibrary:
    """Load a library and run a kernel on it in a separate process."""
    command = [sys.executable, "-c", _LLVM_PROBE, path, str(MINIMUM_LLVM)]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_TIMEOUT_S, check=False)
    except (subprocess.TimeoutExpired, OSError) as error:
        return LlvmLibrary(path, "", False, f"the probe did not finish: {error}")
    if run.returncode != 0:
        last_line = (run.stderr.strip().splitlines() or [f"the process died (exit status {run.returncode})"])[-1]
        return LlvmLibrary(path, "", False, last_line)
    version = json.loads(run.stdout.splitlines()[-1])
    usable = int(version.split(".")[0]) >= MINIMUM_LLVM
    return LlvmLibrary(path, version, usable, "" if usable else f"LLVM {version} is older than {MINIMUM_LLVM}")


def _probe_remembered(path: str) -> LlvmLibrary:
    """Probe a library, or return the stored result for the same file (path, size, time) from the user's cache folder."""
    try:
        resolved = Path(path).resolve(strict=True)
        state = resolved.stat()
    except OSError:
        return _probe(path)
    record = platformdirs.user_cache_path("skybench") / "llvm.json"
    key = f"{sys.executable} {path} {state.st_size} {state.st_mtime_ns}"
    try:
        known = json.loads(record.read_text(encoding="utf-8"))
        if known["key"] == key:
            return LlvmLibrary(path, str(known["version"]), True, "")
    except (OSError, ValueError, KeyError, TypeError):
        known = None
    library = _probe(path)
    if library.usable:
        try:
            record.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(record, json.dumps({"key": key, "version": library.version}).encode())
        except OSError:
            return library
    return library


def llvm_candidates() -> Iterator[str]:
    """Yield libraries to try, best first: only the one set in the environment if any, else pip's, else the system's."""
    chosen = os.environ.get(LLVM_VARIABLE)
    if chosen:
        yield chosen
        return
    candidates = [Path(sys.prefix) / "lib" / name for name in ("libLLVM.so", "libLLVM.dylib")]
    system: list[Path] = []
    for folder in ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib"):
        system += Path(folder).glob("libLLVM*.so*")
    for folder in ("/opt/homebrew/opt/llvm/lib", "/usr/local/opt/llvm/lib"):
        system += Path(folder).glob("libLLVM*.dylib")
    yield from (str(path) for path in [*candidates, *sorted(system, reverse=True)] if path.exists())
    # This search runs a compiler and a linker, so it comes last.
    by_name = ctypes.util.find_library("LLVM")
    if by_name:
        yield by_name


@functools.cache
def find_llvm() -> LlvmLibrary:
    """Return the first usable LLVM library.

    Raises
    ------
    RuntimeUnavailableError
        No library is usable; the message lists those tried and the remedy.
    """
    tried = []
    for path in llvm_candidates():
        library = _probe_remembered(path)
        if library.usable:
            return library
        tried.append(f"{library.path}: {library.problem}")
    causes = "; ".join(tried) or "none found"
    remedy = LIBATOMIC_REMEDY if LIBATOMIC in causes else REMEDY
    raise RuntimeUnavailableError(f"no usable LLVM ({causes}); {remedy}")


@functools.cache
def cuda_works() -> bool:
    """Whether Dr.Jit can compute on a GPU (tried in a separate process)."""
    if not Path("/proc/driver/nvidia/version").exists():
        return False
    try:
        run = subprocess.run(
            [sys.executable, "-c", _CUDA_PROBE], capture_output=True, timeout=PROBE_TIMEOUT_S, check=False
        )
    except (subprocess.TimeoutExpired, OSError):
        return False
    return run.returncode == 0


def choose_variant() -> str:
    """Return the Mitsuba variant to use: that of ``SKYBENCH_VARIANT``, else CUDA if a GPU works, else LLVM."""
    asked = os.environ.get(VARIANT_VARIABLE)
    if asked:
        if asked not in VARIANTS:
            raise RuntimeUnavailableError(f"{VARIANT_VARIABLE}={asked} is not one of {', '.join(VARIANTS)}")
        if asked == CUDA_VARIANT and not cuda_works():
            raise RuntimeUnavailableError(f"{VARIANT_VARIABLE}={asked}, but no GPU works here; unset it to use LLVM")
        return asked
    return CUDA_VARIANT if cuda_works() else LLVM_VARIANT


@functools.cache
def start(variant: str | None = None) -> Any:
    """Import Mitsuba with the right variant and return the module; the first call determines the variant.

    :func:`generator.plugins.start` does the same and registers the plugins of the night sky.

    Raises
    ------
    MemoryError
        The process is limited to less than LEAST_ADDRESS_SPACE.
    RuntimeUnavailableError
        There is no usable LLVM, or the requested variant is not available.
    """
    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if allowed != resource.RLIM_INFINITY and allowed < LEAST_ADDRESS_SPACE:
        raise MemoryError(
            f"rendering needs {LEAST_ADDRESS_SPACE / 1e9:g} GB of address space, {allowed / 1e9:g} are allowed"
        )
    variant = variant or choose_variant()
    if variant == LLVM_VARIANT:
        os.environ[LLVM_VARIABLE] = find_llvm().path
    import mitsuba

    mitsuba.set_variant(variant)
    return mitsuba


def set_threads(count: int) -> None:
    """Set the number of threads on which Dr.Jit computes in this process."""
    start()
    import drjit

    drjit.set_thread_count(count)
