"""Check whether printed numbers are of the revision stated next to them; used by `skybench bench stale`.

Every file of measured numbers has a mark (`benchmark.report.marks`), which is compared with today's code. Numbers of an older
revision may stay where the mark's sentence says so. Permitted names in a mark's ``of``:

* a solver that comes with skybench, or ``the shared detector``;
* ``rendering``, ``the gallery``, or one of the studies (``the study thesis``, ``the study calibration``,
  ``the study realism``, ``the study independence``), which stand for the modules that these import.

Patterns in ``rows`` match names of rows of the leaderboard, ``TASK@REVISION/SPLIT/DETECTIONS/SOLVER``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from benchmark.errors import ResultsError, UnknownSolverError
from benchmark.report.marks import (
    Mark,
    Printed,
    find_marks,
    older_digest,
    restamp,
    sentence_of,
    source_digest,
    stated_path,
)
from benchmark.run.freshness import State
from benchmark.solvers.registry import solver_folder
from benchmark.solvers.revision import REVISION_DIGITS, installed_packages
from generator.identity.behaviour import Entry, behaviour_of

CHECK_COMMAND = "skybench bench stale"
DETECTOR = "the shared detector"
RENDERING, GALLERY = "rendering", "the gallery"
THESIS_STUDY, CALIBRATION_STUDY = "the study thesis", "the study calibration"
REALISM_STUDY, INDEPENDENCE_STUDY = "the study realism", "the study independence"
_SUBJECTS = {
    RENDERING: ("generator.frame.render",),
    GALLERY: ("generator.gallery.make_gallery",),
    THESIS_STUDY: tuple(f"benchmark.studies.thesis.{name}" for name in ("rendered", "disturbed", "centroids")),
    CALIBRATION_STUDY: tuple(f"benchmark.studies.calibration.{name}" for name in ("run", "camera_by_gradient")),
    REALISM_STUDY: ("benchmark.studies.realism.pairs",),
    INDEPENDENCE_STUDY: tuple(
        f"benchmark.studies.independence.{name}" for name in ("frames", "perturbations", "effects")
    ),
}
"""The modules that measure, by what they measure."""
_MEASURED = (
    "docs/solver.md",
    "docs/performance.md",
    "docs/thesis.md",
    "docs/calibration.md",
    "docs/gallery/README.md",
    "docs/images/leaderboard.svg",
    "results/studies/*/index.html",
    "results/leaderboard/site/*.html",
)
"""Files that must have a mark."""
_SEARCHED = (
    "*.md",
    "docs/**/*.md",
    "docs/**/*.svg",
    "results/*.md",
    *(f"results/{folder}/**/*.{kind}" for folder in ("leaderboard", "studies") for kind in ("md", "html")),
)
"""Files whose marks are checked; other folders of results are a user's own, with rows outside the leaderboard."""

Rows = Mapping[str, State]


@dataclass(frozen=True)
class Problem:
    """A discrepancy: the file, what is wrong, and what to do about it."""

    path: str
    what: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.path}: {self.what}; {self.remedy}"


def check_marks(root: Path, rows: Rows) -> list[Problem]:
    """Check all marks under a folder.

    Parameters
    ----------
    root : Path
        Root of the repository.
    rows : mapping of str to State
        State of each row of the leaderboard relative to today's code.
    """
    problems = []
    for pattern in _MEASURED:
        found = sorted(root.glob(pattern))
        if not found and "*" not in pattern:
            problems.append(Problem(pattern, "is missing", "restore it"))
        for path in found:
            if "<!-- measured " not in path.read_text(encoding="utf-8"):
                remedy = "add a mark as benchmark/report/marks.py describes it"
                problems.append(Problem(_name(root, path), "has measured numbers and no mark", remedy))
    for path in sorted({path for pattern in _SEARCHED for path in root.glob(pattern)}):
        problems += _check_file(root, path, rows)
    return problems


def stamp_file(root: Path, path: Path, rows: Rows, measured: bool) -> int:
    """Update the marks of a file to what holds today.

    Parameters
    ----------
    root : Path
        Root of the repository.
    path : Path
    rows : mapping
        As for `check_marks`.
    measured : bool
        Whether the numbers have just been measured, so that their revisions and sources become today's. Otherwise revisions
        stay, and only the sentences are rewritten.

    Returns
    -------
    int
        Number of marks that changed.

    Raises
    ------
    ResultsError
        The file cannot be read, or a mark in it cannot be read, names something unknown, or has no sentence after it.
    """
    changed = 0
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ResultsError(
            f"{path}: cannot be read ({reason}); give a document with marks, such as docs/solver.md, by its path from the "
            "working folder"
        ) from error
    try:
        for printed in find_marks(text):
            mark = _as_measured(root, printed.mark, rows) if measured else printed.mark
            sentence = sentence_of(mark, _states(mark, rows))
            if (mark, sentence) != (printed.mark, printed.sentence):
                text = restamp(text, printed, mark, sentence)
                changed += 1
    except (ValueError, OSError) as error:
        raise ResultsError(f"{path}: {error}") from error
    if changed:
        path.write_text(text, encoding="utf-8")
    return changed


def mark_of_today(by: str, name: str, source: Path) -> tuple[Mark, str]:
    """Make the mark of numbers that were just measured and written to a file, with its path relative to the working folder.

    Returns
    -------
    tuple of (Mark, str)
        The mark, and the sentence to print next to it.
    """
    mark = Mark(by, {name: revision_today(name)}, {stated_path(source): source_digest(source)})
    return mark, sentence_of(mark, {name: State.TODAY})


@cache
def revision_today(name: str) -> str:
    """Today's revision of something that marks can name, other than rows.

    Raises
    ------
    ResultsError
        There is no such thing.
    """
    if name == DETECTOR:
        return installed_packages().detector_revision
    if name in _SUBJECTS:
        found = behaviour_of(installed_packages().sources, Entry([(module, "") for module in _SUBJECTS[name]]))
        return found.digest[:REVISION_DIGITS]
    try:
        return solver_folder(name).revision
    except UnknownSolverError as error:
        known = ", ".join((DETECTOR, *_SUBJECTS))
        raise ResultsError(f"a mark names {name!r}: neither a solver, nor {known}") from error


def _check_file(root: Path, path: Path, rows: Rows) -> list[Problem]:
    name = _name(root, path)
    try:
        found = find_marks(path.read_text(encoding="utf-8"))
        return [problem for printed in found for problem in _check_mark(root, name, printed, rows)]
    except (ValueError, ResultsError) as error:
        return [Problem(name, str(error), "correct the mark")]


def _check_mark(root: Path, name: str, printed: Printed, rows: Rows) -> list[Problem]:
    mark, where = printed.mark, f"line {printed.line_number}"
    problems = []
    for source, digest in mark.sources.items():
        if not (root / source).is_file() or source_digest(root / source) != digest:
            problems.append(Problem(name, f"{where}: was not made from {source} as it is", _again(mark)))
    if problems:
        return problems
    states = _states(mark, rows)
    wanted = sentence_of(mark, states)
    if printed.sentence == wanted and (not mark.rows or mark.older == older_digest(states)):
        return []
    if mark.rows:
        remedy = _again(mark)
    else:
        remedy = f"{_again(mark)} and `{CHECK_COMMAND} --measured {name}`, or let it say so: `{CHECK_COMMAND} --stamp {name}`"
    return [Problem(name, f"{where}: prints {printed.sentence!r}, but what holds today is {wanted!r}", remedy)]


def _again(mark: Mark) -> str:
    return f"make it again: `{mark.by}`"


def _states(mark: Mark, rows: Rows) -> dict[str, State]:
    if mark.rows:
        found = {name: state for name, state in rows.items() if any(fnmatchcase(name, each) for each in mark.rows)}
        if not found:
            raise ResultsError(f"no row of results/leaderboard matches {', '.join(mark.rows)}")
        return found

    def state(name: str, revision: str | None) -> State:
        if revision is None:
            return State.UNRECORDED
        return State.TODAY if revision_today(name) == revision else State.OLDER

    return {name: state(name, revision) for name, revision in mark.of.items()}


def _as_measured(root: Path, mark: Mark, rows: Rows) -> Mark:
    return replace(
        mark,
        of={name: revision_today(name) for name in mark.of},
        sources={source: source_digest(root / source) for source in mark.sources},
        older=older_digest(_states(mark, rows)) if mark.rows else "",
    )


def _name(root: Path, path: Path) -> str:
    return path.relative_to(root).as_posix()
