"""From a frame plan to a Mitsuba scene, and from the scene to expected electrons and truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf

from generator import mitsuba_runtime
from generator.atmosphere import optical_depth
from generator.frame_plan import FramePlan, dimming_atmosphere
from generator.photometry import GRID_NM
from generator.scenario import FrameSpec
from generator.sky_brightness import diffuse_sky
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
    """

    electrons: NDArray[np.float32]
    sky_electrons: NDArray[np.float32]
    u_px: Floats
    v_px: Floats
    star_electrons: Floats
    fraction_in_frame: Floats


def scene_dict(plan: FramePlan) -> dict[str, Any]:
    """Mitsuba scene dictionary of a frame; needs a running Mitsuba (:func:`generator.mitsuba_runtime.start`)."""
    mi = mitsuba_runtime.start()
    spec = plan.spec

    def tensor(values: ArrayLike) -> Any:
        return mi.TensorXf(np.ascontiguousarray(values, dtype=np.float32))

    atmosphere = dimming_atmosphere(spec.atmosphere)
    sky = diffuse_sky(spec.sky.zenith_mag, atmosphere)
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
            "airglow": tensor(sky.airglow[None]),
            "artificial": tensor(sky.artificial[None]),
            "optical_depth": tensor(sky.diffuse_optical_depth[None]),
        },
        "stars": {
            "type": "skybench_stars",
            "directions": tensor(np.stack([plan.start.enu, plan.end.enu], axis=1)),
            "v_mag": tensor(plan.stars.v_mag),
            "colour_row": tensor(colour_row(plan.stars.bv_mag)),
            "airmass": tensor(plan.airmass),
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


def render_expected(plan: FramePlan) -> ExpectedFrame:
    """Render a frame's expected electrons, and what is true of its stars."""
    mi = mitsuba_runtime.start()
    scene = mi.load_dict(scene_dict(plan))
    integrator, camera = scene.integrator(), scene.sensors()[0]
    camera.film().prepare([])
    sky = np.array(integrator.diffuse(scene, camera))[:, :, 0]
    count = len(plan.stars)
    if count == 0:
        nothing = np.zeros(0)
        return ExpectedFrame(sky, sky, nothing, nothing, nothing, nothing)
    emitter = next(emitter for emitter in scene.emitters() if emitter.id() == "stars")
    stars = np.array(integrator.stars(scene, camera, emitter))[:, :, 0]
    precise = type(emitter.first[0])
    u, v, cosine, valid = camera.project(*(precise(axis) for axis in plan.middle.enu.T), precise(0.5))
    valid = np.array(valid)
    u_px, v_px = (np.where(valid, np.array(position, dtype=np.float64), np.nan) for position in (u, v))
    on_axis = np.array(integrator.star_electrons(camera, emitter)[0], dtype=np.float64)
    pupil = np.array(camera.lens.pupil(mi.Float(cosine)), dtype=np.float64)
    sigma = plan.spec.camera.psf_sigma_px
    share = _share_within(u_px, plan.spec.camera.width, sigma) * _share_within(v_px, plan.spec.camera.height, sigma)
    return ExpectedFrame(
        electrons=sky + stars,
        sky_electrons=sky,
        u_px=u_px,
        v_px=v_px,
        star_electrons=on_axis * pupil,
        fraction_in_frame=np.nan_to_num(share),
    )


def _share_within(position_px: Floats, size: int, sigma_px: float) -> Floats:
    """Part of a Gaussian around `position_px` that falls on pixels 0 to size - 1, along one axis."""
    scale = math.sqrt(2) * sigma_px
    return 0.5 * (erf((size - 0.5 - position_px) / scale) - erf((-0.5 - position_px) / scale))
