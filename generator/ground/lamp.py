"""Lamps in view: where they stand, how strong they are, and the light that reaches the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Lamp:
    """A lamp.

    Attributes
    ----------
    azimuth_deg, altitude_deg : float
        Apparent direction.
    distance_m : float
    intensity_cd : float
        Luminous intensity towards the camera.
    downward_cd : float
        Luminous intensity towards the ground, which lights the landscape; that of a source that shines below the
        horizontal alone.
    kind : str
        Name of :func:`generator.light.lamps.lamp_spectra`.
    """

    azimuth_deg: float
    altitude_deg: float
    distance_m: float
    intensity_cd: float
    downward_cd: float
    kind: str = "LED"

    @property
    def illuminance_lx(self) -> float:
        """At the camera, perpendicular to the line of sight, without the air between."""
        return self.intensity_cd / self.distance_m**2

    @property
    def place_m(self) -> Floats:
        """East, north and up of the camera, m, (3,) array."""
        azimuth, altitude = np.radians([self.azimuth_deg, self.altitude_deg])
        direction = [np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)]
        return self.distance_m * np.array(direction)
