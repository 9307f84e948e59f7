"""Lamps in view: their places, their intensities, and the light that reaches the camera."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.light.atmosphere import MAG_PER_OPTICAL_DEPTH, Atmosphere, aerosol_optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import BakedAir
from generator.light.lamps import lamp_spectra, luminous
from generator.light.photometry import BESSELL_V, GRID_NM

Floats = NDArray[np.float64]


RED_NM, RED_WIDTH_NM = 630.0, 8.0
"""Centre and standard deviation of the spectrum of a red light-emitting diode (AlGaInP: 18 to 20 nm at half height)."""
KINDS = ("HPS", "LED", "LED3000", "MH", "mercury", "red")
VISUAL_NM = 550.0


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
        Luminous intensity towards the ground, which lights the landscape; it is that of a source that shines only below
        the horizontal.
    kind : str
        Kind of :func:`spectrum`.
    """

    azimuth_deg: float
    altitude_deg: float
    distance_m: float
    intensity_cd: float
    downward_cd: float
    kind: str = "LED"

    @property
    def illuminance_lx(self) -> float:
        """Illuminance at the camera, perpendicular to the line of sight, without the air in between."""
        return self.intensity_cd / self.distance_m**2

    @property
    def place_m(self) -> Floats:
        """Place east, north and up of the camera, m, (3,) array."""
        azimuth, altitude = np.radians([self.azimuth_deg, self.altitude_deg])
        direction = [np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)]
        return self.distance_m * np.array(direction)


@functools.cache
def spectrum(kind: str) -> Floats:
    """Photon spectrum of a kind of lamp at GRID_NM with a V-band mean of 1, (n,) array."""
    if kind != "red":
        return lamp_spectra()[kind]
    photons = np.exp(-0.5 * ((GRID_NM - RED_NM) / RED_WIDTH_NM) ** 2)
    return np.asarray(photons / BESSELL_V.mean(GRID_NM, photons))


def spectra() -> Floats:
    """Photon spectra of all KINDS as those of a star of V = 0, photons s^-1 m^-2 nm^-1, (kinds, n) array."""
    return BESSELL_V.zero_point * np.array([spectrum(kind) for kind in KINDS])


def apparent_v_mag(lamps: tuple[Lamp, ...], air: Atmosphere | None) -> Floats:
    """V at the camera from the illuminance, dimmed by the air's extinction at the ground at 550 nm, (n,) array."""
    lux = np.array([lamp.illuminance_lx for lamp in lamps])
    of_v_zero = dict(zip(KINDS, luminous(spectra()), strict=True))
    kilometres = np.array([lamp.distance_m for lamp in lamps]) / 1000
    magnitude = -2.5 * np.log10(lux / np.array([of_v_zero[lamp.kind] for lamp in lamps]))
    return np.asarray(magnitude + MAG_PER_OPTICAL_DEPTH * extinction_per_km(air) * kilometres)


def extinction_per_km(air: Atmosphere | None) -> float:
    """Extinction of the air at the ground at VISUAL_NM; 0 without air."""
    if air is None:
        return 0.0
    nm, layers = np.array([VISUAL_NM]), BakedAir()
    gas = rayleigh_optical_depth(nm, air.pressure_hpa) / layers.rayleigh_height_km
    aerosol = aerosol_optical_depth(nm, air.aerosol_tau_550, air.angstrom_exponent) / layers.aerosol_height_km
    return float((gas + aerosol)[0])
