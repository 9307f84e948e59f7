"""Inputs of the bake: the air, the wavelengths, the directions and the distances. Their hash identifies the maps."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.light.atmosphere import STANDARD_PRESSURE_HPA, rayleigh_optical_depth
from generator.light.emission import DIRECT_SHARE, FRONTAL_AREA_INDEX, REFLECTED_SHARE

Floats = NDArray[np.float64]
Numbers = tuple[float, ...]

DEFAULT_ALBEDO = 0.15
"""Grey albedo of vegetation and built land."""


@dataclass(frozen=True)
class BakedAir:
    """The air of the radiative transfer: two exponential layers over a flat Lambert ground.

    Attributes
    ----------
    pressure_hpa : float
    rayleigh_height_km, aerosol_height_km : float
        Scale heights. Source of the aerosol's: Masana et al. 2021, MNRAS 501, 5443 (1.54 km).
    angstrom_exponent, aerosol_albedo : float
        Values for continental aerosol; the albedo is that of single scattering (d'Almeida et al. 1991, "Atmospheric
        Aerosols"). The phase function is :func:`generator.light.single_scattering.aerosol_phase`.
    ground_albedo : float
        Albedo of vegetation and built land.
    top_km : float
        Height at which quadratures end.
    """

    pressure_hpa: float = 1013.25
    rayleigh_height_km: float = 8.0
    aerosol_height_km: float = 1.5
    angstrom_exponent: float = 1.3
    aerosol_albedo: float = 0.92
    ground_albedo: float = DEFAULT_ALBEDO
    top_km: float = 60.0


WAVELENGTHS_NM: Numbers = (380.0, 430.0, 480.0, 530.0, 580.0, 640.0, 720.0, 800.0, 900.0)
VIEW_ALTITUDES_DEG: Numbers = (2.0, 3.5, 5.5, 8.0, 11.0, 15.0, 20.0, 27.0, 36.0, 48.0, 62.0, 76.0, 90.0)


@dataclass(frozen=True)
class MoonGrid:
    """Axes of the moonlight map, and parameters of its computation.

    Attributes
    ----------
    aerosol_tau_550, wavelength_nm, moon_altitude_deg, view_altitude_deg, relative_azimuth_deg : tuple of float
    paths, batches : int
        Paths per batch, and batches, for each aerosol depth, wavelength and view altitude; each path serves all places of
        the Moon.
    seed : int
    """

    aerosol_tau_550: Numbers = (0.03, 0.1, 0.3)
    wavelength_nm: Numbers = WAVELENGTHS_NM
    moon_altitude_deg: Numbers = (3.0, 5.0, 8.0, 13.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0)
    view_altitude_deg: Numbers = VIEW_ALTITUDES_DEG
    relative_azimuth_deg: Numbers = (0.0, 15.0, 30.0, 50.0, 75.0, 105.0, 140.0, 180.0)
    paths: int = 16_384
    batches: int = 8
    seed: int = 1


@dataclass(frozen=True)
class CityGrid:
    """Axes of the kernel of a lamp on the ground, and parameters of its computation.

    Attributes
    ----------
    aerosol_tau_550, wavelength_nm, view_altitude_deg : tuple of float
    core_km, farthest_km : float
    distances, azimuths : int
        Number of rings around the observer, equally spaced in log(1 + distance / core) up to the farthest, and of their
        parts, equally spaced in the square root of the azimuth relative to the lamp's.
    paths, batches : int
        Paths per batch, and batches, for each aerosol depth, wavelength and view altitude; each path serves all places of
        the lamp.
    seed : int
    built_up : tuple of float
        Direct and reflected share and frontal area index of :func:`generator.light.emission.built_up`.
    """

    aerosol_tau_550: Numbers = (0.03, 0.1, 0.3)
    wavelength_nm: Numbers = WAVELENGTHS_NM
    view_altitude_deg: Numbers = VIEW_ALTITUDES_DEG
    core_km: float = 2.0
    farthest_km: float = 180.0
    distances: int = 36
    azimuths: int = 12
    paths: int = 524_288
    batches: int = 8
    seed: int = 2
    built_up: Numbers = (DIRECT_SHARE, REFLECTED_SHARE, FRONTAL_AREA_INDEX)

    def scale(self, distance_km: ArrayLike) -> Floats:
        """Scale on which rings are equally spaced."""
        return np.log1p(np.asarray(distance_km, float) / self.core_km)

    @property
    def edges(self) -> tuple[Floats, Floats]:
        """Edges of the rings, km, and of their parts, deg."""
        rings = self.core_km * np.expm1(self.scale(self.farthest_km) * np.linspace(0, 1, self.distances + 1))
        return rings, 180 * np.linspace(0, 1, self.azimuths + 1) ** 2


@dataclass(frozen=True)
class GroundGrid:
    """Parameters of the separate computation of light that the ground reflects; rings and their edges are those of CityGrid.

    Attributes
    ----------
    aerosol_tau_550, wavelength_nm, view_altitude_deg : tuple of float
    paths, batches : int
        Paths per batch, and batches, for each aerosol depth, wavelength and view altitude.
    seed : int
    city : CityGrid
    """

    aerosol_tau_550: Numbers = (0.03, 0.1, 0.3)
    wavelength_nm: Numbers = WAVELENGTHS_NM
    view_altitude_deg: Numbers = VIEW_ALTITUDES_DEG
    paths: int = 65_536
    batches: int = 4
    seed: int = 3
    city: CityGrid = CityGrid()


@dataclass(frozen=True)
class TwilightGrid:
    """Axes of the map of multiply scattered twilight, and parameters of its computation.

    Monochromatic light depends on the air only through its optical depths, so these are the axes instead of wavelength.

    Attributes
    ----------
    observer_km : tuple of float
        Heights above sea level, which coincide with heights of the profiles.
    aerosol_tau : tuple of float
        Depths of the aerosol above the observer.
    rayleigh_tau : tuple of float
        Depths above sea level, corresponding to wavelengths from 1,100 to 345 nm.
    view_altitude_deg, depression_deg, relative_azimuth_deg : tuple of float
    ozone_tau : tuple of float
    stratosphere_tau_550, stratosphere_exponent : float
        Optical depth and Angstrom's exponent of the stratosphere's aerosol throughout the map. In the quiet years 1998 to
        2004 the depth was 0.003 to 0.005 (Sato et al. 1993 as continued; Vernier et al. 2011); the exponent is of the
        order of SAGE II's ratio of 525 to 1020 nm, 3 to 4.
    paths, batches : int
        Paths per batch, and batches, for each height, aerosol, Rayleigh depth and view; each path serves all places of
        the Sun.
    seed : int
    """

    observer_km: Numbers = (0.0, 4.0, 12.0)
    aerosol_tau: Numbers = (0.02, 0.1, 0.3)
    rayleigh_tau: Numbers = (0.006, 0.015, 0.035, 0.08, 0.16, 0.32, 0.65)
    view_altitude_deg: Numbers = (0.0, 2.0, 5.0, 10.0, 18.0, 30.0, 45.0, 65.0, 90.0)
    depression_deg: Numbers = (0.0, 1.5, 3.0, 4.5, 6.0, 7.5, 9.0, 10.5, 12.0, 14.0, 16.0, 18.0)
    relative_azimuth_deg: Numbers = (0.0, 25.0, 60.0, 100.0, 140.0, 180.0)
    ozone_tau: Numbers = (0.0, 0.02, 0.05)
    stratosphere_tau_550: float = 0.004
    stratosphere_exponent: float = 1.8
    paths: int = 2_048
    batches: int = 4
    seed: int = 3

    def stratosphere_tau(self, wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Optical depth of the stratosphere's aerosol."""
        return self.stratosphere_tau_550 * (np.asarray(wavelength_nm) / 550.0) ** -self.stratosphere_exponent

    def stratosphere_at(self, rayleigh_tau: float) -> float:
        """Optical depth of the stratosphere's aerosol at the wavelength of a given Rayleigh depth of air from sea level."""
        nm = np.linspace(300.0, 1200.0, 9001)
        found = np.interp(-rayleigh_tau, -rayleigh_optical_depth(nm, STANDARD_PRESSURE_HPA), nm)
        return float(self.stratosphere_tau(np.array(found)))


Grid = MoonGrid | CityGrid | GroundGrid | TwilightGrid


def content_hash(air: BakedAir, grid: Grid) -> str:
    """SHA-256 of everything that determines a map's values."""
    meaning = {"format": 2, "air": dataclasses.asdict(air), type(grid).__name__: dataclasses.asdict(grid)}
    return hashlib.sha256(json.dumps(meaning, sort_keys=True).encode()).hexdigest()
