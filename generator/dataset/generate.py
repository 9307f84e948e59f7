"""`skybench generate` from start to end: shards, then card and Croissant, and the manifest last."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from generator.dataset.card import write_card
from generator.dataset.croissant import write_croissant
from generator.dataset.inputs import stored_inputs
from generator.dataset.layout import CARD, CROISSANT, MANIFEST, SCENARIO_COPY, TABLES, DatasetSpec, divide, imu_places
from generator.dataset.manifest import make_manifest, manifest_of, write_manifest
from generator.dataset.receipt import damaged_files, finished_files
from generator.dataset.run import Part, Runner, RunReport, ShardRange, open_dataset_target, run_shards
from generator.dataset.shard import ShardReport
from generator.dataset.target import INCOMING_PREFIX, LocalTarget, Target, open_target
from generator.errors import GeneratorError
from generator.imu.table import write_imu_table
from generator.scenario.file import Scenario
from generator.sensor.photo import check_photo
from generator.stored_files import StoredFile, stored_file

UNFINISHED_PREFIX = ".shard-"


def generate(
    scenario: Scenario,
    text: str,
    out: str | Path,
    spec: DatasetSpec,
    frames: tuple[int, int] | None = None,
    part: Part | ShardRange = Part(),
    workers: int = 0,
    run: Runner = run_shards,
    frame_done: Callable[[int], None] = lambda index: None,
    shard_done: Callable[[ShardReport], None] = lambda report: None,
) -> RunReport:
    """Generate a dataset, complete an interrupted one, or repair a damaged one.

    Parameters
    ----------
    scenario : Scenario
    text : str
        The scenario file's text, kept with the dataset.
    out : str or Path
        A folder, or a URL that fsspec supports.
    spec : DatasetSpec
    frames : (first, stop), optional
        Frames to generate; all by default. A frame's bytes do not depend on the range.
    part : Part or ShardRange
        Part of the dataset for this job, if several jobs share it.
    workers : int
        Number of processes; 0 renders in this one.
    run : callable
        The backend: :func:`generator.dataset.run.run_shards` or a compatible one.
    frame_done, shard_done : callables
        Called after each frame and each shard.

    Returns
    -------
    RunReport
        The manifest is written once nothing is missing; an existing one remains until then.

    Raises
    ------
    GeneratorError
        The folder cannot be used, or workers keep dying.
    """
    first, stop = frames or (0, scenario.frame_count)
    shards = divide(scenario, spec, first, stop)
    own = part.of(shards)
    check_photo(scenario.frame(first).sensor)
    target = open_target(str(out))
    mended = list(open_dataset_target(target, scenario, text))
    reports = []
    for report in run(scenario, spec, own, target, workers, frame_done):
        reports.append(report)
        mended += report.damaged
        shard_done(report)
    # Each of many jobs requests the list of files, which a store returns in pieces of a thousand; only the last one also
    # requests receipts.
    present: dict[str, int] = {}
    for kind in ("data", *TABLES, "receipts"):
        present |= target.sizes(f"{kind}/{spec.split}")
    missing = [shard for shard in shards if not present.keys() >= {shard.receipt, *shard.files}]
    if not missing:
        found = {shard: finished_files(target, shard, scenario, spec, present.get) for shard in shards}
        missing = [shard for shard, files in found.items() if files is None]
        stored = [file for files in found.values() for file in files or ()]
    if not missing:
        mended += _finish(scenario, spec, target, first, stop, stored)
    return RunReport(tuple(reports), tuple(missing), tuple(mended))


def _finish(
    scenario: Scenario, spec: DatasetSpec, target: Target, first: int, stop: int, stored: list[StoredFile]
) -> list[str]:
    """Write the files that describe the whole dataset, the manifest last; returns those that were damaged."""
    known = manifest_of(target)
    listed = {} if known is None else {file.path: file for file in known.files}
    damaged = [MANIFEST] if known is None and target.size(MANIFEST) is not None else []
    try:
        if isinstance(target, LocalTarget):
            # Every shard is complete, so temporary files can only be those of killed workers.
            for prefix in (UNFINISHED_PREFIX, INCOMING_PREFIX):
                for leftover in target.folder.rglob(f"{prefix}*"):
                    leftover.unlink(missing_ok=True)
        with tempfile.TemporaryDirectory(prefix="skybench-") as scratch:
            build = Path(scratch) / "build"
            build.mkdir()
            (build / SCENARIO_COPY).write_bytes(target.read(SCENARIO_COPY) or b"")
            shards = divide(scenario, spec, first, stop)
            figures = write_card(build, scenario, spec, shards, target, Path(scratch))
            readings = imu_places(scenario, spec.split, first, stop)
            for sequence, place in readings.items():
                write_imu_table(build / place, scenario, range(sequence, sequence + 1))
            described = [*stored, *stored_inputs(target, scenario)]
            described += [stored_file(build, place) for place in (SCENARIO_COPY, CARD, *figures, *readings.values())]
            write_croissant(build, scenario, spec, described)
            described.append(stored_file(build, CROISSANT))
            write_manifest(build, make_manifest(scenario, spec, first, stop, described))
            for place in (*readings.values(), CARD, *figures, CROISSANT):
                made = stored_file(build, place)
                if listed.get(place) == made and damaged_files(target, (made,)):
                    damaged.append(place)
                target.put(build / place, place)
            target.put(build / MANIFEST, MANIFEST)
    except OSError as error:
        raise GeneratorError(
            f"{error.filename or target.name}: writing failed ({error.strerror or error}); run the same command again"
        ) from error
    return damaged
