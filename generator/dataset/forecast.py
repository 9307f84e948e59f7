"""What a scenario would make: how many frames, how long it would take, how large it would be."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from generator.dataset.images import encode
from generator.dataset.table_writer import write_table
from generator.frame.plan import plan_frame
from generator.frame.record import frame_record, record_bytes
from generator.scenario.file import Scenario

SECONDS_PER_MEGAPIXEL = 0.11
SECONDS_PER_FRAME = 0.07
BYTES_PER_PIXEL = 0.75
BYTES_PER_STAR = 140
SHARE_IN_FIELD = 0.7
"""Roughly what a frame costs on one core of 2020s hardware, where nothing is measured."""
FRAMES_MEASURED = 2


@dataclass(frozen=True)
class Forecast:
    """What a scenario would make.

    Attributes
    ----------
    frames : int
    width, height, bits : int
        Of the first frame.
    catalogue_stars : int
        Stars and planets above the first frame's horizon and above the list's limit.
    seconds : float
        With all cores.
    bytes : float
        Images, records and tables.
    cores : int
    measured : bool
        Whether time and size come from frames rendered for it.
    """

    frames: int
    width: int
    height: int
    bits: int
    catalogue_stars: int
    seconds: float
    bytes: float
    cores: int
    measured: bool


def forecast(scenario: Scenario, measure: bool = False) -> Forecast:
    """Forecast a scenario from its first frame's plan; with `measure`, from frames rendered here and thrown away.

    Raises
    ------
    GeneratorError
        A frame cannot be planned or rendered.
    """
    first = plan_frame(scenario, 0)
    camera = first.spec.camera
    megapixels = camera.width * camera.height / 1e6
    seconds = SECONDS_PER_FRAME + megapixels * SECONDS_PER_MEGAPIXEL
    size = 1e6 * megapixels * BYTES_PER_PIXEL + SHARE_IN_FIELD * len(first.stars) * BYTES_PER_STAR
    if measure:
        seconds, size = _measured(scenario)
    cores = os.cpu_count() or 1
    return Forecast(
        frames=scenario.frame_count,
        width=camera.width,
        height=camera.height,
        bits=first.spec.sensor.bits,
        catalogue_stars=len(first.stars),
        seconds=scenario.frame_count * seconds / min(cores, scenario.frame_count),
        bytes=scenario.frame_count * size,
        cores=cores,
        measured=measure,
    )


def _measured(scenario: Scenario) -> tuple[float, float]:
    """Seconds on one core and bytes of a frame: means over frames spread over the scenario, after one that warms up."""
    from generator.frame.render import render_frame
    from generator.mitsuba_runtime import set_threads

    set_threads(1)
    render_frame(scenario, 0)
    last = scenario.frame_count - 1
    seconds, size = 0.0, 0
    for index in (last // 3, last):
        with tempfile.TemporaryDirectory() as folder:
            started = time.perf_counter()
            frame = render_frame(scenario, index)
            members = [
                encode(frame.dn, "png"),
                record_bytes(frame_record(frame.plan, frame.expected, frame.stars.num_rows)),
            ]
            for name, table in (("stars", frame.stars), ("objects", frame.objects)):
                write_table(Path(folder) / name, table)
            seconds += time.perf_counter() - started
            size += sum(len(member) for member in members)
            size += sum(file.stat().st_size for file in Path(folder).iterdir())
    return seconds / FRAMES_MEASURED, size / FRAMES_MEASURED
