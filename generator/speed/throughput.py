"""Frames per second of worker processes in their steady state."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from pathlib import Path
from typing import Any

from generator.dataset.layout import DatasetSpec, Shard
from generator.dataset.run import prepare_worker
from generator.dataset.shard import render_shard
from generator.dataset.target import LocalTarget
from generator.errors import GeneratorError
from generator.speed.scenes import FrameSize, data_set

WARM_UP = 5
START_TIMEOUT_S = 600.0


def frames_per_second(workers: int, frames: int, size: FrameSize, codec: str) -> float:
    """Frames per second of `workers` processes that each write a shard of `frames` frames, including truth.

    Every process first renders a few frames; then all start together, and the time of the slowest counts.

    Raises
    ------
    GeneratorError
        A process failed.
    """
    context = multiprocessing.get_context("spawn")
    gate = context.Barrier(workers, timeout=START_TIMEOUT_S)
    with tempfile.TemporaryDirectory(prefix="skybench-speed-") as folder:
        answers: Any = context.SimpleQueue()
        processes = [
            context.Process(target=_work, args=(number, workers, frames, size, codec, folder, gate, answers))
            for number in range(workers)
        ]
        for process in processes:
            process.start()
        for process in processes:
            process.join()
        if any(process.exitcode for process in processes):
            raise GeneratorError("a process that was being timed failed; its message is above")
        spans = [answers.get() for _ in processes]
    return workers * frames / (max(stop for _, stop in spans) - min(start for start, _ in spans))


def _work(
    number: int, workers: int, frames: int, size: FrameSize, codec: str, folder: str, gate: Any, answers: Any
) -> None:
    """Warm up, wait for the other processes, render a shard, and return its start and end times."""
    prepare_worker()
    scenario = data_set(size, WARM_UP + workers * frames)
    spec, target = DatasetSpec(codec=codec), LocalTarget(Path(folder) / str(number))
    render_shard(scenario, spec, Shard(0, 0, WARM_UP, spec.split), target)
    first = WARM_UP + number * frames
    gate.wait()
    start = time.monotonic()
    report = render_shard(scenario, spec, Shard(1, first, first + frames, spec.split), target)
    answers.put((start, time.monotonic()))
    if not report.complete:
        raise GeneratorError(f"frame {report.failures[0].index}: {report.failures[0].error}")
