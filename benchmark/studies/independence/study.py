"""The independence study: render frames, run solvers on them, write tables and one page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import pandas as pd

from benchmark import provenance
from benchmark.errors import ResultsError
from benchmark.report.formatting import number, percent
from benchmark.report.marks import Mark
from benchmark.report.stale import INDEPENDENCE_STUDY, mark_of_today, revision_today
from benchmark.report.templates import render_page
from benchmark.run.engine import run
from benchmark.run.results import FRAMES_NAME
from benchmark.stats.frame_metrics import read_frames
from benchmark.stats.intervals import Estimate
from benchmark.studies.common.page_model import Cell, Number, Table, plain
from benchmark.studies.common.progress import StudyProgress
from benchmark.studies.independence.effects import Change, Effect, effects_of
from benchmark.studies.independence.frames import SEPARATOR, joined_sets, render_perturbed
from benchmark.studies.independence.perturbations import (
    PERTURBATIONS,
    UNPERTURBED,
    Perturbation,
    SuppliedSizes,
)
from generator.files import write_bytes
from generator.scenario.file import load_scenario

FORMAT = "skybench-study/1"
PAGE, NUMBERS = "index.html", "study.json"
FEWEST_FRAMES = 6
"""Fewer frames give no interval of a median."""


@dataclass(frozen=True)
class Study:
    """Content of the page.

    Attributes
    ----------
    n_frames : int
    perturbations : tuple of Perturbation
    effects : tuple of Effect
    command : str
    """

    n_frames: int
    perturbations: tuple[Perturbation, ...]
    effects: tuple[Effect, ...]
    command: str


def run_study(
    scenario_path: Path,
    n_frames: int,
    solvers: Sequence[str],
    work: Path,
    out: Path,
    command: str,
    progress: StudyProgress,
    perturbations: Sequence[Perturbation] = PERTURBATIONS,
) -> Study:
    """Run the study and write its results.

    Parameters
    ----------
    scenario_path : Path
        Sites, instants, attitudes and camera.
    n_frames : int
        Number of frames of each set.
    solvers : sequence of str
    work, out : Path
        Folders for frames and results; the content of `work` is reused.
    command : str
        Command to state on the page.
    progress : StudyProgress
    perturbations : sequence of Perturbation

    Raises
    ------
    BenchmarkError, GeneratorError
        The message says what to do about it.
    """
    if n_frames < FEWEST_FRAMES:
        raise ResultsError(f"{n_frames} frames give no interval of a median; take {FEWEST_FRAMES} or more")
    scenario = load_scenario(scenario_path)
    sets: dict[str, Path] = {}
    progress.begin("frames", n_frames * (1 + len(perturbations)))
    for perturbation in (None, *perturbations):
        key = UNPERTURBED if perturbation is None else perturbation.key
        sets[key] = work / (UNPERTURBED if perturbation is None else perturbation.frames_key)
        render_perturbed(scenario, perturbation, n_frames, sets[key], progress.advance)
    progress.begin("solvers", len(sets) * n_frames * len(solvers))
    told = {perturbation.key: perturbation.told for perturbation in perturbations}
    found = answers_by_set(sets, solvers, work / "results", progress, told)
    before = found.pop(UNPERTURBED)
    study = Study(n_frames, tuple(perturbations), effects_of(before, found), command)
    write_bytes(out / NUMBERS, (json.dumps(_numbers(study), indent=1, allow_nan=False) + "\n").encode())
    mark, sentence = mark_of_today(command, INDEPENDENCE_STUDY, out / NUMBERS)
    write_bytes(out / PAGE, page(study, mark, sentence).encode())
    return study


def answers_by_set(
    sets: Mapping[str, Path],
    solvers: Sequence[str],
    results: Path,
    progress: StudyProgress,
    told: Mapping[str, SuppliedSizes | None] = MappingProxyType({}),
) -> dict[str, Mapping[str, pd.DataFrame]]:
    """Run every solver once over all sets, see `joined_sets`; returns tables of frames by set and solver."""

    def advance(solver: str, n_frames: int) -> None:
        for _ in range(n_frames):
            progress.advance()

    runs = run(joined_sets(sets, told), list(solvers), results, progress=advance)
    tables: dict[str, dict[str, pd.DataFrame]] = {key: {} for key in sets}
    for one in runs:
        table = read_frames(one.folder / FRAMES_NAME)
        keys = table["frame_id"].str.split(SEPARATOR).str
        for key in sets:
            tables[key][one.solver] = table[keys[0] == key].assign(frame_id=keys[1])
    return dict(tables)


def effect_tables(study: Study, perturbation: Perturbation) -> tuple[Table, ...]:
    """Effect of a perturbation on each solver, sorted by success without it; covariances have a separate table."""
    effects = [effect for effect in study.effects if effect.perturbation == perturbation.key]
    effects.sort(key=lambda effect: (-effect.success.before.value, effect.solver))
    honest = [effect for effect in effects if effect.nees.before.n or effect.nees.after.n]
    tables = [
        Table(
            perturbation.title,
            f"{perturbation.source[0].upper()}{perturbation.source[1:]}.",
            ("solver", "success, before", "after", "difference, points", "error / bound, before", "after", "ratio of errors",
             "shown at 5 %"),
            tuple(
                (e.solver, *_cells(e.success, "percent"), *_cells(e.bound_ratio, "plain"), e.words) for e in effects
            ),
        ),
        Table(
            f"{perturbation.title}: covariances",
            "Solvers that return one.",
            ("solver", "NEES, before", "after", "difference", "95 % ellipse holds, before", "after", "difference, points"),
            tuple((e.solver, *_cells(e.nees, "plain"), *_cells(e.ellipse, "percent")) for e in honest),
        ),
    ]  # fmt: skip
    return tuple(table for table in tables if table.rows)


def _cells(change: Change, form: str) -> tuple[Cell, ...]:
    if form == "percent":
        return (*(_share(one) for one in (change.before, change.after)), _known(_in_points(change.change)))
    return tuple(_known(one) for one in (change.before, change.after, change.change))


def _share(estimate: Estimate) -> Cell:
    return "—" if math.isnan(estimate.value) else Number(estimate, "percent")


def _known(estimate: Estimate) -> Cell:
    return "—" if math.isnan(estimate.value) else Number(estimate)


def _in_points(share: Estimate) -> Estimate:
    return Estimate(100.0 * share.value, 100.0 * share.low, 100.0 * share.high, share.n)


def summary_lines(study: Study) -> tuple[str, ...]:
    """One line per perturbation: which effects are significant for which solvers."""
    lines = []
    for one in study.perturbations:
        shown = [effect for effect in study.effects if effect.perturbation == one.key and effect.words != "none shown"]
        words = "; ".join(f"{effect.solver}: {effect.words}" for effect in shown)
        lines.append(f"{one.title}: {words or 'no effect shown'}")
    return tuple(lines)


def _numbers(study: Study) -> dict[str, object]:
    return {
        "format": FORMAT,
        "command": study.command,
        "frames": study.n_frames,
        "perturbations": [{"key": one.key, "title": one.title, "source": one.source} for one in study.perturbations],
        "effects": [plain(effect) | {"shown": effect.words} for effect in study.effects],
        "revision": revision_today(INDEPENDENCE_STUDY),
        "versions": dict(provenance.versions()),
        "machine": plain(provenance.machine()),
        "date_utc": provenance.now_utc(),
    }


def page(study: Study, mark: Mark, sentence: str) -> str:
    """Render the page, with a mark of the sources of its numbers: one self-contained HTML file."""
    return render_page(
        "study_independence.html",
        study=study,
        tables=[table for one in study.perturbations for table in effect_tables(study, one)],
        overview=overview(study),
        told=any(one.told is not None for one in study.perturbations),
        machine=provenance.machine(),
        date=provenance.now_utc(),
        mark=mark,
        sentence=sentence,
    )


def overview(study: Study) -> Table:
    """Success and ratio of errors of each solver under each perturbation of which it receives no information."""
    silent = [one for one in study.perturbations if one.told is None]
    solvers = list(dict.fromkeys(effect.solver for effect in study.effects))
    by_key = {(effect.perturbation, effect.solver): effect for effect in study.effects}
    rows = []
    for solver in solvers:
        cells: list[Cell] = [solver]
        for one in silent:
            effect = by_key[(one.key, solver)]
            after, ratio = effect.success.after, effect.bound_ratio.change
            lines = (
                f"{percent(after.value)}; ×{number(ratio.value)}"
                if not math.isnan(ratio.value)
                else percent(after.value)
            )
            cells.append(lines)
        rows.append(tuple(cells))
    return Table("Success after, and ratio of errors", "Geometric mean over the frames with a fix before and after.",
                 ("solver", *(one.title for one in silent)), tuple(rows))  # fmt: skip
