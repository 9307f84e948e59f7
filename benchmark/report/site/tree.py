"""Reading a tree of results, ``RESULTS/<task>@<revision>/<split>/<detections>/<solver>-<key>/`` (docs/benchmark.md)."""

from __future__ import annotations

import dataclasses
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from benchmark.errors import ResultsError
from benchmark.run.result_tables import DetectionRow
from benchmark.run.results import SUMMARY_NAME, RunProvenance, read_summary
from benchmark.solvers.registry import known_solvers, solver_folder
from benchmark.stats.frame_metrics import SUCCESS_LEVELS_KM, read_frames

SUCCESS_METRICS = tuple(f"success_{limit:g}km" for limit in SUCCESS_LEVELS_KM)
_PATTERN = f"*@*/*/*/*/{SUMMARY_NAME}"


@dataclass(frozen=True)
class TaskFacts:
    """What the report needs to know of a task.

    Attributes
    ----------
    name, revision, title : str
    condition, unit : str
        What the task grades; the unit may be empty.
    harder : int
        1 where larger values of the condition are harder, -1 where smaller ones are.
    metric : str
        Key of the metric that ranks solvers, one of `SUCCESS_METRICS`.
    """

    name: str
    revision: str
    title: str
    condition: str
    unit: str
    harder: int
    metric: str

    @property
    def key(self) -> str:
        """Name and revision."""
        return f"{self.name}@{self.revision}"

    @property
    def limit_km(self) -> float:
        """Error below which a frame is a success."""
        return float(self.metric.removeprefix("success_").removesuffix("km"))

    @property
    def axis(self) -> str:
        """Condition and unit, for an axis."""
        return f"{self.condition}, {self.unit}" if self.unit else self.condition


@dataclass(frozen=True, eq=False)
class StoredResult:
    """One solver's result, as read; `label` tells it from the others of its board."""

    folder: Path
    solver: str
    label: str
    family: str
    title: str
    task: TaskFacts
    split: str
    detections: str
    key: str
    provenance: RunProvenance
    frames: pd.DataFrame

    def detections_of(self, frame_id: str) -> list[DetectionRow]:
        """Detections of one frame; none where the table of detections is not at hand.

        Raises
        ------
        ResultsError
            The table is damaged.
        """
        path = self.folder / "matches.parquet"
        if not path.is_file():
            return []
        try:
            rows = pq.read_table(path, filters=[("frame_id", "=", frame_id)]).to_pylist()
        except (pa.ArrowException, OSError) as error:
            raise ResultsError(f"{path}: damaged ({error}); run `skybench bench run` again") from error
        return [DetectionRow(**row) for row in rows]


def family_of(solver: str) -> str:
    """Which solvers one belongs with: celnav's own, the peers that come with skybench, or others' programs."""
    if solver not in known_solvers():
        return "others"
    return "celnav" if solver_folder(solver).spec.adapter == "celnav" else "peers"


def is_tree(root: Path) -> bool:
    """Whether a folder holds results of tasks."""
    return any(root.glob(_PATTERN))


def read_tree(root: Path) -> list[list[StoredResult]]:
    """Read all results, grouped by task, split and mode of detections, in the order of their paths.

    Raises
    ------
    ResultsError
        There is none, or a file is damaged.
    """
    groups: defaultdict[tuple[str, ...], list[StoredResult]] = defaultdict(list)
    for summary in sorted(root.glob(_PATTERN)):
        result = _read(summary)
        groups[(result.task.key, result.split, result.detections)].append(result)
    if not groups:
        raise ResultsError(f"{root}: no results of tasks in it; make some with `skybench bench run TASK --solver NAME`")
    return [_labelled(group) for group in groups.values()]


def _read(path: Path) -> StoredResult:
    summary, provenance = read_summary(path)
    folder = path.parent
    task, solver = provenance.task or {}, summary["solver"]
    try:
        facts = TaskFacts(
            name=str(task["name"]),
            revision=str(task["revision"]),
            title=str(task["title"]),
            condition=str(task["condition"]["name"]),
            unit=str(task["condition"]["unit"]),
            harder=1 if task["condition"]["harder"] == "higher" else -1,
            metric=str(task["metric"]["name"]),
        )
        if facts.metric not in SUCCESS_METRICS:
            raise ValueError(f"metric {facts.metric!r} is none of {', '.join(SUCCESS_METRICS)}")
    except (KeyError, TypeError, ValueError) as error:
        raise ResultsError(
            f"{path}: what it says of its task cannot be read ({error!r}); run `skybench bench run` again"
        ) from error
    mode, split = folder.parent.name, folder.parents[1].name
    if folder.parents[2].name != facts.key:
        raise ResultsError(f"{path}: holds a result of {facts.key}, which its folder does not say")
    return StoredResult(
        folder=folder,
        solver=solver,
        label=solver,
        family=family_of(solver),
        title=str(task.get("solver_title") or ""),
        task=facts,
        split=split,
        detections=mode,
        key=folder.name.removeprefix(f"{solver}-"),
        provenance=provenance,
        frames=read_frames(folder / "frames.parquet"),
    )


def _labelled(results: Sequence[StoredResult]) -> list[StoredResult]:
    """Add the key to the labels of solvers that appear in several versions or configurations."""
    count = Counter(result.solver for result in results)
    return [
        dataclasses.replace(result, label=f"{result.solver} {result.key[:6]}") if count[result.solver] > 1 else result
        for result in results
    ]
