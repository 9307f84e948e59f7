"""The calibration study: run its experiments, write tables, figures and one page."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
from markupsafe import Markup

from benchmark import provenance
from benchmark.report.marks import Mark
from benchmark.report.stale import CALIBRATION_STUDY, mark_of_today, revision_today
from benchmark.report.templates import render_page
from benchmark.run.results import write_atomically
from benchmark.studies.calibration import figures as figures
from benchmark.studies.calibration import run as run
from benchmark.studies.calibration import summary as summary
from benchmark.studies.calibration.camera_by_gradient import Recovery, as_table, recover_all
from benchmark.studies.calibration.faults import FAULTS
from benchmark.studies.calibration.gradient_summary import PARAMETERS, gradient_finding, gradient_table
from benchmark.studies.calibration.summary import Shifts
from benchmark.studies.common.centroid_frames import list_stars
from benchmark.studies.common.page_model import Table, plain
from benchmark.studies.common.progress import StudyProgress
from benchmark.studies.common.records import write_rows, write_table
from generator.scenario.file import load_scenario

FORMAT = "skybench-study/1"
PAGE, NUMBERS, SHIFTS, GRADIENT = "index.html", "study.json", "shifts.parquet", "gradient.parquet"
GRADIENT_CAMERA = {
    "model": "brown_conrady", "width": 1080, "height": 720, "f_px": 700.0, "k": [-0.1], "aperture_mm": 4,
}  # fmt: skip
UNITS = dict.fromkeys(
    ("east_km", "north_km", "predicted_east_km", "predicted_north_km", "error_km", "faultless_error_km"), "km"
)


@dataclass(frozen=True)
class Sizes:
    """How much of each experiment.

    Attributes
    ----------
    sites : int
        Of the frames without pictures.
    pictures : int
        Rendered frames of each kind.
    gradient : int
        Frames whose camera is recovered by gradient.
    """

    sites: int = 40
    pictures: int = 12
    gradient: int = 10


@dataclass(frozen=True)
class Study:
    """Everything that the page shows."""

    sizes: Sizes
    shifts: Shifts
    recovered: tuple[Recovery, ...]
    tables: tuple[Table, ...]
    command: str
    minutes: float


def run_study(scenario_path: Path, sizes: Sizes, work: Path, out: Path, command: str, progress: StudyProgress) -> Study:
    """Run the study and write its results.

    Parameters
    ----------
    scenario_path : Path
        Sites, instants and camera.
    sizes : Sizes
    work, out : Path
        Where frames and results go.
    command : str
        For the page.
    progress : StudyProgress

    Raises
    ------
    GeneratorError
        With what to do about it.
    """
    start = time.monotonic()
    scenario = load_scenario(scenario_path)
    progress.begin("faults on centroids", sizes.sites)
    sites = run.changed_scenario(scenario, "centroids", sizes.sites)
    rows = run.solve_centroids([list_stars(sites, index) for index in range(sizes.sites)], progress.advance)
    progress.begin("faults on pictures", 2 * sizes.pictures)
    rows += run.solve_pictures(scenario, sizes.pictures, work, progress.advance)
    progress.begin("camera by gradient", sizes.gradient)
    with_k1 = run.changed_scenario(scenario, "gradient", sizes.gradient, camera=GRADIENT_CAMERA)
    recovered = recover_all(with_k1, sizes.gradient, progress.advance)
    shifts = Shifts(tuple(rows))
    tables = (
        summary.summary_table(shifts),
        summary.picture_table(shifts),
        gradient_table(recovered),
        *summary.size_tables(shifts),
    )
    study = Study(sizes, shifts, recovered, tables, command, (time.monotonic() - start) / 60)
    write_rows(out / SHIFTS, rows, UNITS)
    write_table(out / GRADIENT, pa.table(as_table(recovered)))
    write_atomically(out / NUMBERS, (json.dumps(_numbers(study), indent=1, allow_nan=False) + "\n").encode())
    mark, sentence = mark_of_today(command, CALIBRATION_STUDY, out / NUMBERS)
    write_atomically(out / PAGE, page(study, mark, sentence).encode())
    return study


def _numbers(study: Study) -> dict[str, object]:
    return {
        "format": FORMAT,
        "command": study.command,
        "minutes": round(study.minutes, 1),
        "sites": study.sizes.sites,
        "pictures": study.sizes.pictures,
        "revision": revision_today(CALIBRATION_STUDY),
        "versions": dict(provenance.versions()),
        "machine": plain(provenance.machine()),
        "date_utc": provenance.now_utc(),
        "faults": plain(summary.fault_findings(study.shifts)),
        "thesis_case": plain(summary.thesis_case(study.shifts)),
        "gradient": plain(gradient_finding(study.recovered)),
        "tables": [plain(table) for table in study.tables],
    }


def page(study: Study, mark: Mark, sentence: str) -> str:
    """Render the page, with a mark of what its numbers were taken from: one HTML file that needs nothing beside it."""
    return render_page(
        "study_calibration.html",
        faults=summary.fault_findings(study.shifts),
        Effect=summary.Effect,
        thesis_case=summary.thesis_case(study.shifts),
        gradient=gradient_finding(study.recovered),
        tables=study.tables,
        fault_figures=[(fault, Markup(figures.figure_fault(study.shifts, fault))) for fault in FAULTS],
        errors_figure=Markup(figures.figure_errors(study.recovered, PARAMETERS)),
        paths_figure=Markup(figures.figure_paths(study.recovered)),
        sizes=study.sizes,
        command=study.command,
        machine=provenance.machine(),
        date=provenance.now_utc(),
        minutes=f"{study.minutes:.1f}",
        mark=mark,
        sentence=sentence,
    )
