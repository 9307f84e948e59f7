"""The whole report as the pages show it: boards, solvers, matrices of solvers by tasks, words."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from benchmark.report.site.boards import Board, Entry
from benchmark.report.site.charts import SHAPES, Style
from benchmark.report.site.columns import BOUND, MEDIAN, NEES, RISK, SUCCESS, TIME, WRONG, Column
from benchmark.report.site.commands import Places, commands_of
from benchmark.report.site.overall import OverallRow, overall_rows
from benchmark.report.site.task_groups import group_of, groups_among, place_of
from benchmark.report.site.tree import TaskFacts
from benchmark.report.site.words import joined, run_words, site_provenance, site_verdict

COLOURS = 8
_QUESTIONS = {
    "own": "Whole system: own detections",
    "shared": "Same detections for all: what identification and the fix make of them",
}
_MATRICES = (
    (
        "success",
        "success",
        "Share of all frames with a fix within the task's limit. Bars: intervals, 0 to 100 %.",
        SUCCESS,
    ),
    (
        "bound",
        "error / bound",
        "Median over the identified fixes of the error over the frame's Cramér-Rao bound.",
        BOUND,
    ),
    (
        "nees",
        "honesty: NEES",
        "Mean over the identified fixes of the squared error in units of the covariance claimed; honest: 2, too bold: more.",
        NEES,
    ),
    (
        "wrong",
        "honesty: wrong and confident",
        "Share of all frames with a fix beyond the task's limit, whatever confidence or covariance it states.",
        WRONG,
    ),
    ("time", "median time, ms", "Detection and solving, refused frames included.", TIME),
    (
        "risk",
        "risk-coverage area",
        "Share of wrong answers among those kept, averaged over all shares kept from the most confident down.",
        RISK,
    ),
    (
        "break",
        "break point",
        "Value of each task's condition at which success falls to 50 %: the later it breaks, the more a solver bears.",
        None,
    ),
    ("median", "median error, km", "Over all frames, refused ones infinitely far off (∞).", MEDIAN),
)


@dataclass(frozen=True, eq=False)
class MatrixRow:
    """One solver in one mode of detection over all tasks; a cell is None where it was not run."""

    label: str
    family: str
    detections: str
    style: Style
    href: str
    cells: tuple[tuple[TaskFacts, Entry | None], ...]


@dataclass(frozen=True, eq=False)
class Matrix:
    """One number of all solvers on all tasks; `column` is None for the break point."""

    key: str
    title: str
    explained: str
    first: str
    column: Column | None
    rows: tuple[MatrixRow, ...]


@dataclass(frozen=True, eq=False)
class Overall:
    """The four numbers over all sets of frames, for the boards that answer one question.

    Attributes
    ----------
    key, title : str
        Key for ids, and title for readers.
    n_sets : int
        Number of sets of frames over which each row is a mean.
    rows : tuple of OverallRow
    by_group : mapping of str to mapping of str to OverallRow
        The same over the sets of one group of tasks, by group and solver; empty where there is only one group.
    """

    key: str
    title: str
    n_sets: int
    rows: tuple[OverallRow, ...]
    by_group: Mapping[str, Mapping[str, OverallRow]]

    @property
    def complete(self) -> tuple[OverallRow, ...]:
        """Solvers that answered all sets, which alone have the numbers."""
        return tuple(row for row in self.rows if len(row.entries) == self.n_sets)

    @property
    def partial(self) -> tuple[OverallRow, ...]:
        """Solvers that answered some of the sets."""
        return tuple(row for row in self.rows if len(row.entries) < self.n_sets)


@dataclass(frozen=True, eq=False)
class SolverView:
    """One solver over all boards."""

    name: str
    title: str
    family: str
    version: str
    detector: str
    file_name: str
    entries: tuple[tuple[Board, Entry], ...]
    reasons: tuple[tuple[str, int], ...]
    provenance: tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False)
class SiteView:
    """Content of the first page; `groups` are those of its tasks."""

    name: str
    boards: tuple[Board, ...]
    tasks: tuple[TaskFacts, ...]
    groups: tuple[str, ...]
    solvers: tuple[SolverView, ...]
    families: tuple[str, ...]
    modes: tuple[str, ...]
    overall: tuple[Overall, ...]
    matrices: tuple[Matrix, ...]
    n_answers: int
    verdict: str
    provenance: tuple[tuple[str, str], ...]
    commands: tuple[str, ...]


def solver_page(name: str) -> str:
    """File name of a solver's page; solver names are valid file names by `results.check_solver_name`."""
    return f"solver-{name}.html"


def make_styles(boards: Sequence[Board]) -> dict[str, Style]:
    """Assign each solver a colour and a shape for all figures: all colours with one shape, then with the next."""
    names = {(entry.stored.family, entry.stored.solver) for board in boards for entry in board.entries}
    return {
        name: Style(place % COLOURS, SHAPES[place // COLOURS % len(SHAPES)])
        for place, (_, name) in enumerate(sorted(names))
    }


def make_view(boards: Sequence[Board], styles: Mapping[str, Style], places: Places) -> SiteView:
    """Arrange the boards for the first page."""
    tasks = tasks_of(boards)
    solvers = _solvers(boards)
    return SiteView(
        name=site_name(boards),
        boards=tuple(sorted(boards, key=lambda board: place_of(board.task.name))),
        tasks=tasks,
        groups=groups_among(task.name for task in tasks),
        solvers=solvers,
        families=tuple(sorted({solver.family for solver in solvers})),
        modes=tuple(sorted({board.detections for board in boards})),
        overall=overall_of(boards),
        matrices=matrices_of(boards, tasks),
        n_answers=sum(board.n_frames * len(board.entries) for board in boards),
        verdict=site_verdict(boards),
        provenance=site_provenance(boards),
        commands=commands_of([(board, board.entries) for board in boards], places),
    )


def tasks_of(boards: Sequence[Board]) -> tuple[TaskFacts, ...]:
    """Facts about the boards' frames, without duplicates, group by group."""
    found = {board.task.key: board.task for board in boards}.values()
    return tuple(sorted(found, key=lambda task: place_of(task.name)))


def site_name(boards: Sequence[Board]) -> str:
    """Title of the pages: the name of a round, or else the leaderboard."""
    rounds = {
        board.task.title if board.entries[0].stored.provenance.frames.frozen is not None else "" for board in boards
    }
    return rounds.pop() if len(rounds) == 1 and "" not in rounds else "skybench leaderboard"


def overall_of(boards: Sequence[Board]) -> tuple[Overall, ...]:
    """The four numbers over all sets of frames, one table per mode of detection.

    Where boards of a mode are of several splits, those of the most common one count, which the title states: one submission
    to a test split would otherwise leave no solver with answers to all sets.
    """
    groups: defaultdict[str, list[Board]] = defaultdict(list)
    for board in boards:
        groups[board.detections].append(board)
    return tuple(_overall(mode, group) for mode, group in sorted(groups.items()))


def _overall(mode: str, boards: Sequence[Board]) -> Overall:
    title = _QUESTIONS.get(mode, f"{mode} detections")
    splits = Counter(board.split for board in boards).most_common()
    if len(splits) > 1:
        boards = [board for board in boards if board.split == splits[0][0]]
        title += f", split {splits[0][0]}"
    return Overall(mode, title, len(boards), overall_rows(boards), _overall_by_group(boards))


def _overall_by_group(boards: Sequence[Board]) -> dict[str, dict[str, OverallRow]]:
    names = groups_among(board.task.name for board in boards)
    return {
        name: {row.label: row for row in overall_rows([board for board in boards if group_of(board.task.name) == name])}
        for name in (names if len(names) > 1 else ())
    }


def _solvers(boards: Sequence[Board]) -> tuple[SolverView, ...]:
    found: defaultdict[str, list[tuple[Board, Entry]]] = defaultdict(list)
    for board in boards:
        for entry in board.entries:
            found[entry.stored.solver].append((board, entry))
    views = []
    for name, entries in sorted(found.items()):
        reasons: Counter[str] = Counter()
        for _, entry in entries:
            reasons.update(entry.reasons)
        first = entries[0][1].stored
        views.append(
            SolverView(
                name=name,
                title=first.title,
                family=first.family,
                version=joined(entry.stored.provenance.solver.version for _, entry in entries),
                detector=joined(entry.stored.provenance.solver.detector for _, entry in entries),
                file_name=solver_page(name),
                entries=tuple(entries),
                reasons=tuple(reasons.most_common()),
                provenance=tuple((f"{board.title}", run_words(entry)) for board, entry in entries),
            )
        )
    return tuple(views)


def matrices_of(boards: Sequence[Board], tasks: Sequence[TaskFacts]) -> tuple[Matrix, ...]:
    """The numbers of all solvers on all sets of frames."""
    styles = make_styles(boards)
    cells: defaultdict[tuple[str, str], dict[str, Entry]] = defaultdict(dict)
    for board in boards:
        for entry in board.entries:
            cells[(entry.label, board.detections)].setdefault(board.task.key, entry)

    def mean_success(of: Mapping[str, Entry]) -> float:
        return sum(entry.success.value for entry in of.values()) / len(tasks)

    rows = []
    for (label, mode), of in sorted(cells.items(), key=lambda item: (-mean_success(item[1]), item[0])):
        stored = next(iter(of.values())).stored
        rows.append(
            MatrixRow(
                label=label,
                family=stored.family,
                detections=mode,
                style=styles[stored.solver],
                href=solver_page(stored.solver),
                cells=tuple((task, of.get(task.key)) for task in tasks),
            )
        )
    return tuple(
        Matrix(key, title, explained, column.first if column else "descending", column, tuple(rows))
        for key, title, explained, column in _MATRICES
    )
