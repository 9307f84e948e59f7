"""The clock of the measurements, and what else the machine does meanwhile."""

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
    """How busy a machine was during a measurement.

    Attributes
    ----------
    cores : int
        That this process may use.
    before, after : float
        Processes that ran or waited for a core, means over a minute (the system's load average), the measured ones included;
        NaN where the system does not say.
    core_share : float
        Processor time of this process over the time by the clock, while it measured by itself: less than 1 where others
        took its core.
    """

    cores: int
    before: float
    after: float
    core_share: float


def load_average() -> float:
    """Processes that run or wait for a core, mean over the last minute; NaN where the system does not say."""
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return float("nan")


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def best_clock() -> Clock:
    """Processor time of this process, which other processes hardly change; by the clock where a GPU computes."""
    return time.perf_counter if mitsuba_runtime.choose_variant() == mitsuba_runtime.CUDA_VARIANT else time.process_time


@contextmanager
def one_thread() -> Iterator[None]:
    """Dr.Jit computes on one thread within the block, as in a worker process."""
    mitsuba_runtime.start()
    import drjit

    before = drjit.thread_count()
    drjit.set_thread_count(1)
    try:
        yield
    finally:
        drjit.set_thread_count(before)
