"""`skybench generate` from end to end: shards, then card and Croissant, and the manifest last."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from generator.dataset.card import write_card
from generator.dataset.croissant import write_croissant
from generator.dataset.layout import CARD, CROISSANT, MANIFEST, SCENARIO_COPY, DatasetSpec, divide
from generator.dataset.manifest import make_manifest, write_manifest
from generator.dataset.run import Part, RunReport, open_folder, run_shards, shards_of_part
from generator.dataset.shard import ShardReport, StoredFile, read_receipt, stored_file
from generator.errors import GeneratorError
from generator.scenario_file import Scenario

UNFINISHED_PREFIX = ".shard-"


def generate(
    scenario: Scenario,
    text: str,
    folder: Path,
    spec: DatasetSpec,
    frames: tuple[int, int] | None = None,
    part: Part = Part(),  # noqa: B008 - frozen
    workers: int = 0,
    frame_done: Callable[[int], None] = lambda index: None,
    shard_done: Callable[[ShardReport], None] = lambda report: None,
) -> RunReport:
    """Make a dataset, or what is still missing of it.

    Parameters
    ----------
    scenario : Scenario
    text : str
        The scenario file's text, kept with the dataset.
    folder : Path
    spec : DatasetSpec
    frames : (first, stop), optional
        Frames to make; all by default. A frame's bytes do not depend on the range.
    part : Part
        For jobs that share a dataset.
    workers : int
        Processes; 0 renders in this one.
    frame_done, shard_done : callables
        Called as work goes on.

    Returns
    -------
    RunReport
        The manifest is written when nothing is missing.

    Raises
    ------
    GeneratorError
        The folder cannot be used, or workers keep dying.
    """
    first, stop = frames or (0, scenario.frame_count)
    open_folder(folder, scenario, text)
    reports = []
    for report in run_shards(
        scenario, spec, shards_of_part(scenario, spec, first, stop, part), folder, workers, frame_done
    ):
        reports.append(report)
        shard_done(report)
    stored: list[StoredFile] = []
    missing = []
    for shard in divide(scenario, spec, first, stop):
        files = read_receipt(folder, shard, scenario, spec)
        if files is None:
            missing.append(shard)
        else:
            stored += files
    if not missing:
        _finish(scenario, spec, folder, first, stop, stored)
    return RunReport(tuple(reports), tuple(missing))


def _finish(
    scenario: Scenario, spec: DatasetSpec, folder: Path, first: int, stop: int, stored: list[StoredFile]
) -> None:
    """Write what describes the whole dataset; the manifest last."""
    try:
        (folder / MANIFEST).unlink(missing_ok=True)
        # Temporary files of killed workers can go now: with every shard in place, nobody is writing one.
        for leftover in folder.rglob(f"{UNFINISHED_PREFIX}*"):
            leftover.unlink(missing_ok=True)
        assets = write_card(folder, scenario, spec, first, stop)
        described = [*stored, *(stored_file(folder, place) for place in (SCENARIO_COPY, CARD, *assets))]
        write_croissant(folder, scenario, spec, described)
        described.append(stored_file(folder, CROISSANT))
        write_manifest(folder, make_manifest(scenario, spec, first, stop, described))
    except OSError as error:
        raise GeneratorError(
            f"{error.filename or folder}: writing failed ({error.strerror}); run the same command again"
        ) from error
