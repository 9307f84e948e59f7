"""The frames of a video within an exposure: expected light that follows the sky, and the sensor's noise in each of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.frame.exposure.expected import render_expected
from generator.frame.exposure.parts import plan_part, without_sky
from generator.frame.exposure.readouts import readouts
from generator.frame.plan import SKY_RATE_DEG_S, FramePlan
from generator.scenario.processing.video_spec import VideoSpec
from generator.sensor.charge import PhotoResponse
from generator.sensor.colour import filter_array
from generator.sensor.detector import effects
from generator.sensor.develop import demosaic
from generator.sensor.effect import Effect, Exposure, Floats, NoiseStream
from generator.sensor.processing import averaged, denoised, sharpened
from generator.sensor.readout import FixedLines, FixedOffset
from generator.sensor.sunburn import burnt_pixels

Picture = NDArray[np.uint8]

SLICE_STEP_PX = 0.1
"""Motion of the sky, px, during which a star is taken to stand still."""
MOST_SLICES = 32
LARGEST_BALANCE = 16.0
"""Largest factor of the white balance."""


def video_frames(plan: FramePlan, spec: VideoSpec) -> Iterator[Picture]:
    """The 8-bit frames of a video, before any codec: (height, width) uint8 arrays, or (height, width, 3) for a colour sensor.

    The exposure is divided into parts in which stars and sky move by less than SLICE_STEP_PX, but into at most
    MOST_SLICES parts and at most one per frame. Frames within one part have the same expectation and individual noise.
    Trails, satellites and meteors are rendered for each frame in which they shine.
    """
    exposures = readouts(plan)
    count = len(exposures)
    resting = replace(plan, objects=plan.objects.chosen(np.zeros(len(plan.objects), bool)))
    slices = slice_count(plan, count)
    sensor = plan.spec.sensor
    shape = (plan.spec.camera.height, plan.spec.camera.width)
    unit = exposures[0].unit
    sensing = _Sensing.of(effects(sensor, burnt_pixels(plan.lens, sensor, unit)), shape, unit)
    current, light, before = -1, np.zeros(shape, np.float32), None
    balance = spec.white_balance
    for number, exposure in enumerate(exposures):
        part = number * slices // count
        if part != current:
            expected = render_expected(plan_part(resting, part / slices, (part + 1) / slices), channels=False)
            light = expected.electrons * np.float32(slices / count)
            current = part
            if balance is None and sensor.colour is not None:
                balance = grey_sky(light, sensor.colour.pattern)
        moving = moving_light(plan, number / count, (number + 1) / count)
        electrons = light if moving is None else light + moving
        shares = sensing.dn(electrons, exposure) * np.float32(spec.exposure / (2**sensor.bits - 1))
        if sensor.colour is not None and balance is not None:
            black = sensor.black_level_dn * spec.exposure / (2**sensor.bits - 1)
            shares = in_colour(shares, black, sensor.colour.pattern, balance)
        before = averaged(denoised(shares, spec.denoise), before, spec.denoise)
        yield eight_bit(before, spec)


def grey_sky(light: Floats, pattern: str) -> tuple[float, float, float]:
    """Factors on red, green, blue that bring the median expected light of each colour to that of green.

    They are those of a camera's automatic white balance once it has settled, limited to between 1 / LARGEST_BALANCE and
    LARGEST_BALANCE.
    """
    channel = filter_array(pattern, *light.shape)
    blue, green, red = (float(np.median(light[channel == number])) for number in range(3))
    if min(red, green, blue) <= 0:
        return 1.0, 1.0, 1.0
    least, largest = 1 / LARGEST_BALANCE, LARGEST_BALANCE
    return min(max(green / red, least), largest), 1.0, min(max(green / blue, least), largest)


def in_colour(shares: Floats, black: float, pattern: str, balance: tuple[float, float, float]) -> Floats:
    """Convert fractions of white (height, width) of a filter array to red, green, blue (height, width, 3), same black."""
    light = demosaic((shares - np.float32(black)).astype(np.float64), pattern) * np.array(balance)
    return (light + black).astype(np.float32)


def slice_count(plan: FramePlan, count: int) -> int:
    """Number of parts of an exposure in which the sky is taken to stand still; one per frame if the camera turns."""
    if len(plan.motion.R_cam) > 1:
        return count
    way_px = math.radians(SKY_RATE_DEG_S * plan.spec.time.exposure_s) * plan.spec.camera.f_px
    return int(np.clip(math.ceil(way_px / SLICE_STEP_PX), 1, min(MOST_SLICES, count)))


def moving_light(plan: FramePlan, start: float, stop: float) -> Floats | None:
    """Expected electrons of flying objects in a part of the exposure; None if none shines."""
    if not len(plan.objects):
        return None
    part = plan_part(plan, start, stop)
    shining = part.objects.shining
    if not shining.any():
        return None
    alone = replace(without_sky(part), objects=part.objects.chosen(shining))
    # Lamps, windows and the landscape's own light belong to the stationary light.
    return render_expected(alone, layers=True, channels=False).layers.get("objects")


@dataclass(frozen=True)
class _Map:
    """A fixed pattern, computed once: signal x factor + offset."""

    factor: Any
    offset: Any

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Apply the map to a signal."""
        del exposure
        return signal * self.factor + self.offset


@dataclass(frozen=True)
class _Sensing:
    """A sensor's chain of effects with its fixed patterns as maps, for many exposures."""

    chain: tuple[Effect, ...]

    @classmethod
    def of(cls, acting: Sequence[Effect], shape: tuple[int, int], unit: NoiseStream) -> _Sensing:
        """Compute the maps of the sensor's effects."""
        once = Exposure(1.0, unit, unit)
        chain: list[Effect] = []
        for effect in acting:
            if isinstance(effect, PhotoResponse):
                chain.append(_Map(effect.apply(np.ones(shape, np.float32), once), np.float32(0)))
            elif isinstance(effect, FixedOffset | FixedLines):
                chain.append(_Map(np.float32(1), effect.apply(np.zeros(shape, np.float32), once)))
            else:
                chain.append(effect)
        return cls(tuple(chain))

    def dn(self, electrons: Floats, exposure: Exposure) -> Floats:
        """DN of one exposure."""
        signal = electrons
        for effect in self.chain:
            signal = effect.apply(signal, exposure)
        return signal


def eight_bit(light: Floats, spec: VideoSpec) -> Picture:
    """Convert fractions of white, (height, width) or (height, width, 3), to 8-bit values: sharpening, then transfer curve."""
    light = np.clip(sharpened(light, spec.sharpen), 0, 1)
    if spec.gamma != 1:
        light = light ** np.float32(1 / spec.gamma)
    return np.rint(255 * light).astype(np.uint8)
