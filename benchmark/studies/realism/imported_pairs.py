"""Photographs of a dataset and their twins: solvers receive the same for a twin as for its photograph."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.errors import PhotographError
from benchmark.frames.dataset import load_image, open_dataset
from benchmark.frames.record_values import read_record
from benchmark.studies.realism.likeness import Likeness
from benchmark.studies.realism.pairs import Pairs, likenesses_in_circle
from benchmark.twin.imported import read_imported
from benchmark.twin.of_source import twin_of
from benchmark.twin.report import NUMBERS, numbers_of_twin, write_report
from benchmark.twin.scene import Scene
from benchmark.twin.sources import Source, check_names, sources_of
from benchmark.twin.truth import FRAMES, TruthFolder
from benchmark.twin.video_twin import stack_dn


def imported_pairs(
    scene: Scene,
    folder: Path,
    work: Path,
    mask: Path | None = None,
    progress: Callable[[], None] = lambda: None,
) -> Pairs:
    """Render the twins of a dataset's photographs, unless `work` has them all.

    Photographs whose stars gave no attitude are left out: the twin of one would have the supplied attitude, so that a solver
    would have no error of the mount on it.

    Parameters
    ----------
    scene : Scene
        Scene with the camera's sensor, ground and cities.
    folder : Path
        Folder that `skybench import` wrote.
    work : Path
        Folder for everything that is produced.
    mask : Path, optional
        Picture whose dark pixels are not sky.
    progress : callable
        Called after each photograph.

    Raises
    ------
    PhotographError
        A photograph cannot be used, or none has an attitude of its stars.
    """
    sources = sources_of([folder])
    check_names(sources)
    aligned = [_is_aligned(source) for source in sources]
    chosen = [source for source, known in zip(sources, aligned, strict=True) if known]
    if not chosen:
        raise PhotographError(
            f"{folder}: the stars of no photograph gave an attitude; import them with a better --camera"
        )
    measures = _kept(work, chosen)
    # The bar counts all photographs, those that need no twin too.
    for _ in range(len(sources) - (len(chosen) if measures is None else 0)):
        progress()
    if measures is None:
        measures = _made(scene, chosen, work, mask, progress)
    return Pairs(
        names=tuple(source.name for source in chosen),
        # A relative path may be the name of a task, which `run` would take it for.
        real=folder.resolve(),
        twins=work / FRAMES,
        measures=measures,
        likenesses=_likenesses(scene, chosen, work / FRAMES),
        real_indices=tuple(index for index, known in enumerate(aligned) if known),
        n_real=len(sources),
        left_out=tuple(source.name for source, known in zip(sources, aligned, strict=True) if not known),
    )


def _is_aligned(source: Source) -> bool:
    assert source.imported is not None
    alignment = read_imported(source.imported).alignment
    return alignment is not None and math.isfinite(alignment.rms_px)


def _kept(work: Path, sources: list[Source]) -> list[dict[str, Any]] | None:
    """Measurements of an earlier run over the same photographs with the same camera; None without."""
    numbers = work / NUMBERS
    if not numbers.is_file() or not (work / FRAMES).is_dir():
        return None
    found: list[dict[str, Any]] = json.loads(numbers.read_text(encoding="utf-8"))["twins"]
    records = [read_record(frame.image_path.with_suffix(".json")) for frame in open_dataset(work / FRAMES).frames]
    # Solvers receive for a twin what they receive for its photograph: one of another calibration is made again.
    made = [(record["twin"]["photograph"], record.get("told")) for record in records]
    wanted = [(source.name, source.imported.record.get("told")) for source in sources if source.imported is not None]
    return found if made == wanted and [name for name, _ in made] == [one["photograph"] for one in found] else None


def _made(
    scene: Scene, sources: list[Source], work: Path, mask: Path | None, progress: Callable[[], None]
) -> list[dict[str, Any]]:
    frames, rows = TruthFolder(work / FRAMES), []
    for source in sources:
        twin = twin_of(scene, source, work, mask)
        frames.add(twin)
        rows.append(numbers_of_twin(twin))
        write_report(rows, work)
        progress()
    return rows


def _likenesses(scene: Scene, sources: list[Source], twins: Path) -> list[Likeness]:
    """Compare the pictures within the image circle of the first photograph's camera, which is that of all."""
    read = [source.read(scene) for source in sources]
    own, first = read[0]
    dark_dn = own.spec.sensor.black_level_dn * (stack_dn(own, first.name) if first.mean_of_video else 1.0)
    made = [load_image(frame).astype(np.float32) for frame in open_dataset(twins).frames]
    return likenesses_in_circle(own, [photograph.pixels for _, photograph in read], made, dark_dn)
