"""What a scenario would make: how many frames, what they would be, how long it would take, how large it would be."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from generator.dataset.images import encode
from generator.dataset.table_writer import write_table
from generator.frame.outlook import Outlook, outlook, warnings_of
from generator.frame.record import frame_record, record_bytes
from generator.frame.render import RenderedFrame, render_frame, write_exr
from generator.mitsuba_runtime import set_threads
from generator.scenario.file import Scenario

BYTES_PER_READING = 125
"""Of an inertial unit, compressed."""
WORKER_START_S = 4.0
"""Until a worker has loaded Mitsuba and compiled its first kernels, on one core of 2020s hardware."""
FRAMES_MEASURED = 4


@dataclass(frozen=True)
class Forecast:
    """Forecast of a scenario.

    Attributes
    ----------
    frames : int
    width, height, bits : int
        Of the first frame.
    catalogue_stars : int
        Stars and planets above the first frame's horizon and above the list's limit.
    first : Outlook
        The first frame in numbers.
    warnings : tuple of str
        What in the first frame's values looks like a slip.
    seconds : float
        Of `skybench generate`, with all cores.
    bytes : float
        Images, records and tables.
    exr_bytes : float
        The expected electrons beside them.
    cores : int
    measured : bool
        Whether time and size come from frames over the whole scenario, not from the first alone.
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
class _Cost:
    """Of a frame: seconds on one core, bytes without and of the expected electrons."""

    seconds: float
    bytes: int
    exr_bytes: int


def forecast(scenario: Scenario, measure: bool = False) -> Forecast:
    """Forecast a scenario from its first frame, rendered here and thrown away; with `measure`, from others as well.

    Raises
    ------
    GeneratorError
        A frame cannot be planned or rendered.
    """
    set_threads(1)
    first = render_frame(scenario, 0)  # which also compiles the kernels
    last = scenario.frame_count - 1
    places = sorted({round(last * step / (FRAMES_MEASURED - 1)) for step in range(FRAMES_MEASURED)}) if measure else [0]
    costs = [_cost(scenario, place) for place in places]
    seconds, size, exr_size = (
        sum(values) / len(costs) for values in zip(*((c.seconds, c.bytes, c.exr_bytes) for c in costs), strict=True)
    )
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
        seconds=WORKER_START_S + scenario.frame_count * seconds / min(cores, scenario.frame_count),
        bytes=scenario.frame_count * size + _imu_bytes(scenario),
        exr_bytes=scenario.frame_count * exr_size,
        cores=cores,
        measured=measure,
    )


def _imu_bytes(scenario: Scenario) -> float:
    """Of the tables of inertial units, all sequences taken as long as the first."""
    if not scenario.has_imu:
        return 0.0
    spec = scenario.sequence(0)
    readings = 0.0 if spec.imu is None else spec.length_s * spec.imu.rate_hz
    return scenario.sequence_count * readings * BYTES_PER_READING


def _cost(scenario: Scenario, index: int) -> _Cost:
    """What a frame costs to render and to store as a dataset stores it."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        started = time.perf_counter()
        frame = render_frame(scenario, index, channels=False)
        size = _store(frame, place)
        seconds = time.perf_counter() - started
        write_exr(place / "frame.exr", render_frame(scenario, index))
        return _Cost(seconds, size, (place / "frame.exr").stat().st_size)


def _store(frame: RenderedFrame, folder: Path) -> int:
    """Store a frame's image, record and tables; returns bytes."""
    members = [encode(frame.dn, "png"), record_bytes(frame_record(frame.plan, frame.expected, frame.stars))]
    tables = {"stars": frame.stars, "objects": frame.objects}
    for name, table in tables.items():
        write_table(folder / name, table)
    return sum(len(member) for member in members) + sum((folder / name).stat().st_size for name in tables)
