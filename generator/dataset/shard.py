"""Render one shard: a pure function of scenario, dataset and shard, apart from the files that it writes."""

from __future__ import annotations

import io
import tarfile
import tempfile
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import pyarrow as pa

from generator.dataset.frame_columns import FRAME_SCHEMA, frame_row
from generator.dataset.images import encode
from generator.dataset.layout import DatasetSpec, Shard
from generator.dataset.receipt import damaged_files, finished_files, read_receipt, write_receipt
from generator.dataset.table_writer import TableWriter, table_writer, write_table
from generator.dataset.target import LocalTarget, Target
from generator.errors import GeneratorError
from generator.files import atomic_path
from generator.frame.object_table import OBJECT_SCHEMA
from generator.frame.record import STAR_SCHEMA, VISIBLE_SNR, frame_record, record_bytes
from generator.frame.render import RenderedFrame, further_files, render_frame, write_exr
from generator.scenario.file import Scenario
from generator.stored_files import StoredFile, stored_file

TRIES_PER_FRAME = 2


@dataclass(frozen=True)
class FailedFrame:
    """A frame that could not be rendered in any of the attempts."""

    index: int
    error: str


@dataclass(frozen=True)
class ShardReport:
    """Result of a shard: its files, or the frames that failed.

    Attributes
    ----------
    shard : Shard
    files : tuple of StoredFile
    failures : tuple of FailedFrame
    skipped : bool
        Whether it was already complete.
    damaged : tuple of str
        Files in its receipt that were missing or had changed, so that the shard was rendered again.
    """

    shard: Shard
    files: tuple[StoredFile, ...]
    failures: tuple[FailedFrame, ...]
    skipped: bool = False
    damaged: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether all files of the shard have their final names."""
        return not self.failures


@dataclass(frozen=True)
class Truth:
    """Truth tables of a shard that are being written."""

    stars: TableWriter
    objects: TableWriter


def render_shard(
    scenario: Scenario,
    spec: DatasetSpec,
    shard: Shard,
    target: Target,
    progress: Callable[[int], None] = lambda index: None,
) -> ShardReport:
    """Render a shard into a dataset, unless it is already complete and its files agree with its receipt.

    All frames are rendered before any file takes its final name; the receipt is stored last. A frame that fails is tried
    again; if it fails twice, the other frames are still rendered, but the shard is not stored.

    Parameters
    ----------
    scenario : Scenario
    spec : DatasetSpec
    shard : Shard
    target : Target
        Place of the dataset.
    progress : callable
        Called with the index of each finished frame.

    Returns
    -------
    ShardReport

    Raises
    ------
    GeneratorError
        The target cannot be written.
    """
    try:
        finished = read_receipt(target, shard, scenario, spec)
        damaged = damaged_files(target, finished or ())
        if finished is not None and not damaged:
            return ShardReport(shard, finished, (), skipped=True)
        if isinstance(target, LocalTarget):
            return replace(_render(scenario, spec, shard, target.folder, progress), damaged=damaged)
        with tempfile.TemporaryDirectory(prefix="skybench-") as scratch:
            report = _render(scenario, spec, shard, Path(scratch), progress)
            for place in (
                shard.log,
                *((*shard.files, shard.receipt) if report.complete else ()),
            ):
                target.put(Path(scratch) / place, place)
        return replace(report, damaged=damaged)
    except OSError as error:
        with suppress(OSError):
            # A second job with the same shards, when it ends, mistakes temporary files for those of killed jobs.
            made = finished_files(target, shard, scenario, spec)
            if made is not None and not damaged_files(target, made):
                return ShardReport(shard, made, ())
        raise GeneratorError(
            f"{error.filename or target.name}: reading or writing failed ({error.strerror or error}); "
            f"{shard.stem} is left out. Mend it and run the same command again: finished shards are kept"
        ) from error


def _render(
    scenario: Scenario, spec: DatasetSpec, shard: Shard, folder: Path, progress: Callable[[int], None]
) -> ShardReport:
    for place in (*shard.files, shard.receipt, shard.log):
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    try:
        with (
            (folder / shard.log).open("w", encoding="utf-8") as log,
            atomic_path(folder / shard.tar) as temporary,
            table_writer(folder / shard.stars, STAR_SCHEMA) as stars,
            table_writer(folder / shard.objects, OBJECT_SCHEMA) as objects,
        ):
            _write_frames(temporary, scenario, spec, shard, rows, Truth(stars, objects), log, progress)
    except _FramesFailedError as failed:
        return ShardReport(shard, (), failed.failures)
    write_table(folder / shard.frames, pa.Table.from_pylist(rows, schema=FRAME_SCHEMA))
    files = tuple(stored_file(folder, place) for place in shard.files)
    write_receipt(folder, shard, scenario, spec, files)
    return ShardReport(shard, files, ())


def _write_frames(
    path: Path,
    scenario: Scenario,
    spec: DatasetSpec,
    shard: Shard,
    rows: list[dict[str, Any]],
    truth: Truth,
    log: TextIO,
    progress: Callable[[int], None],
) -> None:
    """Write the archive and the truth of a shard and collect its table of frames.

    Raises _FramesFailedError if a frame is missing.
    """
    failures: list[FailedFrame] = []
    with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as archive:
        for index in range(shard.first, shard.stop):
            started = time.perf_counter()
            frame = _try_frame(scenario, index, spec, log)
            if isinstance(frame, FailedFrame):
                failures.append(frame)
                continue
            record = frame_record(frame.plan, frame.expected, frame.stars)
            stem = frame.plan.frame_id
            image = encode(frame.dn, spec.codec)
            _add(archive, f"{stem}.{spec.codec}", image)
            _add(archive, f"{stem}.json", record_bytes(record))
            if spec.exr:
                _add(archive, f"{stem}.exr", _exr_bytes(frame))
            for suffix, content in further_files(frame).items():
                _add(archive, f"{stem}.{suffix}", content)
            rows.append(frame_row(record, shard.split, shard.stem, f"{stem}.{spec.codec}", image))
            truth.stars.add(frame.stars)
            truth.objects.add(frame.objects)
            seen = record["stars"]["n_visible"]
            log.write(f"{stem}: {seen} stars with SNR >= {VISIBLE_SNR:g}, {time.perf_counter() - started:.3f} s\n")
            log.flush()
            progress(index)
    if failures:
        raise _FramesFailedError(tuple(failures))


class _FramesFailedError(Exception):
    """Some frames of a shard could not be rendered."""

    def __init__(self, failures: tuple[FailedFrame, ...]) -> None:
        super().__init__(f"{len(failures)} frames failed")
        self.failures = failures


def _try_frame(scenario: Scenario, index: int, spec: DatasetSpec, log: TextIO) -> RenderedFrame | FailedFrame:
    """Render a frame, with a second attempt if it fails; errors of the operating system, such as a full disk, are raised."""
    problem = ""
    for attempt in range(TRIES_PER_FRAME):
        try:
            return render_frame(scenario, index, channels=spec.exr)
        except OSError:
            raise
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
            log.write(f"frame {index}, try {attempt + 1}: {traceback.format_exc()}\n")
    return FailedFrame(index, problem)


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> None:
    """Add a member without date or owner, so that the same frames give the same archive."""
    member = tarfile.TarInfo(name)
    member.size = len(data)
    archive.addfile(member, io.BytesIO(data))


def _exr_bytes(frame: RenderedFrame) -> bytes:
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "frame.exr"
        write_exr(path, frame)
        return path.read_bytes()
