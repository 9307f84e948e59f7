"""The calibration study: run its experiments, write tables, figures and one page."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from markupsafe import Markup
from scipy import stats

from benchmark import provenance
from benchmark.report.formatting import number
from benchmark.report.templates import render_page
from benchmark.run.results import write_atomically
from benchmark.studies.calibration import figures as figures
from benchmark.studies.calibration import run as run
from benchmark.studies.calibration import summary as summary
from benchmark.studies.calibration.camera_by_gradient import Recovery, as_table, recover_all
from benchmark.studies.calibration.faults import FAULTS
from benchmark.studies.calibration.summary import Shifts
from benchmark.studies.common.centroid_frames import list_stars
from benchmark.studies.common.page_model import Table, plain
from benchmark.studies.common.progress import StudyProgress
from benchmark.studies.common.records import write_rows
from generator.scenario.file import load_scenario

FORMAT = "skybench-study/1"
PAGE, NUMBERS, SHIFTS, GRADIENT = "index.html", "study.json", "shifts.parquet", "gradient.parquet"
GRADIENT_CAMERA = {
    "model": "brown_conrady", "width": 1080, "height": 720, "f_px": 700.0, "k": [-0.1], "aperture_mm": 4,
}  # fmt: skip
PARAMETERS = ("log f", "k1", "turn x", "turn y", "turn z")
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
    """What the page says."""

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
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(as_table(recovered)), sink, compression="zstd")
    write_atomically(out / GRADIENT, sink.getvalue().to_pybytes())
    write_atomically(out / NUMBERS, (json.dumps(_numbers(study), indent=1, allow_nan=False) + "\n").encode())
    write_atomically(out / PAGE, page(study).encode())
    return study


def rms_over_bound(recovered: Sequence[Recovery]) -> list[float]:
    """Root mean square of each parameter's error over the bound's standard deviation."""
    errors = np.array([one.error / one.sigma for one in recovered])
    return [float(value) for value in np.sqrt(np.mean(errors**2, axis=0))]


def nees_interval(n_frames: int) -> tuple[float, float]:
    """Where 95 % of the summed squared errors lie if the bound is reached: chi^2 with five degrees a frame."""
    degrees = len(PARAMETERS) * n_frames
    return float(stats.chi2.ppf(0.025, degrees)), float(stats.chi2.ppf(0.975, degrees))


def gradient_table(recovered: Sequence[Recovery]) -> Table:
    """Errors of the recovered cameras beside their bound."""
    scale = np.array([1e6, 1e6, *[math.degrees(1) * 3600] * 3])
    units = ("millionths", "millionths", "arcsec", "arcsec", "arcsec")
    start, error, bound = (
        np.sqrt(np.mean([getattr(one, kind) ** 2 for one in recovered], axis=0)) * scale
        for kind in ("start", "error", "sigma")
    )
    ratios = rms_over_bound(recovered)
    body = tuple(
        (name, unit, number(a), number(b), number(c), f"{ratio:.2f}")
        for name, unit, a, b, c, ratio in zip(PARAMETERS, units, start, error, bound, ratios, strict=True)
    )
    n = len(recovered)
    low, high = (math.sqrt(float(stats.chi2.ppf(q, n)) / n) for q in (0.025, 0.975))
    return Table(
        "Recovered by gradient",
        f"{len(recovered)} rendered frames, each by itself; root mean squares",
        ("parameter", "unit", "told camera off by", "recovered off by", "Cramér-Rao bound", "error over bound"),
        body,
        f"At the bound, the last column lies between {low:.2f} and {high:.2f} for 95 % of such sets.",
    )


def gradient_sentences(recovered: Sequence[Recovery]) -> tuple[str, ...]:
    """What the recovery found, in sentences."""
    total = sum(one.nees for one in recovered)
    low, high = nees_interval(len(recovered))
    worst = max(rms_over_bound(recovered))
    inside = "inside" if low <= total <= high else "outside"
    return (
        "The stars of a picture are rendered again through a camera that is wrong in focal length, distortion and attitude, "
        "by the renderer's own projection with derivatives (Dr.Jit, forward mode), and the camera follows them: Fisher "
        "scoring on the pixels, at first through a wide Gaussian.",
        f"The largest root mean square error over the bound is {worst:.2f}. The squared errors in the bound's metric add up "
        f"to {total:.1f}; of {len(recovered)} frames at the bound, 95 % lie between {low:.1f} and {high:.1f}: it is "
        f"{inside}. "
        f"It took {number(float(np.mean([one.steps for one in recovered])))} steps a frame.",
        "Names and light of the stars, the sky behind them and the noise are known, to the recovery and to the bound alike: "
        "it says what pictures hold about a camera, not what a calibration in the field reaches.",
    )


def headline(study: Study) -> tuple[str, ...]:
    """The study in a few sentences."""
    case = {
        name: study.shifts.of(run.PICTURES, run.THESIS_CASE, name)
        for name in (run.BELIEVED, run.CALIBRATED, run.THESIS)
    }
    fixed = ", ".join(
        f"{name} {sum(math.isfinite(row.error_km) for row in found.rows)}" for name, found in case.items()
    )
    near = max(sum(row.error_km < 10 for row in found.rows) for found in case.values())
    return (
        *summary.sentences(study.shifts),
        f"The thesis' own case, a stereographic picture told to be a pinhole's: of {study.sizes.pictures} pictures a "
        f"position is given for {fixed}; at most {near} of them within 10 km. No prediction of first order holds there: "
        "at the edge the stars are hundreds of pixels from where the pinhole has them.",
        f"By differentiating the renderer's star pass, the camera is found to "
        f"{max(rms_over_bound(study.recovered)):.2f} times its Cramér-Rao bound or better "
        f"on {study.sizes.gradient} pictures.",
    )


def _numbers(study: Study) -> dict[str, object]:
    low, high = nees_interval(study.sizes.gradient)
    return {
        "format": FORMAT,
        "command": study.command,
        "minutes": round(study.minutes, 1),
        "sites": study.sizes.sites,
        "pictures": study.sizes.pictures,
        "gradient": {
            "frames": study.sizes.gradient,
            "rms_over_bound": dict(zip(PARAMETERS, rms_over_bound(study.recovered), strict=True)),
            "nees": sum(one.nees for one in study.recovered),
            "nees_95": [low, high],
        },
        "versions": dict(provenance.versions()),
        "machine": plain(provenance.machine()),
        "date_utc": provenance.now_utc(),
        "tables": [plain(table) for table in study.tables],
    }


def page(study: Study) -> str:
    """Render the page: one HTML file that needs nothing beside it."""
    notes = {
        "projection": "A pinhole of the same focal length at the axis. Beyond 60 deg the displacement at the edge is tens of "
        "pixels: stars drop out of the fit, and the first order with them.",
        "k1": "Stars at the edge move by 2 px at 0.001.",
        "heading": "A solver that is told no heading cannot be misled by one. Self-calibration gives the stars less to hold "
        "against the heading.",
        "refraction": "Symmetric about the zenith; a tilted camera sees more of it on one side.",
        "epoch": "The same hour, years ago: precession and nutation.",
    }
    drawn = [
        (fault.title, notes.get(fault.key, ""), Markup(figures.figure_fault(study.shifts, fault))) for fault in FAULTS
    ]
    gradient_figures = [
        (
            "Errors over the Cramér-Rao bound",
            "Each recovered parameter of each frame.",
            Markup(figures.figure_errors(study.recovered, PARAMETERS)),
        ),
        (
            "The way there",
            "From the told camera to the recovered one; stages look through Gaussians of 8, 4, 2, 1 and 0 px.",
            Markup(figures.figure_paths(study.recovered)),
        ),
    ]
    return render_page(
        "study_calibration.html",
        headline=headline(study),
        tables=study.tables,
        figures=drawn,
        gradient=gradient_sentences(study.recovered),
        gradient_figures=gradient_figures,
        n_sites=study.sizes.sites,
        n_pictures=study.sizes.pictures,
        n_gradient=study.sizes.gradient,
        command=study.command,
        machine=provenance.machine(),
        date=provenance.now_utc(),
        minutes=f"{study.minutes:.1f}",
    )
