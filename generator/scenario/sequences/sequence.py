"""Sequences: frames at equal intervals by one camera on one path, under one sky and weather."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from generator.places.times import Instant
from generator.places.trajectory import Trajectory
from generator.places.wgs84 import enu_axes, normal_vector
from generator.scenario.gyro_log import check_motion
from generator.scenario.model import FrameSpec, Pointing, SceneSpec, SiteSpec, TimeSpec, pointing_of
from generator.scenario.sequences.path_file import TIME, knots_of, path_columns
from generator.scenario.sequences.path_spec import POSITION, InertialSpec, PathSpec

Floats = NDArray[np.float64]

MOST_FRAMES = 1_000_000
MOST_READINGS = 5_000_000
"""Largest number of readings of an inertial unit in a sequence: seven hours at 200 Hz, a table of 1 GB."""
MOMENTS_CHECKED = 1000
"""Number of moments of a path at which heights are checked."""
LOWEST_M, HIGHEST_M = -500.0, 20000.0
"""Heights that a site may have."""


class SequenceTimeSpec(TimeSpec):
    """Start and length of the first exposure, and the interval and number of the exposures."""

    every_s: Annotated[float, Field(gt=0, le=86400)]
    """Time from the start of one exposure to the start of the next, s."""
    count: Annotated[int, Field(ge=1, le=MOST_FRAMES)]
    """Frames of the sequence."""


class SequenceSpec(SceneSpec):
    """One sequence, every value fixed."""

    site: SiteSpec | None = None
    """Where the camera stands, unless a path gives positions."""
    time: SequenceTimeSpec
    path: PathSpec | None = None
    """Position, attitude, or both, over time; a camera at rest unless given."""
    imu: InertialSpec | None = None
    """An inertial unit at the camera."""

    @model_validator(mode="after")
    def _possible(self) -> SequenceSpec:
        if self.time.exposure_s > self.time.every_s:
            raise ValueError(f"time.every_s: {self.time.every_s:g} s is shorter than the exposure")
        check_motion(self.motion, self.shutter_s)
        self.foreground.check_exposure(self.shutter_s)
        self.sensor.check_exposure(self.time.exposure_s)
        columns = {} if self.path is None else path_columns(self.path, self.time.utc_start)
        self._check_sources(POSITION[0] in columns, bool(set(columns) - {TIME, *POSITION}))
        if columns:
            self._check_path(columns[TIME])
        if self.imu is not None and self.length_s * self.imu.rate_hz > MOST_READINGS:
            raise ValueError(f"imu.rate_hz: {self.length_s * self.imu.rate_hz:.3g} readings, at most {MOST_READINGS}")
        return self

    def _check_sources(self, path_moves: bool, path_turns: bool) -> None:
        if path_moves == (self.site is not None):
            raise ValueError("give positions either by site or by path" if path_moves else "site: missing")
        if path_turns and "attitude" in self.model_fields_set:
            raise ValueError("give the attitude either by attitude or by path")
        motion = self.motion
        for key in ("rate_deg_s", "polynomial_deg", "gyro_log", "imu"):
            value = getattr(motion, key)
            given = any(value) if isinstance(value, tuple) else value is not None
            if given and (path_turns or self.imu is not None):
                raise ValueError(
                    f"motion.{key}: turns the camera in each frame by itself; in a sequence with a path or an imu, "
                    "give its attitude by path and its readings by imu"
                )

    def _check_path(self, knots_s: Floats) -> None:
        if knots_s[0] > 0 or knots_s[-1] < self.length_s:
            raise ValueError(
                f"path: covers t_s {knots_s[0]:g} to {knots_s[-1]:g}, but the sequence lasts from 0 to {self.length_s:g}"
            )
        position = trajectory_of(self).position(np.linspace(0, self.length_s, MOMENTS_CHECKED))
        if not np.isfinite(position).all():
            raise ValueError("path: is no line over the ground; correct its positions and times")
        height = position[2]
        ground_m = None if self.path is None else self.path.ground_height_m
        if ground_m is not None and height.min() < ground_m:
            raise ValueError(
                f"path.ground_height_m: {ground_m:g} lies above the path, which goes down to {height.min():.0f}"
            )
        if height.min() < LOWEST_M or height.max() > HIGHEST_M:
            raise ValueError(
                f"path: reaches heights from {height.min():.0f} to {height.max():.0f} m between its waypoints, "
                f"expected {LOWEST_M:g} to {HIGHEST_M:g}"
            )

    @property
    def shutter_s(self) -> float:
        """Time from the start of the exposure of the first row to the end of that of the last, s."""
        return self.time.exposure_s + self.sensor.read_out_s(self.camera.height)

    @property
    def length_s(self) -> float:
        """Time from the start of the first exposure to the end of the last, s."""
        return self.start_s(self.time.count - 1) + self.shutter_s

    def start_s(self, step: int) -> float:
        """Start of an exposure after that of the first, s, rounded to microseconds as the times in frame records."""
        return round(step * self.time.every_s, 6)


@dataclass(frozen=True)
class Passage:
    """One frame's part of a sequence.

    Attributes
    ----------
    sequence : int
        Number of the sequence in its scenario.
    step : int
        Place of the frame in the sequence, from 0.
    first : Instant
        Start of the sequence's first exposure.
    start_s, shutter_s : float
        Start of the frame's exposure after that of the sequence's first frame, and its length.
    trajectory : Trajectory
        Trajectory of the sequence, by the time after the start of the first exposure.
    moves : bool
        Whether a path moves or turns the camera.
    """

    sequence: int
    step: int
    first: Instant
    start_s: float
    shutter_s: float
    trajectory: Trajectory
    moves: bool

    @property
    def middle_s(self) -> float:
        """Time of mid-exposure after the start of the sequence, s."""
        return self.start_s + self.shutter_s / 2

    @property
    def velocity_enu_m_s(self) -> Floats:
        """Velocity over ground at mid-exposure, east, north, up, (3,)."""
        return self.trajectory.velocity_enu_m_s(np.array([self.middle_s]))[0]

    @property
    def moved_km(self) -> tuple[float, float]:
        """Displacement east and north from the camera's place at the start of the sequence to that at mid-exposure."""
        east_m, north_m, _ = self.trajectory.displacement_enu_m(0.0, self.middle_s)
        return float(east_m) / 1000, float(north_m) / 1000

    def R_cam(self, time_s: Floats) -> Rotation:
        """Attitudes at times (k) after the start of the exposure, from east-north-up at mid-exposure to camera."""
        latitude_deg, longitude_deg, _ = self.trajectory.position(np.array([self.middle_s]))
        enu_at_middle = Rotation.from_matrix(enu_axes(normal_vector(latitude_deg, longitude_deg))[0])
        return self.trajectory.cam_from_ecef(self.start_s + np.asarray(time_s)) * enu_at_middle.inv()


def passage_of(spec: SequenceSpec, sequence: int, step: int) -> Passage:
    """Return frame `step` of a sequence as part of its path."""
    first, start_s = Instant.parse(spec.time.utc_start), spec.start_s(step)
    return Passage(sequence, step, first, start_s, spec.shutter_s, trajectory_of(spec), spec.path is not None)


def frame_of(spec: SequenceSpec, step: int) -> FrameSpec:
    """Return frame `step` of a sequence; place and attitude are those of mid-exposure."""
    utc_start = Instant.parse(spec.time.utc_start).plus(spec.start_s(step)).isoformat()
    values = {name: getattr(spec, name) for name in SceneSpec.model_fields}
    site = spec.site
    if spec.path is not None:
        passage = passage_of(spec, 0, step)
        where = (float(value[0]) for value in passage.trajectory.position(np.array([passage.middle_s])))
        site = SiteSpec(**dict(zip(POSITION, where, strict=True)), ground_height_m=spec.path.ground_height_m)
        values["attitude"] = pointing_of(passage.R_cam(np.array([spec.shutter_s / 2])).as_matrix()[0])
    assert site is not None  # one of the two gives it
    return FrameSpec(site=site, time=TimeSpec(utc_start=utc_start, exposure_s=spec.time.exposure_s), **values)


def trajectory_of(spec: SequenceSpec) -> Trajectory:
    """Return the path of a sequence, by the time after the start of its first exposure. Raises PathError."""
    return _trajectory(spec.path, spec.site, spec.attitude, spec.time.utc_start)


@functools.lru_cache(maxsize=8)
def _trajectory(path: PathSpec | None, site: SiteSpec | None, attitude: Pointing, utc_start: str) -> Trajectory:
    columns = {} if path is None else path_columns(path, utc_start)
    return Trajectory(knots_of(columns, site, attitude))
