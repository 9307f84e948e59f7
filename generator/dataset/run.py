"""Generate a dataset: shards on one or several processes; an interrupted run can be resumed, with the same bytes."""

from __future__ import annotations

import multiprocessing
import queue
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.managers import SyncManager
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from generator.dataset.inputs import check_name, store_inputs
from generator.dataset.layout import SCENARIO_COPY, DatasetSpec, Shard
from generator.dataset.manifest import manifest_of
from generator.dataset.shard import FailedFrame, ShardReport, render_shard
from generator.dataset.target import Target
from generator.errors import GeneratorError, ScenarioError
from generator.processes import begin, follow_parent, packed
from generator.scenario.file import Scenario, parse_scenario

TRIES_PER_SHARD = 3
"""A worker may die by chance, or for lack of memory, but hardly three times on one shard."""
POLL_S = 0.2


@dataclass(frozen=True)
class Part:
    """One of n jobs that share a dataset: it generates the shards whose index modulo `count` is `index`."""

    index: int = 0
    count: int = 1

    def __post_init__(self) -> None:
        """Refuse a part that does not exist. Raises GeneratorError."""
        if not 0 <= self.index < self.count:
            raise GeneratorError(
                f"part {self.index}/{self.count}: parts run from 0/{self.count} to {self.count - 1}/{self.count}"
            )

    def of(self, shards: Sequence[Shard]) -> list[Shard]:
        """The shards that this job generates."""
        return [shard for shard in shards if shard.index % self.count == self.index]


@dataclass(frozen=True)
class ShardRange:
    """One of several jobs that share a dataset: it generates the shards `first` to `stop` - 1."""

    first: int
    stop: int

    def of(self, shards: Sequence[Shard]) -> list[Shard]:
        """The shards that this job generates. Raises GeneratorError if the dataset lacks some of the range."""
        known = shards[0].index, shards[-1].index + 1
        if not known[0] <= self.first < self.stop <= known[1]:
            raise GeneratorError(
                f"shards {self.first}:{self.stop}: the dataset has shards {known[0]}:{known[1]}, stop excluded"
            )
        return [shard for shard in shards if self.first <= shard.index < self.stop]


@dataclass(frozen=True)
class RunReport:
    """Result of a run.

    Attributes
    ----------
    reports : tuple of ShardReport
        Reports of the shards of this part.
    missing : tuple of Shard
        Shards that the dataset still lacks, those of other parts included.
    mended : tuple of str
        Files that were missing or had changed, and were written again.
    """

    reports: tuple[ShardReport, ...]
    missing: tuple[Shard, ...]
    mended: tuple[str, ...] = ()

    @property
    def failures(self) -> tuple[FailedFrame, ...]:
        """Frames that could not be rendered."""
        return tuple(failure for report in self.reports for failure in report.failures)


def open_dataset_target(target: Target, scenario: Scenario, text: str) -> list[str]:
    """Prepare a dataset's place: store the copy of the scenario, then the files that it names.

    A place with another scenario's dataset is refused. If the manifest there states that it is this scenario's, copies
    that differ are damaged, and are replaced.

    Returns
    -------
    list of str
        Copies that were damaged.

    Raises
    ------
    GeneratorError
        The place contains another dataset or other files, or cannot be written.
    """
    for file in scenario.files:
        check_name(file.path)
    try:
        known = manifest_of(target)
        ours = known is not None and known.scenario_sha256 == scenario.sha256
        return [*_store_scenario(target, scenario, text, ours), *store_inputs(target, scenario, ours)]
    except OSError as error:
        raise GeneratorError(
            f"{error.filename or target.name}: cannot be written ({error.strerror or error}); choose another folder"
        ) from error


def _store_scenario(target: Target, scenario: Scenario, text: str, ours: bool) -> list[str]:
    copy = target.read(SCENARIO_COPY)
    others = [] if copy is not None or ours else [name for name in target.listing() if not name.startswith(".")]
    if SCENARIO_COPY in others:  # another job of the dataset began between the two queries
        copy = target.read(SCENARIO_COPY)
    if copy == text.encode():
        return []
    if copy is not None or ours:
        try:
            same = parse_scenario((copy or b"").decode(), scenario.source).sha256 == scenario.sha256
        except (ScenarioError, UnicodeDecodeError):
            same = False
        if same:
            return []
        if not ours:
            raise GeneratorError(f"{target.name}: holds another scenario's dataset; choose another folder")
        _put_text(target, text)
        return [SCENARIO_COPY]
    if others:
        raise GeneratorError(f"{target.name}: holds other files ({others[0]}, …); choose an empty folder")
    _put_text(target, text)
    return []


def _put_text(target: Target, text: str) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        local = Path(scratch) / SCENARIO_COPY
        local.write_text(text, encoding="utf-8")
        target.put(local, SCENARIO_COPY)


def run_shards(
    scenario: Scenario,
    spec: DatasetSpec,
    shards: list[Shard],
    target: Target,
    workers: int,
    progress: Callable[[int], None] = lambda index: None,
) -> Iterator[ShardReport]:
    """Generate shards in this process (`workers` 0) or in `workers` single-threaded processes; yields reports as they finish.

    If a worker dies, its shard is queued again, up to TRIES_PER_SHARD times.

    Raises
    ------
    GeneratorError
        The folder cannot be written, or workers keep dying.
    """
    if workers == 0:
        for shard in shards:
            yield render_shard(scenario, spec, shard, target, progress)
        return
    waiting = {shard.index: (shard, 0) for shard in shards}
    while waiting:
        for report in _pool_round(scenario, spec, target, workers, waiting, progress):
            del waiting[report.shard.index]
            yield report
        exhausted = [shard for shard, tries in waiting.values() if tries >= TRIES_PER_SHARD]
        if exhausted:
            raise GeneratorError(
                f"the worker of {exhausted[0].stem} died {TRIES_PER_SHARD} times (out of memory?); "
                "use fewer --workers and run the same command again"
            )


def _pool_round(
    scenario: Scenario,
    spec: DatasetSpec,
    target: Target,
    workers: int,
    waiting: dict[int, tuple[Shard, int]],
    progress: Callable[[int], None],
) -> Iterator[ShardReport]:
    """Give all waiting shards to a pool of processes; ends early, with shards left waiting, if a worker dies."""
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    manager = SyncManager(ctx=context)
    with deaf_to_interrupts():
        manager.start(follow_parent)
    with manager:
        done = manager.Queue()
        start = packed(_start_worker, scenario, spec, target, done)
        pool = ProcessPoolExecutor(min(workers, len(waiting)), context, begin, (start,))
        try:
            with deaf_to_interrupts():
                futures = {pool.submit(_work, shard): shard for shard, _ in waiting.values()}
            open_futures: set[Future[ShardReport]] = set(futures)
            while open_futures:
                finished, open_futures = wait(open_futures, timeout=POLL_S, return_when=FIRST_COMPLETED)
                _drain(done, progress)
                for future in finished:
                    yield future.result()
        except BrokenProcessPool:
            for index, (shard, tries) in list(waiting.items()):
                waiting[index] = (shard, tries + 1)
        except KeyboardInterrupt:
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Block SIGINT; processes started meanwhile never receive it, so that only this process handles Ctrl-C."""
    # If it must be started first, the resource tracker unblocks SIGINT.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _drain(done: Any, progress: Callable[[int], None]) -> None:
    """Report the frames that workers have announced."""
    while True:
        try:
            progress(done.get_nowait())
        except queue.Empty:
            return


Runner = Callable[[Scenario, DatasetSpec, list[Shard], Target, int, Callable[[int], None]], Iterator[ShardReport]]
"""A backend: generates shards and yields a report for each, as :func:`run_shards` does."""

_worker: dict[str, Any] = {}
"""Arguments of a worker process; empty in every other process."""


def prepare_worker() -> None:
    """Limit Dr.Jit and linear algebra in this process to one thread, and its lifetime to that of its parent."""
    follow_parent()
    from generator.mitsuba_runtime import set_threads

    set_threads(1)
    threadpool_limits(1)


def _start_worker(scenario: Scenario, spec: DatasetSpec, target: Target, done: Any) -> None:
    prepare_worker()
    _worker.update(scenario=scenario, spec=spec, target=target, done=done)


def _work(shard: Shard) -> ShardReport:
    return render_shard(_worker["scenario"], _worker["spec"], shard, _worker["target"], _worker["done"].put)
