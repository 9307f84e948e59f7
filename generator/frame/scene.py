"""Conversion of a frame plan to a Mitsuba scene, and of the scene to expected electrons and truth."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator import plugins
from generator.device_arrays import aligned
from generator.frame.dispersion import with_dispersion
from generator.frame.foreground import shape_dicts
from generator.frame.landscape import (
    LAMP_FACTOR,
    LandscapeMaps,
    frame_lamps,
    lamps_dict,
    landscape_maps,
    own_light_maps,
)
from generator.frame.plan import FramePlan, dimming_atmosphere
from generator.frame.point_lights import faint_lights, moon_dicts, objects_dict, star_lights, stars_dict
from generator.frame.scattered_light import Shining, dust_of, gathered, scattered
from generator.frame.star_truth import LitMoments, StarTruth, between_lit_ends, star_truth
from generator.light.photometry import GRID_NM, surface_brightness_from_radiance
from generator.optics.motion import turned_rad
from generator.optics.psf import psf_table
from generator.plugins.scene_tensors import tensor
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.model import FrameSpec
from generator.sensor.colour import channel_weights, filter_tile, mosaic
from generator.sky.assembly import sky_layers, whole_sky
from generator.sky.below_horizontal import down_to_the_horizon
from generator.sky.clouds import CloudVeil
from generator.sky.component import SkyTable, black_sky, blas_threads, metameric
from generator.sky.moonlit_cloud import MoonVeil

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

SKY_STEP_PX = 8.0
"""The diffuse sky is evaluated once per this many pixels of motion."""
MOST_SKY_MOMENTS = 16
"""Limits the time of a frame with fast motion; the sky is smooth."""
MOST_COVERAGE_MOMENTS = 64
"""Limits the time of a frame with fast motion; with more, a moving edge is blurred in steps of more than a pixel."""


@dataclass(frozen=True)
class ExpectedFrame:
    """Expected electrons of a frame, and the truth behind them.

    Attributes
    ----------
    electrons : (height, width) float32 array
        Expected electrons from stars and sky in each pixel, of the colour that its filter passes.
    sky_electrons : (height, width) float32 array
        Electrons from the sky and the foreground, and those of all light that the lens scatters.
    channels : dict of (height, width) float32 arrays
        Expected electrons by channel (``electrons``, or ``blue``, ``green``, ``red``), as if every pixel had that
        channel; empty unless requested.
    u_px, v_px : (n,) arrays
        Positions of the plan's stars when the row on which they fall is half exposed, px; NaN if a star is outside the
        lens model's range.
    start_px, end_px : (n, 2) arrays
        Positions when that row's exposure starts and ends; NaN outside the range or far from the frame.
    centroid_px : (n, 2) array
        Mean positions weighted by the arriving light; NaN if no light arrives.
    light_px : (n, 2) array
        First moments of the light on an unbounded sensor, with the point spread function's asymmetry and lateral colour;
        NaN if no light arrives.
    star_electrons : (n,) array
        Expected electrons over the whole point spread function; for a colour sensor, the mean over its filter pattern.
    fraction_in_frame : (n,) array
        Fraction of these electrons that falls on the sensor.
    occluded : (n,) bool array
        Whether the foreground and the Moon hide more than half of the star's light.
    hidden_fraction : (n,) array
        Fraction of the star's light that they hide.
    low_px, high_px : (n, 2) arrays
        Least and greatest u and v from which light arrives, without the point spread function; NaN if no light arrives.
    lit : LitMoments
        Where the stars are when their light arrives.
    objects : StarTruth
        Truth of the plan's flying objects.
    lamps : StarTruth
        Truth of the lamps in view.
    moon : StarTruth
        Truth of the Moon's disk as one source (n = 1); n = 0 if no Moon is drawn.
    zenith_mag_arcsec2 : float or None
        Brightness of the diffuse sky at the zenith, V mag/arcsec^2; None for a black sky.
    layers : dict of (height, width) float32 arrays
        Parts of `electrons` by name, if requested; they add up to it.
    cover : (height, width) float32 array or None
        Fraction of each pixel that is not sky; None if the scenario has nothing in front of the sky.
    """

    electrons: NDArray[np.float32]
    sky_electrons: NDArray[np.float32]
    channels: dict[str, NDArray[np.float32]]
    u_px: Floats
    v_px: Floats
    start_px: Floats
    end_px: Floats
    centroid_px: Floats
    light_px: Floats
    star_electrons: Floats
    fraction_in_frame: Floats
    occluded: NDArray[np.bool_]
    hidden_fraction: Floats
    low_px: Floats
    high_px: Floats
    lit: LitMoments
    objects: StarTruth
    lamps: StarTruth
    moon: StarTruth
    zenith_mag_arcsec2: float | None
    layers: dict[str, NDArray[np.float32]]
    cover: NDArray[np.float32] | None = None


def frame_layers(plan: FramePlan) -> dict[str, SkyTable]:
    """Components of a frame's diffuse sky, by name."""
    with blas_threads().limit(limits=1, user_api="blas"):
        atmosphere = dimming_atmosphere(plan.spec.atmosphere)
        layers = sky_layers(plan.spec.sky, plan.spec.stars, atmosphere, plan.sky, plan.horizon.altitude_deg)
        return down_to_the_horizon(layers, plan.horizon, atmosphere)


def scene_dict(
    plan: FramePlan, sky: SkyTable | None = None, camera: Any = None, landscape: LandscapeMaps | None = None
) -> dict[str, Any]:
    """Mitsuba scene dictionary of a frame; needs a running Mitsuba (:func:`generator.plugins.start`).

    Parameters
    ----------
    plan : FramePlan
    sky : SkyTable or None
        The diffuse sky; None for the frame's own.
    camera : Sensor or None
        The frame's camera, if already loaded.
    landscape : LandscapeMaps or None
        The frame's illuminated landscape; None if there is no landscape.
    """
    mi = plugins.start()
    spec = plan.spec
    sky = whole_sky(frame_layers(plan)) if sky is None else sky
    faint = faint_lights(plan)
    lamps = frame_lamps(plan)
    return {
        "type": "scene",
        "integrator": integrator_dict(plan) | ({} if landscape is None else landscape.parameters()),
        "sky": sky_dict(sky),
        "stars": stars_dict(plan, star_lights(plan)),
        **({"unlisted": stars_dict(plan, faint)} if faint else {}),
        "camera": camera_dict(plan) if camera is None else camera,
        **shape_dicts(spec.foreground, mi),
        **({"objects": objects_dict(plan.objects, plan.horizon.sine)} if len(plan.objects) else {}),
        **({"lamps": lamps_dict(plan, lamps)} if lamps else {}),
    }


def sky_dict(sky: SkyTable) -> dict[str, Any]:
    """The diffuse sky's part of a scene; its spectra are common to all light (as in `metameric` and `compressed`)."""
    description = {"type": "skybench_sky", "maps": tensor(sky.maps), "spectra": tensor(sky.spectra)}
    if sky.low is not None:
        description |= {"low_maps": tensor(sky.low.maps[None]), "lowest_deg": sky.low.lowest_deg}
    # There is one veil of the frame's cloud for diffuse light and one for the Moon's.
    veiled = sorted(sky.veiled, key=lambda pair: isinstance(pair[0], MoonVeil))
    veils = [veil for veil, _ in veiled if isinstance(veil, CloudVeil | MoonVeil)]
    if veils:
        from generator.plugins.clouds import cloud_numbers, moon_numbers

        clouds = veils[0].clouds
        if isinstance(veils[-1], MoonVeil):
            description |= {
                "moon": tensor(moon_numbers(veils[-1])),
                "moon_angles": tensor(np.stack((veils[-1].phase, veils[-1].halo))),
                "moon_more": tensor(veils[-1].more),
            }
        description |= {
            "veiled_maps": tensor(np.concatenate([behind.maps for _, behind in veiled])[None]),
            "cloud_coarse": tensor(clouds.pattern.coarse),
            "cloud_fine": tensor(clouds.pattern.fine),
            "cloud_numbers": tensor(cloud_numbers(clouds)),
        }
    return description


def camera_dict(plan: FramePlan) -> dict[str, Any]:
    """The sensor's part of a scene."""
    spec, camera = plan.spec, plan.spec.camera
    projection = camera.projection
    description: dict[str, Any] = {
        "type": "skybench_camera",
        "model": camera.model,
        "f_px": projection.f_px,
        "fy_px": projection.fy_px,
        "cx_px": projection.cx_px,
        "cy_px": projection.cy_px,
        "pupil": camera.pupil_law,
        "aperture_area_m2": math.pi / 4 * (camera.aperture_mm / 1000) ** 2,
        "exposure_s": spec.time.exposure_s,
        "read_out_s": spec.sensor.read_out_s(camera.height),
        "reads_up": spec.sensor.rolling_shutter is not None and spec.sensor.rolling_shutter.direction == "up",
        "attitude": tensor(plan.motion.R_cam),
        "film": {
            "type": "specfilm",
            "width": camera.width,
            "height": camera.height,
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
    }
    for name, curve in spec.sensor.channels.items():
        response = quantum_efficiency(spec, curve)
        pairs = [(float(wavelength), float(value)) for wavelength, value in zip(GRID_NM, response, strict=True)]
        description["film"][name] = {"type": "spectrum", "value": pairs}
    description |= {f"k{i + 1}": value for i, value in enumerate(projection.full_k)}
    description |= {f"p{i + 1}": value for i, value in enumerate(projection.full_p)}
    description |= {f"s{i + 1}": value for i, value in enumerate(projection.full_s)}
    description |= dict(zip(("tau_x", "tau_y"), projection.full_tilt_rad, strict=False))
    if camera.image_circle_px is not None:
        description["image_circle_px"] = camera.image_circle_px
    if camera.vignetting:
        description |= {"vignetting": tensor(camera.vignetting), "corner_px": camera.corner_px}
    return description


def integrator_dict(plan: FramePlan) -> dict[str, Any]:
    """The integrator's part of a scene."""
    spec = plan.spec
    swept_px = turned_rad(plan.motion.R_cam) * spec.camera.f_px * spec.time.exposure_s / spec.shutter_s
    description: dict[str, Any] = {
        "type": "skybench_integrator",
        "sky_moments": int(np.clip(math.ceil(swept_px / SKY_STEP_PX), 1, MOST_SKY_MOMENTS)),
        "lit_samples": spec.foreground.lit_directions,
        "coverage_moments": int(np.clip(math.ceil(swept_px), 1, MOST_COVERAGE_MOMENTS)),
    }
    if spec.camera.psf is None:
        return description | {"psf_sigma_px": spec.camera.psf_sigma_px}
    return description | _psf_tensors(spec.camera.resting)


@functools.lru_cache(maxsize=1)
def _psf_tensors(camera: CameraSpec) -> dict[str, Any]:
    """The tabulated point spread function of a camera, for the integrator."""
    table = psf_table(camera)
    return {
        "psf_stamps": tensor(table.by_phase),
        "psf_shift": tensor(table.shift),
        "psf_inside": tensor(table.inside),
        "psf_beyond": tensor(table.beyond),
    }


def quantum_efficiency(spec: FrameSpec, curve: Sequence[Sequence[float]] | None = None) -> Floats:
    """Electrons per photon at GRID_NM: a curve (points nm, 0-1; by default the sensor's) times the transmission."""
    points = np.array(spec.sensor.quantum_efficiency if curve is None else curve)
    return spec.camera.transmission * np.interp(GRID_NM, points[:, 0], points[:, 1], left=0, right=0)


def render_under_one_sky(plan: FramePlan, layers: bool = False, channels: bool = True) -> ExpectedFrame:
    """Render a frame's expected electrons, and the truth of its stars, with extinction and diffuse sky as planned.

    With `layers`, each component is also rendered separately. Without `channels`, pixels of a colour sensor are rendered
    only in their own channel, which gives the same electrons in less time.
    """
    mi = plugins.start()
    import drjit as dr

    from generator.plugins.film_response import film_response

    tables = frame_layers(plan)
    camera = mi.load_dict(camera_dict(plan))
    camera.film().prepare([])
    response = film_response(camera).on_grid
    landscape = landscape_maps(plan, list(tables.values()), response)
    scene = mi.load_dict(scene_dict(plan, metameric(list(tables.values()), response), camera, landscape))
    integrator = scene.integrator()
    sensor, strays = plan.spec.sensor, plan.spec.camera.strays
    direct = dr.opaque(mi.Float, plan.spec.camera.direct_share)
    apart = sensor.colour is not None and not channels
    names = [] if apart else list(sensor.channels)
    pattern = filter_tile(sensor.colour.pattern) if apart and sensor.colour is not None else None
    zenith = sum(table.zenith_v() for table in tables.values())
    dust = None if plan.spec.camera.dust is None else mi.TensorXf(aligned(dust_of(plan)))

    def recorded(image: Any) -> Singles:
        return mosaic(np.array(image if dust is None else image * dust), sensor)

    def astray(scene: Any, sky: Any, image: Any, shining: list[Shining]) -> Any:
        return scattered(plan, scene, camera, sky, image, shining)

    if plan.spec.foreground.hides_sky:
        sky, covered = integrator.diffuse_and_cover(scene, camera, pattern)
        cover = np.array(covered)
    else:
        sky, cover = integrator.diffuse(scene, camera, pattern), None
    parts: dict[str, NDArray[np.float32]] = {}
    if layers:
        separate = {
            name: (metameric([part], response), landscape_maps(plan, [part], response, name))
            for name, part in tables.items()
        }
        own_light = own_light_maps(plan, response)
        if own_light is not None:
            separate["landscape"] = (black_sky(), own_light)
        for name, (part, lit) in separate.items():
            alone = mi.load_dict(scene_dict(plan, part, camera, lit))
            light = alone.integrator().diffuse(alone, camera, pattern)
            if strays:
                light = direct * light + astray(alone, light, light, [])
            parts[name] = recorded(light)
    truths = dict.fromkeys(("stars", "objects", "lamps"), StarTruth.empty())
    moments = LitMoments.none()
    shining: list[Shining] = []
    image = sky
    dark = mi.load_dict(scene_dict(plan, black_sky(), camera)) if layers else None
    moon = StarTruth.empty()
    moons = (mi.load_dict(block) for block in moon_dicts(plan))
    for emitter in itertools.chain(scene.emitters(), moons):
        if emitter.id() not in (*truths, "unlisted", "moon") or not emitter.count:
            continue
        tracks = integrator.follow(scene, camera, emitter)
        brighter = LAMP_FACTOR if emitter.id() == "lamps" else 1.0
        light = integrator.stars(scene, camera, emitter, tracks, pattern)
        if brighter != 1:
            light = light * dr.opaque(mi.Float, brighter)
        image = image + light
        by_band = brighter * integrator.electrons_by_band(camera, emitter, integrator.bands)
        shines = Shining(emitter, tracks, by_band.sum(axis=2))
        many = emitter.id() == "unlisted" or emitter.step_px > 0
        shining.append(gathered(shines, plan.spec.camera) if many else shines)
        if layers:
            if strays:
                light = direct * light + astray(dark, dr.zeros_like(light), light, shining[-1:])
            name = "stars" if emitter.id() in ("unlisted", "moon") else emitter.id()
            parts[name] = recorded(light) + parts.get(name, np.float32(0))
        if emitter.id() == "unlisted":
            continue
        truth = star_truth(plan, tracks, np.einsum("c,ncb->nb", channel_weights(sensor), by_band))
        if (shift := integrator.dispersion_shift(camera, emitter)) is not None:
            truth = with_dispersion(truth, shift)
        if emitter.id() == "objects":
            truth = between_lit_ends(truth, tracks, plan.objects.dark_ends)
        if emitter.id() == "moon":
            moon = moon.joined(between_lit_ends(truth, tracks, emitter.dark_at_ends).together())
            integrator.forget(emitter)
            # Without evaluation, the sum would keep the points of every block in memory.
            dr.eval(image)
            continue
        if emitter.id() == "stars":
            moments = LitMoments.of(tracks)
        truths[emitter.id()] = truth
    if strays:
        dr.eval(image)
        wide = astray(scene, sky, image, shining)
        image, sky = direct * image + wide, direct * sky + wide
    if dust is not None:
        image, sky = image * dust, sky * dust
    dr.eval(image, sky)
    electrons, sky_electrons = np.array(image), np.array(sky)
    truth = truths["stars"]
    return ExpectedFrame(
        electrons=mosaic(electrons, sensor),
        sky_electrons=mosaic(sky_electrons, sensor),
        channels={name: np.ascontiguousarray(electrons[:, :, channel]) for channel, name in enumerate(names)},
        u_px=truth.u_px,
        v_px=truth.v_px,
        start_px=truth.start_px,
        end_px=truth.end_px,
        centroid_px=truth.centroid_px,
        light_px=truth.light_px,
        star_electrons=truth.electrons,
        fraction_in_frame=truth.fraction_in_frame,
        occluded=truth.occluded,
        hidden_fraction=truth.hidden_fraction,
        low_px=truth.low_px,
        high_px=truth.high_px,
        lit=moments,
        cover=cover,
        objects=truths["objects"],
        lamps=truths["lamps"],
        moon=moon.together(),
        zenith_mag_arcsec2=float(surface_brightness_from_radiance(zenith)) if zenith > 0 else None,
        layers=parts,
    )
