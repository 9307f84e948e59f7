"""All-sky views in true colour: spectra through the CIE 1931 observer, on an equidistant fisheye."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from generator.colour_science import colour
from generator.frame.moon.disk import moon_lights
from generator.frame.plan import FramePlan, dimming_atmosphere, plan_frame
from generator.frame.point_lights import star_lights
from generator.frame.scene import frame_layers
from generator.light.atmosphere import optical_depth
from generator.light.photometry import GRID_NM
from generator.light.points import PointLights
from generator.light.stellar_spectra import star_spectra
from generator.scenario.file import parse_scenario
from generator.sky.assembly import whole_sky

Floats = NDArray[np.float64]

PHOTON_JOULE_NM = constants.h * constants.c * 1e9
"""Energy of a photon times its wavelength."""
OBSERVER = "CIE 1931 2 Degree Standard Observer"
STAR_SIGMA_PX = 0.6
"""Standard deviation of the stars' images."""
WHITE_OVER_MEDIAN = 6.0
"""Luminance of white relative to that of the median sky: dark enough for the Milky Way to show."""
BACKGROUND = 31
"""Dark grey of the corners, 8 bits."""

_SCENARIO = """
name: gallery
seed: 5
site: {{latitude_deg: {latitude}, longitude_deg: {longitude}}}
time: {{utc_start: {utc}, exposure_s: 1.0}}
camera: {{model: equidistant, width: 500, height: 500, hfov_deg: 180, aperture_mm: 10}}
attitude: {{azimuth_deg: 0, altitude_deg: 90}}
sky: {sky}
stars: {{limiting_magnitude: 6.0}}
"""


@dataclass(frozen=True)
class View:
    """One all-sky view.

    Attributes
    ----------
    rgb : (n, n, 3) uint8 array
        sRGB; up is north, left is east.
    white_cd_m2 : float
        Luminance that is shown as white: the exposure.
    """

    rgb: NDArray[np.uint8]
    white_cd_m2: float


def plan_of(sky: str, utc: str, latitude: float = 32.0, longitude: float = 10.0) -> FramePlan:
    """Plan of one frame under a sky (YAML of the scenario's ``sky``)."""
    text = _SCENARIO.format(sky=sky, utc=utc, latitude=latitude, longitude=longitude)
    return plan_frame(parse_scenario(text, "gallery"), 0)


def observer_weights() -> Floats:
    """Weights that convert photon spectra at GRID_NM to CIE 1931 XYZ, (3, n) array.

    They are the colour-matching functions times the maximum luminous efficacy, the energy per photon and the step of the
    grid: photons s^-1 m^-2 nm^-1 sr^-1 become XYZ with Y in cd m^-2.
    """
    library = colour()
    grid = library.SpectralShape(GRID_NM[0], GRID_NM[-1], GRID_NM[1] - GRID_NM[0])
    matching = library.MSDS_CMFS[OBSERVER].copy().align(grid).values.T
    return library.constants.CONSTANT_K_M * matching * (PHOTON_JOULE_NM / GRID_NM) * grid.interval


def true_colour(xyz: Floats, white_cd_m2: float) -> NDArray[np.uint8]:
    """8-bit sRGB (..., 3) for CIE 1931 XYZ (..., 3): light of D65's colour and luminance `white_cd_m2` is (255, 255, 255)."""
    rgb = np.clip(colour().XYZ_to_sRGB(xyz / white_cd_m2), 0, 1)
    return np.rint(255 * rgb).astype(np.uint8)


def all_sky(plan: FramePlan, size: int = 420, white_cd_m2: float | None = None) -> View:
    """All-sky view of a frame's sky and stars; without `white_cd_m2` six times the sky's median is white."""
    weights = observer_weights()
    table = whole_sky(frame_layers(plan))
    v, u = np.mgrid[0:size, 0:size]
    x, y = (size / 2 - 0.5 - u) / (size / 2), (size / 2 - 0.5 - v) / (size / 2)
    radius = np.hypot(x, y)
    inside = radius <= 1
    altitude, azimuth = 90 * (1 - radius), np.degrees(np.arctan2(x, y)) % 360
    xyz = np.zeros((size, size, 3))
    xyz[inside] = table.signal(weights, altitude[inside], azimuth[inside]).T
    points = functools.reduce(PointLights.joined, moon_lights(plan), star_lights(plan))
    depth = np.zeros((len(points.v_mag), 1))
    atmosphere = dimming_atmosphere(plan.spec.atmosphere)
    if atmosphere is not None:
        depth = optical_depth(GRID_NM, atmosphere) * points.airmass[:, None]
    light = (star_spectra(points.v_mag, points.bv_mag, points.vi_mag) * np.exp(-depth)) @ weights.T
    east, north, up = points.directions.mean(axis=1).T
    distance = (1 - np.degrees(np.arcsin(np.clip(up, -1, 1))) / 90) * size / 2
    turn = np.arctan2(east, north)
    column, row = size / 2 - 0.5 - distance * np.sin(turn), size / 2 - 0.5 - distance * np.cos(turn)
    pixel_sr = (np.pi / size) ** 2
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            r, c = np.rint(row).astype(int) + dy, np.rint(column).astype(int) + dx
            square = (r - row) ** 2 + (c - column) ** 2
            share = np.exp(-square / (2 * STAR_SIGMA_PX**2)) / (2 * np.pi * STAR_SIGMA_PX**2)
            on = (r >= 0) & (r < size) & (c >= 0) & (c < size)
            np.add.at(xyz, (r[on], c[on]), (light * share[:, None])[on] / pixel_sr)
    white = float(white_cd_m2 or WHITE_OVER_MEDIAN * np.median(xyz[inside][:, 1]))
    rgb = true_colour(xyz, white)
    rgb[~inside] = BACKGROUND
    return View(rgb, white)
