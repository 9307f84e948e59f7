"""Solving frames with faulty declarations, on centroids and on pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.frames.dataset import Frame, load_image, open_dataset
from benchmark.judge.geodesy import east_north_km
from benchmark.studies.calibration import bias as bias
from benchmark.studies.calibration.bias import Estimator, View
from benchmark.studies.calibration.faults import (
    MOST_STARS,
    NOISE_PX,
    TEMPERATURE_C,
    Declared,
    Fault,
    Setting,
    StudyFrame,
    declared_lens,
    declared_truth,
    make_study_frame,
    solver_camera,
)
from benchmark.studies.common.centroid_frames import StarList
from benchmark.studies.common.progress import Advance
from celnav.position import Weather
from celnav.skybench_config import SkybenchConfig
from celnav.skybench_solver import SkybenchSolver
from celnav.solver import SOLVERS
from generator.places.times import Instant, earth_orientation
from generator.reading.strict_yaml import strict_text
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.file import Scenario, parse_scenario

F8 = NDArray[np.float64]

DECLARED, FOCAL, CALIBRATED = "camera as declared", "focal length if clearly off", "self-calibration"
VERTICAL, THESIS_FIX, THESIS = "vertical alone", "thesis' fix, true names", "thesis-adaptive"
CENTROIDS, PICTURES = "centroids", "pictures"
_PRIORS = tuple(float(sigma) for sigma in SkybenchConfig().priors.sigmas)
# The solver that decides for each frame whether to fit the focal length has no single linear answer.
ESTIMATORS: MappingProxyType[str, Estimator] = MappingProxyType(
    {
        DECLARED: Estimator(noise_px=NOISE_PX),
        CALIBRATED: Estimator(free_sigmas=_PRIORS, noise_px=NOISE_PX),
        VERTICAL: Estimator("vertical alone", noise_px=NOISE_PX),
        THESIS_FIX: Estimator(weights="angle", noise_px=NOISE_PX),
    }
)
ON_CENTROIDS = (DECLARED, FOCAL, CALIBRATED, VERTICAL, THESIS_FIX)
ON_PICTURES = (DECLARED, FOCAL, CALIBRATED, VERTICAL, THESIS)
_MODES: dict[str, Literal["auto", "none", "full"]] = {
    DECLARED: "none",
    VERTICAL: "none",
    FOCAL: "auto",
    CALIBRATED: "full",
}
SOLVER_OF = {name: SkybenchSolver(SkybenchConfig(calibrate=mode)) for name, mode in _MODES.items()}
TRACE_SNR = 5.0
THESIS_CASE = "thesis' own case"
THESIS_FIELD_DEG = 120.0
LEAST_STARS = 3
"""Fewer stars do not determine a position by least squares."""


@dataclass(frozen=True)
class Shift:
    """Shift of one position by a fault.

    Attributes
    ----------
    part, fault : str
    size : float
    site : int
    contestant : str
    east_km, north_km : float
        Position with the fault minus position without; NaN where either was refused.
    predicted_east_km, predicted_north_km : float
        To first order; NaN where there is no prediction.
    error_km, faultless_error_km : float
        Distance from the truth with and without the fault, infinite where refused.
    """

    part: str
    fault: str
    size: float
    site: int
    contestant: str
    east_km: float
    north_km: float
    predicted_east_km: float
    predicted_north_km: float
    error_km: float
    faultless_error_km: float

    @property
    def moved_km(self) -> float:
        """Length of the shift; infinite where a position was refused."""
        return math.hypot(self.east_km, self.north_km) if math.isfinite(self.east_km) else math.inf

    @property
    def predicted_km(self) -> float:
        """Length of the prediction."""
        return math.hypot(self.predicted_east_km, self.predicted_north_km)

    @property
    def along(self) -> float:
        """Ratio of the shift's component along the prediction to the prediction; NaN if either is missing."""
        square = self.predicted_km**2
        if not square > 0:
            return math.nan
        return (self.east_km * self.predicted_east_km + self.north_km * self.predicted_north_km) / square


def offset_km(frame: StudyFrame, contestant: str, declared: Declared) -> F8:
    """Position minus truth, east and north, km, shape (2,); NaN where refused."""
    weather = Weather(declared.pressure_hpa, TEMPERATURE_C)
    if contestant == THESIS_FIX:
        if frame.star_id is None:
            raise ValueError("true names come with centroids alone")
        fix = celnav.fix_position(
            frame.uv,
            frame.star_id,
            declared.camera,
            declared.utc,
            declared.R_cam,
            weather=weather,
            dut1_s=declared.dut1_s,
        )
    else:
        exact = contestant != VERTICAL
        attitude = celnav.Attitude.exact(declared.R_cam) if exact else celnav.Attitude.up(declared.R_cam[:, 2])
        fix = celnav.solve(
            frame.uv, declared.camera, declared.utc, attitude, SOLVER_OF.get(contestant) or SOLVERS[contestant],
            flux=frame.flux, pressure_hpa=declared.pressure_hpa, temperature_c=TEMPERATURE_C, dut1_s=declared.dut1_s,
        )  # fmt: skip
    if not fix.ok:
        return np.full(2, math.nan)
    return np.array(east_north_km(frame.latitude_deg, frame.longitude_deg, fix.lat_deg, fix.lon_deg))


def shifts_of(
    part: str, fault: Fault, size: float, frame: StudyFrame, contestants: Sequence[str], faultless: dict[str, F8]
) -> list[Shift]:
    """Solve a frame with a fault and compare with `faultless`, the offsets of the same frame without it."""
    declared, misfit = fault.declare(frame, size), fault.misfit(frame, size)
    rows = []
    for name in contestants:
        with_fault, without = offset_km(frame, name, declared), faultless[name]
        predicted = np.full(2, math.nan)
        if name in ESTIMATORS and len(frame.view.rays) >= LEAST_STARS:
            predicted = bias.position_bias_km(frame.view, misfit, ESTIMATORS[name])
        lengths = [float(np.linalg.norm(one)) if np.isfinite(one).all() else math.inf for one in (with_fault, without)]
        moved = with_fault - without
        rows.append(Shift(part, fault.key, size, frame.site, name, *moved.tolist(), *predicted.tolist(), *lengths))
    return rows


def solve_centroids(
    sites: Sequence[StarList], camera: CameraSpec, faults: Sequence[Fault], progress: Advance
) -> list[Shift]:
    """Apply all faults in all sizes to star positions with noise."""
    rows: list[Shift] = []
    for stars in sites:
        known: dict[Setting, tuple[StudyFrame, dict[str, F8]]] = {}
        for fault in faults:
            for size in fault.sizes:
                setting = fault.setting(size)
                if setting not in known:
                    frame = make_study_frame(stars, camera, setting)
                    right = {name: offset_km(frame, name, declared_truth(frame)) for name in ON_CENTROIDS}
                    known[setting] = frame, right
                rows += shifts_of(CENTROIDS, fault, size, known[setting][0], ON_CENTROIDS, known[setting][1])
        progress()
    return rows


def changed_scenario(scenario: Scenario, name: str, n_frames: int, **sections: Any) -> Scenario:
    """Make a scenario with the same name stem, other sections (a mapping each) and another number of frames."""
    header = {"name": f"{scenario.name}-{name}", "seed": scenario.seed, "frames": n_frames}
    return parse_scenario(strict_text({**header, **scenario.template, **sections}), scenario.source)


def solve_pictures(
    scenario: Scenario, camera: CameraSpec, faults: Sequence[Fault], n_frames: int, folder: Path, progress: Advance
) -> list[Shift]:
    """Apply faults of typical size to rendered frames, and run the case of the thesis: a stereographic frame at the zenith.

    The size of the thesis' case is the horizontal field of the declared pinhole.
    """
    from generator.frame.render import render_dataset  # loads Mitsuba

    swapped = Setting(hfov_deg=THESIS_FIELD_DEG, stereographic=True)
    sets = {
        Setting(): changed_scenario(scenario, "pictures", n_frames),
        swapped: changed_scenario(
            scenario,
            "stereographic",
            n_frames,
            camera=stereographic_camera(scenario, declared_lens(camera, swapped).f_px),
            attitude="zenith-north-up",
        ),
    }
    rows: list[Shift] = []
    for setting, made in sets.items():
        name = "stereographic" if setting.stereographic else "own"
        render_dataset(made, folder / name, lambda frame: progress())
        for frame in open_dataset(folder / name).frames:
            seen = picture_frame(frame, camera, setting)
            right = {name: offset_km(seen, name, declared_truth(seen)) for name in ON_PICTURES}
            for fault in faults:
                if (fault.key == "projection") != setting.stereographic:
                    continue
                chosen = replace(fault, key=THESIS_CASE) if setting.stereographic else fault
                # Refraction is neglected at the frames' own tilt, not at the tilts of its sweep.
                size = {"projection": THESIS_FIELD_DEG, "refraction": round(seen.tilt_deg, 3)}.get(
                    fault.key, fault.typical
                )
                rows += shifts_of(PICTURES, chosen, size, seen, ON_PICTURES, right)
    return rows


def stereographic_camera(scenario: Scenario, f_px: float) -> dict[str, Any]:
    """Camera section of a scenario, replaced by an ideal, centred stereographic lens."""
    lens = (
        "model",
        "hfov_deg",
        "f_px",
        "focal_length_mm",
        "cx_px",
        "cy_px",
        "k",
        "p",
        "s",
        "tilt_rad",
        "image_circle_px",
        "pixel_aspect",
    )
    kept = {key: value for key, value in scenario.template["camera"].items() if key not in lens}
    return {**kept, "model": "stereographic", "f_px": f_px, "k": [], "p": []}


def thesis_edge_px(camera: CameraSpec) -> float:
    """Distance between the two projections of the thesis' case at the left and right edge of the pinhole's field, px."""
    half = math.radians(THESIS_FIELD_DEG / 2)
    return camera.width / 2 * (1 - 2 * math.tan(half / 2) / math.tan(half))


def picture_frame(frame: Frame, camera: CameraSpec, setting: Setting) -> StudyFrame:
    """Detect the stars of a picture; for predictions, use the true stars that leave a trace in the declared field."""
    detections = celnav.detect(load_image(frame))
    if detections.flux is None:
        raise ValueError("detection gives brightness")
    brightest = np.argsort(-detections.flux, kind="stable")[:MOST_STARS]
    truth, observation = frame.truth, frame.observation
    traced = np.flatnonzero(truth.snr >= TRACE_SNR)
    traced = traced[np.argsort(-truth.electrons_e[traced], kind="stable")][:MOST_STARS]
    declared = declared_lens(camera, setting)
    lens = replace(declared, model="stereographic") if setting.stereographic else declared
    rays = solver_camera(lens, camera.width, camera.height).to_rays(truth.uv[traced])
    rays = rays[np.isfinite(rays).all(axis=1) & (not setting.stereographic or rays[:, 2] > 0)]
    where = frame.conditions
    orientation = earth_orientation(Instant.parse(observation.utc))
    return StudyFrame(
        site=frame.index,
        uv=detections.uv[brightest],
        flux=detections.flux[brightest],
        star_id=None,
        view=View(rays, observation.R_cam, where.latitude_deg, declared, math.hypot(camera.width, camera.height) / 2),
        latitude_deg=where.latitude_deg,
        longitude_deg=where.longitude_deg,
        utc=observation.utc,
        dut1_s=orientation.ut1_utc_s,
        lens=lens,
        width=camera.width,
        height=camera.height,
    )
