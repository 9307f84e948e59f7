"""Worker processes: how they start."""

import gc
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from generator.processes import begin, packed

VARIABLE = "SKYBENCH_TEST_OF_A_WORKER"


def remember(word: str) -> None:
    os.environ[VARIABLE] = f"{word} {gc.isenabled()}"


def state() -> tuple[str, bool, bool, str, str | None]:
    blas = os.environ["OPENBLAS_NUM_THREADS"], os.environ.get("OPENBLAS_CORETYPE")
    return os.environ[VARIABLE], gc.isenabled(), gc.get_freeze_count() > 0, *blas


def kernels() -> str | None:
    """Those of linear algebra that give the same last digits on processors with AVX2 and with AVX-512."""
    listed = Path("/proc/cpuinfo")
    return "Haswell" if listed.is_file() and {"avx2", "fma"} <= set(listed.read_text().split()) else None


def test_a_worker_loads_what_it_needs_without_looking_for_garbage_and_then_looks_again(monkeypatch) -> None:
    for name in ("OPENBLAS_NUM_THREADS", "OPENBLAS_CORETYPE"):
        monkeypatch.delenv(name, raising=False)
    start = packed(remember, "started")
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), begin, (start,)) as pool:
        assert pool.submit(state).result() == ("started False", True, True, "1", kernels())
