"""The replication of the thesis: run its experiments, answer its hypotheses, write tables, figures and one page."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from benchmark import provenance
from benchmark.errors import DatasetError
from benchmark.report.formatting import number
from benchmark.report.templates import render_page
from benchmark.run.results import write_atomically
from benchmark.studies.common.page_model import Answer, Table, plain
from benchmark.studies.common.progress import StudyProgress
from benchmark.studies.common.records import Rows, write_rows
from benchmark.studies.thesis import answers as answers
from benchmark.studies.thesis import answers_confidence as confidence
from benchmark.studies.thesis import answers_disturbed as disturbed_answers
from benchmark.studies.thesis import answers_position as position
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis import figures as figures
from benchmark.studies.thesis import published as thesis
from benchmark.studies.thesis import tables as tables
from benchmark.studies.thesis.centroids import DEPTHS_MAG, CentroidPart, sites_of, solve_centroids
from benchmark.studies.thesis.disturbed import MOST_FRAMES, SETTINGS, solve_disturbed
from benchmark.studies.thesis.rendered import PART, RenderedPart, render_scenario, solve_pictures, study_scenario

FORMAT = "skybench-study/1"
PAGE, NUMBERS, ROWS = "index.html", "study.json", "frames.parquet"
# Experiments with true names cost little, so that they can have more sites.
TRUE_NAMES_FACTOR = 5
SPEED_LIMITS_MS = {who.ADAPTIVE: 50.0, who.BASELINE_SI: 100.0}


@dataclass(frozen=True)
class Study:
    """What the page says.

    Attributes
    ----------
    rendered : RenderedPart
    centroids : CentroidPart
    rows : Rows
        Of both, and of disturbed pictures.
    tables : tuple of Table
    answers : tuple of Answer
        H1 to H11, and the one about the label.
    command : str
        That made it.
    minutes : float
        That it took.
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
        A dataset rendered before; rendered into `work` if None.
    work, out : Path
        Where frames and results go; disturbed pictures go to a folder beside `work`.
    n_sites : int
        Sites of the centroid frames.
    command : str
        For the page.
    progress : StudyProgress

    Raises
    ------
    GeneratorError, DatasetError
        With what to do about it.
    """
    start = time.monotonic()
    folder = dataset
    if folder is None:
        folder = work
        progress.begin("rendering", study_scenario(scenario_path, frames).frame_count)
        render_scenario(scenario_path, frames, folder, lambda frame: progress.advance())
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
    write_atomically(out / NUMBERS, (json.dumps(_numbers(study), indent=1, allow_nan=False) + "\n").encode())
    write_atomically(out / PAGE, page(study).encode())
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
        answers.h1(rows),
        answers.h2(rows),
        answers.h3(rows),
        position.h4(rows),
        position.h5(rows, centroids),
        answers.h6(rows),
        position.h7(centroids),
        confidence.h8(rows),
        position.h9(centroids),
        disturbed_answers.h10(rows),
        answers.h11(rows),
        label_answer(rows, rendered),
    )


def label_answer(rows: Rows, rendered: RenderedPart) -> Answer:
    """Whether the magnitude label says how deep a frame is."""
    deepest = max(rendered.depths, key=lambda d: d.label_mag)
    true_labels = [d for d in rendered.depths if abs(d.half_mag - d.label_mag) <= 0.25]
    best = max(DEPTHS_MAG, key=lambda depth: rows.of("centroids", who.LITERAL_BASELINE, (depth,)).recall().value)
    at_best = rows.of("centroids", who.LITERAL_BASELINE, (best,)).recall()
    beyond = rows.of("centroids", who.LITERAL_BASELINE, (max(DEPTHS_MAG),)).recall()
    return Answer(
        "Label",
        "A set labelled with a limiting magnitude is as deep as its label says.",
        "no" if len(true_labels) < len(rendered.depths) else "yes",
        (
            "Here the label cuts the list of stars. Up to label "
            f"{number(max((d.label_mag for d in true_labels), default=math.nan))} at least half of its faintest stars are "
            f"detected; the sets above are all alike, since the camera sees to {number(deepest.half_mag)} "
            f"({deepest.detections:.0f} detections a frame at label {deepest.label_mag:g}).",
            "The thesis' label must mean something else. Its baseline with a catalogue to 4.0 is best at label "
            "8.0 and dead "
            f"at 6.5. To the letter, a baseline is best on frames that end at magnitude {best:g} "
            f"({answers.share(at_best)}) and at {max(DEPTHS_MAG):g} reaches {answers.share(beyond)}: a frame "
            "much deeper or "
            "shallower than the catalogue defeats it. We infer that the blobs in the thesis' frames ended near "
            "magnitude 4 at "
            "label 8 and at brighter stars below it; its Bortle axis is then one of the renderer's settings, "
            "not of skies.",
        ),
    )


def speed_sentence(rows: Rows) -> str:
    """Whether the speed asked for is reached, on this machine."""
    parts = []
    for name, limit in SPEED_LIMITS_MS.items():
        found = rows.of(PART, name).median_solve_ms()
        word = "within" if found.value <= limit else "above"
        parts.append(f"{name} takes {found.value:.0f} ms in the median, {word} the {limit:g} ms aimed at")
    return "; ".join(parts) + "."


def headline(study: Study) -> list[str]:
    """The page's first sentences, from the numbers."""
    rows = study.rows
    recall = rows.of(PART, who.ADAPTIVE, (thesis.TABLE_LABEL_MAG,)).recall()
    baseline = rows.of(PART, who.BASELINE, (thesis.TABLE_LABEL_MAG,)).recall()
    literal = rows.of(PART, who.LITERAL_ADAPTIVE, (thesis.TABLE_LABEL_MAG,)).recall()
    published = thesis.TABLE_1_1[-1].recall / 100
    where = "above" if recall.low > published else "below" if recall.high < published else "not distinguishable from"
    return [
        "At magnitude 7, with the projection right, our reading of the adaptive algorithm fixes "
        f"{answers.share(recall)} within "
        f"10 km, {where} the thesis' 71.5 %; the baseline {answers.share(baseline)} (thesis 39.0 %). Taken to "
        "the letter, "
        f"without brightnesses and without confirmation, the adaptive algorithm fixes {answers.share(literal)} "
        "of the same frames.",
        speed_sentence(rows),
    ]


def _numbers(study: Study) -> dict[str, object]:
    dataset = study.rendered.dataset
    return {
        "format": FORMAT,
        "command": study.command,
        "minutes": round(study.minutes, 1),
        "scenario": {"name": dataset.scenario_name, "sha256": dataset.scenario_sha256, "frames": len(dataset.frames)},
        "truth_sha256": dataset.truth_sha256,
        "centroid_sites": study.centroids.n_sites,
        "versions": dict(provenance.versions()),
        "machine": plain(provenance.machine()),
        "date_utc": provenance.now_utc(),
        "tables": [plain(table) for table in study.tables],
        "answers": [plain(answer) for answer in study.answers],
    }


def page(study: Study) -> str:
    """Render the page: one HTML file that needs nothing beside it."""
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
    return render_page(
        "study_thesis.html",
        study=study,
        headline=headline(study),
        figures=[(title, note, Markup(svg)) for title, note, svg in drawn],
        n_frames=len(study.rendered.dataset.frames),
        machine=provenance.machine(),
        date=provenance.now_utc(),
        minutes=f"{study.minutes:.1f}",
    )
