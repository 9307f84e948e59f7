"""From a frame plan to a Mitsuba scene, and from the scene to expected electrons and truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf

from generator import mitsuba_runtime
from generator.atmosphere import MAG_PER_OPTICAL_DEPTH, airmass, optical_depth
from generator.frame_plan import FramePlan, dimming_atmosphere
from generator.moon_disk import moon_points
from generator.photometry import GRID_NM, surface_brightness_from_radiance
from generator.scenario import FrameSpec
from generator.sky.assembly import sky_layers, whole_sky
from generator.sky.component import SkyTable, blas_threads, compressed
from generator.sky.moonlight import MOON_BV_MAG
from generator.stellar_spectra import colour_row, colour_table

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ExpectedFrame:
    """What light does to the sensor, on average.

    Attributes
    ----------
    electrons : (height, width) float32 array
        Expected electrons per pixel, stars and sky.
    sky_electrons : (height, width) float32 array
        The diffuse sky's part.
    u_px, v_px : (n,) arrays
        Positions of the plan's stars at mid-exposure, px; NaN where a star lies outside the lens model's range.
    star_electrons : (n,) array
        Expected electrons of each star over the whole point spread function.
    fraction_in_frame : (n,) array
        Part of them that falls on the sensor.
    zenith_mag_arcsec2 : float or None
        Brightness of the diffuse sky at the zenith, V mag/arcsec^2; None for a black sky.
    layers : dict of (height, width) float32 arrays
        Parts of `electrons` by name, where they were asked for; they add up to it.
    """

    electrons: NDArray[np.float32]
    sky_electrons: NDArray[np.float32]
    u_px: Floats
    v_px: Floats
    star_electrons: Floats
    fraction_in_frame: Floats
    zenith_mag_arcsec2: float | None
    layers: dict[str, NDArray[np.float32]]


def frame_layers(plan: FramePlan) -> dict[str, SkyTable]:
    """Components of a frame's diffuse sky, by name."""
    with blas_threads().limit(limits=1, user_api="blas"):
        return sky_layers(plan.spec.sky, dimming_atmosphere(plan.spec.atmosphere), plan.sky)


@dataclass(frozen=True)
class PointLights:
    """All points of light of a frame: its stars and planets, then the points of the Moon's disk.

    Attributes
    ----------
    directions : (n, 2, 3) array
        Apparent unit vectors at exposure start and end.
    v_mag, bv_mag, airmass : (n,) arrays
    """

    directions: Floats
    v_mag: Floats
    bv_mag: Floats
    airmass: Floats


def point_lights(plan: FramePlan) -> PointLights:
    """Stars, planets and the Moon of a frame. The Moon stands still during the exposure at its middle place."""
    stars = PointLights(
        np.stack([plan.start.enu, plan.end.enu], axis=1), plan.dimmed_v_mag, plan.stars.bv_mag, plan.airmass
    )
    state, spec = plan.sky, plan.spec
    if "moonlight" not in spec.sky.active_components or state.moon_altitude_deg <= 0:
        return stars
    enu, share = moon_points(
        state.moon_enu, state.sun_enu, state.moon.distance_km, state.moon.phase_angle_deg, spec.camera.f_px
    )
    cloud = np.zeros(len(enu)) if state.clouds is None else state.clouds.slant_depth(enu)
    path = airmass(state.moon_altitude_deg) if spec.atmosphere.extinction else 0.0
    return PointLights(
        np.concatenate([stars.directions, np.repeat(enu[:, None], 2, axis=1)]),
        np.concatenate([stars.v_mag, state.moon_v_mag - 2.5 * np.log10(share) + MAG_PER_OPTICAL_DEPTH * cloud]),
        np.concatenate([stars.bv_mag, np.full(len(enu), MOON_BV_MAG)]),
        np.concatenate([stars.airmass, np.full(len(enu), path)]),
    )


def scene_dict(plan: FramePlan, sky: SkyTable | None = None) -> dict[str, Any]:
    """Mitsuba scene dictionary of a frame; needs a running Mitsuba (:func:`generator.mitsuba_runtime.start`).

    Parameters
    ----------
    plan : FramePlan
    sky : SkyTable or None
        The diffuse sky; None: the frame's own.
    """
    mi = mitsuba_runtime.start()
    spec = plan.spec

    def tensor(values: ArrayLike) -> Any:
        return mi.TensorXf(np.ascontiguousarray(values, dtype=np.float32))

    atmosphere = dimming_atmosphere(spec.atmosphere)
    sky = whole_sky(frame_layers(plan)) if sky is None else sky
    points = point_lights(plan)
    depth = np.zeros_like(GRID_NM) if atmosphere is None else optical_depth(GRID_NM, atmosphere)
    camera = spec.camera
    response = [
        (float(wavelength), float(value)) for wavelength, value in zip(GRID_NM, quantum_efficiency(spec), strict=True)
    ]
    return {
        "type": "scene",
        "integrator": {"type": "skybench_integrator", "psf_sigma_px": camera.psf_sigma_px},
        "sky": {
            "type": "skybench_sky",
            "maps": tensor(sky.maps),
            "spectra": tensor(sky.spectra),
        },
        "stars": {
            "type": "skybench_stars",
            "directions": tensor(points.directions),
            "v_mag": tensor(points.v_mag),
            "colour_row": tensor(colour_row(points.bv_mag)),
            "airmass": tensor(points.airmass),
            "colour_table": tensor(colour_table()),
            "optical_depth": tensor(depth[None]),
        },
        "camera": {
            "type": "skybench_camera",
            "model": camera.model,
            "f_px": camera.f_px,
            "fy_px": camera.f_px,
            "cx_px": (camera.width - 1) / 2,
            "cy_px": (camera.height - 1) / 2,
            "aperture_area_m2": math.pi / 4 * (camera.aperture_mm / 1000) ** 2,
            "exposure_s": spec.time.exposure_s,
            "attitude": tensor(spec.R_cam[None]),
            "film": {
                "type": "specfilm",
                "width": camera.width,
                "height": camera.height,
                "component_format": "float32",
                "rfilter": {"type": "box"},
                "electrons": {"type": "spectrum", "value": response},
            },
        },
    }


def quantum_efficiency(spec: FrameSpec) -> Floats:
    """Electrons per photon at GRID_NM: the sensor's curve times the optics' transmission."""
    curve = np.array(spec.sensor.quantum_efficiency)
    return spec.camera.transmission * np.interp(GRID_NM, curve[:, 0], curve[:, 1], left=0, right=0)


def render_expected(plan: FramePlan, layers: bool = False) -> ExpectedFrame:
    """Render a frame's expected electrons, and what is true of its stars; with `layers`, each component by itself too."""
    mi = mitsuba_runtime.start()
    tables = frame_layers(plan)
    table = whole_sky(tables)
    scene = mi.load_dict(scene_dict(plan, table))
    integrator, camera = scene.integrator(), scene.sensors()[0]
    camera.film().prepare([])
    sky = np.array(integrator.diffuse(scene, camera))[:, :, 0]
    zenith = table.zenith_v()
    zenith_mag = float(surface_brightness_from_radiance(zenith)) if zenith > 0 else None
    count = len(plan.stars)
    emitter = next(emitter for emitter in scene.emitters() if emitter.id() == "stars")
    electrons, points = sky, np.zeros_like(sky)
    if emitter.count:
        points = np.array(integrator.stars(scene, camera, emitter))[:, :, 0]
        electrons = sky + points
    parts: dict[str, NDArray[np.float32]] = {}
    if layers:
        parts = {name: _sky_electrons(plan, part) for name, part in tables.items()} | {"stars": points}
    if count == 0:
        nothing = np.zeros(0)
        return ExpectedFrame(electrons, sky, nothing, nothing, nothing, nothing, zenith_mag, parts)
    precise = type(emitter.first[0])
    u, v, cosine, valid = camera.project(*(precise(axis) for axis in plan.middle.enu.T), precise(0.5))
    valid = np.array(valid)
    u_px, v_px = (np.where(valid, np.array(position, dtype=np.float64), np.nan) for position in (u, v))
    on_axis = np.array(integrator.star_electrons(camera, emitter)[0], dtype=np.float64)[:count]
    pupil = np.array(camera.lens.pupil(mi.Float(cosine)), dtype=np.float64)
    sigma = plan.spec.camera.psf_sigma_px
    share = _share_within(u_px, plan.spec.camera.width, sigma) * _share_within(v_px, plan.spec.camera.height, sigma)
    return ExpectedFrame(
        electrons=electrons,
        sky_electrons=sky,
        u_px=u_px,
        v_px=v_px,
        star_electrons=on_axis * pupil,
        fraction_in_frame=np.nan_to_num(share),
        zenith_mag_arcsec2=zenith_mag,
        layers=parts,
    )


def _sky_electrons(plan: FramePlan, part: SkyTable) -> NDArray[np.float32]:
    """Expected electrons (height, width) of one part of the sky."""
    mi = mitsuba_runtime.start()
    scene = mi.load_dict(scene_dict(plan, compressed(part)))
    camera = scene.sensors()[0]
    camera.film().prepare([])
    return np.array(scene.integrator().diffuse(scene, camera))[:, :, 0]


def _share_within(position_px: Floats, size: int, sigma_px: float) -> Floats:
    """Part of a Gaussian around `position_px` that falls on pixels 0 to size - 1, along one axis."""
    scale = math.sqrt(2) * sigma_px
    return 0.5 * (erf((size - 0.5 - position_px) / scale) - erf((-0.5 - position_px) / scale))
