"""The diffuse night sky: airglow and artificial skyglow, as spectra and as functions of the zenith angle.

Each component's ground-level radiance is a spectrum times a function of direction. The zenith's total brightness is the
scenario's: airglow gives the natural part, artificial skyglow the rest.
"""

from __future__ import annotations

import csv
import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.atmosphere import Atmosphere, airmass, optical_depth
from generator.errors import DataFileError
from generator.photometry import BESSELL_V, GRID_NM, radiance_from_surface_brightness

Floats = NDArray[np.float64]

LAMPS_PATH = Path(__file__).parent / "data" / "lamps.csv"

BORTLE_ZENITH_MAG = {1: 21.99, 2: 21.80, 3: 21.50, 4: 21.05, 5: 20.40, 6: 19.55, 7: 18.55, 8: 17.50, 9: 16.50}
"""Zenith surface brightness of a Bortle class, V mag/arcsec^2, natural light included. Bortle's scale is visual and
published mappings differ by about 1 mag for classes 4 to 9; this table is skybench's convention (docs/physics.md)."""

NATURAL_ZENITH_MAG = 22.0
"""Natural sky at the zenith, V mag/arcsec^2 (174 ucd/m^2). Source: Falchi et al. 2016, Sci. Adv. 2, e1600377."""

AIRGLOW_LAYER_KM = 87.0
EARTH_RADIUS_KM = 6378.0
DIFFUSE_EXTINCTION_FACTOR = 0.75
"""Effective optical depth of diffuse light over that of a star: light scattered out of one line of sight is partly made up
for by light scattered in. Source: Kwon et al. 2004, New Astronomy 10, 91; published values run from 0.5 to 0.9."""

ARTIFICIAL_AIRMASS_EXPONENT = 0.78
"""Artificial skyglow inside a city goes as airmass to this power: radiance over zenith 1.22, 1.71 and 3.83 at 40, 60 and 80
deg, against 1.25, 1.78 and 3.7 in a radiative transfer calculation (10 km city, Rayleigh 0.097 and aerosol 0.10)."""

LAMP_MIX = {"HPS": 0.5, "LED": 0.5}
"""Shares of the light of a town, in V-band photons: high-pressure sodium and white light-emitting diodes."""

# Airglow at the zenith and 130 solar flux units: continuum as (nm, photons s^-1 cm^-2 A^-1 arcsec^-2) through the
# broad-band brightness of ESO's sky model (B 23.06, V 22.01, R 21.10, I 19.55 less the lines), and lines as (nm, rayleigh).
# Source: Noll et al. 2012, A&A 543, A92.
_AIRGLOW_CONTINUUM = [(350, 7.0e-7), (440, 8.3e-7), (550, 1.10e-6), (641, 2.2e-6), (798, 6.85e-6), (1000, 8.5e-6)]
_AIRGLOW_LINES = [(557.7, 218.0), (589.3, 48.0), (630.0, 165.0), (636.4, 44.0)]
_PHOTONS_CM2_SR_PER_RAYLEIGH = 1e6 / (4 * np.pi)


@dataclass(frozen=True)
class DiffuseSky:
    """Spectra of the diffuse sky at ground level, photons s^-1 m^-2 nm^-1 sr^-1 at GRID_NM.

    Attributes
    ----------
    airglow : (n,) array
        At the zenith *above* the atmosphere.
    artificial : (n,) array
        At the zenith, at the ground.
    diffuse_optical_depth : (n,) array
        Vertical optical depth that acts on the airglow.
    """

    airglow: Floats
    artificial: Floats
    diffuse_optical_depth: Floats

    def radiance(self, apparent_altitude_deg: ArrayLike) -> Floats:
        """Radiance at the ground, (m, n) array for m altitudes; zero below the horizon."""
        altitude = np.atleast_1d(np.asarray(apparent_altitude_deg, float))[:, None]
        path = airmass(altitude)
        glow = self.airglow * van_rhijn(90 - altitude) * np.exp(-self.diffuse_optical_depth * path)
        city = self.artificial * (path / airmass(90.0)) ** ARTIFICIAL_AIRMASS_EXPONENT
        return np.where(altitude >= 0, glow + city, 0.0)


def van_rhijn(zenith_angle_deg: ArrayLike, layer_km: float = AIRGLOW_LAYER_KM) -> Floats:
    """Brightening of a thin glowing layer away from the zenith. Source: van Rhijn 1921, Publ. Astr. Lab. Groningen 31."""
    sine = EARTH_RADIUS_KM / (EARTH_RADIUS_KM + layer_km) * np.sin(np.radians(np.asarray(zenith_angle_deg, float)))
    return 1 / np.sqrt(1 - sine**2)


@functools.cache
def airglow_shape() -> Floats:
    """Relative photon spectrum of the airglow at GRID_NM; each line is spread over the grid interval that holds it."""
    nodes = np.array(_AIRGLOW_CONTINUUM)
    spectrum = np.exp(np.interp(GRID_NM, nodes[:, 0], np.log(nodes[:, 1])))
    spacing = GRID_NM[1] - GRID_NM[0]
    arcsec2_to_sr = np.radians(1 / 3600) ** 2
    for wavelength, rayleigh in _AIRGLOW_LINES:
        line = rayleigh * _PHOTONS_CM2_SR_PER_RAYLEIGH * arcsec2_to_sr
        position = (wavelength - GRID_NM[0]) / spacing
        lower = int(position)
        spectrum[lower] += line * (1 - position + lower) / (10 * spacing)
        spectrum[lower + 1] += line * (position - lower) / (10 * spacing)
    return spectrum


@functools.cache
def lamp_spectra() -> dict[str, Floats]:
    """Photon spectra of street lamps at GRID_NM, each with a V-band mean of 1; zero beyond the tables' 780 nm."""
    try:
        with LAMPS_PATH.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
        wavelength = np.array([float(row["wavelength_nm"]) for row in rows])
        power = {name: np.array([float(row[name]) for row in rows]) for name in LAMP_MIX}
    except (OSError, KeyError, ValueError) as error:
        raise DataFileError(f"{LAMPS_PATH}: not a table of lamp spectra ({error}); reinstall skybench") from error
    photons = {name: np.interp(GRID_NM, wavelength, watts * wavelength, right=0) for name, watts in power.items()}
    return {name: spectrum / BESSELL_V.mean(GRID_NM, spectrum) for name, spectrum in photons.items()}


def diffuse_sky(zenith_mag: float | None, atmosphere: Atmosphere | None) -> DiffuseSky:
    """Spectra of a sky of given brightness at the zenith.

    Parameters
    ----------
    zenith_mag : float or None
        Total surface brightness of the zenith at the ground, V mag/arcsec^2; None is a black sky. Airglow gives
        NATURAL_ZENITH_MAG of it, or all of it in a darker sky.
    atmosphere : Atmosphere or None
        None: no extinction.

    Returns
    -------
    DiffuseSky
    """
    depth = np.zeros_like(GRID_NM)
    if atmosphere is not None:
        depth = DIFFUSE_EXTINCTION_FACTOR * optical_depth(GRID_NM, atmosphere)
    if zenith_mag is None:
        return DiffuseSky(np.zeros_like(GRID_NM), np.zeros_like(GRID_NM), depth)
    total = float(radiance_from_surface_brightness(zenith_mag))
    natural = min(total, float(radiance_from_surface_brightness(NATURAL_ZENITH_MAG)))
    seen = airglow_shape() * np.exp(-depth * airmass(90.0))
    airglow = airglow_shape() * natural / BESSELL_V.mean(GRID_NM, seen)
    lamps = sum(share * lamp_spectra()[name] for name, share in LAMP_MIX.items())
    return DiffuseSky(airglow, (total - natural) * np.asarray(lamps), depth)
