"""Plots of the sky's models beside published numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.atmosphere import Atmosphere, rayleigh_optical_depth
from generator.bake.grids import WAVELENGTHS_NM
from generator.photometry import GRID_NM
from generator.sky import zodiacal
from generator.sky.airglow import lower_spectrum, upper_spectrum, van_rhijn
from generator.sky.city_light import City, bortle_city, city_radiance, city_table
from generator.sky.moonlight import moon_v_mag, moonlight
from generator.sky.twilight import zenith_magnitude
from generator.sky.zenith import BORTLE_ZENITH_MAG
from generator.vision import naked_eye_limit

Floats = NDArray[np.float64]

VAN_RHIJN_87 = {30: 1.150, 45: 1.396, 60: 1.924, 70: 2.667, 75: 3.298, 80: 4.223, 85: 5.413}
KOOMEN_DEPRESSION = [0, 3, 6, 9, 12, 15]
KOOMEN = {
    "Sacramento Peak": [7.74, 10.00, 14.14, 17.81, 20.30, 21.75],
    "Maryland": [7.06, 9.25, 13.05, 17.06, 19.80, 20.99],
}
ZODIACAL_ECLIPTIC = {30: 2480, 45: 910, 60: 505, 75: 338, 90: 259, 120: 188, 150: 179, 180: 230}
CRUMEY = {1: 6.25, 2: 6.17, 3: 6.05, 4: 5.87, 5: 5.63, 6: 5.33, 7: 5.04, 8: 4.83, 9: 4.78}


def natural_sky(plt: Any) -> Any:
    """Airglow's spectrum, van Rhijn, zodiacal light, twilight, naked-eye limit: a figure."""
    figure, axes = plt.subplots(2, 3, figsize=(12, 7))
    axis = axes[0, 0]
    axis.plot(GRID_NM, lower_spectrum() + upper_spectrum(), lw=1)
    axis.set(
        yscale="log", xlabel="nm", ylabel="photons s⁻¹ m⁻² nm⁻¹ sr⁻¹", title="Airglow, zenith, 130 sfu (Noll 2012)"
    )
    axis = axes[0, 1]
    z = np.linspace(0, 88, 100)
    axis.plot(z, van_rhijn(z), label="skybench, 87 km")
    axis.plot(list(VAN_RHIJN_87), list(VAN_RHIJN_87.values()), "o", label="van Rhijn, tabulated")
    axis.set(xlabel="zenith angle, deg", title="Airglow over its zenith")
    axis.legend()
    axis = axes[0, 2]
    longitude = np.linspace(20, 180, 200)
    axis.plot(longitude, zodiacal.brightness(longitude, np.zeros_like(longitude)), label="skybench")
    axis.plot(list(ZODIACAL_ECLIPTIC), list(ZODIACAL_ECLIPTIC.values()), "o", label="Leinert 1998")
    axis.set(yscale="log", xlabel="longitude from the Sun, deg", ylabel="10⁻⁸ W m⁻² sr⁻¹ µm⁻¹", title="Zodiacal light")
    axis.legend()
    axis = axes[1, 0]
    depression = np.linspace(0, 16, 100)
    axis.plot(depression, [zenith_magnitude("V", d) for d in depression], label="skybench (Patat 2006 from 5 deg)")
    for site, marker in zip(KOOMEN, "os", strict=True):
        axis.plot(KOOMEN_DEPRESSION, KOOMEN[site], marker, label=f"Koomen 1952, {site}")
    axis.set(xlabel="Sun's depression, deg", ylabel="zenith V mag/arcsec²", title="Twilight")
    axis.invert_yaxis()
    axis.legend(fontsize=8)
    axis = axes[1, 1]
    axis.plot(
        list(BORTLE_ZENITH_MAG),
        [naked_eye_limit(mu) for mu in BORTLE_ZENITH_MAG.values()],
        label="skybench (Crumey 2014, F = 2)",
    )
    axis.plot(list(CRUMEY), list(CRUMEY.values()), "o", label="tabulated")
    axis.set(xlabel="Bortle class", ylabel="naked-eye limit, V", title="Faintest star on the class table")
    axis.legend()
    axes[1, 2].axis("off")
    return figure


def artificial_and_moon(plt: Any) -> Any:
    """City light and moonlight: a figure."""
    figure, axes = plt.subplots(2, 2, figsize=(10, 7))
    axis = axes[0, 0]
    z = np.arange(0, 81, 5.0)
    for name, city, style in (
        ("inside (class 9)", bortle_city(9), "-"),
        ("20 km, towards", City(20, 0, 10), "--"),
        ("20 km, away", City(20, 180, 10), ":"),
    ):
        light = 10 ** (-0.4 * city_table(city).v_mag_arcsec2(90 - z, np.zeros_like(z)))
        axis.plot(z, light / light[0], style, label=name)
    axis.set(xlabel="zenith angle, deg", yscale="log", title="City light over its zenith")
    axis.legend()
    axis = axes[0, 1]
    distance = np.array([15.0, 20, 26, 33, 42, 52, 60])
    share, at_530 = City(0, 0, 1).horizon_share, WAVELENGTHS_NM.index(530.0)
    zenith = np.array([city_radiance(d, 3.0, share)[at_530, -1, 0] for d in distance])
    axis.loglog(distance, zenith / zenith[0], "o-", label="skybench")
    axis.loglog(distance, (distance / distance[0]) ** -2.5, "--", label="Walker: d^-2.5")
    axis.set(xlabel="distance, km", title="Zenith brightness by distance")
    axis.legend()
    axis = axes[1, 0]
    for lamps in ("HPS", "LED", "MH"):
        table = city_table(City(0.0, 0.0, 10.0, lamps=((lamps, 1.0),)))
        axis.plot(GRID_NM, table.radiance(np.array([90.0]), np.array([0.0]))[0], lw=1, label=lamps)
    axis.set(xlabel="nm", title="Zenith inside a city, by lamp")
    axis.legend()
    axis = axes[1, 1]
    rho = np.arange(5, 91, 5.0)
    pressure, k = 725.0, 0.172
    tau = k / 1.0857 - float(rayleigh_optical_depth(550.0, pressure)) - 0.031 / 1.0857
    air = Atmosphere(pressure, tau, 1.3, 300.0)
    moon = np.array([0.0, math.sin(math.radians(60)), 0.5])
    table = moonlight(moon, float(moon_v_mag(0.0)), air)
    beyond = 30 + rho > 90
    altitude, azimuth = np.where(beyond, 150 - rho, 30 + rho), np.where(beyond, 180.0, 0.0)
    ours = 34.08 * np.exp(20.7233 - 0.92104 * table.v_mag_arcsec2(altitude, azimuth))
    axis.semilogy(rho, ours, label="skybench")
    axis.semilogy(
        rho, [krisciunas_schaefer(r, 60.0, abs(60.0 - r), k) for r in rho], "o", label="Krisciunas & Schaefer 1991"
    )
    axis.set(
        xlabel="degrees from the full Moon (30 deg up), towards the zenith", ylabel="nL", title="Moonlight, k = 0.172"
    )
    axis.legend()
    return figure


def krisciunas_schaefer(rho_deg: float, moon_zenith_deg: float, zenith_deg: float, k: float) -> float:
    """Moonlight of the full Moon, nanolambert. Source: Krisciunas & Schaefer 1991, PASP 103, 1033, eqs. 3, 15, 20, 21."""

    def path(angle: float) -> float:
        return float((1 - 0.96 * math.sin(math.radians(angle)) ** 2) ** -0.5)

    moon = 10 ** (-0.4 * (-12.73 + 16.57))
    aerosol = 10 ** (6.15 - rho_deg / 40) if rho_deg >= 10 else 6.2e7 / rho_deg**2
    scattering = 10**5.36 * (1.06 + math.cos(math.radians(rho_deg)) ** 2) + aerosol
    return scattering * moon * 10 ** (-0.4 * k * path(moon_zenith_deg)) * (1 - 10 ** (-0.4 * k * path(zenith_deg)))
