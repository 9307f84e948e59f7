"""What is baked: the air, the wavelengths, the directions and the distances. Their hash names the maps."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class BakedAir:
    """The air of the radiative transfer: two exponential layers over a flat Lambert ground.

    Attributes
    ----------
    pressure_hpa : float
    rayleigh_height_km, aerosol_height_km : float
        Scale heights. Source of the aerosol's: Masana et al. 2021, MNRAS 501, 5443 (1.54 km).
    angstrom_exponent, aerosol_albedo, aerosol_asymmetry : float
        Single-scattering albedo, and the asymmetry of a Henyey-Greenstein phase function: continental aerosol
        (d'Almeida et al. 1991, "Atmospheric Aerosols").
    ground_albedo : float
        Of vegetation and built land.
    top_km, half_width_km : float
        The box that holds the air; 4,000 km stand in for an infinite plane.
    """

    pressure_hpa: float = 1013.25
    rayleigh_height_km: float = 8.0
    aerosol_height_km: float = 1.5
    angstrom_exponent: float = 1.3
    aerosol_albedo: float = 0.92
    aerosol_asymmetry: float = 0.70
    ground_albedo: float = 0.15
    top_km: float = 60.0
    half_width_km: float = 2000.0


WAVELENGTHS_NM: Numbers = (380.0, 430.0, 480.0, 530.0, 580.0, 640.0, 720.0, 800.0, 900.0)


@dataclass(frozen=True)
class MoonGrid:
    """Axes of the moonlight map, and how it is computed.

    Attributes
    ----------
    aerosol_tau_550, wavelength_nm, moon_altitude_deg, view_altitude_deg, relative_azimuth_deg : tuple of float
    paths : int
        Per cell.
    seed : int
    """

    aerosol_tau_550: Numbers = (0.03, 0.1, 0.3)
    wavelength_nm: Numbers = WAVELENGTHS_NM
    moon_altitude_deg: Numbers = (5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0)
    view_altitude_deg: Numbers = (2.0, 4.0, 7.0, 11.0, 16.0, 23.0, 32.0, 45.0, 60.0, 75.0, 90.0)
    relative_azimuth_deg: Numbers = (0.0, 15.0, 30.0, 50.0, 75.0, 105.0, 140.0, 180.0)
    paths: int = 2048
    seed: int = 1


@dataclass(frozen=True)
class CityGrid:
    """Axes of the kernel of a small disk of lamps.

    Attributes
    ----------
    aerosol_tau_550 : float
    wavelength_nm, distance_km, view_altitude_deg, relative_azimuth_deg : tuple of float
        Azimuth relative to the lamps' direction.
    disk_radius_km : float
    paths : int
        Per cell.
    seed : int
    """

    aerosol_tau_550: float = 0.1
    wavelength_nm: Numbers = WAVELENGTHS_NM
    distance_km: Numbers = (0, 1, 2, 3, 4, 6, 8, 10, 13, 17, 22, 28, 36, 46, 60, 80)
    view_altitude_deg: Numbers = (2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0)
    relative_azimuth_deg: Numbers = (0.0, 10.0, 20.0, 40.0, 60.0, 90.0, 130.0, 180.0)
    disk_radius_km: float = 2.0
    paths: int = 16384
    seed: int = 2


def content_hash(air: BakedAir, grid: MoonGrid | CityGrid) -> str:
    """SHA-256 of everything that decides a map's values."""
    meaning = {"format": 1, "air": dataclasses.asdict(air), type(grid).__name__: dataclasses.asdict(grid)}
    return hashlib.sha256(json.dumps(meaning, sort_keys=True).encode()).hexdigest()
