"""Forecast of a scenario's dataset: number and properties of the frames, time and size."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from generator.dataset.images import encode
from generator.dataset.table_writer import write_table
from generator.frame.outlook import Outlook, outlook, warnings_of
from generator.frame.record import frame_record, record_bytes
from generator.frame.render import RenderedFrame, further_files, render_frame, write_exr
from generator.mitsuba_runtime import set_threads
from generator.scenario.file import Scenario

BYTES_PER_READING = 125
"""Bytes per reading of an inertial unit, compressed."""
AROUND_S = 5.0
"""Time for starting the command and its workers, and for the dataset's card, on one core of 2020s hardware."""
SIDE_BY_SIDE = 1.4
"""Factor on the time of a frame in parallel with other processes, which share memory and caches, and when written to a
dataset."""
FRAMES_MEASURED = 4


@dataclass(frozen=True)
class Forecast:
    """Forecast of a scenario.

    Attributes
    ----------
    frames : int
    width, height, bits : int
        Image format of the first frame.
    catalogue_stars : int
        Stars and planets above the first frame's horizon and above the list's limit.
    first : Outlook
        The first frame in numbers.
    warnings : tuple of str
        Warnings about values of the first frame that look like mistakes.
    seconds : float
        Duration of `skybench generate` with all cores.
    bytes : float
        Size of images, records and tables.
    exr_bytes : float
        Size of the expected electrons in addition.
    cores : int
    measured : bool
        Whether time and size come from frames over the whole scenario, rather than from the first alone.
    """

    frames: int
    width: int
    height: int
    bits: int
    catalogue_stars: int
    first: Outlook
    warnings: tuple[str, ...]
    seconds: float
    bytes: float
    exr_bytes: float
    cores: int
    measured: bool


@dataclass(frozen=True)
class _Costs:
    """Costs of the mean frame: seconds on one core, bytes without and of the expected electrons."""

    seconds: float
    bytes: float
    exr_bytes: float


def forecast(scenario: Scenario, measure: bool = False) -> Forecast:
    """Forecast a scenario from its first frame, which is rendered and discarded; with `measure`, from others as well.

    Raises
    ------
    GeneratorError
        A frame cannot be planned or rendered.
    """
    set_threads(1)
    started = time.perf_counter()
    first = render_frame(scenario, 0)
    first_s = time.perf_counter() - started
    last = scenario.frame_count - 1
    places = sorted({round(last * step / (FRAMES_MEASURED - 1)) for step in range(FRAMES_MEASURED)}) if measure else [0]
    costs = _costs(scenario, places)
    # Each worker also needs the additional time of the first frame: loading Mitsuba, compiling, tables of the lens.
    start_s = AROUND_S + max(first_s - costs.seconds, 0.0)
    cores = os.cpu_count() or 1
    spec = first.plan.spec
    found = outlook(first)
    return Forecast(
        frames=scenario.frame_count,
        width=spec.camera.width,
        height=spec.camera.height,
        bits=spec.sensor.bits,
        catalogue_stars=len(first.plan.stars),
        first=found,
        warnings=warnings_of(spec, found),
        seconds=start_s + SIDE_BY_SIDE * scenario.frame_count * costs.seconds / min(cores, scenario.frame_count),
        bytes=scenario.frame_count * costs.bytes + _imu_bytes(scenario),
        exr_bytes=scenario.frame_count * costs.exr_bytes,
        cores=cores,
        measured=measure,
    )


def _imu_bytes(scenario: Scenario) -> float:
    """Size of the tables of inertial units, if all sequences are as long as the first."""
    if not scenario.has_imu:
        return 0.0
    spec = scenario.sequence(0)
    readings = 0.0 if spec.imu is None else spec.length_s * spec.imu.rate_hz
    return scenario.sequence_count * readings * BYTES_PER_READING


def _costs(scenario: Scenario, places: list[int]) -> _Costs:
    """Measure the costs of rendering frames and of storing them as in a dataset; each is rendered once before it is timed."""
    seconds, size, exr_size = 0.0, 0, 0
    tables: list[dict[str, pa.Table]] = []
    with tempfile.TemporaryDirectory() as folder:
        exr = Path(folder) / "frame.exr"
        for index in places:
            write_exr(exr, render_frame(scenario, index))
            exr_size += exr.stat().st_size
            started = time.perf_counter()
            frame = render_frame(scenario, index, channels=False)
            size += _bytes_in_archive(frame)
            tables.append({"stars": frame.stars, "objects": frame.objects})
            _bytes_of_tables(tables[-1:], Path(folder))
            seconds += time.perf_counter() - started
        size += _bytes_of_tables(tables, Path(folder))
    return _Costs(seconds / len(places), size / len(places), exr_size / len(places))


def _bytes_in_archive(frame: RenderedFrame) -> int:
    """Size of a frame's images and record."""
    members = [
        encode(frame.dn, "png"),
        record_bytes(frame_record(frame.plan, frame.expected, frame.stars)),
        *further_files(frame).values(),
    ]
    return sum(len(member) for member in members)


def _bytes_of_tables(tables: list[dict[str, pa.Table]], folder: Path) -> int:
    """Size of the tables of truth of some frames."""
    for name in tables[0]:
        write_table(folder / name, pa.concat_tables([frame[name] for frame in tables]))
    return sum((folder / name).stat().st_size for name in tables[0])
