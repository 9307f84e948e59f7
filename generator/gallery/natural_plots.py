"""Plots of the natural sky's models and of twilight beside published numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.photometry import GRID_NM
from generator.sky import milky_way, zodiacal
from generator.sky.airglow import LOWER_LINES, UPPER_LAYER_KM, UPPER_LINES, lower_spectrum, upper_spectrum, van_rhijn
from generator.sky.assembly import star_light
from generator.sky.twilight import zenith_magnitude
from generator.sky.zenith import BORTLE_ZENITH_MAG
from generator.vision import naked_eye_limit

Floats = NDArray[np.float64]

VAN_RHIJN = {
    "87 km": {30: 1.150, 45: 1.396, 60: 1.924, 70: 2.667, 75: 3.298, 80: 4.223, 85: 5.413},
    "250 km": {30: 1.141, 45: 1.365, 60: 1.809, 70: 2.342, 75: 2.711, 80: 3.132, 85: 3.513},
}
ESO_LINES = {557.7: 218.0, 589.3: 48.0, 630.0: 165.0, 636.4: 44.0}
"""Rayleigh at the zenith, 130 sfu. Source: Noll et al. 2012."""
ZODIACAL = {
    0: {30: 2480, 45: 910, 60: 505, 75: 338, 90: 259, 120: 188, 150: 179, 180: 230},
    30: {30: 365, 45: 250, 60: 183, 75: 151, 90: 132, 120: 113, 150: 116, 180: 134},
    60: {30: 131, 45: 116, 60: 104, 75: 93, 90: 86, 120: 77, 150: 79, 180: 83},
}
"""Source: Leinert et al. 1998, table 17, by ecliptic latitude."""
MILKY_WAY = {-75: 20, -60: 24, -45: 30, -30: 47, -20: 70, -10: 131, -5: 167, 0: 156, 5: 137, 10: 102, 15: 81, 20: 63,
             30: 44, 45: 28, 60: 22, 75: 20}  # fmt: skip
"""Median S10(V) over longitude of an all-sky star map at 550 nm (SkyMapMod)."""
MILKY_WAY_RANGE = {0: (103, 260), 5: (81, 205)}
"""10 to 90 % of longitudes."""
KOOMEN_DEPRESSION = [0, 3, 6, 9, 12, 15]
KOOMEN = {
    "Sacramento Peak": [7.74, 10.00, 14.14, 17.81, 20.30, 21.75],
    "Maryland": [7.06, 9.25, 13.05, 17.06, 19.80, 20.99],
}
PATAT = {5: 11.84, 6: 13.30, 8: 15.88, 9: 17.00, 10: 18.00, 12: 19.67, 14: 20.89, 15: 21.32}
CRUMEY = {1: 6.25, 2: 6.17, 3: 6.05, 4: 5.87, 5: 5.63, 6: 5.33, 7: 5.04, 8: 4.83, 9: 4.78}


def natural_sky(plt: Any) -> Any:
    """Airglow, zodiacal light, Milky Way, twilight and naked-eye limit: a figure."""
    figure, axes = plt.subplots(3, 3, figsize=(13, 11))
    _airglow_spectrum(axes[0, 0])
    _lines(axes[0, 1])
    _van_rhijn(axes[0, 2])
    _zodiacal(axes[1, 0])
    _milky_way(axes[1, 1])
    _counted_once(axes[1, 2])
    _twilight(axes[2, 0])
    _naked_eye(axes[2, 1])
    axes[2, 2].axis("off")
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
    depression = np.linspace(0, 16, 100)
    axis.plot(depression, [zenith_magnitude("V", d) for d in depression], label="skybench")
    axis.plot(list(PATAT), list(PATAT.values()), "x", label="Patat 2006, Paranal")
    for site, marker in zip(KOOMEN, "os", strict=True):
        axis.plot(KOOMEN_DEPRESSION, KOOMEN[site], marker, mfc="none", label=f"Koomen 1952, {site}")
    axis.set(xlabel="Sun's depression, deg", ylabel="zenith V mag/arcsec²", title="Twilight")
    axis.invert_yaxis()
    axis.legend(fontsize=8)


def _naked_eye(axis: Any) -> None:
    ours = [naked_eye_limit(mu) for mu in BORTLE_ZENITH_MAG.values()]
    axis.plot(list(BORTLE_ZENITH_MAG), ours, label="skybench (Crumey 2014, F = 2)")
    axis.plot(list(CRUMEY), list(CRUMEY.values()), "o", label="tabulated")
    axis.set(xlabel="Bortle class", ylabel="naked-eye limit, V", title="Faintest star on the class table")
    axis.legend(loc="upper right")
