"""Angular scattering by cloud particles: diffraction around their shadows, and reflected and refracted light.

Particles much larger than the wavelength extinguish twice their shadow: half is diffracted (Babinet), half meets the
particle (van de Hulst 1957, "Light Scattering by Small Particles", chapter 12). The angular distribution of the second
half is the same for all sizes.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv, j1

from generator.light.cloud_kinds import WAVELENGTH_UM

Floats = NDArray[np.float64]

ICE_ASYMMETRY = 0.75
"""Mean cosine of all light that cirrus scatters, diffracted light included, measured in flight; its scattering function is
smooth, without haloes. Source: Jaervinen et al. 2018, Atmos. Chem. Phys. 18, 15767."""
WATER_ASYMMETRY = 0.85
"""Mean cosine of the light that droplets scatter, visible light. Source: Bohren 1987, Am. J. Phys. 55, 524."""
WATER_INDEX = 1.334
"""Refractive index of water at 0.55 um. Source: Hale & Querry 1973, Appl. Opt. 12, 555."""
INNER_REFLECTIONS = 5
"""Number of reflections inside a droplet for which rays are followed; later ones carry a thousandth of the light."""
RAYS = 40_000
BIN_DEG = 2.0
"""Width over which the droplets' phase function is averaged: rays have infinite intensity at rainbow angles, which cloud
droplets spread over some degrees."""
SIZE_VARIANCE = 0.1
"""Effective variance of the particles' sizes, a gamma distribution. Source: Hansen 1971, J. Atmos. Sci. 28, 1400 (water)."""
SIZES = 24
MOON_RADIUS_DEG = 0.259


def henyey_greenstein(cosine: ArrayLike, asymmetry: float) -> Floats:
    """Phase function of Henyey & Greenstein 1941, ApJ 93, 70, sr^-1."""
    base = 1 + asymmetry**2 - 2 * asymmetry * np.asarray(cosine, dtype=np.float64)
    return np.asarray((1 - asymmetry**2) / (4 * np.pi) * base**-1.5)


@functools.cache
def droplet_rays() -> tuple[Floats, Floats]:
    """Angles (n,), deg, and phase function (n,), sr^-1, of light that meets a droplet: ray optics, Fresnel's reflectances.

    Rays are reflected outside (p = 0), or pass through with p - 1 reflections inside (van de Hulst 1957, section 12.2).
    """
    sine = np.sqrt((np.arange(RAYS) + 0.5) / RAYS)
    outside = np.arcsin(sine)
    inside = np.arcsin(sine / WATER_INDEX)
    across = (np.sin(outside - inside) / np.maximum(np.sin(outside + inside), 1e-12)) ** 2
    along = (np.tan(outside - inside) / np.tan(outside + inside)) ** 2
    edges = np.arange(0, 180 + BIN_DEG, BIN_DEG)
    light = np.zeros(len(edges) - 1)
    for p in range(INNER_REFLECTIONS + 2):
        turned = np.pi - 2 * outside if p == 0 else 2 * (outside - inside) + (p - 1) * (np.pi - 2 * inside)
        angle_deg = np.degrees(np.arccos(np.cos(turned)))
        for reflectance in (across, along):
            weight = reflectance if p == 0 else (1 - reflectance) ** 2 * reflectance ** (p - 1)
            light += np.histogram(angle_deg, edges, weights=weight / (2 * RAYS))[0]
    solid = 2 * np.pi * -np.diff(np.cos(np.radians(edges)))
    return (edges[1:] + edges[:-1]) / 2, light / light.sum() / solid


def ray_phase(angle_rad: ArrayLike, ice: bool) -> Floats:
    """Phase function of the light that meets a particle, sr^-1; its integral over the sphere is 1.

    Ice: rough crystals scatter smoothly, according to Henyey & Greenstein's function. Its mean cosine 2 g - 1 makes that
    of all light ICE_ASYMMETRY, because the diffracted half goes straight on. Water: :func:`droplet_rays`.
    """
    angle = np.asarray(angle_rad, dtype=np.float64)
    if ice:
        return henyey_greenstein(np.cos(angle), 2 * ICE_ASYMMETRY - 1)
    degrees, phase = droplet_rays()
    return np.asarray(np.interp(np.degrees(angle), degrees, phase))


def aureole(angle_rad: ArrayLike, particle_um: float) -> Floats:
    """Diffracted light around the Moon, sr^-1: disks' patterns, convolved with the Moon's disk; its integral is 1.

    The disks have the sizes of the particles. A disk of diameter D sends J1(x)^2 / (pi sin^2 t) into the angle t, x = pi
    D sin t / wavelength (Born & Wolf, "Principles of Optics", 8.5.2). Sizes follow a gamma distribution around the
    effective diameter, weighted by their shadows. The small-angle approximation is used.
    """
    angle = np.asarray(angle_rad, dtype=np.float64)
    # Quantiles of the shadow-weighted gamma distribution of effective variance v: shape 1 / v, mean D.
    parts = (np.arange(SIZES) + 0.5) / SIZES
    diameters = gammaincinv(1 / SIZE_VARIANCE, parts) * (particle_um * SIZE_VARIANCE)
    radius = np.radians(MOON_RADIUS_DEG) * np.sqrt((np.arange(4) + 0.5) / 4)
    turn = (np.arange(8) + 0.5) * np.pi / 8
    away = np.sqrt(
        angle[..., None, None] ** 2 + radius[:, None] ** 2 - 2 * angle[..., None, None] * radius[:, None] * np.cos(turn)
    )
    sine = np.maximum(np.sin(np.minimum(away, np.pi / 2)), 1e-9)[..., None]
    pattern = (j1(np.pi * diameters / WAVELENGTH_UM * sine) / sine) ** 2 / np.pi
    return np.asarray(pattern.mean(axis=(-3, -2, -1)))


DIFFRACTION_DEPTHS = np.linspace(0.05, 6.0, 24)
"""Optical depths of diffraction for which aureoles of stars are tabulated."""
WAVES, ANGLES = 512, 1024
"""Numbers of nodes of their transform and of the angle."""
WIDEST = 12.0
"""Angle at which their tables end, in wavelengths over the effective diameter."""


@functools.lru_cache(maxsize=4)
def aureole_radii(particle_um: float, points: int) -> Floats:
    """Angles around a star, rad, that contain (j + 1/2) / points of its diffracted light, (DIFFRACTION_DEPTHS, points) array.

    Light that passes through a depth d of diffraction has the transform exp(-d (1 - A)), because small angles add up
    (Wells 1969, J. Opt. Soc. Am. 59, 686). A is that of a disk's pattern, the overlap of two disks (Goodman,
    "Introduction to Fourier Optics", 6.3), mean over the sizes of :func:`aureole`. The undiffracted part exp(-d) is
    subtracted. Light beyond WIDEST is placed at WIDEST.
    """
    parts = (np.arange(SIZES) + 0.5) / SIZES
    diameters = gammaincinv(1 / SIZE_VARIANCE, parts) * (particle_um * SIZE_VARIANCE) / WAVELENGTH_UM
    wave = (np.arange(WAVES) + 0.5) / WAVES * diameters.max()
    over = np.minimum(wave / diameters[:, None], 1.0)
    transform = (2 / np.pi * (np.arccos(over) - over * np.sqrt(1 - over**2))).mean(axis=0)
    angle = np.linspace(0, WIDEST * WAVELENGTH_UM / particle_um, ANGLES)
    bessel = 2 * np.pi * angle[:, None] * j1(2 * np.pi * angle[:, None] * wave) * (wave[1] - wave[0])
    wanted = (np.arange(points) + 0.5) / points
    radii = np.empty((len(DIFFRACTION_DEPTHS), points))
    for row, depth in enumerate(DIFFRACTION_DEPTHS):
        scattered = np.exp(-depth * (1 - transform)) - np.exp(-depth)
        inside = np.maximum.accumulate(bessel @ scattered) / -np.expm1(-depth)
        radii[row] = np.interp(wanted, inside, angle)
    return radii
