"""`skybench export`: the formats by name, and the folder to which they are written."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa

from generator.dataset.reader import Dataset
from generator.errors import GeneratorError
from generator.export.coco import export_coco
from generator.export.fits_image import export_fits
from generator.export.form import ExportOptions, Form, Progress
from generator.export.huggingface import export_huggingface
from generator.export.plain_files import export_files
from generator.export.yolo import export_yolo

EXPORTS: dict[str, Form] = {
    "files": export_files,
    "coco": export_coco,
    "yolo": export_yolo,
    "fits": export_fits,
    "huggingface": export_huggingface,
}
ADDS_TO_A_FOLDER = {"huggingface"}
"""Formats that add another split to those in a folder."""
ANNOTATED = ("coco", "yolo")
"""Formats that annotate sources."""


def export(
    folder: Path,
    form: str,
    out: Path,
    options: ExportOptions = ExportOptions(),
    progress: Progress = lambda frame_id: None,
) -> None:
    """Export a finished dataset.

    Parameters
    ----------
    folder : Path
        Folder of the dataset.
    form : str
        One of EXPORTS.
    out : Path
        An empty or new folder; for ``huggingface`` also one with other splits.
    options : ExportOptions
    progress : callable
        Called with the id of each finished frame.

    Raises
    ------
    GeneratorError
        The format is unknown, does not support an option, the dataset is unfinished or damaged, or the folder cannot be used.
    """
    if form not in EXPORTS:
        raise GeneratorError(f"--to {form}: one of {', '.join(EXPORTS)}")
    if options.least_snr is not None and form not in ANNOTATED:
        raise GeneratorError(f"--least-snr: only with --to {' or '.join(ANNOTATED)}; {form} has no annotations")
    dataset = Dataset.open(folder)
    try:
        out.mkdir(parents=True, exist_ok=True)
        if form not in ADDS_TO_A_FOLDER and any(out.iterdir()):
            raise GeneratorError(f"{out}: is not empty; choose another folder")
        EXPORTS[form](dataset, out, options, progress)
    except (KeyError, TypeError, ValueError, pa.ArrowException) as error:
        raise GeneratorError(
            f"{folder}: a record or table is not as docs/dataset_format.md says ({type(error).__name__}: {error}); "
            "run `skybench verify`"
        ) from error
    except OSError as error:
        raise GeneratorError(
            f"{error.filename or out}: writing failed ({error.strerror or error}); choose another folder"
        ) from error
