"""Worker processes: how they start."""

import gc
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor

from generator.processes import begin, packed

VARIABLE = "SKYBENCH_TEST_OF_A_WORKER"


def remember(word: str) -> None:
    os.environ[VARIABLE] = f"{word} {gc.isenabled()}"


def state() -> tuple[str, bool, bool, str]:
    return os.environ[VARIABLE], gc.isenabled(), gc.get_freeze_count() > 0, os.environ["OPENBLAS_NUM_THREADS"]


def test_a_worker_loads_what_it_needs_without_looking_for_garbage_and_then_looks_again(monkeypatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    start = packed(remember, "started")
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), begin, (start,)) as pool:
        assert pool.submit(state).result() == ("started False", True, True, "1")
