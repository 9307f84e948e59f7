"""The exposures of a frame's sensor, each with its random streams: one, or those of its video."""

from __future__ import annotations

import numpy as np

from generator.frame.plan import FramePlan
from generator.seeds import random_stream, unit_stream
from generator.sensor.effect import Exposure


def readouts(plan: FramePlan) -> tuple[Exposure, ...]:
    """Return the exposures, equally long, that the sensor reads out one after the other for a frame."""
    seed, index, sensor = plan.scenario.seed, plan.index, plan.spec.sensor
    count = sensor.exposures(plan.spec.time.exposure_s)
    exposure_s = plan.spec.time.exposure_s / count

    def unit(name: str) -> np.random.Generator:
        return unit_stream(seed, sensor.unit, name)

    def exposure(number: int) -> Exposure:
        prefix = "" if sensor.video is None else f"video.{number}."

        def frame(name: str) -> np.random.Generator:
            return random_stream(seed, prefix + name, index)

        return Exposure(exposure_s, frame, unit, plan.start_s + number * exposure_s)

    return tuple(map(exposure, range(count)))
