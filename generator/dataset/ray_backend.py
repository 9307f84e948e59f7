"""Generate shards on a Ray cluster: a local one by default, or the one at an address."""

from __future__ import annotations

import contextlib
import socket
import sys
from collections.abc import Callable, Iterator
from typing import Any

from generator.dataset.layout import DatasetSpec, Shard
from generator.dataset.run import TRIES_PER_SHARD, Runner, prepare_worker
from generator.dataset.shard import ShardReport, render_shard
from generator.dataset.target import Target
from generator.errors import GeneratorError
from generator.scenario.file import Scenario

CONNECT_TIMEOUT_S = 5.0


def ray_runner(address: str | None = None) -> Runner:
    """Return a backend that submits each shard to Ray as a single-core task, retried if its worker or node dies.

    Parameters
    ----------
    address : str, optional
        Address of a running cluster; by default, Ray starts a cluster on this machine.

    Raises
    ------
    GeneratorError
        Ray is not installed, or the cluster cannot be reached.
    """
    try:
        import ray
    except ImportError as error:
        raise GeneratorError("--backend ray needs Ray: pip install 'skybench[cluster]'") from error

    def run(
        scenario: Scenario,
        spec: DatasetSpec,
        shards: list[Shard],
        target: Target,
        workers: int,
        progress: Callable[[int], None],
    ) -> Iterator[ShardReport]:
        if address:
            _check_reachable(address)
        try:
            ray.init(address=address, num_cpus=None if address else max(1, workers), include_dashboard=False,
                     configure_logging=False, log_to_driver=False)  # fmt: skip
        except (ConnectionError, RuntimeError) as error:
            raise GeneratorError(f"cannot reach a Ray cluster: {error}") from error
        # Ray reports dead workers on standard output, which is reserved for the command's own output.
        with contextlib.redirect_stdout(sys.stderr), contextlib.ExitStack() as stack:
            stack.callback(ray.shutdown)
            task: Any = ray.remote(num_cpus=1, max_retries=TRIES_PER_SHARD)(_render_on_one_thread)
            shared = ray.put((scenario, spec, target))
            open_tasks = [task.remote(shared, shard) for shard in shards]
            while open_tasks:
                finished, open_tasks = ray.wait(open_tasks)
                for reference in finished:
                    report: ShardReport = _result(ray, reference)
                    if not report.skipped:
                        for index in range(report.shard.first, report.shard.stop):
                            progress(index)
                    yield report

    return run


def _render_on_one_thread(shared: tuple[Scenario, DatasetSpec, Target], shard: Shard) -> ShardReport:
    prepare_worker()
    scenario, spec, target = shared
    return render_shard(scenario, spec, shard, target)


def _check_reachable(address: str) -> None:
    """Refuse an address where no server listens; Ray itself would retry for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon:
        return  # a name such as "auto", which Ray resolves
    try:
        socket.create_connection((host, int(port)), timeout=CONNECT_TIMEOUT_S).close()
    except (OSError, ValueError) as error:
        raise GeneratorError(f"cannot reach a Ray cluster at {address}: {error}") from error


def _result(ray: Any, reference: Any) -> ShardReport:
    try:
        report: ShardReport = ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        raise error.as_instanceof_cause() from None
    except ray.exceptions.RayError as error:
        raise GeneratorError(f"Ray gave up on a shard after {TRIES_PER_SHARD} retries: {error}") from error
    return report
