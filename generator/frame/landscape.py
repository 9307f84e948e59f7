"""A frame's landscape: its panorama, the light of this night on it, and the maps that the integrator draws."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.frame.plan import FramePlan, dimming_atmosphere, field_radius_deg
from generator.ground.lamp import KINDS, Lamp, apparent_v_mag, extinction_per_km, spectra, spectrum
from generator.ground.lighting import (
    SkyLight,
    airlight,
    irradiance,
    lamp_illuminance,
    reflected_signal,
    sky_directions,
    transmission,
)  # fmt: skip
from generator.ground.panorama import Layers, Panorama, Window, reduced
from generator.ground.reflectance import primaries
from generator.light.atmosphere import airmass
from generator.light.lamps import LUMEN_PER_V_PHOTON
from generator.light.molecular_bands import depth_per_airmass
from generator.light.photometry import GRID_NM
from generator.plugins.scene_tensors import tensor
from generator.scenario.ground.landscape_spec import LandscapeSpec, landscape_panorama
from generator.sky.component import SkyTable, blas_threads
from generator.sky.directions import interpolate, sky_grid, unit_vectors
from generator.sky.moonlit_cloud import DIFFRACTED, MoonVeil

Floats = NDArray[np.float64]

TEXELS_PER_PX = 2.0
"""Of the maps, along each axis, in the middle of the frame: two looks and a texel's own width make a pixel."""
WINDOW_LIGHT = "LED"
"""Spectrum of a landscape's own glow, coloured by its picture."""

VIEW_MARGIN_DEG = 0.5
SURROUNDINGS_DEG = 1.0
"""Step of the whole circle for light that comes from outside the frame."""
LAMP_DIMMING_MAG = 10.0
"""Lamps are splatted this much fainter: the integers that sum the light end at 1e12 electrons in a pixel."""
LAMP_FACTOR = 10 ** (0.4 * LAMP_DIMMING_MAG)


@dataclass(frozen=True, eq=False)
class LandscapeMaps:
    """A landscape as the integrator needs it.

    Attributes
    ----------
    maps : (1 + channels, ny, nx) float32 array
        Alpha, and each channel's signal over alpha: radiance times response, summed over GRID_NM.
    layers : Layers
        The grid of the maps.
    whole : LandscapeMaps or None
        The whole circle in coarse steps, where the lens scatters light from outside the frame.
    """

    maps: NDArray[np.float32]
    layers: Layers
    whole: LandscapeMaps | None = None

    def parameters(self, name: str = "landscape") -> dict[str, Any]:
        """As parameters of the integrator."""
        own = {
            f"{name}_maps": tensor(self.maps),
            f"{name}_top_deg": self.layers.top_deg,
            f"{name}_bottom_deg": self.layers.bottom_deg,
            f"{name}_first_column": self.layers.first_column,
            f"{name}_whole_columns": self.layers.whole_columns,
        }
        return own if self.whole is None else own | self.whole.parameters("surroundings")


@functools.lru_cache(maxsize=4)
def _fitted(panorama: Panorama, texel_deg: float) -> Layers:
    return reduced(panorama, texel_deg)


def _texel_deg(plan: FramePlan) -> float:
    """Texels as fine as a camera's pixels need them."""
    return math.degrees(1 / plan.spec.camera.f_px) / TEXELS_PER_PX


def _in_view(plan: FramePlan, layers: Layers) -> Window:
    """The part of a landscape that a frame's camera may see."""
    boresight = plan.motion.R_mid[2]
    turned = np.degrees(np.arccos(np.clip(plan.motion.R_cam[:, 2] @ boresight, -1, 1))).max()
    radius_deg = field_radius_deg(plan.spec.camera) + float(turned) + VIEW_MARGIN_DEG
    altitude = float(np.degrees(np.arcsin(np.clip(boresight[2], -1, 1))))
    azimuth = float(np.degrees(np.arctan2(boresight[0], boresight[1])))
    return layers.around(altitude, azimuth, radius_deg)


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
    panorama = panorama_of(plan, spec)
    # BLAS threads wait for each other in busy loops: on a machine whose cores are taken, one is several times faster.
    with blas_threads().limit(limits=1, user_api="blas"):
        light = sky_light(plan, tables, component in (None, "moonlight"))
        lit = irradiance(panorama, light)

        def drawn(whole: Layers, part: Window) -> LandscapeMaps:
            layers = whole.window(part)
            signal = reflected_signal(layers, lit, response)
            if component is None:
                signal += own_light(plan, panorama, whole, part, response, layers)
            return LandscapeMaps(
                np.concatenate([layers.alpha[None], _through_air(plan, layers, signal, light, response)]), layers
            )

        return _in_both(plan, panorama, drawn)


def _in_both(plan: FramePlan, panorama: Panorama, drawn: Callable[[Layers, Window], LandscapeMaps]) -> LandscapeMaps:
    """Maps of what a frame's camera may see, and of the whole circle where its lens needs that."""
    fine = _fitted(panorama, _texel_deg(plan))
    near = drawn(fine, _in_view(plan, fine))
    if plan.spec.camera.direct_share == 1:
        return near
    coarse = _fitted(panorama, SURROUNDINGS_DEG)
    rows, columns = coarse.alpha.shape
    return dataclasses.replace(near, whole=drawn(coarse, Window(slice(0, rows), np.arange(columns))))


def own_light_maps(plan: FramePlan, response: Floats) -> LandscapeMaps | None:
    """Maps of the light alone that a frame's landscape has of its windows and lamps; None without a landscape."""
    spec = plan.spec.foreground.landscape
    if spec is None:
        return None
    panorama = panorama_of(plan, spec)

    def drawn(whole: Layers, part: Window) -> LandscapeMaps:
        layers = whole.window(part)
        signal = own_light(plan, panorama, whole, part, response, layers)
        return LandscapeMaps(np.concatenate([layers.alpha[None], _through_air(plan, layers, signal)]), layers)

    return _in_both(plan, panorama, drawn)


def panorama_of(plan: FramePlan, spec: LandscapeSpec) -> Panorama:
    """A frame's landscape at its site."""
    site = plan.spec.site
    return landscape_panorama(spec, plan.scenario.seed, spec.place(site.latitude_deg, site.longitude_deg))


def _through_air(
    plan: FramePlan,
    layers: Layers,
    signal: NDArray[np.float32],
    light: SkyLight | None = None,
    response: Floats | None = None,
) -> NDArray[np.float32]:
    """Signal (channels, ny, nx) of a landscape behind the air before it, which shines where a sky's light is given."""
    passed = transmission(layers, extinction_per_km(dimming_atmosphere(plan.spec.atmosphere)))
    if passed is None:
        return signal
    signal *= passed
    if light is not None and response is not None:
        signal += airlight(layers, light, response)[:, None, :] * ((1 - passed) * layers.alpha)
    return signal


def own_light(
    plan: FramePlan, panorama: Panorama, whole: Layers, part: Window, response: Floats, layers: Layers
) -> NDArray[np.float32]:
    """Light of windows and of lamps on a part of a landscape, through the camera's response, (channels, ny, nx) array.

    `layers` are those of the part.
    """
    total = np.zeros((len(response), *layers.alpha.shape), np.float32)
    if layers.glow is not None:
        # cd/m^2 is lm m^-2 sr^-1, and the spectrum has a V-band mean of 1.
        white = spectrum(WINDOW_LIGHT) * panorama.glow_cd_m2 / LUMEN_PER_V_PHOTON
        total += _by_channel(layers.glow, white, response)
    spec = plan.spec.foreground.landscape
    assert spec is not None
    for kind in KINDS:
        shining = tuple(lamp for lamp in frame_lamps(plan) if lamp.kind == kind and lamp.downward_cd > 0)
        if shining:
            lux = part.of(_lamps_on(whole, shining, (spec.eye_height_m, spec.distance_m)))
            light = _by_channel(layers.reflectance, spectrum(kind) / (np.pi * LUMEN_PER_V_PHOTON), response)
            total += light * lux
    return total


def _by_channel(colours: NDArray[np.float32], white: Floats, response: Floats) -> NDArray[np.float32]:
    """Signal of linear colours (ny, nx, 3) whose white has a spectrum, (channels, ny, nx) array."""
    terms = (response @ (primaries() * white).T).astype(np.float32)
    return np.moveaxis(colours @ terms.T, -1, 0)


@functools.lru_cache(maxsize=4)
def _lamps_on(layers: Layers, lamps: tuple[Lamp, ...], plain: tuple[float, float]) -> NDArray[np.float32]:
    return lamp_illuminance(layers, lamps, plain)


def frame_lamps(plan: FramePlan) -> tuple[Lamp, ...]:
    """Lamps in view: those of the scenario, then those of its skyline."""
    own = tuple(lamp.lamp() for lamp in plan.spec.foreground.lamps)
    spec = plan.spec.foreground.landscape
    return own if spec is None else own + panorama_of(plan, spec).lamps


def lamps_dict(plan: FramePlan, lamps: tuple[Lamp, ...]) -> dict[str, Any]:
    """Lamps as an emitter like that of the stars, in front of everything, LAMP_DIMMING_MAG fainter than they are."""
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
        through = 1.0
        if state.clouds is not None:
            # The aureole lights surfaces as the Moon does.
            straight = dataclasses.replace(state.clouds, point_share=DIFFRACTED)
            through = float(straight.point_transmission(state.moon_enu[None])[0])
        path = float(airmass(state.moon_altitude_deg))
        loss = 0.0 if atmosphere is None else path * depth_per_airmass(GRID_NM, atmosphere, np.array([path]))[0]
        direct = state.moon_spectrum * through * np.exp(-loss)
    return SkyLight(maps, spectra, state.moon_enu, direct)


def _sampled(table: SkyTable, altitude_deg: Floats, azimuth_deg: Floats) -> list[tuple[Floats, Floats]]:
    """Values (k, m) of a table's maps in m directions, and its spectra (k, n); then those behind each veil."""

    def looked_up(maps: NDArray[np.float32]) -> Floats:
        return interpolate(np.broadcast_to(maps, (len(maps), *sky_grid().shape)), altitude_deg, azimuth_deg)

    values = looked_up(table.wide_parts)
    if table.pattern is not None:
        patterns = looked_up(table.pattern if table.pattern.ndim == 3 else table.pattern[None])
        values = values * np.repeat(patterns, len(values) // len(patterns), axis=0)
    result = [(values, table.spectra)]
    for veil, behind in table.veiled:
        broad = veil.broad if isinstance(veil, MoonVeil) else veil
        factor = broad.at(unit_vectors(altitude_deg, azimuth_deg))
        result += [(part * factor, spectra) for part, spectra in _sampled(behind, altitude_deg, azimuth_deg)]
    return result
