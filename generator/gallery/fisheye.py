"""All-sky views in true colour: spectra through the CIE 1931 observer, on an equidistant fisheye."""

from __future__ import annotations

from dataclasses import dataclass

import colour
import numpy as np
from numpy.typing import NDArray

from generator.frame.plan import FramePlan, dimming_atmosphere, plan_frame
from generator.frame.scene import frame_layers, point_lights
from generator.light.atmosphere import optical_depth
from generator.light.photometry import GRID_NM
from generator.light.stellar_spectra import star_spectra
from generator.scenario.file import parse_scenario
from generator.sky.assembly import whole_sky

Floats = NDArray[np.float64]

PHOTON_JOULE_NM = 6.62607015e-34 * 299792458.0 * 1e9
STAR_SIGMA_PX = 0.6
WHITE_OVER_MEDIAN = 6.0

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
    """CIE 1931 2 deg observer on GRID_NM times 683 lm/W times joule per photon and the grid's step, (3, n) array."""
    functions = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    matching = np.array([np.interp(GRID_NM, functions.wavelengths, functions.values[:, k]) for k in range(3)])
    return 683.0 * matching * (PHOTON_JOULE_NM / GRID_NM) * (GRID_NM[1] - GRID_NM[0])


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
    points = point_lights(plan)
    depth = np.zeros((len(points.v_mag), 1))
    atmosphere = dimming_atmosphere(plan.spec.atmosphere)
    if atmosphere is not None:
        depth = optical_depth(GRID_NM, atmosphere) * points.airmass[:, None]
    light = (star_spectra(points.v_mag, points.bv_mag) * np.exp(-depth)) @ weights.T
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
    rgb = np.clip(colour.XYZ_to_sRGB(xyz / white), 0, 1)
    rgb[~inside] = 0.12
    return View((rgb * 255 + 0.5).astype(np.uint8), white)
