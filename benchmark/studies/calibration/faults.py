"""Frames of star positions, faults in their declared camera, attitude, time or air, and each fault's predicted effect."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import celnav
from benchmark.errors import BenchmarkError
from benchmark.studies.calibration import bias as bias
from benchmark.studies.calibration.bias import Misfit, View
from benchmark.studies.calibration.chosen import LOWEST_ALTITUDE_DEG, Subject
from benchmark.studies.calibration.kinds import KINDS, NARROW_DEG, Kind
from benchmark.studies.calibration.lens import project, with_k1
from benchmark.studies.common.centroid_frames import StarList
from generator.places.times import Instant
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.file import Scenario
from generator.scenario.model import Pointing, pointing_matrix
from generator.scenario.projection import Projection
from generator.seeds import random_stream

F8 = NDArray[np.float64]

MOST_STARS = 150
LEAST_STARS = 4
WHOLE_SKY = {"model": "equidistant", "width": 512, "height": 512, "hfov_deg": 359.0, "aperture_mm": 4.0}
"""Camera of the scenario whose stars are listed; a fault may turn the study's camera, or give it another field."""
NOISE_PX = 0.1
PRESSURE_HPA, TEMPERATURE_C = 1010.0, 10.0
EARTH_TURN_S = 86164.098903691
"""UT1 seconds in which the Earth rotation angle completes a turn (Capitaine, Guinot & McCarthy 2000, A&A 355, 398)."""
TURNS_PER_YEAR = 366.2422


@dataclass(frozen=True)
class Setting:
    """How a frame is produced.

    Attributes
    ----------
    hfov_deg : float or None
        Field across the width of a pinhole with the frame's focal length; None for the scenario's own camera.
    tilt_deg : float or None
        Tilt of the boresight from the zenith, towards the scenario's azimuth; None for the scenario's attitude.
    stereographic : bool
        Whether the lens is stereographic but declared as the pinhole; only with `hfov_deg`.
    """

    hfov_deg: float | None = None
    tilt_deg: float | None = None
    stereographic: bool = False


def declared_lens(camera: CameraSpec, setting: Setting) -> Projection:
    """Lens that a solver receives where there is no fault other than a mistaken projection."""
    if setting.hfov_deg is None:
        return camera.projection
    f_px = camera.width / 2 / math.tan(math.radians(setting.hfov_deg) / 2)
    return Projection("pinhole", f_px, f_px, (camera.width - 1) / 2, (camera.height - 1) / 2)


@dataclass(frozen=True, eq=False)
class StudyFrame:
    """A frame with its truth, from centroids or from a picture.

    Attributes
    ----------
    site : int
    uv, flux : ndarray, shapes (n, 2) and (n,)
        Detections.
    star_id : ndarray, shape (n,) or None
        Their true names; None where the detections come from a picture.
    view : View
        View of the stars, for predictions.
    latitude_deg, longitude_deg : float
    utc : str
        Mid-exposure.
    dut1_s : float
        UT1 - UTC.
    lens : Projection
        Lens of the frame itself; `view` has the one that a solver receives.
    width, height : int
        Size of the frame, px.
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
    lens: Projection
    width: int
    height: int

    @property
    def tilt_deg(self) -> float:
        """Angle of the boresight from the zenith."""
        return math.degrees(math.acos(min(1.0, max(-1.0, float(self.view.R_cam[2, 2])))))


@dataclass(frozen=True, eq=False)
class Declared:
    """The camera, attitude, time and air that a solver receives."""

    camera: celnav.Camera
    R_cam: F8
    utc: str
    dut1_s: float | None = None
    pressure_hpa: float = PRESSURE_HPA


def solver_camera(lens: Projection, width: int, height: int) -> celnav.Camera:
    """Convert a lens and a frame size to celnav's camera."""
    return celnav.Camera(
        lens.model, width, height, lens.f_px, fy_px=lens.fy_px, cx_px=lens.cx_px, cy_px=lens.cy_px,
        k=lens.k, p=lens.p, s=lens.s, tilt_rad=lens.tilt_rad,
    )  # fmt: skip


def make_study_frame(stars: StarList, camera: CameraSpec, setting: Setting, noise_px: float = NOISE_PX) -> StudyFrame:
    """Make a frame of the brightest stars that are high enough, from the stars of the whole sky (`WHOLE_SKY`).

    Where the setting has its own tilt, the camera tilts towards the azimuth of the scenario's attitude.
    """
    plan = stars.plan
    enu = stars.rays @ np.asarray(plan.spec.R_cam)
    R_cam = np.asarray(plan.spec.R_cam, dtype=np.float64)
    if setting.tilt_deg is not None:
        towards = plan.spec.attitude
        R_cam = pointing_matrix(
            Pointing(azimuth_deg=towards.azimuth_deg, altitude_deg=90 - setting.tilt_deg, roll_deg=towards.roll_deg)
        )
    rays = enu @ R_cam.T
    declared = declared_lens(camera, setting)
    lens = replace(declared, model="stereographic") if setting.stereographic else declared
    uv = project(rays, lens)
    edge = np.array([camera.width - 0.5, camera.height - 0.5])
    with np.errstate(invalid="ignore"):
        inside = (uv > -0.5).all(axis=1) & (uv < edge).all(axis=1)
        if camera.image_circle_px is not None and setting.hfov_deg is None:
            inside &= np.hypot(*(uv - [lens.cx_px, lens.cy_px]).T) < camera.image_circle_px
    inside &= enu[:, 2] > math.sin(math.radians(LOWEST_ALTITUDE_DEG))
    if setting.stereographic:
        # A stereographic lens reaches farther from the axis than a pinhole can; its rim has no image in the declared camera.
        inside &= rays[:, 2] > 0.2
    rows = np.flatnonzero(inside)
    rows = rows[np.argsort(stars.v_mag[rows], kind="stable")][:MOST_STARS]
    noise = random_stream(plan.scenario.seed, "study.calibration_noise", plan.index).normal(
        0.0, noise_px, (MOST_STARS, 2)
    )
    site = plan.spec.site
    return StudyFrame(
        site=plan.index,
        uv=np.clip(uv[rows] + noise[: len(rows)], -0.5, edge),
        flux=10.0 ** (-0.4 * stars.v_mag[rows]),
        star_id=stars.star_id[rows],
        view=View(rays[rows], R_cam, site.latitude_deg, declared, math.hypot(camera.width, camera.height) / 2),
        latitude_deg=site.latitude_deg,
        longitude_deg=site.longitude_deg,
        utc=plan.utc_mid.isoformat(),
        dut1_s=plan.orientation.ut1_utc_s,
        lens=lens,
        width=camera.width,
        height=camera.height,
    )


def declared_truth(frame: StudyFrame) -> Declared:
    """The true values."""
    return Declared(solver_camera(frame.lens, frame.width, frame.height), frame.view.R_cam, frame.utc)


@dataclass(frozen=True)
class Fault(Kind):
    """A kind of fault, and its effect on a frame.

    Attributes
    ----------
    declare : callable
        Returns the values that the solver receives for a size.
    misfit : callable
        Returns its first-order misfit.
    setting : callable
        Returns the setting of the frame for a size.
    """

    declare: Callable[[StudyFrame, float], Declared] = field(kw_only=True)
    misfit: Callable[[StudyFrame, float], Misfit] = field(kw_only=True)
    setting: Callable[[float], Setting] = lambda size: Setting()


def _turned(frame: StudyFrame, turn_rad: F8) -> Declared:
    R_cam = frame.view.R_cam @ Rotation.from_rotvec(turn_rad).as_matrix()
    return replace(declared_truth(frame), R_cam=R_cam)


def _declare_lens(frame: StudyFrame, lens: Projection) -> Declared:
    return replace(declared_truth(frame), camera=solver_camera(lens, frame.width, frame.height))


def _declare_focal(frame: StudyFrame, percent: float) -> Declared:
    factor = 1 + percent / 100
    return _declare_lens(frame, replace(frame.lens, f_px=frame.lens.f_px * factor, fy_px=frame.lens.fy_px * factor))


def _declare_centre(frame: StudyFrame, shift_px: float) -> Declared:
    return _declare_lens(frame, replace(frame.lens, cx_px=frame.lens.cx_px + shift_px))


def _declare_k1(frame: StudyFrame, k1: float) -> Declared:
    bent = with_k1(frame.lens, k1)
    if bent is None:
        raise ValueError(f"{frame.lens.model} has no k1")
    return _declare_lens(frame, bent)


def _declare_pinhole(frame: StudyFrame, size: float) -> Declared:
    del size
    return _declare_lens(frame, frame.view.lens)


def _declare_clock(frame: StudyFrame, late_s: float) -> Declared:
    return replace(declared_truth(frame), utc=_later(frame.utc, late_s))


def _declare_epoch(frame: StudyFrame, years: float) -> Declared:
    """Declare a date some years too early, by a whole number of turns of the Earth: at its UT1, which `dut1_s` preserves."""
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


def _fault(
    key: str,
    declare: Callable[[StudyFrame, float], Declared],
    misfit: Callable[[StudyFrame, float], Misfit],
    setting: Callable[[float], Setting] = lambda size: Setting(),
) -> Fault:
    return Fault(**vars(KINDS[key]), declare=declare, misfit=misfit, setting=setting)


FAULTS = (
    _fault("focal", _declare_focal, lambda frame, size: bias.focal_misfit(frame.view, size / 100)),
    _fault("centre", _declare_centre, lambda frame, size: bias.centre_misfit(frame.view, np.array([size, 0.0]))),
    _fault("k1", _declare_k1, lambda frame, size: bias.k1_misfit(frame.view, size)),
    _fault(
        "projection",
        _declare_pinhole,
        lambda frame, size: bias.projection_misfit(frame.view),
        lambda size: Setting(hfov_deg=size, stereographic=True),
    ),
    _fault(
        "tilt",
        lambda frame, size: _turned(frame, np.radians([size, 0.0, 0.0])),
        lambda frame, size: bias.attitude_misfit(frame.view, np.radians([size, 0.0, 0.0])),
    ),
    _fault(
        "heading",
        lambda frame, size: _turned(frame, np.radians([0.0, 0.0, size])),
        lambda frame, size: bias.attitude_misfit(frame.view, np.radians([0.0, 0.0, size])),
    ),
    _fault("clock", _declare_clock, lambda frame, size: bias.clock_misfit(frame.view, size)),
    _fault(
        "refraction",
        lambda frame, size: replace(declared_truth(frame), pressure_hpa=0.0),
        lambda frame, size: bias.refraction_misfit(frame.view, PRESSURE_HPA, TEMPERATURE_C),
        lambda size: Setting(hfov_deg=NARROW_DEG, tilt_deg=size),
    ),
    _fault("epoch", _declare_epoch, _epoch_misfit),
)
"""All faults in their usual sizes, for a pinhole wider than `NARROW_DEG`."""


def chosen_faults(subject: Subject, sizes: Mapping[str, tuple[float, ...]]) -> tuple[Fault, ...]:
    """The faults that the camera can have, in the requested sizes; see `chosen.check_sizes`."""
    faults = []
    for fault in FAULTS:
        if fault.key == "k1" and not subject.has_k1:
            continue
        made = fault
        if fault.key == "refraction" and subject.field_deg <= NARROW_DEG:
            title = "Refraction neglected, by tilt"
            made = replace(made, title=title, setting=lambda size: Setting(tilt_deg=size))
        if fault.key in sizes:
            wanted = sizes[fault.key]
            typical = fault.typical if fault.typical in wanted else wanted[(len(wanted) - 1) // 2]
            made = replace(made, sizes=wanted, typical=typical)
        faults.append(made)
    return tuple(faults)


def check_stars(scenario: Scenario, camera: CameraSpec, lists: Sequence[StarList]) -> None:
    """Refuse a scenario whose typical frame has too few stars for a position.

    Raises
    ------
    BenchmarkError
    """
    counts = sorted(len(make_study_frame(stars, camera, Setting()).uv) for stars in lists)
    median = counts[len(counts) // 2]
    if median < LEAST_STARS:
        raise BenchmarkError(
            f"{scenario.source}: stars.limiting_magnitude: half of the frames hold {median} stars or fewer, and a solver "
            f"needs {LEAST_STARS}; draw fainter stars or take a wider field"
        )
