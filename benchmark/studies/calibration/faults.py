"""Frames of star positions, faults in their declared camera, attitude, time or air, and each fault's predicted effect."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import celnav
from benchmark.protocol import CameraRecord
from benchmark.studies.calibration import bias as bias
from benchmark.studies.calibration.bias import Misfit, View
from benchmark.studies.common.centroid_frames import Projection, StarList, project
from generator.places.times import Instant
from generator.scenario.model import Pointing, pointing_matrix
from generator.seeds import random_stream

F8 = NDArray[np.float64]

WIDTH, HEIGHT = 1080, 720
MOST_STARS = 150
LOWEST_ALTITUDE_DEG = 10.0
NOISE_PX = 0.1
PRESSURE_HPA, TEMPERATURE_C = 1010.0, 10.0
EARTH_TURN_S = 86164.098903691
"""UT1 seconds in which the Earth rotation angle goes once round (Capitaine, Guinot & McCarthy 2000, A&A 355, 398)."""
TURNS_PER_YEAR = 366.2422


@dataclass(frozen=True)
class Setting:
    """How a frame is made.

    Attributes
    ----------
    hfov_deg : float
        Field across the width of a pinhole of the frame's focal length.
    tilt_deg : float
        Of the boresight from the zenith.
    projection : str
        Of the lens.
    """

    hfov_deg: float = 120.0
    tilt_deg: float = 20.0
    projection: Projection = "pinhole"

    @property
    def f_px(self) -> float:
        """Focal length, px."""
        return WIDTH / 2 / math.tan(math.radians(self.hfov_deg) / 2)


@dataclass(frozen=True, eq=False)
class StudyFrame:
    """A frame with its truth, from centroids or from a picture.

    Attributes
    ----------
    site : int
    uv, flux : ndarray, shapes (n, 2) and (n,)
        Detections.
    star_id : ndarray, shape (n,) or None
        Their true names; None where they come from a picture.
    view : View
        Of the stars, for predictions.
    latitude_deg, longitude_deg : float
    utc : str
        Mid-exposure.
    dut1_s : float
        UT1 - UTC.
    model : str
        Projection of the lens.
    """

    site: int
    uv: F8
    flux: F8
    star_id: NDArray[np.int64] | None
    view: View
    latitude_deg: float
    longitude_deg: float
    utc: str
    dut1_s: float
    model: Projection = "pinhole"


@dataclass(frozen=True, eq=False)
class Declared:
    """The camera, attitude, time and air that a solver is given."""

    camera: celnav.Camera
    R_cam: F8
    utc: str
    dut1_s: float | None = None
    pressure_hpa: float = PRESSURE_HPA


def camera_record(setting: Setting) -> CameraRecord:
    """The frame's camera as a pinhole, with its principal point in the middle."""
    f_px = setting.f_px
    return CameraRecord("pinhole", WIDTH, HEIGHT, f_px, f_px, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)


def make_study_frame(stars: StarList, setting: Setting, noise_px: float = NOISE_PX) -> StudyFrame:
    """Make a frame of the brightest stars that stand high enough; the camera tilts towards an azimuth drawn for the site."""
    plan = stars.plan
    enu = stars.rays @ np.asarray(plan.spec.R_cam)
    towards = plan.spec.attitude
    R_cam = pointing_matrix(
        Pointing(azimuth_deg=towards.azimuth_deg, altitude_deg=90 - setting.tilt_deg, roll_deg=towards.roll_deg)
    )
    rays = enu @ R_cam.T
    uv = project(rays, camera_record(setting), setting.projection)
    with np.errstate(invalid="ignore"):
        inside = (uv > -0.5).all(axis=1) & (uv[:, 0] < WIDTH - 0.5) & (uv[:, 1] < HEIGHT - 0.5)
    # A stereographic frame reaches farther from the axis than a pinhole can; its rim has no image in the declared camera.
    inside &= (enu[:, 2] > math.sin(math.radians(LOWEST_ALTITUDE_DEG))) & (rays[:, 2] > 0.2)
    rows = np.flatnonzero(inside)
    rows = rows[np.argsort(stars.v_mag[rows], kind="stable")][:MOST_STARS]
    noise = random_stream(plan.scenario.seed, "study.calibration_noise", plan.index).normal(
        0.0, noise_px, (MOST_STARS, 2)
    )
    seen = np.clip(uv[rows] + noise[: len(rows)], -0.5, [WIDTH - 0.5, HEIGHT - 0.5])
    site = plan.spec.site
    return StudyFrame(
        site=plan.index,
        uv=seen,
        flux=10.0 ** (-0.4 * stars.v_mag[rows]),
        star_id=stars.star_id[rows],
        view=View(rays[rows], R_cam, site.latitude_deg, setting.f_px, math.hypot(WIDTH, HEIGHT) / 2),
        latitude_deg=site.latitude_deg,
        longitude_deg=site.longitude_deg,
        utc=plan.utc_mid.isoformat(),
        dut1_s=plan.orientation.ut1_utc_s,
        model=setting.projection,
    )


def declared_truth(frame: StudyFrame) -> Declared:
    """The true values."""
    return Declared(celnav.Camera(frame.model, WIDTH, HEIGHT, f_px=frame.view.f_px), frame.view.R_cam, frame.utc)


@dataclass(frozen=True)
class Fault:
    """A kind of fault in several sizes.

    Attributes
    ----------
    key, title, unit : str
    sizes : tuple of float
    typical : float
        The size shown in the summary.
    setting : callable
        Setting of the frame for a size.
    declare : callable
        Makes the values that the solver is given, for a size.
    misfit : callable
        Its first-order misfit.
    logarithmic : bool
        Sizes go by factors.
    """

    key: str
    title: str
    unit: str
    sizes: tuple[float, ...]
    typical: float
    declare: Callable[[StudyFrame, float], Declared]
    misfit: Callable[[StudyFrame, float], Misfit]
    setting: Callable[[float], Setting] = lambda size: Setting()
    logarithmic: bool = True


def _turned(frame: StudyFrame, turn_rad: F8) -> Declared:
    R_cam = frame.view.R_cam @ Rotation.from_rotvec(turn_rad).as_matrix()
    return replace(declared_truth(frame), R_cam=R_cam)


def _declare_focal(frame: StudyFrame, percent: float) -> Declared:
    declared = declared_truth(frame)
    f_px = frame.view.f_px * (1 + percent / 100)
    return replace(declared, camera=replace(declared.camera, f_px=f_px, fy_px=f_px))


def _declare_centre(frame: StudyFrame, shift_px: float) -> Declared:
    declared = declared_truth(frame)
    return replace(declared, camera=replace(declared.camera, cx_px=declared.camera.cx_px + shift_px))


def _declare_k1(frame: StudyFrame, k1: float) -> Declared:
    declared = declared_truth(frame)
    return replace(declared, camera=replace(declared.camera, model="brown_conrady", k=(k1,)))


def _declare_pinhole(frame: StudyFrame, size: float) -> Declared:
    del size
    declared = declared_truth(frame)
    return replace(declared, camera=replace(declared.camera, model="pinhole"))


def _declare_clock(frame: StudyFrame, late_s: float) -> Declared:
    return replace(declared_truth(frame), utc=_later(frame.utc, late_s))


def _declare_epoch(frame: StudyFrame, years: float) -> Declared:
    """A date so many years too early, a whole number of turns of the Earth: at its UT1, which `dut1_s` carries over."""
    return replace(declared_truth(frame), utc=_earlier_date(frame.utc, years), dut1_s=frame.dut1_s)


def _epoch_misfit(frame: StudyFrame, years: float) -> Misfit:
    instant, declared = Instant.parse(frame.utc), Instant.parse(_earlier_date(frame.utc, years))
    angle = erfa.era00(instant.utc1, instant.utc2 + frame.dut1_s / 86400) + math.radians(frame.longitude_deg)
    return bias.epoch_misfit(frame.view, celestial_pole(instant), celestial_pole(declared), angle)


def celestial_pole(instant: Instant) -> F8:
    """X and Y of the celestial intermediate pole, rad, shape (2,): IAU 2006 precession, 2000A nutation."""
    tai1, tai2 = erfa.utctai(instant.utc1, instant.utc2)
    return np.array(erfa.xy06(*erfa.taitt(tai1, tai2)))


def _later(utc: str, seconds: float) -> str:
    moment = datetime.fromisoformat(utc) + timedelta(seconds=seconds)
    return moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def _earlier_date(utc: str, years: float) -> str:
    return _later(utc, -round(years * TURNS_PER_YEAR) * EARTH_TURN_S)


FAULTS = (
    Fault(
        "focal", "Focal length too long", "%", (0.1, 0.3, 1.0, 3.0), 0.3, _declare_focal,
        lambda frame, size: bias.focal_misfit(frame.view, size / 100),
    ),
    Fault(
        "centre", "Principal point off", "px", (0.3, 1.0, 3.0, 10.0), 1.0, _declare_centre,
        lambda frame, size: bias.centre_misfit(frame.view, np.array([size, 0.0])),
    ),
    Fault(
        "k1", "Radial distortion k1 declared for a lens without", "", (1e-4, 3e-4, 1e-3, 3e-3, 1e-2), 3e-4, _declare_k1,
        lambda frame, size: bias.k1_misfit(frame.view, size),
    ),
    Fault(
        "projection", "Stereographic lens declared as pinhole, by horizontal field", "deg",
        (20.0, 40.0, 60.0, 80.0, 100.0, 120.0),
        40.0, _declare_pinhole, lambda frame, size: bias.projection_misfit(frame.view),
        lambda size: Setting(hfov_deg=size, projection="stereographic"), logarithmic=False,
    ),
    Fault(
        "tilt", "Vertical off", "deg", (0.01, 0.03, 0.1, 0.3, 1.0), 0.1,
        lambda frame, size: _turned(frame, np.radians([size, 0.0, 0.0])),
        lambda frame, size: bias.attitude_misfit(frame.view, np.radians([size, 0.0, 0.0])),
    ),
    Fault(
        "heading", "Heading off", "deg", (0.01, 0.03, 0.1, 0.3, 0.9), 0.1,
        lambda frame, size: _turned(frame, np.radians([0.0, 0.0, size])),
        lambda frame, size: bias.attitude_misfit(frame.view, np.radians([0.0, 0.0, size])),
    ),
    Fault(
        "clock", "Clock fast", "s", (0.1, 1.0, 10.0, 100.0), 10.0, _declare_clock,
        lambda frame, size: bias.clock_misfit(frame.view, size),
    ),
    Fault(
        "refraction", "Refraction neglected, by tilt of a 60 deg camera", "deg", (0.0, 10.0, 20.0, 30.0, 40.0), 30.0,
        lambda frame, size: replace(declared_truth(frame), pressure_hpa=0.0),
        lambda frame, size: bias.refraction_misfit(frame.view, PRESSURE_HPA, TEMPERATURE_C),
        lambda size: Setting(hfov_deg=60.0, tilt_deg=size), logarithmic=False,
    ),
    Fault("epoch", "Epoch of the sky too early", "yr", (1.0, 3.0, 10.0, 25.0), 10.0, _declare_epoch, _epoch_misfit),
)  # fmt: skip
