"""`celnav.calibrate`: lens, attitudes and their uncertainty from frames of stars at a known place and time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.all_frames import fit_all
from celnav.calibrating.beside_axis import SURE_PX, scatter_px
from celnav.calibrating.blind_start import Start
from celnav.calibrating.bundle import adjust
from celnav.calibrating.calibration import CameraCalibration, FrameAttitude, Residuals
from celnav.calibrating.frames import CalibrationFrame, Site, nights_of, sky_over
from celnav.calibrating.joint_fit import Field, JointFit, refine
from celnav.calibrating.lens_form import LAWS, LensForm
from celnav.calibrating.model_choice import Judged, choose_form, in_opencv, started
from celnav.calibrating.mount import LEAST_CHANCE, drift_chance, mean_rotation, mount_of
from celnav.calibrating.scatter.air import air_errors, relative_sigma
from celnav.calibrating.scatter.residual_pattern import residual_pattern, star_cells
from celnav.camera import Camera
from celnav.checking import finite_number, shown
from celnav.errors import CalibrationError, ConfigError
from celnav.lens.lens_uncertainty import LensUncertainty
from celnav.position import usual_weather
from celnav.sky.utc import Utc

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]
MountChoice = Literal["auto", "night", "frame"]

# A lens of the asked laws scatters by at most this factor more than a general one.
_MOST_SCATTER = 3.0


def calibrate(
    frames: Sequence[CalibrationFrame],
    lat_deg: float,
    lon_deg: float,
    *,
    height_m: float = 0.0,
    pressure_hpa: float | None = None,
    temperature_c: float | None = None,
    camera: Camera | None = None,
    models: Sequence[str] | None = None,
    form: LensForm | None = None,
    opencv_only: bool = False,
    mount: MountChoice = "auto",
    dut1_s: float | None = None,
) -> CameraCalibration:
    """Calibrate a camera from the stars.

    Parameters
    ----------
    frames : sequence of CalibrationFrame
        One or more frames of the same camera and size.
    lat_deg, lon_deg : float
        Geodetic position of the camera; longitude is positive to the east.
    height_m, pressure_hpa, temperature_c : float
        Height above sea level, and air for refraction; pressure and temperature follow from the height unless given, and the
        covariances then hold the scatter of the weather (`celnav.calibrating.scatter.air`).
    camera : Camera, optional
        A guess whose focal length is within 6 %, of the frames' size. Without one, field and projection law are searched for,
        with square pixels; if `fy_px` differs from `f_px`, the pixels are taken to be as oblong.
    models : sequence of str, optional
        Projection laws to choose among; all of `celnav.calibrating.lens_form.LAWS` unless given.
    form : LensForm, optional
        The form of lens to fit; then no choice is made.
    opencv_only : bool
        Choose only among lenses that OpenCV can represent.
    mount : str
        ``night``: one attitude for all frames of a night; ``frame``: one for each frame; ``auto``: one per night, unless
        the frames of a night differ by more than chance (probability below 0.001) explains.
    dut1_s : float, optional
        UT1-UTC in seconds, for all frames; taken from the IERS table unless given.

    Returns
    -------
    CameraCalibration
        The calibration.

    Raises
    ------
    CalibrationError
        When no frame can be identified, or too few stars remain.
    ConfigError
        For invalid options.
    """
    frames = list(frames)
    _check(frames, mount, camera, form)
    site = Site(
        finite_number(lat_deg, "lat_deg", ConfigError, -90, 90),
        finite_number(lon_deg, "lon_deg", ConfigError, -360, 360),
        usual_weather(height_m, pressure_hpa, temperature_c),
        dut1_s,
    )
    chosen_models = LAWS if models is None else tuple(models)
    if not chosen_models:
        raise ConfigError("models is empty: name at least one law")
    if unknown := [model for model in chosen_models if model not in LAWS]:
        raise ConfigError(f"lens model {unknown[0]!r} is not known; known: {', '.join(LAWS)}")
    if opencv_only:
        _check_opencv(chosen_models, form)
    skies = [sky_over(site, frame.utc) for frame in frames]
    field = Field(frames, skies, [np.ones(len(frame.uv), dtype=bool) for frame in frames])
    used, part, general = fit_all(field, None if camera is None else _guess(camera))
    night = nights_of(part.frames, site.lon_deg)
    seen_group = general.group[general.seen.frame]
    judged: list[Judged] = []
    if form is None:
        form, judged = choose_form(general.bundle, general.seen, seen_group, chosen_models, opencv_only=opencv_only)
    # If the law differs, the start has no distortion, so it is fitted to the present stars before others are searched for.
    lens = adjust(started(general.bundle, form), general.seen, seen_group, robust=False)
    fit = refine(part, lens, general.group)
    if judged:
        _check_follows(fit, form, general)
    assert fit.bundle.turn_cov is not None
    steady = drift_chance(fit.bundle.rotations, fit.bundle.turn_cov, night) >= LEAST_CHANCE
    if len(np.unique(night)) < len(night) and (mount == "night" or (mount == "auto" and steady)):
        fit = _by_night(part, fit, night)
    left_out = [frame.name for i, frame in enumerate(frames) if i not in used]
    air_sigma = relative_sigma(
        site.weather, pressure_given=pressure_hpa is not None, temperature_given=temperature_c is not None
    )
    return _described(part, fit, form, judged, night, left_out, steady, air_sigma)


def _check(frames: list[CalibrationFrame], mount: str, camera: Camera | None, form: LensForm | None) -> None:
    if not frames:
        raise CalibrationError("no frames: a calibration needs at least one")
    if not all(isinstance(frame, CalibrationFrame) for frame in frames):
        raise ConfigError("frames must be celnav.CalibrationFrame, each with detections, time and size")
    if form is not None and not isinstance(form, LensForm):
        raise ConfigError(f"form = {shown(form)} must be a celnav.calibrating.lens_form.LensForm")
    if camera is not None and not isinstance(camera, Camera):
        raise ConfigError(f"camera = {shown(camera)} must be a celnav.Camera")
    if len({frame.size for frame in frames}) > 1:
        sizes = sorted({f"{width} x {height}" for width, height in (frame.size for frame in frames)})
        raise CalibrationError(f"frames are of different sizes ({', '.join(sizes)}): calibrate each camera by itself")
    if camera is not None and (camera.width, camera.height) != frames[0].size:
        width, height = frames[0].size
        raise CalibrationError(
            f"the camera has {camera.width} x {camera.height} pixels and the frames have {width} x {height}: scale its focal "
            "length and principal point to the frames, or leave it out"
        )
    first: dict[tuple[Utc, bytes], CalibrationFrame] = {}
    for frame in frames:
        same = first.setdefault((frame.utc, frame.uv.tobytes()), frame)
        if same is not frame:
            raise CalibrationError(
                f"{same.name} and {frame.name} have the same time and detections: give each frame once"
            )
    if mount not in ("auto", "night", "frame"):
        raise ConfigError(f"mount = {mount!r} must be auto, night or frame")


def _check_follows(fit: JointFit, form: LensForm, general: JointFit) -> None:
    """Raise if a lens of the chosen form loses half of the stars that a general lens follows, or lies far from them."""
    found, scatter = len(fit.seen), scatter_px(fit)
    if 2 * found >= len(general.seen) and scatter <= max(SURE_PX, _MOST_SCATTER * scatter_px(general)):
        return
    best, _ = choose_form(general.bundle, general.seen, general.group[general.seen.frame])
    raise CalibrationError(
        f"no lens of the model {form.model} (--models, --opencv-only) follows the stars: {found} of {len(general.seen)} "
        f"remain, {scatter:.2f} px apart from it; {best.model} does, so name it or leave the choice free"
    )


def _check_opencv(models: tuple[str, ...], form: LensForm | None) -> None:
    """Raise `ConfigError` if OpenCV can hold neither the form nor, without one, any of the models."""
    if form is not None:
        if not in_opencv(form):
            raise ConfigError(f"OpenCV cannot hold a lens of the form {form.words}")
    elif not any(in_opencv(LensForm(model)) for model in models):
        known = ", ".join(law for law in LAWS if in_opencv(LensForm(law)))
        raise ConfigError(
            f"OpenCV can hold none of the models {', '.join(models)} (--models): add one of {known}, or leave out "
            "opencv_only (--opencv-only, --opencv)"
        )


def _guess(camera: Camera) -> Start:
    """Make a start from a camera; identification will find the attitude."""
    return Start(camera, np.eye(3), math.hypot(camera.width, camera.height) / 2, 0)


def _by_night(field: Field, fit: JointFit, night: Rows) -> JointFit:
    """Fit one attitude to the frames of each night."""
    rotations = np.stack([mean_rotation(fit.bundle.rotations[night == number]) for number in np.unique(night)])
    return refine(field, replace(fit.bundle, rotations=rotations, cov=None, turn_cov=None, turn_by_lens=None), night)


def _described(
    field: Field,
    fit: JointFit,
    form: LensForm,
    judged: list[Judged],
    night: Rows,
    left_out: list[str],
    steady: bool,
    air_sigma: float,
) -> CameraCalibration:
    bundle = fit.bundle
    assert bundle.cov is not None
    assert bundle.turn_cov is not None
    assert bundle.turn_by_lens is not None
    residual = fit.residual_px
    group = fit.group[fit.seen.frame]
    pattern = residual_pattern(fit.seen, residual, fit.bundle.size)
    weather = field.skies[0].site.weather
    air = air_errors(bundle, fit.seen, group, night[fit.seen.frame], weather, air_sigma)
    # The lens is held fixed: the attitude is used with the lens published with it, and their errors compensate each other.
    cov_of_group = bundle.turn_cov * pattern.inflation + air.turn_cov
    group_night = np.array([night[np.flatnonzero(fit.group == g)[0]] for g in range(len(bundle.rotations))])
    weight = 1 / fit.seen.sigma_px**2
    square = (residual**2).sum(axis=1) / 2
    attitudes = []
    for i, (frame, match) in enumerate(zip(field.frames, fit.matches, strict=True)):
        rows, g = np.flatnonzero(fit.seen.frame == i), fit.group[i]
        R_cam = bundle.rotations[g]
        about_axes = np.degrees(np.sqrt(np.diag(R_cam.T @ cov_of_group[g] @ R_cam)))
        attitudes.append(
            FrameAttitude(
                frame.name,
                frame.utc,
                int(night[i]),
                R_cam,
                float(np.hypot(*about_axes[:2]) / math.sqrt(2)),
                float(about_axes[2]),
                len(rows),
                math.sqrt(float(np.average(square[rows], weights=weight[rows]))) if len(rows) else math.nan,
                match.limiting_mag,
                frame.exposure_s,
            )
        )
    stars = np.array([field.skies[f].star_id[s] for f, s in zip(fit.seen.frame, fit.seen.star, strict=True)])
    cov = bundle.cov * pattern.inflation + air.lens_cov
    mount = mount_of(bundle.rotations, cov_of_group, group_night)
    turn = bundle.turn_by_lens.mean(axis=0)
    parts = (cov, mount.R_cam, turn, star_cells(fit.seen, bundle.size).round(3))
    known = LensUncertainty(form.names, *(tuple(tuple(row) for row in part.tolist()) for part in parts))
    return CameraCalibration(
        camera=replace(form.camera(bundle.values, bundle.size), uncertainty=known),
        form=form,
        values=bundle.values,
        cov=cov,
        attitudes=tuple(attitudes),
        one_attitude_per="night" if len(bundle.rotations) < len(field.frames) else "frame",
        steady=steady,
        mount=mount,
        noise=fit.noise,
        pixel_phase=fit.phase,
        rms_px=math.sqrt(float(np.average(square, weights=weight))),
        plain_rms_px=math.sqrt(float(square.mean())),
        median_px=float(np.median(np.hypot(*residual.T))),
        pattern=pattern,
        judged=tuple(judged),
        left_out=tuple(left_out),
        residuals=Residuals(fit.seen.uv, residual, fit.seen.sigma_px, fit.seen.frame, stars, group),
        R_by_group=bundle.rotations,
    )
