"""Restrict NumPy and its linear algebra to AVX2 instructions, even on processors that have more.

NumPy's exponentials and OpenBLAS's products have other last digits with AVX-512 than with AVX2, enough to move some
pixels of a frame by one step. Frames are the same bytes on every x86-64 processor since Haswell (2013) and Zen because
all use the same instructions, and because kernels of Dr.Jit use no approximate ones (``rsqrt``), whose results differ
between manufacturers.

Both libraries choose their instructions when they are loaded. This module therefore imports only the standard library
and must be imported first. After NumPy has been loaded it does nothing, and worker processes (`multiprocessing`)
compute as their parent does. Other kinds of processors and systems use whatever instructions they have.
"""

from __future__ import annotations

import os
import sys
from collections.abc import MutableMapping
from importlib.metadata import version
from multiprocessing import parent_process
from pathlib import Path

OPENBLAS_VARIABLE = "OPENBLAS_CORETYPE"
OPENBLAS_KERNELS = "Haswell"
NUMPY_VARIABLES = ("NPY_ENABLE_CPU_FEATURES", "NPY_DISABLE_CPU_FEATURES")
NUMPY_FEATURE = "X86_V3"
FIRST_NUMPY = (2, 4)
"""First version of NumPy with a feature of this name; earlier versions make their own choice."""
NEEDED = frozenset({"avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm"})
"""Linux' names of the instructions that x86-64-v3 adds to v2."""
PROCESSOR = Path("/proc/cpuinfo")
UNSETTLED_VARIABLE = "SKYBENCH_UNSETTLED_INSTRUCTIONS"
"""Environment variable that tells workers that their parent process had loaded NumPy before skybench."""


def settle(environment: MutableMapping[str, str] = os.environ, processor: Path = PROCESSOR) -> bool:
    """Make NumPy and OpenBLAS use AVX2 when they are loaded; settings made by the user are kept.

    Parameters
    ----------
    environment : mapping of str to str
        Environment variables of this process, which its children inherit.
    processor : Path
        Linux' description of the processor.

    Returns
    -------
    bool
        False if nothing was settled, because NumPy is already loaded (which workers learn by UNSETTLED_VARIABLE), or the
        processor is of another kind or unknown.
    """
    if "numpy" in sys.modules:
        if NUMPY_VARIABLES[0] not in environment:
            environment[UNSETTLED_VARIABLE] = "1"
        return False
    as_parent = UNSETTLED_VARIABLE in environment and parent_process() is not None
    if as_parent or not NEEDED.issubset(_instructions(processor)):
        return False
    environment.setdefault(OPENBLAS_VARIABLE, OPENBLAS_KERNELS)
    if not any(name in environment for name in NUMPY_VARIABLES) and _numpy_version() >= FIRST_NUMPY:
        environment[NUMPY_VARIABLES[0]] = NUMPY_FEATURE
    return True


def _instructions(processor: Path) -> frozenset[str]:
    try:
        lines = processor.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return frozenset()
    flags = next((line for line in lines if line.startswith("flags")), "")
    return frozenset(flags.partition(":")[2].split())


def _numpy_version() -> tuple[int, ...]:
    return tuple(int(part) for part in version("numpy").split(".")[:2])
