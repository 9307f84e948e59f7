"""Reader of a tree of results (docs/benchmark.md), raw and packed.

Raw results are in ``RESULTS/LABEL/PART/DETECTIONS/SOLVER-KEY/``, packed ones in ``RESULTS/LABEL/PART.json`` and
``PART.parquet``. A raw result replaces the packed one of the same solver on the same frames, unless it is of a part of them.
"""

from __future__ import annotations

import dataclasses
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import pandas as pd

from benchmark.errors import ResultsError
from benchmark.frames.frame_set import FrameFacts
from benchmark.judge.outcome import DetectionRow
from benchmark.report.superseded import superseded
from benchmark.run.freshness import Age, age_of, origin_of, today
from benchmark.run.packed import read_packed
from benchmark.run.provenance import RunProvenance, read_provenance
from benchmark.run.results import FRAMES_NAME, MATCHES_NAME, RUN_AGAIN, SUMMARY_NAME, read_summary, read_table
from benchmark.solvers.registry import known_solvers, solver_folder
from benchmark.stats.frame_metrics import read_frames, success_limit_km
from benchmark.stats.metrics import ERROR, FIX

_PATTERN = f"*@*/*/*/*/{SUMMARY_NAME}"
_PACKED_PATTERN = "*@*/*.json"
GRADED = "condition"
"""Column of the value that a task grades."""


@dataclass(frozen=True)
class TaskFacts:
    """What the report needs to know about a task, or about ungraded frames.

    Attributes
    ----------
    name, revision, title : str
    condition, unit : str
        The graded quantity of the task; the unit may be empty. For ungraded frames: the quantity by which success is shown
        instead, empty where nothing varies.
    harder : int
        1 where larger values of the condition are harder, -1 where smaller ones are.
    metric : str
        Key of the metric that ranks solvers, ``success_Nkm``.
    by : str
        Column of the condition; `GRADED` in a task.
    """

    name: str
    revision: str
    title: str
    condition: str
    unit: str
    harder: int
    metric: str
    by: str = GRADED

    @property
    def graded(self) -> bool:
        """Whether a task grades the frames."""
        return self.by == GRADED

    @property
    def key(self) -> str:
        """Name and revision."""
        return f"{self.name}@{self.revision}"

    @property
    def limit_km(self) -> float:
        """Error below which a frame is a success."""
        return success_limit_km(self.metric)

    @property
    def axis(self) -> str:
        """Condition and unit, for an axis."""
        return f"{self.condition}, {self.unit}" if self.unit else self.condition


@dataclass(frozen=True, eq=False)
class StoredResult:
    """One solver's result as read from files.

    Attributes
    ----------
    folder : Path
        Folder of its raw result, whether it exists or is packed.
    solver, family, title, split, detections, key : str
    label : str
        Distinguishes it from the others on its board.
    task : TaskFacts
    provenance : RunProvenance
    frames : DataFrame
    source : Path
        File that states its provenance.
    established : str
        How the solver's revision was established, where the run did not record it.
    age : Age or None
        How it relates to today's code; None where that is not available.
    """

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
    source: Path
    established: str = ""
    age: Age | None = None

    def is_part_of(self, other: StoredResult) -> bool:
        """Whether it is of some of the other's frames and of no more, as a run with fewer ``--frames`` is."""
        same = self.provenance.frames.scenario_sha256 == other.provenance.frames.scenario_sha256
        fewer = len(self.frames) < len(other.frames)
        return same and fewer and set(self.frames["frame_id"]) < set(other.frames["frame_id"])

    def detections_in(self, frame_ids: Collection[str]) -> dict[str, list[DetectionRow]]:
        """Detections by frame; empty where the table of detections is not available.

        Raises
        ------
        ResultsError
            The table is damaged.
        """
        path = self.folder / MATCHES_NAME
        if not path.is_file() or not frame_ids:
            return {}
        rows = read_table(path, filters=[("frame_id", "in", list(frame_ids))]).to_pylist()
        found: dict[str, list[DetectionRow]] = {frame_id: [] for frame_id in frame_ids}
        for row in rows:
            found[row["frame_id"]].append(DetectionRow(**row))
        return found


@lru_cache(maxsize=256)  # reading all solvers' files for each of a hundred rows takes ten seconds
def family_of(solver: str) -> str:
    """Family of a solver: celnav's own, the peers that come with skybench, or others' programs."""
    if solver not in known_solvers():
        return "others"
    return "celnav" if solver_folder(solver).spec.adapter == "celnav" else "peers"


Tell = Callable[[StoredResult, StoredResult], None]
"""Called with a result that is left out, and with the one on more frames because of which it is."""


def untold(left_out: StoredResult, because_of: StoredResult) -> None:
    """Say nothing."""


def read_tree(root: Path, tell: Tell = untold) -> list[list[StoredResult]]:
    """Read all results, grouped by frames and mode of detection, in the order of their paths.

    Results on an earlier revision of a task are left out where a later one exists (`benchmark.report.superseded`), and raw
    results on a part of the frames of the packed one of the same solver.

    Parameters
    ----------
    root : Path
    tell : callable
        Called with each of these raw results.

    Raises
    ------
    ResultsError
        There are no results, or a file is damaged.
    """
    raw = [_read(summary) for summary in sorted(root.glob(_PATTERN))]
    packed = [result for listing in sorted(root.glob(_PACKED_PATTERN)) for result in _unpacked(listing)]
    packed_at = {(result.folder.parent, result.solver): result for result in packed}
    for result in list(raw):
        other = packed_at.get((result.folder.parent, result.solver))
        if other is not None and result.is_part_of(other):
            tell(result, other)
            raw.remove(result)
    replaced = {(result.folder.parent, result.solver) for result in raw}
    kept = [result for result in packed if (result.folder.parent, result.solver) not in replaced]
    old = superseded(root)
    found = sorted(
        (result for result in (*raw, *kept) if root / result.task.key not in old), key=lambda result: result.folder
    )
    now = today(origin_of(result.provenance) for result in found)
    groups: defaultdict[Path, list[StoredResult]] = defaultdict(list)
    for result in found:
        age = age_of(origin_of(result.provenance), now)
        groups[result.folder.parent].append(dataclasses.replace(result, age=age))
    if not groups:
        raise ResultsError(
            f"{root}: no results in it; make some with `skybench bench run TASK|DIR --solver NAME --out {root}`"
        )
    return [labelled(group) for group in groups.values()]


def _read(path: Path) -> StoredResult:
    summary = read_summary(path)
    folder = path.parent
    frames = read_frames(folder / FRAMES_NAME)
    counts = len(frames), int((frames["status"] == FIX).sum()), int((frames["status"] == ERROR).sum())
    if counts != (summary.n_frames, summary.n_fixes, summary.n_errors):
        raise ResultsError(f"{folder / FRAMES_NAME}: does not belong to {SUMMARY_NAME}; {RUN_AGAIN}")
    return _stored(path, folder, summary.solver, summary.provenance, frames)


def _unpacked(listing: Path) -> list[StoredResult]:
    found = []
    for row in read_packed(listing):
        try:
            source = read_provenance(row.provenance)
        except ResultsError as error:
            raise ResultsError(f"{listing}: {row.solver}: {error}; restore it") from error
        if (source.frames.place, source.detections) != (Path(listing.parent.name) / listing.stem, row.detections):
            raise ResultsError(f"{listing}: {row.solver}: holds a result of {source.frames.place}; restore it")
        folder = listing.with_suffix("") / row.detections / f"{row.solver}-{row.key}"
        found.append(_stored(listing, folder, row.solver, source, row.frames, row.established))
    return found


def _stored(
    path: Path, folder: Path, solver: str, source: RunProvenance, frames: pd.DataFrame, established: str = ""
) -> StoredResult:
    try:
        success_limit_km(source.frames.metric)
    except ResultsError as error:
        raise ResultsError(f"{path}: {error}") from error
    return StoredResult(
        folder=folder,
        solver=solver,
        label=solver,
        family=family_of(solver),
        title=source.solver.title,
        task=_task_facts(source.frames),
        split=source.frames.part,
        detections=source.detections,
        key=source.key,
        provenance=source,
        frames=frames,
        source=path,
        established=established,
    )


def _task_facts(frames: FrameFacts) -> TaskFacts:
    """Facts for the report; frames of a single condition count as ungraded, and the board finds how to show success."""
    name, _, revision = frames.label.rpartition("@")
    grading = frames.grading if frames.condition is None else None
    chosen = "" if frames.grading is None or frames.condition is None else _only(frames)
    return TaskFacts(
        name=name,
        revision=revision,
        title=frames.title + chosen,
        condition=grading.name if grading else "",
        unit=grading.unit if grading else "",
        harder=-1 if grading and grading.harder == "lower" else 1,
        metric=frames.metric,
        by=GRADED if grading else "",
    )


def _only(frames: FrameFacts) -> str:
    assert frames.grading is not None
    return f", {frames.grading.name} {frames.condition:.12g} {frames.grading.unit}".rstrip()


def whole_results(results: Sequence[StoredResult], tell: Tell = untold) -> list[StoredResult]:
    """Those results of a group that are not of a part of another's frames; `tell` is called with each of the others."""
    largest = max(results, key=lambda result: len(result.frames))
    whole = []
    for result in results:
        if result.is_part_of(largest):
            tell(result, largest)
        else:
            whole.append(result)
    return labelled(whole)


def labelled(results: Sequence[StoredResult]) -> list[StoredResult]:
    """Add the key to the labels of solvers that appear in several versions or configurations, and only to these."""
    count = Counter(result.solver for result in results)
    return [
        dataclasses.replace(result, label=result.solver + (f" {result.key[:6]}" if count[result.solver] > 1 else ""))
        for result in results
    ]
