"""Plots of city light and moonlight compared with published numbers and independent calculations."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import quad

from generator.bake.make_maps import run_worker
from generator.light.atmosphere import Atmosphere, aerosol_optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import VIEW_ALTITUDES_DEG, WAVELENGTHS_NM, BakedAir, CityGrid
from generator.light.baked_maps import city_map, moon_map
from generator.light.emission import GARSTANG_HORIZON_SHARE, WORLD_ATLAS_HORIZON_SHARE, pattern_weights
from generator.light.lamps import City, mixed_lamps
from generator.light.photometry import BESSELL_B, BESSELL_V, GRID_NM
from generator.light.single_scattering import aerosol_phase, city_single, rayleigh_phase
from generator.light.view_directions import view_directions
from generator.sky.city_light import bortle_city, city_radiance, city_table
from generator.sky.moon_irradiance import krisciunas_schaefer_v_mag
from generator.sky.moonlight import moonlight

Floats = NDArray[np.float64]

NM = 530.0
AT_NM = WAVELENGTHS_NM.index(NM)
KS91_K, KS91_PRESSURE_HPA = 0.172, 725.0
KS91_VECTORS = [
    (50, 70, 20, 45, 0.15, 389.5), (60, 60, 0, 0, 0.172, 1089.9), (60, 60, 0, 60, 0.172, 247.0),
    (60, 60, 0, 90, 0.172, 99.2), (30, 30, 0, 0, 0.172, 2367.6), (90, 60, 45, 0, 0.172, 1067.2),
    (10, 40, 30, 0, 0.172, 4967.1), (5, 40, 35, 0, 0.172, 12206.0),
]  # fmt: skip
"""Distance from the Moon, its zenith angle, the line of sight's, phase angle, deg; k; nL of Krisciunas & Schaefer 1991."""


def artificial_and_moon() -> Figure:
    """City light and moonlight: a figure."""
    figure = Figure(figsize=(13, 11))
    axes = figure.subplots(3, 3)
    _gradient(axes[0, 0])
    _walker(axes[0, 1])
    _garstang(axes[0, 2])
    _colour(axes[1, 0])
    _lamps(axes[1, 1])
    _noise(axes[1, 2])
    _moonlight(axes[2, 0])
    _vectors(axes[2, 1])
    _furnace(axes[2, 2])
    return figure


def _gradient(axis: Any) -> None:
    z = np.arange(0, 86, 2.5)
    for name, city, style in (
        ("inside (class 9)", bortle_city(9), "-"),
        ("inside, upward light of Garstang", replace(bortle_city(9), horizon_share=GARSTANG_HORIZON_SHARE), (0, (3, 1))),
        ("inside, upward light of the world atlas", replace(bortle_city(9), horizon_share=WORLD_ATLAS_HORIZON_SHARE), "-."),
        ("inside, Lambert", replace(bortle_city(9), horizon_share=0.0), (0, (1, 1))),
        ("20 km, towards", City(20, 0, 10), "--"),
        ("20 km, away", City(20, 180, 10), ":"),
    ):  # fmt: skip
        light = 10 ** (-0.4 * city_table(city).v_mag_arcsec2(90 - z, np.zeros_like(z)))
        axis.plot(z, light / light[0], linestyle=style, label=name)
    axis.axhspan(2, 6, alpha=0.15, color="grey", label="2 to 6: rule of thumb inside a city")
    axis.set(xlabel="zenith angle, deg", yscale="log", title="City light over its zenith")
    axis.legend(fontsize=8)


def _walker(axis: Any) -> None:
    distance = np.array([15.0, 20, 26, 33, 42, 52, 60, 80, 100, 150])
    zenith = np.array([city_radiance(d, 3.0, None)[AT_NM, -1, 0] for d in distance])
    near = distance[distance <= 60]
    axis.loglog(distance, zenith / zenith[0], "o-", label="skybench")
    axis.loglog(near, (near / near[0]) ** -2.5, "k--", label="Walker 1977: d^-2.5")
    axis.fill_between(near, (near / 15) ** -2.9, (near / 15) ** -2.1, alpha=0.15, color="grey", label="± 0.4")
    axis.set_xticks([15, 30, 60, 100, 150], ["15", "30", "60", "100", "150"])
    axis.minorticks_off()
    axis.set(xlabel="distance, km", title="Zenith brightness by distance")
    axis.legend(loc="lower left")


def garstang_kernel(distance_km: float, zenith_deg: float, share: float) -> float:
    """Garstang's single scattering of a point city, by adaptive quadrature, km^-2 sr^-1. Source: Garstang 1986, eqs. 4-9."""
    air = BakedAir()
    rayleigh = float(rayleigh_optical_depth(NM, air.pressure_hpa))
    aerosol = float(aerosol_optical_depth(NM, 0.1, air.angstrom_exponent))
    z = math.radians(zenith_deg)

    def integrand(s: float) -> float:
        y, h = s * math.sin(z), s * math.cos(z)
        leg = math.hypot(y - distance_km, h)
        psi = math.acos(h / leg)
        column = rayleigh * (1 - math.exp(-h / air.rayleigh_height_km))
        column += aerosol * (1 - math.exp(-h / air.aerosol_height_km))
        cosine = -(y * (y - distance_km) + h * h) / (leg * s)
        scattered = (
            rayleigh / air.rayleigh_height_km * math.exp(-h / air.rayleigh_height_km) * float(rayleigh_phase(cosine))
        )
        scattered += (
            air.aerosol_albedo * aerosol / air.aerosol_height_km * math.exp(-h / air.aerosol_height_km)
        ) * float(aerosol_phase(cosine))
        emitted = (1 - share) * math.cos(psi) / math.pi + share * 0.554 * psi**4 / (2 * math.pi)
        return emitted / leg**2 * math.exp(-column * (leg + s) / h) * scattered

    return float(quad(integrand, 1e-4, 40 / math.cos(z), limit=400, points=[0.1, 1.0, 10.0])[0])


def _garstang(axis: Any) -> None:
    share, zenith = GARSTANG_HORIZON_SHARE, np.arange(0.0, 61.0, 10.0)
    views = view_directions(90 - zenith, [0.0])
    for distance in (5.0, 20.0):
        once = city_single(BakedAir(), np.array([NM]), 0.1, np.array([[0.0, distance]]), views)
        (line,) = axis.semilogy(zenith, (pattern_weights(share) @ once[:, 0]), label=f"once, {distance:.0f} km")
        reference = [garstang_kernel(distance, z, share) for z in zenith]
        axis.semilogy(zenith, reference, "o", color=line.get_color(), label=f"Garstang, {distance:.0f} km")
        rows = [k for k, altitude in enumerate(VIEW_ALTITUDES_DEG) if altitude >= 27]
        all_orders = city_radiance(distance, 0.5, share)[AT_NM, rows, 0] * 1e6
        axis.semilogy(90 - np.array(VIEW_ALTITUDES_DEG)[rows], all_orders, "--", color=line.get_color(),
                      label=f"all orders, {distance:.0f} km")  # fmt: skip
    axis.set(
        xlabel="zenith angle towards the lamp, deg",
        ylabel="km⁻² sr⁻¹",
        ylim=(1e-6, 5e-3),
        title="A lamp's light, 530 nm (Garstang 1986)",
    )
    axis.legend(fontsize=7, ncols=2, loc="upper left")


def _b_minus_v(spectrum: Floats) -> float:
    return float(BESSELL_B.magnitude(GRID_NM, spectrum) - BESSELL_V.magnitude(GRID_NM, spectrum))


def _colour(axis: Any) -> None:
    lamps, distance = (("LED", 1.0),), np.array([0.0, 5.0, 10.0, 20.0, 40.0, 60.0, 100.0])
    for altitude in (90.0, 10.0, 3.0):
        colours = [
            _b_minus_v(city_table(City(d, 0.0, 3.0, lamps=lamps)).radiance(np.array([altitude]), np.array([0.0]))[0])
            for d in distance
        ]
        axis.plot(distance, colours, "o-", label=f"{altitude:.0f}° high, towards the city")
    axis.axhline(_b_minus_v(mixed_lamps(lamps)), color="k", ls="--", label="the lamps themselves (white LED)")
    axis.set(xlabel="distance, km", ylabel="B-V", ylim=(0.2, 2.6), title="Bluer near the city, redder far away")
    axis.legend(fontsize=8, loc="upper left")


def _lamps(axis: Any) -> None:
    for lamps in ("HPS", "LED", "MH"):
        table = city_table(City(0.0, 0.0, 10.0, lamps=((lamps, 1.0),)))
        axis.plot(GRID_NM, table.radiance(np.array([90.0]), np.array([0.0]))[0], lw=1, label=lamps)
    axis.set(xlabel="nm", title="Zenith inside a city, by lamp")
    axis.legend()


def _noise(axis: Any) -> None:
    grid, error = CityGrid(), city_map("relative_error")
    rings = grid.edges[0][1:]
    for pattern, name in enumerate(("city, Lambert", "city, near the horizon", "city, built-up")):
        axis.loglog(rings, 100 * np.median(error[pattern], axis=(0, 1, 2, 4))[1:], label=name)
    axis.axhline(100 * np.median(moon_map("relative_error")), color="grey", label="moonlight")
    for electrons in (100, 1000, 10_000):
        axis.axhline(20 / math.sqrt(electrons), color="k", ls=":", lw=1)
        axis.text(1.0, 20.6 / math.sqrt(electrons), f"a fifth of the noise of {electrons:,} e", fontsize=8)
    axis.set(xlabel="distance, km", ylabel="%", ylim=(0.08, 20), title="Monte Carlo error of the maps (median)")
    axis.legend(fontsize=8, loc="upper center")


def krisciunas_schaefer(rho_deg: float, moon_zenith_deg: float, zenith_deg: float, k: float) -> float:
    """Moonlight of the full Moon, nanolambert. Source: Krisciunas & Schaefer 1991, PASP 103, 1033, eqs. 3, 15, 20, 21."""

    def path(angle: float) -> float:
        return float((1 - 0.96 * math.sin(math.radians(angle)) ** 2) ** -0.5)

    moon = 10 ** (-0.4 * (-12.73 + 16.57))
    aerosol = 10 ** (6.15 - rho_deg / 40) if rho_deg >= 10 else 6.2e7 / rho_deg**2
    scattering = 10**5.36 * (1.06 + math.cos(math.radians(rho_deg)) ** 2) + aerosol
    return scattering * moon * 10 ** (-0.4 * k * path(moon_zenith_deg)) * (1 - 10 ** (-0.4 * k * path(zenith_deg)))


def _ks91_air(k: float) -> Atmosphere:
    """Air at 2,800 m whose aerosol brings V extinction to k magnitudes per airmass."""
    tau = k / 1.0857 - float(rayleigh_optical_depth(550.0, KS91_PRESSURE_HPA)) - 0.031 / 1.0857
    return Atmosphere(KS91_PRESSURE_HPA, tau, 1.3, 300.0)


def _nanolambert(v_mag_arcsec2: Floats) -> Floats:
    return 34.08 * np.exp(20.7233 - 0.92104 * v_mag_arcsec2)


def _moonlight(axis: Any) -> None:
    rho = np.arange(4, 91, 2.0)
    moon = np.array([0.0, math.sin(math.radians(60)), 0.5])
    table = moonlight(moon, krisciunas_schaefer_v_mag(0.0), _ks91_air(KS91_K))
    beyond = 30 + rho > 90
    altitude, azimuth = np.where(beyond, 150 - rho, 30 + rho), np.where(beyond, 180.0, 0.0)
    axis.semilogy(rho, _nanolambert(table.v_mag_arcsec2(altitude, azimuth)), label="skybench")
    published = np.array([krisciunas_schaefer(r, 60.0, abs(60.0 - r), KS91_K) for r in rho])
    axis.semilogy(rho, published, "k--", label="Krisciunas & Schaefer 1991")
    axis.fill_between(rho, 0.7 * published, 1.3 * published, alpha=0.15, color="grey", label="± 30 %")
    axis.set(xlabel="degrees from the full Moon (30° up), to the zenith", ylabel="nL", title="Moonlight, k = 0.172")
    axis.legend(fontsize=8)


def _vectors(axis: Any) -> None:
    ratios, names = [], []
    for rho, moon_zenith, zenith, phase, k, published in KS91_VECTORS:
        zm, z = math.radians(moon_zenith), math.radians(zenith)
        cosine = (math.cos(math.radians(rho)) - math.cos(zm) * math.cos(z)) / max(math.sin(zm) * math.sin(z), 1e-9)
        turn = math.degrees(math.acos(min(max(cosine, -1.0), 1.0))) if zenith else 0.0
        moon = np.array([0.0, math.sin(zm), math.cos(zm)])
        table = moonlight(moon, krisciunas_schaefer_v_mag(phase), _ks91_air(k))
        light = table.v_mag_arcsec2(np.array([90.0 - zenith]), np.array([turn]))
        ratios.append(float(_nanolambert(light)[0]) / published)
        names.append(f"{rho}° / {phase}°")
    axis.axhspan(0.7, 1.3, alpha=0.15, color="grey", label="± 30 %")
    axis.axhline(1, color="k", lw=1)
    axis.plot(ratios, "o", label="skybench / published")
    axis.set_xticks(range(len(names)), names, rotation=60, fontsize=8)
    axis.set(ylim=(0, 1.6), xlabel="distance from the Moon / phase angle", title="Eight vectors of KS 1991")
    axis.legend(fontsize=8)


def _furnace(axis: Any) -> None:
    mean, error = run_worker("furnace")
    axis.axhspan(0.99, 1.01, alpha=0.15, color="grey", label="± 1 %")
    axis.errorbar(range(len(mean)), mean, error, fmt="o", capsize=3, label="volpath in the bake's air")
    axis.set(ylim=(0.96, 1.04), xlabel="direction", title="White furnace: radiance 1")
    axis.legend(fontsize=8)
