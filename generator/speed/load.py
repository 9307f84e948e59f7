"""The clock of the measurements, and the load of the machine by other processes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from generator import mitsuba_runtime

Clock = Callable[[], float]


@dataclass(frozen=True)
class Load:
    """Load of a machine during a measurement.

    Attributes
    ----------
    cores : int
        Number of cores that this process may use.
    before, after : float
        Processes that ran or waited for a core, means over a minute (the system's load average), including the measured
        ones; NaN if the system does not state it.
    core_share : float
        Processor time of this process relative to wall-clock time while it measured by itself; less than 1 if other
        processes took its core.
    """

    cores: int
    before: float
    after: float
    core_share: float


def load_average() -> float:
    """Processes that run or wait for a core, mean over the last minute; NaN if the system does not state it."""
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return float("nan")


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def best_clock() -> Clock:
    """Processor time of this process, which other processes hardly affect; wall-clock time if a GPU computes."""
    return time.perf_counter if mitsuba_runtime.choose_variant() == mitsuba_runtime.CUDA_VARIANT else time.process_time


@contextmanager
def one_thread() -> Iterator[None]:
    """Make Dr.Jit compute on one thread within the block, as in a worker process."""
    mitsuba_runtime.start()
    import drjit

    before = drjit.thread_count()
    drjit.set_thread_count(1)
    try:
        yield
    finally:
        drjit.set_thread_count(before)
