"""The whole diffuse sky of a frame: its components, separately and together."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from generator.light.atmosphere import Atmosphere
from generator.light.ground import Albedo, albedo_at, ground_light
from generator.light.lamps import City
from generator.light.molecular_bands import beam_depth
from generator.light.photometry import GRID_NM, radiance_from_surface_brightness
from generator.places.catalogue import load_catalogue
from generator.places.ephemeris import AU_KM
from generator.places.tycho2 import load_with_tycho2
from generator.scenario.model import Component, SkySpec, StarsSpec
from generator.sky import milky_way as mw
from generator.sky.airglow import airglow
from generator.sky.city_light import bortle_layout, skyglow
from generator.sky.cloud_light import cloud_light
from generator.sky.clouds import CloudVeil, mean_reflectance
from generator.sky.component import SkyTable, black_sky, compressed, total
from generator.sky.directions import irradiance_weights
from generator.sky.moonlight import moonlit_sky
from generator.sky.starlight import scattered_starlight
from generator.sky.state import SkyState
from generator.sky.twilight import nodes_nm, twilight
from generator.sky.zenith import BORTLE_ZENITH_MAG
from generator.sky.zodiacal import zodiacal

Floats = NDArray[np.float64]


@functools.cache
def star_light(catalogue: str = "ybsc+hipparcos", limit_v_mag: float = 9.0) -> tuple[float, float]:
    """Return the factor on the Milky Way's map, and the mean S10(V) of all stars over the sky.

    Parameters
    ----------
    catalogue : str
        With ``ybsc+hipparcos``, all of it counts as drawn; with ``tycho2``, stars brighter than the limit do.
    limit_v_mag : float
    """
    if catalogue == "tycho2":
        v_mag = load_with_tycho2().v_mag
        factor = mw.deep_factor(v_mag, limit_v_mag)
        return factor, mw.points_s10(v_mag[v_mag <= mw.FAINT_LIMIT_V_MAG]) + mw.sky_mean_s10()
    v_mag = load_catalogue().v_mag
    factor = mw.gap_factor(v_mag)
    return factor, mw.points_s10(v_mag[v_mag <= mw.FAINT_LIMIT_V_MAG]) + factor * mw.sky_mean_s10()


NATURAL: dict[Component, Callable[[SkySpec, StarsSpec, Atmosphere | None, SkyState], SkyTable]] = {
    "airglow": lambda spec, stars, air, state: airglow(spec.solar_flux_sfu, air, spec.airglow_factor),
    "zodiacal": lambda spec, stars, air, state: zodiacal(state.icrs_from_enu, state.sun_icrs, air),
    "milky_way": lambda spec, stars, air, state: mw.milky_way(
        state.icrs_from_enu, _light_of(stars)[0], air, stars.catalogue == "tycho2"
    ),
    "starlight": lambda spec, stars, air, state: scattered_starlight(_light_of(stars)[1], air),
}
"""Components that do not depend on lamps, Moon and Sun. A Bortle class includes them; lamps provide the rest of its light."""


def _light_of(stars: StarsSpec) -> tuple[float, float]:
    return star_light(stars.catalogue, stars.limiting_magnitude) if stars.catalogue == "tycho2" else star_light()


def layout(spec: SkySpec) -> tuple[City, ...]:
    """Cities of a scenario, before their output is scaled."""
    if spec.cities is not None:
        return tuple(city.city() for city in spec.cities)
    if spec.bortle is not None:
        return bortle_layout(spec.bortle)
    if spec.zenith_mag_arcsec2 is not None:
        wanted = spec.zenith_mag_arcsec2
        return bortle_layout(min(BORTLE_ZENITH_MAG, key=lambda bortle: abs(BORTLE_ZENITH_MAG[bortle] - wanted)))
    return ()


def _asked_zenith(spec: SkySpec) -> float | None:
    """Zenith brightness requested by the scenario, V mag/arcsec^2; None if its cities' own output counts."""
    return spec.zenith_mag_arcsec2 if spec.bortle is None else BORTLE_ZENITH_MAG[spec.bortle]


def sky_layers(
    spec: SkySpec, stars: StarsSpec, atmosphere: Atmosphere | None, state: SkyState, horizon_deg: float = 0.0
) -> dict[str, SkyTable]:
    """Components of a frame's sky at the ground, by name; their sum, together with the drawn `stars`, is the sky.

    The Sun counts as up if it is above a horizon at the apparent altitude `horizon_deg`, 0 or less.

    Raises
    ------
    GeneratorError
        Twilight is requested and the Sun is up.
    DataFileError
        A map is missing or damaged.
    """
    active = spec.active_components
    layers: dict[str, SkyTable] = {
        name: make(spec, stars, atmosphere, state) for name, make in NATURAL.items() if name in active
    }
    dark = atmosphere is not None and not atmosphere.scatters
    cities = () if dark or "skyglow" not in active else layout(spec)
    glow = skyglow(cities, atmosphere, spec.ground_albedo) if cities else None
    asked_mag = _asked_zenith(spec)
    if asked_mag is not None:
        asked = float(radiance_from_surface_brightness(asked_mag))
        natural = sum(layer.zenith_v() for layer in layers.values())
        if natural > asked:
            # The request is darker than this night's natural sky, so the components keep their proportions.
            layers = {name: layer.scaled(asked / natural) for name, layer in layers.items()}
        if glow is not None:
            factor = max(0.0, asked - natural) / glow.zenith_v()
            glow = glow.scaled(factor)
            cities = tuple(
                dataclasses.replace(city, upward_mlm=city.upward_mlm * factor) for city in cities if factor > 0
            )
    if glow is not None:
        layers["skyglow"] = glow
    if "moonlight" in active:
        layers["moonlight"] = moonlit_sky(state, atmosphere, spec.ground_albedo)
    if "twilight" in active:
        layers["twilight"] = twilight(
            state.sun_enu,
            state.sun_depression_deg,
            atmosphere,
            state.height_m,
            state.sun.distance_km / AU_KM,
            albedo_at(spec.ground_albedo, nodes_nm()),
            horizon_deg,
        )
    if state.clouds is not None and layers:
        layers = _under_cloud(layers, cities, atmosphere, state, spec.ground_albedo)
    return layers


def _under_cloud(
    layers: dict[str, SkyTable],
    cities: tuple[City, ...],
    atmosphere: Atmosphere | None,
    state: SkyState,
    ground_albedo: Albedo,
) -> dict[str, SkyTable]:
    """Return the layers seen through the frame's cloud, and the cloud's own light."""
    assert state.clouds is not None
    passed = CloudVeil(state.clouds)
    moon_sine = max(0.0, float(state.moon_enu[2])) if "moonlight" in layers else 0.0
    moon = np.zeros_like(GRID_NM)
    if moon_sine > 0:
        moon = state.moon_spectrum
        moon_on_ground = moon * moon_sine
        if atmosphere is not None:
            moon_on_ground = moon_on_ground * np.exp(-beam_depth(atmosphere, state.moon_altitude_deg))
    else:
        moon_on_ground = moon
    above = [layer for name, layer in layers.items() if name != "skyglow"]
    sky_on_ground = sum((np.pi * _hemisphere_mean(layer) for layer in above), np.zeros_like(GRID_NM))
    reflected = mean_reflectance(state.clouds.pattern, state.clouds.asymmetry)
    falling = (1 - reflected) * (sky_on_ground + moon_on_ground)
    ground = ground_light(albedo_at(ground_albedo, GRID_NM), falling, reflected)
    seen = {name: layer if name == "skyglow" else layer.behind(passed) for name, layer in layers.items()}
    glow = cloud_light(state.clouds, cities, ground, moon, state.moon_enu, atmosphere, ground_albedo)
    return seen | {"clouds": glow}


def _hemisphere_mean(layer: SkyTable) -> Floats:
    """Mean radiance over the hemisphere, weighted by the cosine of the zenith angle, (n,) array."""
    return (layer.azimuth_mean @ irradiance_weights()) @ layer.spectra


def whole_sky(layers: dict[str, SkyTable]) -> SkyTable:
    """The sum of the layers, in few terms."""
    return compressed(total(list(layers.values()))) if layers else black_sky()
