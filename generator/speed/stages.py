"""Seconds of each stage of a frame, and of the floor, which is only drawing the noise and compressing the image."""

from __future__ import annotations

import io
import statistics
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from generator.dataset.images import encode
from generator.dataset.table_writer import write_table
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import FramePlan, plan_frame
from generator.frame.record import frame_record, record_bytes, star_table
from generator.frame.scene import frame_layers
from generator.seeds import random_stream
from generator.sensor.detector import expose
from generator.speed.load import best_clock
from generator.speed.scenes import FrameSize, data_set

WARM_UP = 3
REFERENCE_PNG_LEVEL = 1


class Stopwatch:
    """Accumulates the time of blocks of code, by :func:`generator.speed.load.best_clock`."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}
        self._clock = best_clock()

    @contextmanager
    def time(self, name: str) -> Iterator[None]:
        """Time a block."""
        start = self._clock()
        yield
        self.seconds.setdefault(name, []).append(self._clock() - start)

    def medians(self) -> dict[str, float]:
        """Median seconds by name, in the order of first appearance."""
        return {name: statistics.median(values) for name, values in self.seconds.items()}


def time_stages(frames: int, size: FrameSize, codec: str) -> tuple[dict[str, float], dict[str, float]]:
    """Time the stages of some frames of a data set in this process.

    Returns
    -------
    stages, floor : dict of float
        Median seconds by name. The floor's parts are measured on the same frames: ``Generator.poisson``, normal numbers in
        single precision, and a 16-bit PNG by Pillow at level 1.
    """
    scenario = data_set(size, WARM_UP + frames)
    watch, floor = Stopwatch(), Stopwatch()
    with tempfile.TemporaryDirectory() as folder:
        for index in range(WARM_UP + frames):
            if index == WARM_UP:
                watch, floor = Stopwatch(), Stopwatch()
            with watch.time("plan"):
                plan = plan_frame(scenario, index)
            with watch.time("render"):
                expected = render_expected(plan, channels=False)
            with watch.time("of which sky maps"):
                frame_layers(plan)
            with watch.time("noise"):
                dn = _noisy(plan, expected.electrons)
            with watch.time("truth"):
                stars = star_table(plan, expected)
                record_bytes(frame_record(plan, expected, stars))
            with watch.time("image"):
                encode(dn, codec)
            with watch.time("parquet"):
                write_table(Path(folder) / "stars.parquet", stars)
            _time_floor(floor, expected.electrons, dn)
    return watch.medians(), floor.medians()


def _noisy(plan: FramePlan, electrons: NDArray[np.float32]) -> NDArray[np.uint16]:
    seed, index = plan.scenario.seed, plan.index
    return expose(electrons, plan.spec.time.exposure_s, plan.spec.sensor, lambda name: random_stream(seed, name, index))


def _time_floor(floor: Stopwatch, electrons: NDArray[np.float32], dn: NDArray[np.uint16]) -> None:
    random = random_stream(0, "floor", 0)
    with floor.time("poisson"):
        random.poisson(electrons)
    with floor.time("normals"):
        random.standard_normal(electrons.shape, np.float32)
    with floor.time("png"):
        Image.fromarray(dn).save(io.BytesIO(), format="PNG", compress_level=REFERENCE_PNG_LEVEL)
