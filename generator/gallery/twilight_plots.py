"""Plots of twilight compared with measurements."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from generator.light.atmosphere import Atmosphere
from generator.light.bake_grids import BakedAir
from generator.light.photometry import ARCSEC2_PER_SR, BESSELL_V, GRID_NM
from generator.light.stellar_spectra import star_spectra
from generator.sky.sunlight import SUN_BV_MAG, SUN_VI_MAG
from generator.sky.twilight import SUN_V_MAG, twilight_depths, twilight_field
from generator.twilight.solar_beam import solar_beam
from generator.twilight.twilight_map import twilight_multiple
from generator.twilight.twilight_single import twilight_single

Floats = NDArray[np.float64]
Site = tuple[Atmosphere, float]

PARANAL: Site = (Atmosphere(744.0, 0.04, 1.3, 260.0), 2.635)
SACRAMENTO_PEAK: Site = (Atmosphere(722.0, 0.03, 1.3, 300.0), 2.8)
MARYLAND: Site = (Atmosphere(1010.0, 0.15, 1.3, 320.0), 0.03)
"""Air and height, km, of the sites; aerosol from Patat et al. 2011 at Paranal, assumed at the others."""
BANDS = {
    "U": (360.0, 756e5), "B": (438.0, 1393.5e5), "V": (545.0, 995.9e5), "R": (641.0, 702.5e5), "I": (798.0, 452.3e5)
}  # fmt: skip
"""Effective wavelength, nm, and photons s^-1 m^-2 nm^-1 of magnitude 0. Source: Bessell, Castelli & Plez 1998."""
PATAT = {
    "U": (11.78, 1.376, -0.039), "B": (11.84, 1.411, -0.041), "V": (11.84, 1.518, -0.057), "R": (11.40, 1.567, -0.064),
    "I": (10.93, 1.470, -0.062),
}  # fmt: skip
"""Zenith brightness, night sky included: a0 + a1 x + a2 x^2, x = depression - 5 deg. Source: Patat et al. 2006, table 1."""
NIGHT_MAG = {"U": 22.28, "B": 22.64, "V": 21.61, "R": 20.87, "I": 19.71}
"""Night sky of the same site, which those values include. Source: Patat 2003, A&A 400, 1183."""
KOOMEN_DEPRESSION = (0.0, 3.0, 6.0, 9.0, 12.0)
KOOMEN = {
    "Sacramento Peak": (SACRAMENTO_PEAK, (7.74, 10.00, 14.14, 17.81, 20.30)),
    "Maryland": (MARYLAND, (7.06, 9.25, 13.05, 17.06, 19.80)),
}
"""Zenith brightness, V mag/arcsec^2. Source: Koomen et al. 1952, J. Opt. Soc. Am. 42, 353."""
DEPRESSIONS: Floats = np.linspace(0, 18, 37)
COLOURS = {"U": "C4", "B": "C0", "V": "C2", "R": "C3", "I": "k"}


def radiances(site: Site, depression_deg: float, altitude_deg: Floats, azimuth_deg: float = 0.0) -> Floats:
    """Photon radiances, s^-1 m^-2 nm^-1 sr^-1, in the plane of the Sun or another, (m, n) array."""
    sun = star_spectra([SUN_V_MAG], [SUN_BV_MAG], [SUN_VI_MAG])[0]
    return twilight_field(depression_deg, *site, altitude_deg, np.array([azimuth_deg]))[:, 0] * sun


def zenith(site: Site, depression_deg: float) -> Floats:
    """Photon radiance at the zenith, (n,) array."""
    return radiances(site, depression_deg, np.array([90.0]))[0]


def band_magnitude(light: Floats, band: str) -> float:
    """Surface brightness at a band's effective wavelength, mag/arcsec^2."""
    wavelength, zero = BANDS[band]
    return float(-2.5 * np.log10(np.interp(wavelength, GRID_NM, light) / ARCSEC2_PER_SR / zero))


def v_magnitude(light: Floats) -> float:
    """Surface brightness, V mag/arcsec^2."""
    return float(-2.5 * np.log10(BESSELL_V.mean(GRID_NM, light) / ARCSEC2_PER_SR / BESSELL_V.zero_point))


def with_night(mag: float, night_mag: float) -> float:
    """Sum of two brightnesses."""
    return float(-2.5 * np.log10(10 ** (-0.4 * mag) + 10 ** (-0.4 * night_mag)))


def patat_magnitude(band: str, depression_deg: Floats) -> Floats:
    """Brightness by Patat's fit, night sky included."""
    a, b, c = PATAT[band]
    x = depression_deg - 5
    return a + b * x + c * x * x


def twilight_measured() -> Figure:
    """Zenith by band, its deviations and colour, the Sun's meridian, spectra, and the fraction scattered once: a figure."""
    figure = Figure(figsize=(13, 8))
    axes = figure.subplots(2, 3)
    spectra = [zenith(PARANAL, float(d)) for d in DEPRESSIONS[:-1]]
    _bands(axes[0, 0], spectra)
    _deviations(axes[0, 1], spectra)
    _colour(axes[0, 2], spectra)
    _meridian(axes[1, 0])
    _spectra(axes[1, 1])
    _scattered_once(axes[1, 2])
    return figure


def _bands(axis: Any, spectra: list[Floats]) -> None:
    for band, colour in COLOURS.items():
        ours = [with_night(band_magnitude(light, band), NIGHT_MAG[band]) for light in spectra]
        axis.plot(DEPRESSIONS[:-1], ours, color=colour, label=band)
        fit = np.linspace(5, 15, 11)
        axis.plot(fit, patat_magnitude(band, fit), "x", color=colour)
    axis.plot([], [], "kx", label="Patat 2006")
    axis.set(xlabel="Sun's depression, deg", ylabel="zenith, mag/arcsec²", title="Zenith at Paranal, night included")
    axis.invert_yaxis()
    axis.legend(fontsize=8)


def _deviations(axis: Any, spectra: list[Floats]) -> None:
    axis.axhspan(-0.2, 0.2, alpha=0.15, color="grey", label="scatter of Patat's points")
    measured = (DEPRESSIONS >= 5) & (DEPRESSIONS <= 15)
    for band, colour in COLOURS.items():
        x = DEPRESSIONS[measured]
        ours = [with_night(band_magnitude(spectra[i], band), NIGHT_MAG[band]) for i in np.flatnonzero(measured)]
        axis.plot(x, ours - patat_magnitude(band, x), color=colour, label=f"{band}, Patat 2006")
    for (name, (site, published)), marker in zip(KOOMEN.items(), "os", strict=True):
        ours = [with_night(v_magnitude(zenith(site, d)), 21.7) for d in KOOMEN_DEPRESSION]
        axis.plot(KOOMEN_DEPRESSION, np.subtract(ours, published), marker, color="C2", mfc="none",
                  label=f"V, Koomen 1952, {name}")  # fmt: skip
    axis.set(
        xlabel="Sun's depression, deg", ylabel="skybench - measured, mag", title="Deviations overhead", ylim=(-1.6, 1.2)
    )
    axis.legend(fontsize=6, loc="lower right", ncol=2)


def _colour(axis: Any, spectra: list[Floats]) -> None:
    ours = [band_magnitude(light, "B") - band_magnitude(light, "V") for light in spectra]
    axis.plot(DEPRESSIONS[:-1], ours, color="C0", label="skybench, 260 DU of ozone")
    dry = Atmosphere(744.0, 0.04, 1.3, 0.0), PARANAL[1]
    without = [
        band_magnitude(light, "B") - band_magnitude(light, "V") for light in (zenith(dry, d) for d in DEPRESSIONS[:-1])
    ]
    axis.plot(DEPRESSIONS[:-1], without, "--", color="C1", label="skybench, no ozone")
    x = np.linspace(5, 11, 7)
    alone = [10 ** (-0.4 * patat_magnitude(b, x)) - 10 ** (-0.4 * NIGHT_MAG[b]) for b in "BV"]
    axis.plot(x, -2.5 * np.log10(alone[0] / alone[1]), "kx", label="Patat 2006, night taken off")
    axis.axhline(SUN_BV_MAG, color="grey", lw=1, label="Sun")
    axis.set(
        xlabel="Sun's depression, deg",
        ylabel="B-V, mag",
        title="Colour overhead: ozone keeps it blue",
        ylim=(-0.8, 1.3),
    )
    axis.legend(fontsize=8, loc="upper right")


def _meridian(axis: Any) -> None:
    altitude = np.concatenate([np.linspace(1, 10, 10), np.linspace(12.5, 90, 32)])
    for depression, colour in zip((3.0, 6.0, 7.0, 9.0, 12.0), ("C0", "C1", "C2", "C3", "C4"), strict=True):
        sides = [radiances(MARYLAND, depression, altitude, azimuth) for azimuth in (0.0, 180.0)]
        light = np.array([[BESSELL_V.mean(GRID_NM, row) for row in side] for side in sides])
        angle = np.concatenate([altitude, 180 - altitude[::-1]])
        axis.plot(
            angle,
            np.concatenate([light[0], light[1][::-1]]) / light[0, -1],
            color=colour,
            label=f"Sun {-depression:.0f}°",
        )
    axis.errorbar([35], [3.1], [0.8], fmt="ko", capsize=3)
    axis.errorbar([165], [1.4], [0.4], fmt="ko", capsize=3, label="photograph, Sun -7°")
    axis.set(yscale="log", xlabel="angle above the horizon below which the Sun is, deg", ylabel="V light over the zenith's",
             title="Along the Sun's meridian")  # fmt: skip
    axis.legend(fontsize=8)


def _spectra(axis: Any) -> None:
    sun = star_spectra([SUN_V_MAG], [SUN_BV_MAG], [SUN_VI_MAG])[0]
    for depression in (0.0, 3.0, 6.0, 9.0, 12.0):
        light = zenith(PARANAL, depression) / sun
        axis.plot(GRID_NM, light / np.interp(550.0, GRID_NM, light), label=f"Sun {-depression:.0f}°")
    axis.set(
        yscale="log",
        xlabel="nm",
        ylabel="light over the Sun's, 1 at 550 nm",
        title="Zenith: the Chappuis band at 600 nm",
    )
    axis.legend(fontsize=8)


def _scattered_once(axis: Any) -> None:
    wavelength = np.array([360.0, 440.0, 550.0, 700.0, 900.0])
    atmosphere, height = MARYLAND
    depths = twilight_depths(wavelength, atmosphere, height)
    overhead = np.array([90.0]), np.array([0.0])
    ground = np.full(len(wavelength), BakedAir().ground_albedo)
    x = np.linspace(0, 12, 25)
    shares = []
    for depression in x:
        once = twilight_single(solar_beam(0.0), depths, height, float(depression), *overhead, 0.0, BakedAir())
        more = twilight_multiple(depths, height, float(depression), *overhead, ground)
        shares.append(once.radiance[:, 0, 0] / (once.radiance + more.radiance)[:, 0, 0])
    for nm, share in zip(wavelength, np.transpose(shares), strict=True):
        axis.plot(x, share, label=f"{nm:.0f} nm")
    axis.set(xlabel="Sun's depression, deg", ylabel="part of the light", title="Scattered once, overhead", ylim=(0, 1))
    axis.legend(fontsize=8)
