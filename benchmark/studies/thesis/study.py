"""The replication of the thesis: run its experiments, answer its hypotheses, write tables, figures and one page."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

import jinja2
from markupsafe import Markup

from benchmark import provenance
from benchmark.errors import DatasetError
from benchmark.report.formatting import interval, number, percent
from benchmark.report.marks import Mark
from benchmark.report.stale import THESIS_STUDY, mark_of_today, revision_today
from benchmark.report.templates import environment
from benchmark.stats.intervals import Estimate
from benchmark.studies.common.page_model import Answer, Outcome, Table, p_text, plain
from benchmark.studies.common.progress import StudyProgress
from benchmark.studies.common.records import Rows, write_rows
from benchmark.studies.thesis import answers_identification as identification
from benchmark.studies.thesis import answers_position as position
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis import figures as figures
from benchmark.studies.thesis import published as thesis
from benchmark.studies.thesis import tables as tables
from benchmark.studies.thesis.answers_confidence import h8
from benchmark.studies.thesis.answers_disturbed import h10
from benchmark.studies.thesis.answers_history import h2
from benchmark.studies.thesis.answers_label import label_answer
from benchmark.studies.thesis.answers_projection import h5
from benchmark.studies.thesis.answers_time import Speed, h11, speeds
from benchmark.studies.thesis.centroids import DEPTHS_MAG, CentroidPart, sites_of, solve_centroids
from benchmark.studies.thesis.disturbed import MOST_FRAMES, SETTINGS, solve_disturbed
from benchmark.studies.thesis.rendered import PART, RenderedPart, render_scenario, solve_pictures, study_scenario
from generator.files import write_bytes

FORMAT = "skybench-study/1"
PAGE, NUMBERS, ROWS = "index.html", "study.json", "frames.parquet"
# Experiments with true names are cheap, so they can use more sites.
TRUE_NAMES_FACTOR = 5


@dataclass(frozen=True)
class Headline:
    """First numbers of the page: recalls at magnitude 7, in our reading and in the literal one, next to the thesis' own.

    Attributes
    ----------
    adaptive, baseline, literal : Estimate
        The last is the adaptive variant in its literal reading.
    thesis_adaptive, thesis_baseline : float
    against_thesis : Outcome
        Our adaptive variant compared with the thesis'.
    speeds : tuple of Speed
    """

    adaptive: Estimate
    baseline: Estimate
    literal: Estimate
    thesis_adaptive: float
    thesis_baseline: float
    against_thesis: Outcome
    speeds: tuple[Speed, ...]


@dataclass(frozen=True)
class Study:
    """Content of the page.

    Attributes
    ----------
    rendered : RenderedPart
    centroids : CentroidPart
    rows : Rows
        Rows of both, and of disturbed pictures.
    tables : tuple of Table
    answers : tuple of Answer
        H1 to H11, and the answer about the label.
    command : str
        Command that ran the study.
    minutes : float
        Duration of the study.
    """

    rendered: RenderedPart
    centroids: CentroidPart
    rows: Rows
    tables: tuple[Table, ...]
    answers: tuple[Answer, ...]
    command: str
    minutes: float


def run_study(
    scenario_path: Path,
    frames: int | None,
    dataset: Path | None,
    work: Path,
    out: Path,
    n_sites: int,
    command: str,
    progress: StudyProgress,
) -> Study:
    """Run the replication and write its results.

    Parameters
    ----------
    scenario_path : Path
        The thesis' sets as a scenario.
    frames : int or None
        Frames per label; the scenario's own number if None.
    dataset : Path or None
        A dataset rendered before; with None it is rendered into `work`.
    work, out : Path
        Folders for frames and results; disturbed pictures go to a folder next to `work`.
    n_sites : int
        Number of sites of the centroid frames.
    command : str
        Command to state on the page.
    progress : StudyProgress

    Raises
    ------
    GeneratorError, DatasetError
        The message says what to do about it.
    """
    start = time.monotonic()
    folder = dataset
    if folder is None:
        folder = work
        progress.begin("rendering", study_scenario(scenario_path, frames).frame_count)
        render_scenario(scenario_path, frames, folder, progress.advance)
    progress.begin("solving pictures", len(list(folder.glob("frame-*.json"))))
    rendered = solve_pictures(folder, progress.advance)
    scenario = study_scenario(scenario_path, frames)
    n_disturbed = min(scenario.repeats, MOST_FRAMES)
    progress.begin("disturbed pictures", n_disturbed * len(SETTINGS))
    disturbed = solve_disturbed(scenario, n_disturbed, work.with_name(f"{work.name}-disturbed"), progress.advance)
    progress.begin("solving centroids", 0)
    centroids = solve_centroids(sites_of(study_scenario(scenario_path, None), TRUE_NAMES_FACTOR * n_sites), n_sites)
    rows = Rows((*rendered.rows, *disturbed, *centroids.rows))
    if len(rows.of(PART, who.BASELINE, (thesis.TABLE_LABEL_MAG,))) == 0:
        raise DatasetError(f"{folder}: has no frames of limiting magnitude 7, which Table 1.1 is about")
    study = Study(
        rendered,
        centroids,
        rows,
        _tables(rows, rendered),
        _answers(rows, rendered, centroids),
        command,
        (time.monotonic() - start) / 60,
    )
    write_rows(out / ROWS, rows.rows)
    write_bytes(out / NUMBERS, (json.dumps(_numbers(study), indent=1, allow_nan=False) + "\n").encode())
    mark, sentence = mark_of_today(command, THESIS_STUDY, out / NUMBERS)
    write_bytes(out / PAGE, page(study, mark, sentence).encode())
    return study


def _tables(rows: Rows, rendered: RenderedPart) -> tuple[Table, ...]:
    return (
        tables.table_1_1(rows, DEPTHS_MAG),
        tables.table_labels(rows, rendered.depths),
        tables.table_depths(rows, DEPTHS_MAG),
        tables.table_1_2(rows),
        tables.table_speed(rows),
    )


def _answers(rows: Rows, rendered: RenderedPart, centroids: CentroidPart) -> tuple[Answer, ...]:
    return (
        identification.h1(rows),
        h2(rows),
        identification.h3(rows),
        position.h4(rows),
        h5(rows, centroids),
        identification.h6(rows),
        position.h7(centroids),
        h8(rows),
        position.h9(centroids),
        h10(rows),
        h11(rows),
        label_answer(rows, rendered.depths),
    )


def headline(rows: Rows) -> Headline:
    """Gather the numbers of the page's first sentences."""
    at_seven = {
        name: rows.of(PART, name, (thesis.TABLE_LABEL_MAG,)).recall()
        for name in (who.ADAPTIVE, who.BASELINE, who.LITERAL_ADAPTIVE)
    }
    recall = at_seven[who.ADAPTIVE]
    published, published_baseline = (thesis.TABLE_1_1[place].recall / 100 for place in (-1, 0))
    above, below = recall.low > published, recall.high < published
    return Headline(
        recall,
        at_seven[who.BASELINE],
        at_seven[who.LITERAL_ADAPTIVE],
        published,
        published_baseline,
        Outcome.BETTER if above else Outcome.WORSE if below else Outcome.NO_DIFFERENCE,
        speeds(rows),
    )


def _numbers(study: Study) -> dict[str, object]:
    dataset = study.rendered.dataset
    return {
        "format": FORMAT,
        "command": study.command,
        "minutes": round(study.minutes, 1),
        "scenario": {"name": dataset.scenario_name, "sha256": dataset.scenario_sha256, "frames": len(dataset.frames)},
        "truth_sha256": dataset.truth_sha256,
        "centroid_sites": study.centroids.n_sites,
        "revision": revision_today(THESIS_STUDY),
        "versions": dict(provenance.versions()),
        "machine": plain(provenance.machine()),
        "date_utc": provenance.now_utc(),
        "tables": [plain(table) for table in study.tables],
        "answers": [plain(answer) for answer in study.answers],
    }


def words() -> jinja2.Environment:
    """Templates of the page and of its answers, with the functions that format numbers and the thesis' own numbers."""
    return environment(thesis=thesis, number=number, percent=percent, interval=interval, p_text=p_text)


def page(study: Study, mark: Mark, sentence: str) -> str:
    """Render the page, with a mark of the sources of its numbers: one self-contained HTML file."""
    drawn = (
        (
            "Figure 5: recall by class",
            "Rendered frames; the thesis' points hollow, dashed. Bars: 95 % intervals (Wilson).",
            figures.figure_5(study.rows),
        ),
        (
            "The same against the depth of the frame",
            "Centroid frames with 0.3 px of noise that end at a magnitude. The literal baseline lives only "
            "where the frame is as "
            "deep as its catalogue, much as the thesis' baseline does over its labels.",
            figures.figure_depth(study.rows, DEPTHS_MAG),
        ),
        (
            "Figure 6: time by class",
            "Rendered frames, median time of solving with 95 % intervals. The thesis gives no numbers for its "
            "figure; in the text "
            "the adaptive variant is slower under dark skies and as fast as the baseline, or faster, under "
            "bright ones.",
            figures.figure_6(study.rows),
        ),
        (
            "What the projection mix-up does to one star",
            "Centroid frames; the most central star above magnitude 3 or 4, its name known. Hollow dots have 0.3 px of noise "
            "and the right projection. Points far above are the second latitude that one star allows, or a small det J.",
            figures.figure_swap(study.centroids),
        ),
    )
    return (
        words()
        .get_template("study_thesis.html")
        .render(
            study=study,
            headline=headline(study.rows),
            figures=[(title, note, Markup(svg)) for title, note, svg in drawn],
            n_frames=len(study.rendered.dataset.frames),
            machine=provenance.machine(),
            date=provenance.now_utc(),
            minutes=f"{study.minutes:.1f}",
            mark=mark,
            sentence=sentence,
        )
    )
