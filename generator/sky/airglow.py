"""Airglow: the spectrum of ESO's sky model from published values, emitted by two thin layers."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.light.atmosphere import Atmosphere
from generator.light.photometry import GRID_NM
from generator.places.earth import EQUATORIAL_RADIUS_KM
from generator.sky.component import SkyTable, above_the_air, total
from generator.sky.directions import sky_grid

Floats = NDArray[np.float64]

LOWER_LAYER_KM, UPPER_LAYER_KM = 87.0, 250.0
"""Heights of the layers: OH, Na, O2 and 557.7 nm come from the lower one, the red lines of oxygen from the upper one."""

REFERENCE_SOLAR_FLUX_SFU = 130.0
ARCSEC2_IN_SR = np.radians(1 / 3600) ** 2
PHOTONS_CM2_SR_PER_RAYLEIGH = 1e6 / (4 * np.pi)

# Airglow at the zenith and 130 solar flux units without its atomic lines, photons s^-1 cm^-2 A^-1 arcsec^-2. Source: ESO's
# sky model, Noll et al. 2012, A&A 543, A92; Jones et al. 2013, A&A 560, A91 (public SkyCalc tool).
_CONTINUUM = [(350, 7.0e-7), (440, 8.3e-7), (550, 1.10e-6), (597.5, 1.25e-6)]
"""Points (nm, radiance) up to 597.5 nm, fitted to the model's broad-band brightness (B 23.06, V 22.01 without the lines)."""
_BANDS_FROM_600 = [
    136, 128, 123, 139, 142, 216, 150, 166, 123, 145, 171, 193, 151, 113, 102, 102, 102, 329, 188, 261,
    170, 142, 131, 140, 128, 461, 645, 595, 268, 285, 253, 418, 305, 288, 589, 654, 870, 825, 878, 668,
    695, 582, 288, 252, 236, 239, 1133, 1204, 1074, 1316, 619, 534, 451, 1300, 535, 1286, 1054, 2695, 2282, 1374,
    1023, 672, 508, 471, 386, 400, 1747, 1209, 3217, 2128, 2172, 1066, 609, 565, 2442, 683, 3252, 2343, 2406, 4074,
    2522,
]  # fmt: skip
"""Hydroxyl's Meinel bands, the oxygen bands at 688 and 865 nm and the continuum from 600 to 1000 nm: means of the model over
steps of 5 nm, in 1e-8 of the unit. Individual rotational lines are far narrower than the grid."""
LOWER_LINES = [(557.7, 218.0), (589.3, 48.0)]
UPPER_LINES = [(630.0, 165.0), (636.4, 44.0)]
"""Lines (nm, rayleigh) at the zenith and 130 sfu: [O I] green and red, sodium. Source: Noll et al. 2012."""


NIGHTLY_SIGMA = 0.3
"""Standard deviation of a night's airglow relative to its mean at one solar flux. The dark sky of Paranal scatters by 0.15 to
0.2 mag about its dependence on solar flux (Patat 2008, A&A 481, 575); ESO's model leaves 0.19 mag in V (Noll et al. 2012, A&A
543, A92); airglow is two thirds of the dark sky. Four nights of an all-sky camera had 0.6, 0.7, 1.2 and 0.9 times the
mean."""


def van_rhijn(zenith_angle_deg: ArrayLike, layer_km: float = LOWER_LAYER_KM) -> Floats:
    """Brightening of a thin glowing layer away from the zenith. Source: van Rhijn 1921, Publ. Astr. Lab. Groningen 31."""
    sine = (
        np.sin(np.radians(np.asarray(zenith_angle_deg, float)))
        * EQUATORIAL_RADIUS_KM
        / (EQUATORIAL_RADIUS_KM + layer_km)
    )
    return 1 / np.sqrt(1 - sine**2)


def line_spectrum(lines: list[tuple[float, float]]) -> Floats:
    """Convert lines (nm, rayleigh) to photons s^-1 m^-2 nm^-1 sr^-1 at GRID_NM, each spread over its two neighbours."""
    spectrum = np.zeros_like(GRID_NM)
    spacing = GRID_NM[1] - GRID_NM[0]
    for wavelength, rayleigh in lines:
        position = (wavelength - GRID_NM[0]) / spacing
        lower = int(position)
        photons = rayleigh * PHOTONS_CM2_SR_PER_RAYLEIGH * 1e4 / spacing
        spectrum[lower] += photons * (1 - position + lower)
        spectrum[lower + 1] += photons * (position - lower)
    return spectrum


@functools.cache
def lower_spectrum() -> Floats:
    """Zenith radiance outside the atmosphere of the layer at 87 km, 130 sfu, photons s^-1 m^-2 nm^-1 sr^-1 at GRID_NM."""
    nodes = np.array(_CONTINUUM)
    continuum = np.exp(np.interp(GRID_NM, nodes[:, 0], np.log(nodes[:, 1])))
    continuum[GRID_NM >= 600] = 1e-8 * np.array(_BANDS_FROM_600)
    continuum *= 1e5 / ARCSEC2_IN_SR
    return continuum + line_spectrum(LOWER_LINES)


@functools.cache
def upper_spectrum() -> Floats:
    """Zenith radiance outside the atmosphere of the layer at 250 km, 130 sfu, photons s^-1 m^-2 nm^-1 sr^-1 at GRID_NM."""
    return line_spectrum(UPPER_LINES)


def solar_activity_scale(solar_flux_sfu: float) -> float:
    """Airglow relative to that at 130 solar flux units (10.7 cm): 0.2 + 0.00614 F. Source: Noll et al. 2012, section 4.3."""
    return (0.2 + 0.00614 * solar_flux_sfu) / (0.2 + 0.00614 * REFERENCE_SOLAR_FLUX_SFU)


@functools.lru_cache(maxsize=16)
def _airglow(solar_flux_sfu: float, atmosphere: Atmosphere | None) -> SkyTable:
    scale = solar_activity_scale(solar_flux_sfu)
    zenith_angle = 90 - sky_grid().altitude_deg[:, None]
    layers = ((lower_spectrum(), LOWER_LAYER_KM), (upper_spectrum(), UPPER_LAYER_KM))
    return total([above_the_air(scale * van_rhijn(zenith_angle, km), spectrum, atmosphere) for spectrum, km in layers])


def airglow(solar_flux_sfu: float, atmosphere: Atmosphere | None, factor: float = 1.0) -> SkyTable:
    """Airglow at the ground, `factor` times its mean at this solar flux.

    Nights of the same solar flux scatter by NIGHTLY_SIGMA. Hydroxyl and oxygen vary partly together; here they do so
    entirely.
    """
    return _airglow(solar_flux_sfu, atmosphere).scaled(factor)
