"""A frame's landscape: its panorama, the light of this night on it, and the maps that the integrator draws."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.frame.plan import FramePlan, dimming_atmosphere
from generator.ground.lighting import SkyLight, irradiance, reflected_signal, sky_directions
from generator.ground.panorama import Layers, Panorama, reduced
from generator.ground.reflectance import primaries
from generator.light.atmosphere import airmass, optical_depth
from generator.light.lamps import LUMEN_PER_V_PHOTON, lamp_spectra
from generator.light.photometry import GRID_NM
from generator.light.stellar_spectra import star_spectra
from generator.plugins.scene_tensors import tensor
from generator.scenario.ground.landscape_spec import landscape_panorama
from generator.sky.component import SkyTable, blas_threads
from generator.sky.directions import interpolate, sky_grid, unit_vectors
from generator.sky.moonlight import MOON_BV_MAG

Floats = NDArray[np.float64]

TEXELS_PER_PX = 2.0
"""Of the maps, along each axis, in the middle of the frame: two looks and a texel's own width make a pixel."""
WINDOW_LIGHT = "LED"
"""Spectrum of a landscape's own glow, coloured by its picture."""


@dataclass(frozen=True, eq=False)
class LandscapeMaps:
    """A landscape as the integrator needs it.

    Attributes
    ----------
    maps : (1 + channels, ny, nx) float32 array
        Alpha, and each channel's signal over alpha: radiance times response, summed over GRID_NM.
    top_deg, bottom_deg : float
    """

    maps: NDArray[np.float32]
    top_deg: float
    bottom_deg: float

    def parameters(self) -> dict[str, Any]:
        """As parameters of the integrator."""
        return {
            "landscape_maps": tensor(self.maps),
            "landscape_top_deg": self.top_deg,
            "landscape_bottom_deg": self.bottom_deg,
        }


@functools.lru_cache(maxsize=2)
def _fitted(panorama: Panorama, f_px: float) -> Layers:
    """The panorama with texels as fine as a camera's pixels need them."""
    return reduced(panorama, math.degrees(1 / f_px) / TEXELS_PER_PX)


def landscape_maps(
    plan: FramePlan, tables: Sequence[SkyTable], response: Floats, component: str | None = None
) -> LandscapeMaps | None:
    """Maps of a frame's landscape under a sky; None without a landscape.

    Parameters
    ----------
    plan : FramePlan
    tables : sequence of SkyTable
        Their sum is the sky.
    response : (channels, n) array
        Response of each channel at GRID_NM; the sum of response times spectrum is its signal.
    component : str or None
        Name of the only component of the sky that counts, `tables` being its own; None: everything that shines.
    """
    spec = plan.spec.foreground.landscape
    if spec is None:
        return None
    panorama = landscape_panorama(spec)
    layers = _fitted(panorama, plan.spec.camera.f_px)
    # BLAS threads wait for each other in busy loops: on a machine whose cores are taken, one is several times faster.
    with blas_threads().limit(limits=1, user_api="blas"):
        lit = irradiance(panorama, sky_light(plan, tables, component in (None, "moonlight")))
        signal = reflected_signal(layers, lit, response)
    if component is None:
        signal += own_light(panorama, layers, response)
    return LandscapeMaps(np.concatenate([layers.alpha[None], signal]), layers.top_deg, layers.bottom_deg)


def own_light_maps(plan: FramePlan, response: Floats) -> LandscapeMaps | None:
    """Maps of the light alone that a frame's landscape has of its own; None where it has none."""
    spec = plan.spec.foreground.landscape
    if spec is None or landscape_panorama(spec).glow is None:
        return None
    panorama = landscape_panorama(spec)
    layers = _fitted(panorama, plan.spec.camera.f_px)
    signal = own_light(panorama, layers, response)
    return LandscapeMaps(np.concatenate([layers.alpha[None], signal]), layers.top_deg, layers.bottom_deg)


def own_light(panorama: Panorama, layers: Layers, response: Floats) -> NDArray[np.float32]:
    """Light of a landscape's windows and signs through the camera's response, over alpha, (channels, ny, nx) array."""
    if layers.glow is None:
        return np.zeros((len(response), *layers.alpha.shape), np.float32)
    # cd/m^2 is lm m^-2 sr^-1, and the spectrum has a V-band mean of 1.
    white = lamp_spectra()[WINDOW_LIGHT] * panorama.glow_cd_m2 / LUMEN_PER_V_PHOTON
    terms = (response @ (primaries() * white).T).astype(np.float32)
    return np.moveaxis(layers.glow @ terms.T, -1, 0)


def sky_light(plan: FramePlan, tables: Sequence[SkyTable], moon: bool = True) -> SkyLight:
    """Light from a frame's sky and Moon on its landscape."""
    altitude, azimuth = sky_directions()
    lights = [light for table in tables for light in _sampled(table, altitude, azimuth)]
    lights = lights or [(np.zeros((1, len(altitude))), np.zeros((1, len(GRID_NM))))]
    maps, spectra = (np.concatenate(parts) for parts in zip(*lights, strict=True))
    state = plan.sky
    shines = moon and "moonlight" in plan.spec.sky.active_components and state.moon_altitude_deg > 0
    direct = np.zeros(len(GRID_NM))
    if shines:
        atmosphere = dimming_atmosphere(plan.spec.atmosphere)
        depth = 0.0 if state.clouds is None else float(state.clouds.slant_depth(state.moon_enu[None])[0])
        loss = 0.0 if atmosphere is None else optical_depth(GRID_NM, atmosphere) * airmass(state.moon_altitude_deg)
        direct = star_spectra([state.moon_v_mag], [MOON_BV_MAG])[0] * np.exp(-loss - depth)
    return SkyLight(maps, spectra, state.moon_enu, direct)


def _sampled(table: SkyTable, altitude_deg: Floats, azimuth_deg: Floats) -> list[tuple[Floats, Floats]]:
    """Values (k, m) of a table's maps in m directions, and its spectra (k, n); then those behind each veil."""

    def looked_up(maps: NDArray[np.float32]) -> Floats:
        return interpolate(np.broadcast_to(maps, (len(maps), *sky_grid().shape)), altitude_deg, azimuth_deg)

    values = looked_up(table.parts)
    if table.pattern is not None:
        values = values * looked_up(table.pattern[None])
    result = [(values, table.spectra)]
    for veil, behind in table.veiled:
        factor = veil.at(unit_vectors(altitude_deg, azimuth_deg))
        result += [(part * factor, spectra) for part, spectra in _sampled(behind, altitude_deg, azimuth_deg)]
    return result
