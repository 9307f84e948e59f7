"""Pixels burnt by the Sun: traps that retain a fixed charge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.scenario.camera_spec import CameraSpec
from generator.scenario.sensor_spec import SensorSpec
from generator.sensor.effect import Exposure, Floats, NoiseStream
from generator.sensor.sun_path import sun_minutes


@dataclass(frozen=True, eq=False)
class TrappedCharge:
    """Pixels that retain part of their charge in each exposure.

    Traps hold a fixed charge, so a pixel loses a large fraction of a weak signal and a small fraction of a strong one
    (Janesick 2001, Scientific Charge-Coupled Devices, chapter 5; dark pixels where X-rays damaged the CCD of Yohkoh's
    telescope, Acton 1997). They are filled to the fraction n / (n + half_full_e), where n is the charge that remains free
    (the steady state of capture and emission: Shockley & Read 1952, Phys. Rev. 87, 835).

    Attributes
    ----------
    places : (n,) array
        Flat indices of the pixels.
    room_e : (n,) array
        Electrons that all traps of each pixel can hold.
    half_full_e : float
    """

    places: NDArray[np.intp]
    room_e: Floats
    half_full_e: float

    def held_e(self, charge: Floats) -> Floats:
        """Electrons retained from the charge of each of these pixels, (..., n) array."""
        whole = charge + self.room_e + np.float32(self.half_full_e)
        return (whole - np.sqrt(np.maximum(whole * whole - 4 * self.room_e * charge, 0))) / 2

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Remove the retained charge."""
        del exposure
        result = signal.copy()
        pixels = result.reshape(*signal.shape[:-2], -1)
        pixels[..., self.places] -= self.held_e(pixels[..., self.places])
        return result


def burnt_pixels(camera: CameraSpec, sensor: SensorSpec, unit: NoiseStream) -> TrappedCharge | None:
    """The pixels of this particular sensor that the Sun burnt; None if there are none, or without noise.

    The number of traps is Poisson, with a mean proportional to the minutes in the Sun's image, and each can hold an
    exponentially distributed charge. This law fits an all-sky camera's pixels (docs/physics.md).
    """
    burn = sensor.sunburn
    if burn is None or not sensor.noise:
        return None
    minutes = sun_minutes(burn, camera).ravel()
    crossed = np.flatnonzero(minutes)
    random = unit("sunburn")
    traps = random.poisson(burn.traps_per_min * minutes[crossed].astype(np.float64))
    burnt = traps > 0
    room_e = (burn.trap_e * random.standard_gamma(traps[burnt])).astype(np.float32)
    return TrappedCharge(crossed[burnt], room_e, burn.half_full_e)
