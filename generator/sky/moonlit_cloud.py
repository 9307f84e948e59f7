"""Moonlight scattered by cloud, as a function of the angle to the Moon.

Columns are independent: the light from a direction is that of an infinite layer with the depth in that direction.
"""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from generator.light.cloud_phase import aureole, ray_phase
from generator.places.earth import EQUATORIAL_RADIUS_KM
from generator.sky.cloud_layer import KEPT_TO, cloud_transfer, scattered_once
from generator.sky.clouds import CloudField

Floats = NDArray[np.float64]

ANGLE_NODES = 1025
"""Number of nodes of the tables by angle, evenly spaced in the root of the sine of half the angle: a resolution of 0.02 deg
near the Moon, and of 0.2 far from it."""
DIFFRACTED = 0.5
"""Fraction of the optical depth that is due to diffraction."""
DEPTH_NODES, COSINE_NODES, TURN_NODES = 65, 33, 25
"""Numbers of nodes of the table of multiply scattered light: evenly spaced in t / (1 + t), the cosine (0 to 1) and the
azimuth (0 to pi)."""


@dataclass(frozen=True, eq=False)
class MoonVeil:
    """Radiance of cloud divided by the Moon's irradiance above it, sr^-1, by direction.

    Diffraction, half of the vertical depth, is removed from the layer (delta scaling, Joseph et al. 1976, J. Atmos. Sci.
    33, 2452). With t the other half and m0 the cosine of the Moon to the layer's vertical, it is the sum of

    - light scattered once, with the phase function itself (as in Nakajima & Tanaka 1988, J. Quant. Spectrosc. Radiat.
      Transfer
      40, 51);
    - light scattered more than once (:mod:`generator.sky.cloud_layer`);
    - diffracted light outside the Moon's image, as an aureole: light not scattered otherwise, exp(-t / m0), minus the
      image's light.

    Attributes
    ----------
    clouds : CloudField
    moon_enu : (3,) array
        Apparent direction of the Moon, above the horizon.
    phase, halo : (ANGLE_NODES,) arrays
        Phase function and aureole, sr^-1, even in the root of the sine of half the angle.
    more : (DEPTH_NODES, COSINE_NODES, TURN_NODES) array
        The second term, sr^-1.
    """

    clouds: CloudField
    moon_enu: Floats
    phase: Floats
    halo: Floats
    more: Floats

    @property
    def broad(self) -> MoonVeil:
        """The same veil without the aureole."""
        return dataclasses.replace(self, halo=np.zeros_like(self.halo))

    @property
    def moon_cosine(self) -> float:
        """Cosine of the Moon's zenith angle at the layer."""
        return float(layer_cosine(self.moon_enu, self.clouds.altitude_km))

    def at(self, enu: Floats) -> Floats:
        """Radiance over irradiance, (...) array for (..., 3) unit vectors; mean over the exposure."""
        place = np.sqrt(np.linalg.norm(enu - self.moon_enu, axis=-1) / 2)
        nodes = np.linspace(0, 1, ANGLE_NODES)
        phase, halo = (np.interp(place, nodes, table) for table in (self.phase, self.halo))
        cosine = layer_cosine(enu, self.clouds.altitude_km)
        level = np.maximum(np.hypot(enu[..., 0], enu[..., 1]) * np.hypot(*self.moon_enu[:2]), 1e-12)
        turn = np.arccos(np.clip((enu[..., :2] @ self.moon_enu[:2]) / level, -1, 1))
        axes = [np.linspace(0, end, count) for end, count in zip((1, 1, np.pi), self.more.shape, strict=True)]
        table = RegularGridInterpolator(axes, self.more)
        light = []
        for still in self.clouds.moments:
            slant = (1 - DIFFRACTED) * still.slant_depth(enu)
            depth = slant * cosine
            through = depth / self.moon_cosine
            image = np.exp(-self.clouds.point_share / (1 - DIFFRACTED) * through)
            light.append(
                phase * scattered_once(slant, through)
                + table(np.stack((depth / (1 + depth), cosine, turn), axis=-1))
                + halo * np.maximum(np.exp(-through) - image, 0)
            )
        return np.asarray(np.mean(light, axis=0))


def layer_cosine(enu: Floats, altitude_km: float) -> Floats:
    """Cosine between directions (..., 3) and the vertical where they meet a layer."""
    ratio = EQUATORIAL_RADIUS_KM / (EQUATORIAL_RADIUS_KM + altitude_km)
    return np.asarray(np.sqrt(1 - (enu[..., 0] ** 2 + enu[..., 1] ** 2) * ratio**2))


def angle_nodes() -> Floats:
    """Angles of the tables, rad."""
    return np.asarray(2 * np.arcsin(np.linspace(0, 1, ANGLE_NODES) ** 2))


@functools.lru_cache(maxsize=8)
def angle_tables(ice: bool, particle_um: float) -> tuple[Floats, Floats]:
    """Phase function and aureole at :func:`angle_nodes`, each with the integral 1; the same for particles without a size."""
    angle = angle_nodes()
    phase = ray_phase(angle, ice)
    phase /= _over_the_sphere(phase, angle)
    if particle_um == 0:
        return phase, phase
    halo = np.zeros_like(angle)
    near = angle < np.pi / 2
    halo[near] = aureole(angle[near], particle_um)
    return phase, halo / _over_the_sphere(halo, angle)


def _over_the_sphere(table: Floats, angle: Floats) -> float:
    return float(np.trapezoid(2 * np.pi * table * np.sin(angle), angle))


def moon_veil(clouds: CloudField, moon_enu: Floats) -> MoonVeil:
    """Return the veil of moonlight that a layer scatters; the Moon must be above the horizon."""
    phase, halo = angle_tables(clouds.ice, clouds.particle_um)
    share = np.linspace(0, 1, DEPTH_NODES)
    depths = np.minimum(share / np.maximum(1 - share, 1e-9), KEPT_TO)
    more = cloud_transfer(clouds.ice).radiance(
        float(layer_cosine(moon_enu, clouds.altitude_km)),
        depths,
        np.linspace(0, 1, COSINE_NODES),
        np.linspace(0, np.pi, TURN_NODES),
    )
    return MoonVeil(clouds, np.asarray(moon_enu, dtype=np.float64), phase, halo, more)
