"""The Moon as a light source: its irradiance by wavelength and phase, with the opposition surge.

Source: Kieffer & Stone 2005, AJ 129, 2887, eq. 10 and table 4: disk reflectance fitted to a thousand nights of the
Robotic Lunar Observatory in 25 bands, for phase angles from 1.55 to 97 deg. Libration and the Sun's selenographic
longitude (together up to 7 %) and the variation of the distance from the Sun over the year (3 %) are left out.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from generator.light.photometry import BESSELL_V, GRID_NM
from generator.light.stellar_spectra import band_weights, colours, star_spectra
from generator.sky.sunlight import SUN_BV_MAG, SUN_VI_MAG

Floats = NDArray[np.float64]

MEAN_DISTANCE_KM = 384_400.0
SOLID_ANGLE_SR = 6.4177e-5
"""Solid angle of the Moon at that distance (the source's value)."""
SUN_V_MAG = -26.76
"""V of the Sun. Source: Torres 2010, AJ 140, 1158."""
EARTH_ALBEDO, EARTH_RADIUS_KM = 0.297, 6378.0
LEAST_PHASE_DEG, LARGEST_PHASE_DEG = 1.55, 97.0
"""Range of phase angles for which the source is valid. A Moon closer to opposition takes the first; beyond the second, the
law of Krisciunas & Schaefer 1991 (:func:`moon_v_mag`) is used."""
_P1_DEG, _P2_DEG, _P3_DEG, _P4_DEG = 4.06054, 12.8802, -30.5858, 16.7498
# Wavelength, nm; a0 to a3 (powers of the phase angle, rad); d1, d2 (exponentials), d3 (cosine).
_BANDS: Floats = np.array([
    [350.0, -2.67511, -1.78539, 0.50612, -0.25578, 0.34185, 0.01441, -0.01602],
    [355.1, -2.71924, -1.74298, 0.44523, -0.23315, 0.33875, 0.01612, -0.00996],
    [405.0, -2.35754, -1.72134, 0.40337, -0.21105, 0.35235, -0.03818, -0.00006],
    [412.3, -2.34185, -1.74337, 0.42156, -0.21512, 0.36591, -0.05902, 0.00080],
    [414.4, -2.43367, -1.72184, 0.43600, -0.22675, 0.35558, -0.03247, -0.00503],
    [441.6, -2.31964, -1.72114, 0.37286, -0.19304, 0.37935, -0.09562, 0.00970],
    [465.8, -2.35085, -1.66538, 0.41802, -0.22541, 0.33450, -0.02546, -0.00484],
    [475.0, -2.28999, -1.63180, 0.36193, -0.20381, 0.33024, -0.03131, 0.00222],
    [486.9, -2.23351, -1.68573, 0.37632, -0.19877, 0.36590, -0.08945, 0.00678],
    [544.0, -2.13864, -1.60613, 0.27886, -0.16426, 0.37190, -0.10629, 0.01428],
    [549.1, -2.10782, -1.66736, 0.41697, -0.22026, 0.36814, -0.09815, 0.00000],
    [553.8, -2.12504, -1.65970, 0.38409, -0.20655, 0.37206, -0.10745, 0.00347],
    [665.1, -1.88914, -1.58096, 0.30477, -0.17908, 0.37141, -0.13514, 0.01248],
    [693.1, -1.89410, -1.58509, 0.28080, -0.16427, 0.39109, -0.17048, 0.01754],
    [703.6, -1.92103, -1.60151, 0.36924, -0.20567, 0.37155, -0.13989, 0.00412],
    [745.3, -1.86896, -1.57522, 0.33712, -0.19415, 0.36888, -0.14828, 0.00958],
    [763.7, -1.85258, -1.47181, 0.14377, -0.11589, 0.39126, -0.16957, 0.03053],
    [774.8, -1.80271, -1.59357, 0.36351, -0.20326, 0.36908, -0.16182, 0.00830],
    [865.3, -1.74561, -1.58482, 0.35009, -0.19569, 0.39200, -0.18837, 0.00978],
    [872.6, -1.76779, -1.60345, 0.37974, -0.20625, 0.39354, -0.19360, 0.00568],
    [882.0, -1.73011, -1.61156, 0.36115, -0.19576, 0.40714, -0.21499, 0.01146],
    [928.4, -1.75981, -1.45395, 0.13780, -0.11254, 0.41900, -0.19963, 0.02940],
    [939.3, -1.76245, -1.49892, 0.07956, -0.07546, 0.47936, -0.29463, 0.04706],
    [942.1, -1.66473, -1.61875, 0.14630, -0.09216, 0.57275, -0.38204, 0.04902],
    [1059.5, -1.59323, -1.71358, 0.50599, -0.25178, 0.48160, -0.29486, 0.00116],
])  # fmt: skip
SMOOTH_DEGREE = 3
"""Degree of the polynomial through the logarithms of the 25 bands. The bands scatter by some percent between instruments,
whereas the reflectance of lunar rock is smooth."""


def disk_reflectance(phase_angle_deg: float) -> Floats:
    """Equivalent reflectance of the Moon's disk at GRID_NM, (n,) array.

    It is 1 for a white Lambertian disk that faces both Sun and observer.
    """
    g_deg = float(np.clip(abs(phase_angle_deg), LEAST_PHASE_DEG, LARGEST_PHASE_DEG))
    g = np.radians(g_deg)
    wavelength, a0, a1, a2, a3, d1, d2, d3 = _BANDS.T
    logarithm = a0 + a1 * g + a2 * g**2 + a3 * g**3
    logarithm = logarithm + d1 * np.exp(-g_deg / _P1_DEG) + d2 * np.exp(-g_deg / _P2_DEG)
    logarithm = logarithm + d3 * np.cos((g_deg - _P3_DEG) / _P4_DEG)
    middle, scale = 700.0, 350.0
    fit = np.polynomial.polynomial.polyfit((wavelength - middle) / scale, logarithm, SMOOTH_DEGREE)
    return np.exp(np.polynomial.polynomial.polyval((GRID_NM - middle) / scale, fit))


@functools.cache
def sun_spectrum() -> Floats:
    """Photon irradiance of the Sun, photons s^-1 m^-2 nm^-1 at GRID_NM."""
    return star_spectra([SUN_V_MAG], [SUN_BV_MAG], [SUN_VI_MAG])[0]


def measured_irradiance(phase_angle_deg: float) -> Floats:
    """Photon irradiance of the Moon at its mean distance, photons s^-1 m^-2 nm^-1 at GRID_NM, within the source's phases."""
    return disk_reflectance(phase_angle_deg) * SOLID_ANGLE_SR / np.pi * sun_spectrum()


def krisciunas_schaefer_v_mag(phase_angle_deg: float) -> float:
    """V of the Moon at its mean distance without the opposition surge, -12.73 + 0.026 |a| + 4e-9 a^4.

    Source: Krisciunas & Schaefer 1991, PASP 103, 1033, eq. 9 (after Allen).
    """
    a = abs(phase_angle_deg)
    return -12.73 + 0.026 * a + 4e-9 * a**4


def moon_v_mag(phase_angle_deg: float, distance_km: float = MEAN_DISTANCE_KM) -> float:
    """V of the Moon at a phase angle (0 full, 180 new), above the atmosphere.

    Up to 97 deg it is that of :func:`measured_irradiance`; beyond, it falls as :func:`krisciunas_schaefer_v_mag`.
    """
    a = abs(phase_angle_deg)
    light = float(measured_irradiance(a) @ band_weights(BESSELL_V)) / BESSELL_V.zero_point
    crescent = 0.0
    if a > LARGEST_PHASE_DEG:
        crescent = krisciunas_schaefer_v_mag(a) - krisciunas_schaefer_v_mag(LARGEST_PHASE_DEG)
    return float(-2.5 * np.log10(light)) + crescent + 5 * float(np.log10(distance_km / MEAN_DISTANCE_KM))


def moon_colours(phase_angle_deg: float) -> tuple[float, float]:
    """B-V and V-I of the Moon at a phase angle."""
    bv, vi = colours(measured_irradiance(phase_angle_deg))
    return float(bv), float(vi)


def earthshine_over_moonlight(phase_angle_deg: float) -> float:
    """Light of the Moon's disk lit by the Earth relative to that of its part lit by the Sun, in V.

    The Earth lights the Moon as a Lambertian sphere with the albedo 0.297 (Goode et al. 2001, GRL 28, 1671), at the phase
    angle that completes the Moon's to 180 deg, from a distance of 60 Earth radii. The Moon reflects this light back to
    the Earth as at full Moon. Its colour is taken as that of the Moon; measured earthshine is bluer.
    """
    a = np.radians(180.0 - abs(phase_angle_deg))
    phase_law = (np.sin(a) + (np.pi - a) * np.cos(a)) / np.pi
    earth_over_sun = 2 / 3 * EARTH_ALBEDO * phase_law * (EARTH_RADIUS_KM / MEAN_DISTANCE_KM) ** 2
    return float(earth_over_sun * 10 ** (-0.4 * (moon_v_mag(LEAST_PHASE_DEG) - moon_v_mag(phase_angle_deg))))


def moon_spectrum(v_mag: float, phase_angle_deg: float) -> Floats:
    """Photon irradiance of a Moon of given V, with the colour of its phase, photons s^-1 m^-2 nm^-1 at GRID_NM."""
    shape = measured_irradiance(phase_angle_deg)
    return shape * (BESSELL_V.zero_point * 10 ** (-0.4 * v_mag) / float(shape @ band_weights(BESSELL_V)))
