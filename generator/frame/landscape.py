"""A frame's landscape: its panorama, how this night illuminates it, and the maps that the integrator draws."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.device_arrays import aligned
from generator.frame.plan import FramePlan, dimming_atmosphere, field_radius_deg
from generator.ground.lamp import KINDS, Lamp, apparent_v_mag, extinction_per_km, spectra
from generator.ground.lighting import SkyLight, irradiance, sky_directions
from generator.ground.panorama import Panorama
from generator.ground.surface import AZIMUTHS, SURFACES, surface_terms
from generator.ground.surface_textures import (
    SURROUNDINGS_DEG,
    TEXELS_PER_PX,
    Ground,
    Place,
    Response,
    Surface,
    surface,
)
from generator.light.atmosphere import airmass
from generator.light.molecular_bands import depth_per_airmass
from generator.light.photometry import GRID_NM
from generator.plugins.scene_tensors import tensor
from generator.scenario.ground.landscape_spec import LandscapeSpec, landscape_panorama
from generator.sky.component import SkyTable, Veil, blas_threads
from generator.sky.directions import Places, places, unit_vectors
from generator.sky.moonlit_cloud import DIFFRACTED, MoonVeil

Floats = NDArray[np.float64]

VIEW_MARGIN_DEG = 0.5
LAMP_DIMMING_MAG = 10.0
"""Lamps are splatted this much fainter, because the integers that sum the light are limited to 1e12 electrons in a pixel."""
LAMP_FACTOR = 10 ** (0.4 * LAMP_DIMMING_MAG)


@dataclass(frozen=True, eq=False)
class LandscapeMaps:
    """An illuminated landscape, in the form that the integrator needs.

    The signal of a direction, radiance times response summed over GRID_NM, is the sum over the surfaces of the fraction
    of each times its term, plus the landscape's own light.

    Attributes
    ----------
    surface : Surface
    terms : (channels, AZIMUTHS, SURFACES) float32 array
        Signal of each of the SURFACES.
    shines : bool
        Whether its own light counts.
    whole : LandscapeMaps or None
        The full circle at coarse resolution, if the lens scatters light from outside the frame.
    """

    surface: Surface
    terms: NDArray[np.float32]
    shines: bool
    whole: LandscapeMaps | None = None

    def signal(self, altitude_deg: float, azimuth_deg: float) -> Floats:
        """Signal of the texel around a direction, (channels,) array."""
        terms = self.terms[:, round(azimuth_deg % 360 / 360 * AZIMUTHS) % AZIMUTHS]
        there = self.surface.at(altitude_deg, azimuth_deg)
        signal = terms.astype(np.float64) @ there[1 : 1 + SURFACES]
        if self.shines:
            signal += there[1 + SURFACES :][: len(terms)]
        return np.asarray(signal)

    def parameters(self, name: str = "landscape") -> dict[str, Any]:
        """Return the maps as parameters of the integrator."""
        maps = self.surface
        # As many numbers as the maps have planes.
        padded = np.zeros((*self.terms.shape[:2], 1 + SURFACES), np.float32)
        padded[..., 1:] = self.terms
        numbers = {
            f"{name}_maps": maps.values,
            f"{name}_planes": maps.planes,
            f"{name}_shines": self.shines,
            f"{name}_cells": maps.cells,
            f"{name}_terms": tensor(aligned(padded.reshape(-1))),
            f"{name}_channels": len(self.terms),
            f"{name}_rows": maps.rows,
            f"{name}_columns": maps.columns,
            f"{name}_top_deg": maps.top_deg,
            f"{name}_bottom_deg": maps.bottom_deg,
            f"{name}_first_column": maps.first_column,
            f"{name}_whole_columns": maps.whole_columns,
        }
        return numbers if self.whole is None else numbers | self.whole.parameters("surroundings")


def _in_view(plan: FramePlan, ground: Ground) -> Place | None:
    """Return the part of a large landscape that the camera may see, for which maps are needed; None for the whole."""
    if not ground.is_large:
        return None
    boresight = plan.motion.R_mid[2]
    turned = np.degrees(np.arccos(np.clip(plan.motion.R_cam[:, 2] @ boresight, -1, 1))).max()
    radius_deg = field_radius_deg(plan.spec.camera) + float(turned) + VIEW_MARGIN_DEG
    altitude = float(np.degrees(np.arcsin(np.clip(boresight[2], -1, 1))))
    azimuth = float(np.degrees(np.arctan2(boresight[0], boresight[1])))
    return ground.layers().around(altitude, azimuth, radius_deg).place


def landscape_maps(
    plan: FramePlan, tables: Sequence[SkyTable], response: Floats, component: str | None = None
) -> LandscapeMaps | None:
    """Maps of a frame's landscape under a sky; None without a landscape.

    Parameters
    ----------
    plan : FramePlan
    tables : sequence of SkyTable
        Components whose sum is the sky.
    response : (channels, n) array
        Response of each channel at GRID_NM; the sum of response times spectrum is its signal.
    component : str or None
        Name of the only component of the sky to include, whose tables `tables` then are; None for all light.
    """
    spec = plan.spec.foreground.landscape
    if spec is None:
        return None
    panorama = panorama_of(plan, spec)
    # BLAS threads wait for each other in busy loops: on a machine with busy cores, one thread is several times faster.
    with blas_threads().limit(limits=1, user_api="blas"):
        light = sky_light(plan, tables, component in (None, "moonlight"))
        terms = surface_terms(irradiance(panorama, light), light, response)
        return _in_both(plan, spec, terms, response, shines=component is None)


def own_light_maps(plan: FramePlan, response: Floats) -> LandscapeMaps | None:
    """Maps of only the light that a frame's landscape emits by its windows and lamps; None without a landscape."""
    spec = plan.spec.foreground.landscape
    if spec is None:
        return None
    dark = np.zeros((len(response), AZIMUTHS, SURFACES), np.float32)
    return _in_both(plan, spec, dark, response, shines=True)


def _in_both(
    plan: FramePlan, spec: LandscapeSpec, terms: NDArray[np.float32], response: Floats, shines: bool
) -> LandscapeMaps:
    """Maps of the part that a frame's camera may see, and of the full circle if its lens needs it."""
    ground = Ground(
        panorama_of(plan, spec),
        math.degrees(1 / plan.spec.camera.f_px) / TEXELS_PER_PX,
        extinction_per_km(dimming_atmosphere(plan.spec.atmosphere)),
        tuple(lamp for lamp in frame_lamps(plan) if lamp.downward_cd > 0),
        (spec.eye_height_m, spec.distance_m),
    )

    def drawn(ground: Ground, part: Place | None) -> LandscapeMaps:
        maps = surface(ground, part, Response.of(response))
        return LandscapeMaps(maps, terms, shines and maps.shines)

    near = drawn(ground, _in_view(plan, ground))
    if plan.spec.camera.direct_share == 1:
        return near
    around = dataclasses.replace(ground, texel_deg=SURROUNDINGS_DEG)
    return dataclasses.replace(near, whole=drawn(around, None))


def panorama_of(plan: FramePlan, spec: LandscapeSpec) -> Panorama:
    """Return the panorama of a frame's landscape at its site."""
    site = plan.spec.site
    return landscape_panorama(spec, plan.scenario.seed, spec.place(site.latitude_deg, site.longitude_deg))


def frame_lamps(plan: FramePlan) -> tuple[Lamp, ...]:
    """Lamps in view: those of the scenario, then those of its skyline."""
    own = tuple(lamp.lamp() for lamp in plan.spec.foreground.lamps)
    spec = plan.spec.foreground.landscape
    return own if spec is None else own + panorama_of(plan, spec).lamps


def lamps_dict(plan: FramePlan, lamps: tuple[Lamp, ...]) -> dict[str, Any]:
    """Return lamps as an emitter like that of the stars, in front of everything, fainter by LAMP_DIMMING_MAG."""
    places = np.array([lamp.place_m / lamp.distance_m for lamp in lamps])
    return {
        "type": "skybench_stars",
        "in_front": True,
        "directions": tensor(np.repeat(places[:, None], 2, axis=1)),
        "v_mag": tensor(lamp_v_mag(plan, lamps) + LAMP_DIMMING_MAG),
        "colour_row": tensor([float(KINDS.index(lamp.kind)) for lamp in lamps]),
        "colour_column": tensor(np.zeros(len(lamps))),
        "airmass": tensor(np.zeros(len(lamps))),
        "colour_table": tensor(np.repeat(spectra()[:, None], 2, axis=1)),
        "optical_depth": tensor(np.zeros((1, len(GRID_NM)))),
    }


def lamp_v_mag(plan: FramePlan, lamps: tuple[Lamp, ...]) -> Floats:
    """V of lamps at the camera, (n,) array."""
    return apparent_v_mag(lamps, dimming_atmosphere(plan.spec.atmosphere))


@functools.cache
def _sky_places() -> tuple[Floats, Places]:
    """Directions from which the sky lights a landscape: unit vectors (m, 3), and their places on the sky's grid."""
    altitude, azimuth = sky_directions()
    return unit_vectors(altitude, azimuth), places(altitude, azimuth)


def sky_light(plan: FramePlan, tables: Sequence[SkyTable], moon: bool = True) -> SkyLight:
    """Light from a frame's sky and Moon on its landscape."""
    factors: dict[Veil, Floats] = {}
    lights = [light for table in tables for light in _sampled(table, factors)]
    lights = lights or [(np.zeros((1, len(_sky_places()[0]))), np.zeros((1, len(GRID_NM))))]
    maps, spectra = (np.concatenate(parts) for parts in zip(*lights, strict=True))
    state = plan.sky
    shines = moon and "moonlight" in plan.spec.sky.active_components and state.moon_altitude_deg > 0
    direct = np.zeros(len(GRID_NM))
    if shines:
        atmosphere = dimming_atmosphere(plan.spec.atmosphere)
        through = 1.0
        if state.clouds is not None:
            # The aureole lights surfaces as the Moon does.
            straight = dataclasses.replace(state.clouds, point_share=DIFFRACTED)
            through = float(straight.point_transmission(state.moon_enu[None])[0])
        path = float(airmass(state.moon_altitude_deg))
        loss = 0.0 if atmosphere is None else path * depth_per_airmass(GRID_NM, atmosphere, np.array([path]))[0]
        direct = state.moon_spectrum * through * np.exp(-loss)
    return SkyLight(maps, spectra, state.moon_enu, direct)


def _sampled(table: SkyTable, factors: dict[Veil, Floats]) -> list[tuple[Floats, Floats]]:
    """Values (k, m) of a table's maps where the sky lights a landscape, with its spectra (k, n); then those behind each veil.

    `factors` caches the factors of veils, which the components of a sky have in common.
    """
    directions, on_grid = _sky_places()
    values = on_grid.of(table.wide_parts)
    if table.pattern is not None:
        patterns = on_grid.of(table.pattern if table.pattern.ndim == 3 else table.pattern[None])
        values = values * np.repeat(patterns, len(values) // len(patterns), axis=0)
    result = [(values, table.spectra)]
    for veil, behind in table.veiled:
        if veil not in factors:
            factors[veil] = (veil.broad if isinstance(veil, MoonVeil) else veil).at(directions)
        result += [(part * factors[veil], spectra) for part, spectra in _sampled(behind, factors)]
    return result
