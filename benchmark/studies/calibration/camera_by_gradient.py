"""A camera recovered from pictures by differentiating the renderer's star pass, compared with its Cramer-Rao bound.

A picture is rendered and read out with noise. The recovery starts from a camera with errors in focal length, distortion and
attitude, renders the stars through it with derivatives, and corrects it until only noise remains in the residuals: Fisher
scoring on the pixels. The derivative of a point of light reaches no farther than its width. The first steps therefore view
both images through a wide Gaussian, and the last ones use the pixels themselves.

The names and light of the stars, the sky background, the light scattered by the lens, and the noise are known. The bound is
that of the five camera parameters with all of this known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from benchmark.studies.calibration.lens import corner_shift_px, project, with_k1
from benchmark.studies.calibration.run import changed_scenario
from benchmark.studies.common.progress import Advance
from generator import plugins
from generator.frame.plan import FramePlan
from generator.frame.render import RenderedFrame, render_frame
from generator.frame.scattered_light import dust_of
from generator.frame.scene import scene_dict
from generator.optics.psf import equivalent_sigma_px
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.file import Scenario
from generator.seeds import random_stream
from generator.sensor.detector import saturation_e
from generator.sky.component import SkyTable

F8 = NDArray[np.float64]

BLURS_PX = (8.0, 4.0, 2.0, 1.0, 0.0)
COARSE_STEPS, MOST_STEPS = 8, 40
"""Number of steps of a stage with a wide Gaussian, and limit for the last stage, which continues until it has settled."""
STARTING_PX = 2.0
"""Standard deviation of the starting camera's errors, expressed as the displacement of a star, px: in the frame's corner for
focal length, k1 and the rotation about the axis, on the axis for the other rotations."""
SATURATED = 0.8
"""Pixels whose expectation exceeds this fraction of saturation are left out."""
LONGEST_STEP_PX = 4.0
"""A step that would move the stars further, on average, is shortened to this: with few stars in a frame the first steps can
overshoot by more than the blurred images reach."""
SETTLED = 1e-3
"""A step shorter than this fraction of its standard deviation ends the iteration."""


@dataclass(frozen=True, eq=False)
class Recovery:
    """Recovery of the camera of one picture.

    Attributes
    ----------
    frame : int
    start, error, sigma : ndarray, shape (5,)
        Errors of the starting camera and of the recovered one, and the standard deviations of the bound, in the order and
        units of `generator.plugins.star_gradient.PARAMETERS`.
    nees : float
        Square of the error in the metric of the bound: chi^2 with five degrees of freedom where the bound is attained.
    steps : int
    path_px : tuple of float
        Root-mean-square distance of the predicted stars from their true positions, after each step, px; the start comes
        first.
    """

    frame: int
    start: F8
    error: F8
    sigma: F8
    nees: float
    steps: int
    path_px: tuple[float, ...]


def recover_camera(scenario: Scenario, index: int) -> Recovery:
    """Render a frame, perturb its camera, and recover it.

    Parameters
    ----------
    scenario : Scenario
        A scenario with a lens model that has a k1, one channel, a Gaussian point spread function and a still camera.
    index : int
        Index of the frame.
    """
    mi = plugins.start()
    from generator.plugins.star_gradient import DifferentiableStars  # needs Mitsuba's variant

    rendered = render_frame(scenario, index)
    plan = rendered.plan
    start = starting_sigma(plan.spec.camera) * random_stream(
        scenario.seed, "study.gradient_start", index
    ).standard_normal(5)
    declared = spoiled(plan, start)
    stars = DifferentiableStars(mi.load_dict(scene_dict(declared, _black())))
    observed, background, noise_variance = _electrons(rendered)
    passed, full_e = passed_share(plan), saturation_e(plan.spec.sensor, plan.spec.time.exposure_s)
    rays = _rays(plan, rendered)
    steps, path = 0, [_distance_px(plan, declared, np.zeros(5), rays)]
    values = np.zeros(5)
    information = np.eye(5)
    for blur_px in BLURS_PX:
        for _ in range(COARSE_STEPS if blur_px else MOST_STEPS):
            model = stars.image(values, blur_px)
            step, information = _score(passed * model.electrons, passed * model.derivatives, observed, background,
                                       noise_variance, full_e, blur_px)  # fmt: skip
            moved = _distance_px(spoiled(declared, values), declared, values + step, rays)
            values = values + step * min(1.0, LONGEST_STEP_PX / max(moved, 1e-9))
            steps += 1
            path.append(_distance_px(plan, declared, values, rays))
            if float(step @ information @ step) < SETTLED**2 * len(values):
                break
    error = difference(plan, declared, values)
    covariance = np.linalg.inv(information)
    return Recovery(
        index, difference(plan, declared, np.zeros(5)), error, np.sqrt(np.diag(covariance)),
        float(error @ information @ error), steps, tuple(path),
    )  # fmt: skip


def gradient_scenario(scenario: Scenario, camera: CameraSpec, n_frames: int) -> Scenario:
    """Adapt a scenario for the recovery: a lens model with k1, a Gaussian point spread without wings, steady stars."""
    lens = with_k1(camera.projection, 0.0)
    if lens is None:
        raise ValueError(f"{camera.model} has no k1")
    left_out = ("hfov_deg", "focal_length_mm", "psf", "bloom", "ghosts")
    section = {key: value for key, value in scenario.template["camera"].items() if key not in left_out}
    # Wings and glare count as known, although they depend on the camera too.
    section |= {"bloom": {"share": 0.0}, "veiling_glare": 0.0}
    section |= {"model": lens.model, "f_px": lens.f_px, "k": list(lens.k), "p": list(lens.p)}
    if camera.psf is not None:
        section |= {"psf": None, "psf_sigma_px": min(20.0, max(0.2, equivalent_sigma_px(camera)))}
    stars = {**scenario.template.get("stars", {}), "scintillation": False}
    return changed_scenario(scenario, "gradient", n_frames, camera=section, stars=stars, foreground={})


def passed_share(plan: FramePlan) -> F8:
    """Fraction of the stars' light in each pixel that neither the lens scatters nor dust stops, shape (height, width).

    The differentiable pass renders all of the light; the renderer adds what is scattered to the light of the sky.
    """
    camera = plan.spec.camera
    passed = np.full((camera.height, camera.width), camera.direct_share)
    return passed if camera.dust is None else passed * dust_of(plan)[:, :, 0]


def starting_sigma(camera: CameraSpec) -> F8:
    """Standard deviations of the starting camera's errors, shape (5,), so that each moves stars by `STARTING_PX`."""
    lens, corner_px = camera.projection, camera.corner_px
    small = 1e-6
    bent = with_k1(lens, small)
    if bent is None:
        raise ValueError(f"{lens.model} has no k1")
    by_k1 = corner_shift_px(lens, bent, corner_px) / small
    return STARTING_PX / np.array([corner_px, by_k1, lens.f_px, lens.f_px, corner_px])


def recover_all(scenario: Scenario, n_frames: int, progress: Advance) -> tuple[Recovery, ...]:
    """Recover the camera of each of the first frames separately."""
    found = []
    for index in range(n_frames):
        found.append(recover_camera(scenario, index))
        progress()
    return tuple(found)


def spoiled(plan: FramePlan, change: F8) -> FramePlan:
    """Change a plan's camera: log focal length, k1, and a rotation vector about the camera's axes, shape (5,)."""
    camera = plan.spec.camera
    k = (camera.projection.full_k[0] + change[1], *camera.projection.full_k[1:])
    fields = {"hfov_deg": None, "focal_length_mm": None, "focal_px": camera.f_px * math.exp(change[0]), "k": k}
    R_cam = Rotation.from_rotvec(change[2:]).as_matrix() @ plan.motion.R_cam
    spec = plan.spec.model_copy(update={"camera": camera.model_copy(update=fields)})
    return replace(plan, spec=spec, motion=replace(plan.motion, R_cam=R_cam))


def difference(plan: FramePlan, declared: FramePlan, values: F8) -> F8:
    """Difference between a declared camera plus `values` and the camera of a plan, shape (5,)."""
    ours, theirs = plan.spec.camera.projection, declared.spec.camera.projection
    x, y, z = values[2:] / 2
    turn = Rotation.from_quat([x, y, z, 1.0])
    off = turn * Rotation.from_matrix(declared.motion.R_cam[0]) * Rotation.from_matrix(plan.motion.R_cam[0]).inv()
    log_f = math.log(theirs.f_px / ours.f_px) + values[0]
    return np.array([log_f, theirs.full_k[0] - ours.full_k[0] + values[1], *off.as_rotvec()])


def _black() -> SkyTable:
    """A sky without light."""
    from generator.sky.assembly import whole_sky

    return whole_sky({})


def _electrons(rendered: RenderedFrame) -> tuple[F8, F8, float]:
    """Picture in electrons, the known background in it, and the noise that does not depend on light (variance, e^2)."""
    sensor, exposure_s = rendered.plan.spec.sensor, rendered.plan.spec.time.exposure_s
    observed = (rendered.dn.astype(np.float64) - sensor.black_level_dn) * sensor.gain_e_per_dn
    background = rendered.expected.sky_electrons + sensor.mean_dark_e_s * exposure_s
    return observed, np.asarray(background, dtype=np.float64), sensor.read_noise_e**2 + sensor.gain_e_per_dn**2 / 12


def _score(
    stars: F8, derivatives: F8, observed: F8, background: F8, noise_variance: float, full_e: float, blur_px: float
) -> tuple[F8, F8]:
    """Step of Fisher scoring, and the information, for pixels with Poisson light and Gaussian read noise.

    The score of a parameter is the sum of (observed - expected)/variance x derivative; the information is the sum of
    derivative x derivative'/variance (Kay, Fundamentals of Statistical Signal Processing, 1993, 3.9, with the variance held
    fixed).
    """
    residual = observed - background - stars
    if blur_px:
        # `stars` is already blurred.
        residual = gaussian_filter(observed - background, blur_px) - stars
    variance = np.maximum(stars + background, 0) + noise_variance
    weight = np.where(stars + background < SATURATED * full_e, 1 / variance, 0.0)
    flat = derivatives.reshape(len(derivatives), -1)
    weighted = flat * weight.ravel()
    information = weighted @ flat.T
    step = np.linalg.solve(information + 1e-9 * np.diag(np.diag(information)), weighted @ residual.ravel())
    return np.asarray(step, dtype=np.float64), information


def _rays(plan: FramePlan, rendered: RenderedFrame) -> F8:
    """Directions (east, north, up) of the stars in the frame, shape (n, 3)."""
    inside = rendered.expected.fraction_in_frame > 0.5
    return np.asarray(plan.middle.enu[inside], dtype=np.float64)


def _distance_px(plan: FramePlan, declared: FramePlan, values: F8, enu: F8) -> float:
    """Root-mean-square distance, px, between stars through the true camera and through the declared one plus `values`."""
    places = []
    off = difference(plan, declared, values)
    for change in (np.zeros(5), off):
        camera = spoiled(plan, change)
        rays = enu @ camera.motion.R_cam[0].T
        places.append(project(rays, camera.spec.camera.projection))
    return float(np.sqrt(np.nanmean(np.sum((places[1] - places[0]) ** 2, axis=1))))


def as_table(found: tuple[Recovery, ...]) -> dict[str, Any]:
    """Columns of numbers for a file, with one row per frame."""
    columns: dict[str, Any] = {"frame": [one.frame for one in found], "nees": [one.nees for one in found]}
    for kind in ("start", "error", "sigma"):
        for place, name in enumerate(("log_f", "k1", "turn_x_rad", "turn_y_rad", "turn_z_rad")):
            columns[f"{kind}_{name}"] = [float(getattr(one, kind)[place]) for one in found]
    return columns
