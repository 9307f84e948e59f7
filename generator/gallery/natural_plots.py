"""Plots of the natural sky's models and of twilight compared with published numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from generator.gallery.twilight_plots import KOOMEN, KOOMEN_DEPRESSION, PARANAL, v_magnitude, with_night, zenith
from generator.gallery.vision import naked_eye_limit
from generator.light.atmosphere import Atmosphere
from generator.light.lamps import luminous
from generator.light.molecular_bands import beam_depth
from generator.light.photometry import ARCSEC2_PER_SR, BESSELL_B, BESSELL_V, GRID_NM, Band
from generator.sky import milky_way, zodiacal
from generator.sky.airglow import (
    LOWER_LINES,
    UPPER_LAYER_KM,
    UPPER_LINES,
    airglow,
    lower_spectrum,
    upper_spectrum,
    van_rhijn,
)  # fmt: skip
from generator.sky.assembly import star_light
from generator.sky.component import total
from generator.sky.directions import sky_grid
from generator.sky.moon_irradiance import moon_spectrum, moon_v_mag
from generator.sky.moonlight import moonlight
from generator.sky.starlight import scattered_starlight
from generator.sky.zenith import BORTLE_ZENITH_MAG

Floats = NDArray[np.float64]

VAN_RHIJN = {
    "87 km": {30: 1.150, 45: 1.396, 60: 1.924, 70: 2.667, 75: 3.298, 80: 4.223, 85: 5.413},
    "250 km": {30: 1.141, 45: 1.365, 60: 1.809, 70: 2.342, 75: 2.711, 80: 3.132, 85: 3.513},
}
ESO_LINES = {557.7: 218.0, 589.3: 48.0, 630.0: 165.0, 636.4: 44.0}
"""Brightness of lines in rayleigh at the zenith, 130 sfu. Source: Noll et al. 2012."""
ZODIACAL = {
    0: {30: 2480, 45: 910, 60: 505, 75: 338, 90: 259, 120: 188, 150: 179, 180: 230},
    30: {30: 365, 45: 250, 60: 183, 75: 151, 90: 132, 120: 113, 150: 116, 180: 134},
    60: {30: 131, 45: 116, 60: 104, 75: 93, 90: 86, 120: 77, 150: 79, 180: 83},
}
"""Zodiacal light by ecliptic latitude. Source: Leinert et al. 1998, table 17."""
MILKY_WAY = {-75: 20, -60: 24, -45: 30, -30: 47, -20: 70, -10: 131, -5: 167, 0: 156, 5: 137, 10: 102, 15: 81, 20: 63,
             30: 44, 45: 28, 60: 22, 75: 20}  # fmt: skip
"""Median S10(V) over longitude of an all-sky star map at 550 nm (SkyMapMod)."""
MILKY_WAY_RANGE = {0: (103, 260), 5: (81, 205)}
"""Range from 10 to 90 % of longitudes."""
PATAT_V = {5: 11.84, 6: 13.30, 8: 15.88, 9: 17.00, 10: 18.00, 12: 19.67, 14: 20.89, 15: 21.32}
CRUMEY = {1: 6.25, 2: 6.17, 3: 6.05, 4: 5.87, 5: 5.63, 6: 5.33, 7: 5.04, 8: 4.83, 9: 4.78}


def natural_sky() -> Figure:
    """Airglow, zodiacal light, Milky Way, twilight and naked-eye limit: a figure."""
    figure = Figure(figsize=(13, 11))
    axes = figure.subplots(3, 3)
    _airglow_spectrum(axes[0, 0])
    _lines(axes[0, 1])
    _van_rhijn(axes[0, 2])
    _zodiacal(axes[1, 0])
    _milky_way(axes[1, 1])
    _counted_once(axes[1, 2])
    _twilight(axes[2, 0])
    _naked_eye(axes[2, 1])
    _single_numbers(axes[2, 2])
    return figure


def _airglow_spectrum(axis: Any) -> None:
    axis.plot(GRID_NM, lower_spectrum() + upper_spectrum(), lw=1)
    axis.set(
        yscale="log", xlabel="nm", ylabel="photons s⁻¹ m⁻² nm⁻¹ sr⁻¹", title="Airglow, zenith, 130 sfu (Noll 2012)"
    )


def _lines(axis: Any) -> None:
    ours = dict(LOWER_LINES + UPPER_LINES)
    place = np.arange(len(ESO_LINES))
    axis.bar(place, [ours[nm] for nm in ESO_LINES], 0.6, label="skybench")
    axis.errorbar(place, list(ESO_LINES.values()), [0.15 * r for r in ESO_LINES.values()], fmt="ko", capsize=4,
                  label="ESO sky model, ±15 %")  # fmt: skip
    axis.set_xticks(place, [f"{nm} nm" for nm in ESO_LINES])
    axis.set(ylabel="rayleigh", title="Airglow's lines")
    axis.legend()


def _van_rhijn(axis: Any) -> None:
    z = np.linspace(0, 88, 100)
    for name, height in (("87 km", 87.0), ("250 km", UPPER_LAYER_KM)):
        (line,) = axis.plot(z, van_rhijn(z, height), label=f"skybench, {name}")
        axis.plot(*zip(*VAN_RHIJN[name].items(), strict=True), "o", color=line.get_color(), label=f"tabulated, {name}")
    axis.set(xlabel="zenith angle, deg", title="Airglow over its zenith")
    axis.legend()


def _zodiacal(axis: Any) -> None:
    longitude = np.linspace(20, 180, 200)
    for latitude, table in ZODIACAL.items():
        values = zodiacal.brightness(longitude, np.full_like(longitude, latitude))
        (line,) = axis.plot(longitude, values, label=f"skybench, latitude {latitude}°")
        axis.plot(list(table), list(table.values()), "o", color=line.get_color())
    axis.plot([], [], "o", color="grey", label="Leinert 1998")
    axis.set(yscale="log", xlabel="longitude from the Sun, deg", ylabel="10⁻⁸ W m⁻² sr⁻¹ µm⁻¹", title="Zodiacal light")
    axis.legend(fontsize=8)


def galactic_icrs(longitude_deg: Floats, latitude_deg: float) -> Floats:
    """ICRS unit vectors of galactic coordinates, (n, 3) array (rotation of the Hipparcos catalogue, ESA 1997)."""
    to_galactic = np.array(
        [[-0.0548755604, -0.8734370902, -0.4838350155],
         [+0.4941094279, -0.4448296300, +0.7469822445],
         [-0.8676661490, -0.1980763734, +0.4559837762]]
    )  # fmt: skip
    longitude, latitude = np.radians(longitude_deg), np.radians(latitude_deg)
    across = np.cos(latitude)
    vector = [across * np.cos(longitude), across * np.sin(longitude), np.full_like(longitude, np.sin(latitude))]
    return np.stack(vector, axis=-1) @ to_galactic


def _milky_way(axis: Any) -> None:
    latitude, longitude = np.arange(-80.0, 81.0, 2.5), np.arange(0.0, 360.0, 2.0)
    light = np.array([milky_way.s10(galactic_icrs(longitude, b)) for b in latitude])
    low, middle, high = np.percentile(light, [10, 50, 90], axis=1)
    axis.fill_between(latitude, low, high, alpha=0.25, label="skybench, 10 to 90 % of longitudes")
    axis.plot(latitude, middle, label="skybench, median")
    axis.plot(list(MILKY_WAY), list(MILKY_WAY.values()), "ko", ms=4, label="all-sky star map, median")
    for b, (least, most) in MILKY_WAY_RANGE.items():
        axis.plot([b, b], [least, most], "k-", lw=1)
    axis.set(yscale="log", ylim=(15, 900), xlabel="galactic latitude, deg", ylabel="S10(V)", title="Diffuse Milky Way")
    axis.legend(fontsize=8, loc="upper center")


def _counted_once(axis: Any) -> None:
    factor, mean = star_light()
    diffuse, gap = milky_way.sky_mean_s10(), (factor - 1) * milky_way.sky_mean_s10()
    bottom = 0.0
    for name, value in (("points of the catalogue", mean - diffuse - gap), ("map", diffuse), ("gap to V 11", gap)):
        axis.bar(["skybench"], [value], 0.5, bottom=bottom, label=name)
        bottom += value
    axis.bar(["Roach & Gordon 1973"], [105.0], 0.5, color="grey")
    axis.set(ylim=(0, 170), ylabel="mean S10(V) over the sky", title="All stars' light, counted once")
    axis.legend(fontsize=8, loc="upper right")


def _twilight(axis: Any) -> None:
    depression = np.linspace(0, 17.5, 36)
    for name, (site, published) in KOOMEN.items():
        ours = [with_night(v_magnitude(zenith(site, float(d))), 21.7) for d in depression]
        (line,) = axis.plot(depression, ours, label=f"skybench, {name}")
        axis.plot(KOOMEN_DEPRESSION, published, "o", color=line.get_color(), mfc="none", label="Koomen 1952")
    ours = [with_night(v_magnitude(zenith(PARANAL, float(d))), 21.61) for d in depression]
    (line,) = axis.plot(depression, ours, label="skybench, Paranal")
    axis.plot(list(PATAT_V), list(PATAT_V.values()), "x", color=line.get_color(), label="Patat 2006")
    axis.set(xlabel="Sun's depression, deg", ylabel="zenith V mag/arcsec²", title="Twilight")
    axis.set_ylim(22.5, 2)
    axis.legend(fontsize=7)


def _naked_eye(axis: Any) -> None:
    ours = [naked_eye_limit(mu) for mu in BORTLE_ZENITH_MAG.values()]
    axis.plot(list(BORTLE_ZENITH_MAG), ours, label="skybench (Crumey 2014, F = 2)")
    axis.plot(list(CRUMEY), list(CRUMEY.values()), "o", label="tabulated")
    axis.set(
        xlabel="Bortle class", ylabel="naked-eye limit, V", ylim=(4.2, 6.4), title="Faintest star on the class table"
    )
    axis.legend(loc="lower left")


def natural_zenith() -> Floats:
    """Natural sky at the zenith of a mountain with the ecliptic pole (b = 30 deg) overhead, at solar minimum, (n,) array."""
    air = Atmosphere(740.0, 0.05, 1.3, 260.0)
    to_ecliptic = zodiacal.ecliptic_from_icrs()
    pole, sun = to_ecliptic[2], to_ecliptic[0]
    east = np.cross([0.0, 0.0, 1.0], pole)
    east /= np.linalg.norm(east)
    turned = np.stack([east, np.cross(pole, east), pole], axis=1)
    factor, mean_s10 = star_light()
    parts = [
        airglow(70.0, air),
        zodiacal.zodiacal(turned, sun, air),
        milky_way.milky_way(turned, factor, air),
        scattered_starlight(mean_s10, air),
    ]
    return total(parts).radiance(np.array([90.0]), np.array([0.0]))[0]


MEAN_FULL_MOON_DEG = 3.3
"""Phase angle of a full Moon in the mean: an orbit inclined by 5.15 deg is 2 / pi of that from the ecliptic."""


def full_moon_lux() -> float:
    """Illuminance of the ground by a mean full Moon 60 deg up, direct and scattered, lx."""
    air, magnitude = Atmosphere(1013.25, 0.1, 1.3, 300.0), float(moon_v_mag(MEAN_FULL_MOON_DEG))
    moon = np.array([0.0, 0.5, np.sqrt(0.75)])
    direct = moon_spectrum(magnitude, MEAN_FULL_MOON_DEG) * np.exp(-beam_depth(air, 60.0))
    altitude = np.radians(sky_grid().altitude_deg)
    sky = moonlight(moon, magnitude, air)
    rows = np.asarray(sky.azimuth_mean).T @ sky.spectra
    diffuse = 2 * np.pi * np.trapezoid(rows * (np.sin(altitude) * np.cos(altitude))[:, None], altitude, axis=0)
    return float(luminous(direct * moon[2] + diffuse))


def _magnitude(spectrum: Floats, band: Band) -> float:
    return float(-2.5 * np.log10(band.mean(GRID_NM, spectrum) / ARCSEC2_PER_SR / band.zero_point))


def _single_numbers(axis: Any) -> None:
    sky, glow = natural_zenith(), lower_spectrum() + upper_spectrum()
    blue, visual = _magnitude(sky, BESSELL_B), _magnitude(sky, BESSELL_V)
    numbers = [
        ("natural zenith, V\n22.0 ± 0.1 (Falchi 2016)", visual, 22.0, 0.1),
        ("natural zenith, B-V\n1.03 ± 0.2 (Patat 2003)", blue - visual, 1.03, 0.2),
        ("airglow alone, V\n22.01 ± 0.1 (Noll 2012)", _magnitude(glow, BESSELL_V), 22.01, 0.1),
        ("airglow alone, B\n23.06 ± 0.1 (Noll 2012)", _magnitude(glow, BESSELL_B), 23.06, 0.1),
        ("full Moon on the ground, lx\n0.25 ± 10 % (Kyba 2017)", full_moon_lux(), 0.25, 0.025),
    ]
    axis.axvspan(-1, 1, alpha=0.15, color="grey")
    axis.axvline(0, color="k", lw=1)
    for row, (_, ours, published, tolerance) in enumerate(numbers):
        axis.plot((ours - published) / tolerance, row, "o", color="C0")
        axis.annotate(f"{ours:.3g}" if tolerance < 0.05 else f"{ours:.2f}", ((ours - published) / tolerance, row),
                      xytext=(0, 7), textcoords="offset points", ha="center", fontsize=8)  # fmt: skip
    axis.set_yticks(range(len(numbers)), [name for name, *_ in numbers], fontsize=8)
    axis.set(xlim=(-1.6, 1.6), ylim=(len(numbers) - 0.4, -0.7), xlabel="(skybench - published) / tolerance",
             title="Single numbers")  # fmt: skip
