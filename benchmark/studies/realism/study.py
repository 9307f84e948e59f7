"""The realism study: render twins, run solvers on both sets, write tables and one page."""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from markupsafe import Markup

from benchmark import provenance
from benchmark.errors import ResultsError
from benchmark.report.formatting import interval, number, percent
from benchmark.report.marks import Mark
from benchmark.report.stale import REALISM_STUDY, mark_of_today, revision_today
from benchmark.report.templates import render_page
from benchmark.run.engine import SolverRun, run
from benchmark.run.results import FRAMES_NAME, read_table
from benchmark.stats.metrics import SUCCESS_KM
from benchmark.studies.common.page_model import Table, plain
from benchmark.studies.common.progress import StudyProgress
from benchmark.studies.common.records import write_table
from benchmark.studies.realism.agreement import Agreement, Outcomes, agreement_of, successes
from benchmark.studies.realism.imported_pairs import imported_pairs
from benchmark.studies.realism.likeness import Likeness
from benchmark.studies.realism.pairs import Pairs, make_pairs
from benchmark.studies.realism.star_tables import pairs_of, star_figures, star_tables
from benchmark.twin.given_files import check_photograph
from benchmark.twin.scene import Scene
from benchmark.twin.sources import sources_of
from generator.files import write_bytes

FORMAT = "skybench-study/1"
PAGE, NUMBERS, ROWS = "index.html", "study.json", "outcomes.parquet"
LEAST_PHOTOGRAPHS = 3


@dataclass(frozen=True, eq=False)
class Study:
    """Content of the page.

    Attributes
    ----------
    names : tuple of str
        Names of the photographs.
    calibrated_on : str or None
        The photograph of the calibration; None where a dataset states the camera.
    left_out : tuple of str
        Photographs of the dataset that have no twin.
    outcomes : Outcomes
    agreement : Agreement
    tables : tuple of Table
    measures : sequence of dict
    command : str
    minutes : float
    """

    names: tuple[str, ...]
    calibrated_on: str | None
    outcomes: Outcomes
    agreement: Agreement
    tables: tuple[Table, ...]
    measures: Sequence[dict[str, Any]]
    command: str
    minutes: float
    left_out: tuple[str, ...] = ()


def run_study(
    scene: Scene,
    photographs: Sequence[Path],
    calibrated_on: Path | None,
    solvers: Sequence[str],
    work: Path,
    out: Path,
    command: str,
    progress: StudyProgress,
    mask: Path | None = None,
) -> Study:
    """Run the study and write its results.

    Parameters
    ----------
    scene : Scene
        Scene of the fixed camera.
    photographs : sequence of Path
        FITS files on which solvers are judged; or one folder that `skybench import` wrote, whose records state the camera.
    calibrated_on : Path or None
        The photograph on which the camera of FITS files is calibrated; None for a folder.
    solvers : sequence of str
    work, out : Path
        Folders for frames and results.
    command : str
        Command to state on the page.
    progress : StudyProgress
    mask : Path, optional
        Picture whose dark pixels are not sky, for a folder.

    Raises
    ------
    BenchmarkError, GeneratorError
        The message says what to do about it.
    """
    start = time.monotonic()
    pairs = _pairs(scene, photographs, calibrated_on, work, progress, mask)
    progress.begin("solvers", (pairs.n_real + len(pairs.names)) * len(solvers))
    outcomes = outcomes_of(pairs, solvers, work, progress)
    study = Study(
        names=pairs.names,
        calibrated_on=None if calibrated_on is None else calibrated_on.name,
        outcomes=outcomes,
        agreement=agreement_of(outcomes),
        tables=(
            solver_table(outcomes),
            frame_table(pairs.names, outcomes),
            *measure_tables(pairs.measures),
            *star_tables(pairs_of(pairs.measures)),
            likeness_table([one["photograph"] for one in pairs.measures], pairs.likenesses),
        ),
        measures=pairs.measures,
        command=command,
        minutes=(time.monotonic() - start) / 60,
        left_out=pairs.left_out,
    )
    write_table(out / ROWS, _rows(study))
    write_bytes(out / NUMBERS, (json.dumps(_numbers(study), indent=1, allow_nan=False) + "\n").encode())
    mark, sentence = mark_of_today(command, REALISM_STUDY, out / NUMBERS)
    write_bytes(out / PAGE, page(study, mark, sentence).encode())
    return study


def _pairs(
    scene: Scene,
    photographs: Sequence[Path],
    calibrated_on: Path | None,
    work: Path,
    progress: StudyProgress,
    mask: Path | None,
) -> Pairs:
    """Pairs of FITS files or of a folder; ResultsError for too few, or for arguments of the other kind."""
    folders = [path for path in photographs if path.is_dir()]
    if folders:
        if len(photographs) > 1:
            raise ResultsError(f"{folders[0]}: is a folder of photographs; give it alone")
        if calibrated_on is not None:
            raise ResultsError(
                f"--calibrate-on {calibrated_on}: the records of {folders[0]} state the camera; leave it out"
            )
        progress.begin("twins", len(sources_of(folders)))
        pairs = imported_pairs(scene, folders[0], work, mask, progress.advance)
        _check_enough(len(pairs.names))
        return pairs
    if calibrated_on is None:
        raise ResultsError("FITS files need --calibrate-on FITS, another photograph that the camera is calibrated on")
    if mask is not None:
        raise ResultsError(f"--mask {mask}: is for a folder of photographs; for FITS files the scene's ground is used")
    _check_enough(len(photographs))
    for path in (*photographs, calibrated_on):
        check_photograph(path)
    progress.begin("twins", len(photographs) + 1)
    return make_pairs(scene, photographs, calibrated_on, work, progress.advance)


def _check_enough(count: int) -> None:
    if count < LEAST_PHOTOGRAPHS:
        raise ResultsError(f"{count} photographs tell nothing of a ranking; give {LEAST_PHOTOGRAPHS} or more")


def outcomes_of(pairs: Pairs, solvers: Sequence[str], work: Path, progress: StudyProgress) -> Outcomes:
    """Run every solver on both sets."""
    found = []
    for folder, indices in ((pairs.real, pairs.real_indices), (pairs.twins, range(len(pairs.names)))):
        runs = run(folder, list(solvers), work / "results", progress=lambda solver, count: _advance(progress, count))
        found.append(np.array([_errors_km(one, indices) for one in runs]))
    return Outcomes(tuple(solvers), found[0], found[1])


def _advance(progress: StudyProgress, count: int) -> None:
    for _ in range(count):
        progress.advance()


def _errors_km(one: SolverRun, indices: Iterable[int]) -> list[float]:
    """Errors of a run on some frames; infinite without a fix."""
    table = read_table(one.folder / FRAMES_NAME)
    by_index = dict(zip(table["index"].to_pylist(), table["error_km"].to_pylist(), strict=True))
    return [math.inf if by_index[index] is None else by_index[index] for index in indices]


def solver_table(outcomes: Outcomes) -> Table:
    """Success and errors of every solver, the best on photographs first."""
    real, twin = successes(outcomes.real_km), successes(outcomes.twin_km)
    order = np.lexsort((np.median(outcomes.real_km, axis=1), -real.sum(axis=1)))
    rows = []
    for row in order:
        near = [errors[row][hits[row]] for errors, hits in ((outcomes.real_km, real), (outcomes.twin_km, twin))]
        rows.append(
            (
                outcomes.solvers[row],
                str(real[row].sum()),
                str(twin[row].sum()),
                _wrong(outcomes.real_km[row]),
                _wrong(outcomes.twin_km[row]),
                *(number(float(np.median(errors)), "km") if len(errors) else "-" for errors in near),
                f"{np.mean(real[row] == twin[row]):.0%}",
            )
        )
    return Table(
        "Solvers",
        f"{outcomes.real_km.shape[1]} frames; success: a fix within {SUCCESS_KM:g} km.",
        ("solver", "successes on photographs", "on twins", "wrong fixes", "on twins", "median error of successes",
         "on twins", "frames with the same outcome"),
        tuple(rows),
    )  # fmt: skip


def _wrong(errors_km: np.ndarray[Any, np.dtype[np.float64]]) -> str:
    return str(int(np.count_nonzero(np.isfinite(errors_km) & (errors_km >= SUCCESS_KM))))


def frame_table(names: Sequence[str], outcomes: Outcomes) -> Table:
    """Which solvers succeed on each photograph and on its twin."""
    real, twin = successes(outcomes.real_km), successes(outcomes.twin_km)
    rows = tuple(
        (name, str(real[:, frame].sum()), str(twin[:, frame].sum()), str((real & ~twin)[:, frame].sum()),
         str((twin & ~real)[:, frame].sum()))
        for frame, name in enumerate(names)
    )  # fmt: skip
    header = ("photograph", "solvers that succeed", "on its twin", "on the photograph alone", "on the twin alone")
    return Table("Frames", f"Of {len(outcomes.solvers)} solvers.", header, rows)


def measure_tables(measures: Sequence[dict[str, Any]]) -> tuple[Table, ...]:
    """Measurements on a photograph and on its twin: detections and stars; sky and noise."""
    detections, skies = [], []
    for one in measures:
        found = one["detections"]
        detections.append(
            (
                one["photograph"],
                *(f"{found[name]['real']}, {found[name]['twin']}" for name in ("celnav", "sep")),
                *(
                    f"{_share(found[name]['spurious_real'])}, {_share(found[name]['spurious_twin'])}"
                    for name in ("celnav", "sep")
                ),
                _ratio(one["snr_ratio"]),
                _ratio(one["flux_ratio"]),
                f"{_ratio(one['nearest_share_real'])}, {_ratio(one['nearest_share_twin'])}",
            )
        )
        skies.append(
            (
                one["photograph"],
                f"{one['moon_altitude_deg']:.0f}",
                *(_ratio(value) for value in one["sky_ratio"]),
                _ratio(one["noise_ratio"]),
                *(_ratio(value) for value in one["spectrum_ratio"]),
            )
        )
    edges = measures[0]["sky_edges_deg"]
    bands = [f"{low}-{high} deg" for low, high in itertools.pairwise(edges)]
    return (
        Table(
            "Detections and stars",
            "Photograph, twin. Spurious: 1.5 px or more from any star to V 7.5. Ratios are photograph over twin, medians "
            "of stars to V 4.5.",
            ("photograph", "celnav", "sep, 3 sigma", "celnav, spurious", "sep, spurious", "SNR", "light",
             "light in the brightest pixel"),
            tuple(detections),
        ),
        Table(
            "Sky and noise",
            "Photograph over twin: the sky's light by altitude, the noise of a pixel, and the noise's spectrum in four bands "
            "of frequency, low to high.",
            ("photograph", "Moon, deg", *bands, "noise", "0.03-0.1 / px", "0.1-0.2", "0.2-0.35", "0.35-0.5"),
            tuple(skies),
        ),
    )  # fmt: skip


def likeness_table(names: Sequence[str], alike: Sequence[Likeness]) -> Table:
    """Similarity of the pictures."""
    return Table(
        "Pictures",
        "Structure: structural similarity (1: equal) of the light's logarithm in blocks of 8 px within the image circle, "
        "with the own twin and, median, with the twins of other photographs. Shift: what brings the twin's stars on the "
        "photograph's. Patches: connected regions larger than stars and 1.25 times as bright as what surrounds them; "
        "photograph, twin.",
        ("photograph", "structure, own twin", "other twins", "shift along u, v, px", "patches", "of the image circle"),
        tuple(
            (
                name,
                f"{one.structure:.2f}",
                _ratio(one.structure_of_others if math.isfinite(one.structure_of_others) else None),
                f"{one.shift_px[0]:.2f}, {one.shift_px[1]:.2f}",
                f"{one.patches_real}, {one.patches_twin}",
                f"{one.patch_share_real:.1%}, {one.patch_share_twin:.1%}",
            )
            for name, one in zip(names, alike, strict=True)
        ),
    )


def _ratio(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.0%}"


def _rows(study: Study) -> pa.Table:
    """Table with one row per solver and photograph."""
    m, n = study.outcomes.real_km.shape
    columns = {
        "solver": np.repeat(study.outcomes.solvers, n).tolist(),
        "photograph": list(study.names) * m,
        "real_error_km": study.outcomes.real_km.ravel().tolist(),
        "twin_error_km": study.outcomes.twin_km.ravel().tolist(),
    }
    return pa.table(columns)


def _numbers(study: Study) -> dict[str, object]:
    return {
        "format": FORMAT,
        "command": study.command,
        "minutes": round(study.minutes, 1),
        "photographs": list(study.names),
        "calibrated_on": study.calibrated_on,
        "left_out": list(study.left_out),
        "agreement": plain(study.agreement),
        "measures": [plain(one) for one in study.measures],
        "revision": revision_today(REALISM_STUDY),
        "versions": dict(provenance.versions()),
        "machine": plain(provenance.machine()),
        "date_utc": provenance.now_utc(),
        "tables": [plain(table) for table in study.tables],
    }


def page(study: Study, mark: Mark, sentence: str) -> str:
    """Render the page, with a mark of the sources of its numbers: one self-contained HTML file."""
    return render_page(
        "study_realism.html",
        study=study,
        agreement=study.agreement,
        n_frames=len(study.names),
        n_solvers=len(study.outcomes.solvers),
        number=number,
        percent=percent,
        interval=interval,
        machine=provenance.machine(),
        date=provenance.now_utc(),
        minutes=f"{study.minutes:.1f}",
        figures=[(one, Markup(one.html)) for one in star_figures(pairs_of(study.measures))],
        mark=mark,
        sentence=sentence,
    )
