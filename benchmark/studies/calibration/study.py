"""The calibration study: run its experiments, write tables, figures and one page."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import pyarrow as pa
from markupsafe import Markup

from benchmark import provenance
from benchmark.report.marks import Mark
from benchmark.report.stale import CALIBRATION_STUDY, mark_of_today, revision_today
from benchmark.report.templates import render_page
from benchmark.studies.calibration import figures as figures
from benchmark.studies.calibration import run as run
from benchmark.studies.calibration import summary as summary
from benchmark.studies.calibration.camera_by_gradient import Recovery, as_table, gradient_scenario, recover_all
from benchmark.studies.calibration.chosen import Subject, check_gradient, check_sizes, notes_of, subject_of
from benchmark.studies.calibration.faults import MOST_STARS, NOISE_PX, WHOLE_SKY, check_stars, chosen_faults
from benchmark.studies.calibration.gradient_summary import PARAMETERS, gradient_finding, gradient_table
from benchmark.studies.calibration.summary import Shifts
from benchmark.studies.common.centroid_frames import list_stars
from benchmark.studies.common.page_model import Table, plain
from benchmark.studies.common.progress import StudyProgress
from benchmark.studies.common.records import write_rows, write_table
from generator.files import write_bytes
from generator.scenario.file import load_scenario

FORMAT = "skybench-study/1"
PAGE, NUMBERS, SHIFTS, GRADIENT = "index.html", "study.json", "shifts.parquet", "gradient.parquet"
UNITS = dict.fromkeys(
    ("east_km", "north_km", "predicted_east_km", "predicted_north_km", "error_km", "faultless_error_km"), "km"
)


@dataclass(frozen=True)
class Sizes:
    """Extent of each experiment.

    Attributes
    ----------
    sites : int
        Number of sites for the frames without pictures.
    pictures : int
        Number of rendered frames of each kind.
    gradient : int
        Number of frames whose camera is recovered by gradient; 0 skips this part.
    """

    sites: int = 40
    pictures: int = 12
    gradient: int = 10


@dataclass(frozen=True)
class Study:
    """Content of the page."""

    subject: Subject
    sizes: Sizes
    shifts: Shifts
    recovered: tuple[Recovery, ...]
    tables: tuple[Table, ...]
    command: str
    minutes: float


def run_study(
    scenario_path: Path,
    sizes: Sizes,
    work: Path,
    out: Path,
    command: str,
    progress: StudyProgress,
    fault_sizes: Mapping[str, tuple[float, ...]] = MappingProxyType({}),
) -> Study:
    """Run the study and write its results.

    Parameters
    ----------
    scenario_path : Path
        Sites, instants, attitude and camera.
    sizes : Sizes
    work, out : Path
        Folders for frames and results.
    command : str
        Command to state on the page.
    progress : StudyProgress
    fault_sizes : mapping of str to tuple of float
        Sizes of faults that replace the usual ones, as `chosen.read_sizes` returns them.

    Raises
    ------
    BenchmarkError
        The study does not support the scenario; nothing has been done yet.
    GeneratorError
        The message says what to do about it.
    """
    start = time.monotonic()
    scenario = load_scenario(scenario_path)
    subject = subject_of(scenario)
    check_sizes(subject, fault_sizes)
    if sizes.gradient:
        check_gradient(scenario, subject)
    faults = chosen_faults(subject, fault_sizes)
    sites = run.changed_scenario(scenario, "centroids", sizes.sites, camera=WHOLE_SKY)
    progress.begin("faults on centroids", sizes.sites)
    lists = [list_stars(sites, index) for index in range(sizes.sites)]
    check_stars(scenario, subject.camera, lists)
    rows = run.solve_centroids(lists, subject.camera, faults, progress.advance)
    progress.begin("faults on pictures", 2 * sizes.pictures)
    rows += run.solve_pictures(scenario, subject.camera, faults, sizes.pictures, work, progress.advance)
    recovered: tuple[Recovery, ...] = ()
    if sizes.gradient:
        progress.begin("camera by gradient", sizes.gradient)
        recovered = recover_all(
            gradient_scenario(scenario, subject.camera, sizes.gradient), sizes.gradient, progress.advance
        )
    shifts = Shifts(tuple(rows), faults)
    tables = (
        summary.summary_table(shifts),
        summary.picture_table(shifts, subject.text),
        *((gradient_table(recovered),) if recovered else ()),
        *summary.size_tables(shifts),
    )
    study = Study(subject, sizes, shifts, recovered, tables, command, (time.monotonic() - start) / 60)
    write_rows(out / SHIFTS, rows, UNITS)
    if recovered:
        write_table(out / GRADIENT, pa.table(as_table(recovered)))
    else:
        (out / GRADIENT).unlink(missing_ok=True)
    write_bytes(out / NUMBERS, (json.dumps(_numbers(study), indent=1, allow_nan=False) + "\n").encode())
    mark, sentence = mark_of_today(command, CALIBRATION_STUDY, out / NUMBERS)
    write_bytes(out / PAGE, page(study, mark, sentence).encode())
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
        "camera": study.subject.text,
        "gradient": plain(gradient_finding(study.recovered)) if study.recovered else None,
        "tables": [plain(table) for table in study.tables],
    }


def page(study: Study, mark: Mark, sentence: str) -> str:
    """Render the page, with a mark of the sources of its numbers: one self-contained HTML file."""
    recovered = study.recovered
    n_faults = len(study.shifts.faults)
    return render_page(
        "study_calibration.html",
        subject=study.subject,
        most_stars=MOST_STARS,
        noise_px=NOISE_PX,
        thesis_field_deg=run.THESIS_FIELD_DEG,
        thesis_edge_px=run.thesis_edge_px(study.subject.camera),
        faults=summary.fault_findings(study.shifts),
        Effect=summary.Effect,
        thesis_case=summary.thesis_case(study.shifts),
        gradient=gradient_finding(recovered) if recovered else None,
        shift_table=study.tables[0],
        picture_table=study.tables[1],
        gradient_table=study.tables[2] if recovered else None,
        size_tables=study.tables[-n_faults:],
        notes=notes_of(study.subject, study.shifts.faults),
        fault_figures=[(fault, Markup(figures.figure_fault(study.shifts, fault))) for fault in study.shifts.faults],
        errors_figure=Markup(figures.figure_errors(recovered, PARAMETERS)) if recovered else None,
        paths_figure=Markup(figures.figure_paths(recovered)) if recovered else None,
        sizes=study.sizes,
        command=study.command,
        machine=provenance.machine(),
        date=provenance.now_utc(),
        minutes=f"{study.minutes:.1f}",
        mark=mark,
        sentence=sentence,
    )
