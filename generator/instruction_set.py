"""The processor's instructions that NumPy and its linear algebra compute with: AVX2's, whatever more a processor has.

NumPy's exponentials and OpenBLAS's products have other last digits with AVX-512 than with AVX2, enough to move some pixels of
a frame by a step. Frames are the same bytes on every x86-64 processor since Haswell (2013) and Zen because all take the same
instructions, and because kernels of Dr.Jit use no approximate ones (``rsqrt``), whose results are their makers' choice.

Both libraries choose when they are loaded. This module imports nothing but Python's own and must come first. After NumPy it
does nothing, and workers of such a process (`multiprocessing`) compute as it does. Other kinds of processors and systems
compute with what they have.
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
"""Version of NumPy that first has a feature of this name; earlier ones choose by themselves."""
NEEDED = frozenset({"avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm"})
"""What Linux calls the instructions of x86-64-v3 beyond v2."""
PROCESSOR = Path("/proc/cpuinfo")
UNSETTLED_VARIABLE = "SKYBENCH_UNSETTLED_INSTRUCTIONS"
"""Tells workers that the process that starts them had loaded NumPy before skybench."""


def settle(environment: MutableMapping[str, str] = os.environ, processor: Path = PROCESSOR) -> bool:
    """Let NumPy and OpenBLAS take AVX2 when they are loaded; what the user has set stays.

    Parameters
    ----------
    environment : mapping of str to str
        Variables of this process, which its children get too.
    processor : Path
        Linux' description of the processor.

    Returns
    -------
    bool
        False where NumPy is loaded already, or the processor is another or unknown: nothing is changed.
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
