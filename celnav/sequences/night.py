"""A night of a stationary camera: one attitude, one position, and a test whether the sky turns as the Earth does.

Every frame measures the same orientation relative to the Earth, so noise averages out; an error of the vertical is the same
in every frame and does not. What stars cannot reveal at all is stated in words.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.attitude import Attitude, as_attitude
from celnav.camera import Camera
from celnav.checking import finite_number, shown
from celnav.detections import Detections
from celnav.errors import ConfigError
from celnav.fix import Estimate, Fix, Reason
from celnav.horizon import heading_contradicts, honest_place, horizontal_frame
from celnav.identification.verification import rotation_of
from celnav.position import Weather
from celnav.problem import LastKnown, Solver, ToldSigmas
from celnav.sequences.fixed_mount import EARTH_RAD_S, FixedMount, combine
from celnav.sequences.known_orientation import UNFOUND, Orientation, solve_oriented, terrestrial_orientation
from celnav.sequences.lifted_sky import LiftedSky
from celnav.sky.astrometry import enu_rotation
from celnav.sky.utc import Utc, parse_utc
from celnav.skybench_config import SkybenchConfig
from celnav.skybench_solver import SkybenchSolver
from celnav.solver import solve
from celnav.uncertainty.contradicted import vertical_doubt_deg
from celnav.uncertainty.refraction_errors import RELATIVE_SIGMA

F8 = NDArray[np.float64]

# A rotation is attributed to the mount or the clock if its probability by chance is below this.
LEAST_CHANCE = 1e-3


@dataclass(frozen=True, eq=False)
class NightFix:
    """Result of a night.

    Attributes
    ----------
    ok : bool
        Whether there is a position.
    reason : Reason
        ``ok``; ``vertical_required`` if no vertical is known; ``too_few_detections`` if no frame was identified;
        ``inconsistent`` if a heading is contradicted, or if no frame is usable and some are inconsistent themselves.
    message : str
        The reason in words; empty if there is a position.
    lat_deg, lon_deg, cov_km2
        As in `Fix`. The standard deviations of attitude and clock enter the covariance once, not averaged over frames.
    heading_off_deg : float
        Difference between the heading that the stars imply and the supplied one; NaN if none was supplied.
    R_terrestrial_to_camera : ndarray, shape (3, 3), or None
        Orientation relative to the Earth (ITRS) at the mean time. If no vertical is known, it contains the refraction, which
        `attitude_at` removes.
    cov_rad2 : ndarray, shape (3, 3), or None
        Covariance of its error as a small rotation in the camera frame, including wander and drift of the mount, but not the
        error of the clock.
    clock_sigma_s : float
        Standard deviation of the clock's offset.
    lifted : LiftedSky or None
        The refraction that the orientation contains; None if it was removed from the stars.
    wander_deg : float
        Scatter of the frames about each axis beyond their own covariances.
    axis_camera : ndarray, shape (3,), or None
        The Earth's axis (north) in the camera frame, from the rotation of the sky; independent of the frames' absolute
        times.
    axis_sigma_deg : float
        Standard deviation of the axis along the worse direction.
    rate : Estimate or None
        Rotation rate of the sky over that of the Earth: 1 if the mount does not move and the clock runs at the right rate.
    turn_chance : float
        Probability that a steady mount and a right clock show as much rotation; NaN if the frames span no time.
    latitude_deg : Estimate or None
        Latitude from that axis and the vertical alone, independent of time and longitude. None without a vertical or an
        axis. The vertical is used as supplied; the displacement of the axis by a moving mount is part of the sigma.
    used, left_out : tuple of int
        Numbers of the frames that were used, and of those that were identified but disagree.
    told, untold : tuple of str
        In words: what the night shows, and what no night can show.
    """

    ok: bool
    reason: Reason
    message: str = ""
    lat_deg: float = math.nan
    lon_deg: float = math.nan
    cov_km2: F8 | None = None
    heading_off_deg: float = math.nan
    R_terrestrial_to_camera: F8 | None = None
    cov_rad2: F8 | None = None
    clock_sigma_s: float = 0.0
    lifted: LiftedSky | None = None
    wander_deg: float = math.nan
    axis_camera: F8 | None = None
    axis_sigma_deg: float = math.nan
    rate: Estimate | None = None
    turn_chance: float = math.nan
    latitude_deg: Estimate | None = None
    used: tuple[int, ...] = ()
    left_out: tuple[int, ...] = ()
    told: tuple[str, ...] = ()
    untold: tuple[str, ...] = ()

    def attitude_at(self, lat_deg: float, lon_deg: float) -> Attitude:
        """Return the attitude of a camera at a known place, at any time of the night, with its standard deviations.

        They include the clock's offset, the drift of a mount that moves, and the uncertainty of a refraction that is removed
        only now.

        Raises
        ------
        ConfigError
            When no frame was identified.
        """
        if self.R_terrestrial_to_camera is None or self.cov_rad2 is None:
            raise ConfigError("no frame of the night was identified: there is no attitude")
        pole = self.R_terrestrial_to_camera[:, 2]
        cov = self.cov_rad2 + (EARTH_RAD_S * self.clock_sigma_s) ** 2 * np.outer(pole, pole)
        R_cam = self.R_terrestrial_to_camera @ enu_rotation(lat_deg, lon_deg).T
        if self.lifted is not None:
            turn = self.lifted.turn(R_cam[:, 2])
            R_cam = rotation_of(turn) @ R_cam
            cov = cov + self.lifted.relative_sigma**2 * np.outer(turn, turn)
        local = R_cam.T @ cov @ R_cam
        tilt = math.degrees(math.sqrt(float(local[0, 0] + local[1, 1]) / 2))
        return Attitude.with_sigma(R_cam, tilt_deg=tilt, heading_deg=math.degrees(math.sqrt(float(local[2, 2]))))


@dataclass(frozen=True, eq=False)
class _Frame:
    """A frame of the night: its time, its detections, and its fix."""

    utc: Utc
    detections: Detections | ArrayLike
    flux: ArrayLike | None
    fix: Fix


@dataclass
class Night:
    r"""Frames of one stationary camera; add them in any order, then call `fix`.

    Attributes
    ----------
    camera : Camera
        The camera.
    attitude : Attitude, 3x3 array_like or None
        Orientation relative to the horizon, the same for all frames; without one (None) there is no position.
    clock_sigma_s : float
        Standard deviation of the clock's offset, which is the same in all frames and affects the longitude. Taken from
        `sigmas` unless given.
    pressure_hpa, temperature_c : float
        Pressure and temperature of the air, for refraction.
    near : LastKnown, optional
        A circle that contains the answer.
    solver : str or callable
        A solver that provides `Fix.R_icrs_to_camera` and `Fix.rotation_cov_rad2`: ``skybench``, or a variant of it.
    sigmas : ToldSigmas
        Stated standard deviations of time, lens and air. These errors are the same in all frames, so they enter the
        covariance once, not averaged over frames.
    dut1_s : float or None
        UT1-UTC in seconds, the same for all frames; None takes it from the IERS table.

    Examples
    --------
    >>> night = celnav.Night(camera, attitude=celnav.Attitude.up([0, 0, 1], tilt_deg=0.05))
    >>> for image, utc in frames:
    ...     night.add(celnav.detect(image), utc)
    >>> found = night.fix()
    >>> print(found.lat_deg, found.lon_deg, found.cov_km2, *found.told, *found.untold, sep="\n")
    """

    camera: Camera
    attitude: Attitude | ArrayLike | None = None
    clock_sigma_s: float = 0.0
    pressure_hpa: float = 1010.0
    temperature_c: float = 10.0
    near: LastKnown | None = None
    solver: str | Solver = "skybench"
    sigmas: ToldSigmas = field(default_factory=ToldSigmas)
    dut1_s: float | None = None
    _frames: list[_Frame] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        self.attitude = as_attitude(self.attitude)
        self.clock_sigma_s = finite_number(self.clock_sigma_s, "clock_sigma_s", ConfigError, least=0.0)
        if not isinstance(self.sigmas, ToldSigmas):
            raise ConfigError(f"sigmas = {shown(self.sigmas)} must be a celnav.ToldSigmas")
        self.clock_sigma_s = self.clock_sigma_s or self.sigmas.utc_s

    @property
    def fixes(self) -> tuple[Fix, ...]:
        """The individual fixes and refusals of the frames."""
        return tuple(frame.fix for frame in self._frames)

    def add(
        self, detections: Detections | ArrayLike, utc: str | datetime | Utc, *, flux: ArrayLike | None = None
    ) -> Fix:
        """Solve a frame on its own, and store it.

        Parameters
        ----------
        detections, utc, flux
            As in `celnav.solve`.
        """
        instant = parse_utc(utc)
        known = self.attitude
        assert known is None or isinstance(known, Attitude)
        fix = solve(
            detections, self.camera, instant, known, self.solver, flux=flux, pressure_hpa=self.pressure_hpa,
            temperature_c=self.temperature_c, dut1_s=self.dut1_s, near=self.near, sigmas=self.sigmas,
        )  # fmt: skip
        self._frames.append(_Frame(instant, detections, flux, fix))
        return fix

    def fix(self) -> NightFix:
        """Combine the frames.

        A frame that could not be identified on its own is searched again near the orientation of those that could.
        """
        found = self._combined()
        if found.R_terrestrial_to_camera is not None and self._search_again(found):
            found = self._combined()
        return found

    def _combined(self) -> NightFix:
        """Combine the identified frames."""
        rows, rotations, covs, common = [], [], [], []
        for number, frame in enumerate(self._frames):
            rotation = terrestrial_orientation(frame.fix, frame.utc, self.dut1_s)
            if rotation is not None and frame.fix.rotation_cov_rad2 is not None:
                rows.append(number)
                rotations.append(rotation)
                alike = frame.fix.common_cov_rad2
                common.append(np.zeros((3, 3)) if alike is None else alike)
                covs.append(frame.fix.rotation_cov_rad2 - common[-1])
        if not rows:
            refused = [frame.fix.message for frame in self._frames if frame.fix.reason is Reason.INCONSISTENT]
            if refused:
                message = (
                    f"{len(refused)} of {len(self._frames)} frames are inconsistent, and none is usable: {refused[0]}"
                )
                return NightFix(False, Reason.INCONSISTENT, message)
            message = f"none of {len(self._frames)} frames was identified"
            return NightFix(False, Reason.TOO_FEW_DETECTIONS, message)
        first = self._frames[rows[0]].utc
        times = np.array([_seconds_between(first, self._frames[number].utc) for number in rows])
        mount = combine(np.stack(rotations), np.stack(covs), times)
        # The errors of lens and air are the same in all frames of a stationary camera.
        mount = replace(mount, cov=mount.cov + np.mean([common[k] for k in mount.used], axis=0))
        used = tuple(rows[k] for k in mount.used)
        without_vertical = self.attitude is None and self.pressure_hpa > 0
        night = NightFix(
            False,
            Reason.OK,
            R_terrestrial_to_camera=mount.rotation,
            cov_rad2=mount.cov,
            clock_sigma_s=self.clock_sigma_s,
            lifted=self._lifted(used) if without_vertical else None,
            wander_deg=math.degrees(mount.wander_rad),
            used=used,
            left_out=tuple(number for number in rows if number not in used),
        )
        night = _with_turn(night, mount)
        if night.turn_chance < LEAST_CHANCE:
            # A mount that moves during the night has also moved since its attitude was measured; or the clock drifts.
            night = replace(night, cov_rad2=mount.cov + mount.drift_cov)
        return _in_words(self._placed(night, mount), mount, len(self._frames), self.clock_sigma_s)

    def _search_again(self, found: NightFix) -> bool:
        """Search unidentified frames near the night's orientation; return whether one of them was identified."""
        assert found.R_terrestrial_to_camera is not None
        assert found.cov_rad2 is not None
        assert self.attitude is None or isinstance(self.attitude, Attitude)
        own = float(np.linalg.eigvalsh(found.cov_rad2)[-1])
        sigma = math.sqrt(own + math.radians(found.wander_deg) ** 2)
        known = Orientation(found.R_terrestrial_to_camera, sigma, found.lat_deg, found.lon_deg)
        weather = Weather(self.pressure_hpa, self.temperature_c)
        some = False
        for number, frame in enumerate(self._frames):
            if frame.fix.reason not in UNFOUND:
                continue
            fix = solve_oriented(
                frame.detections, self.camera, frame.utc, self.attitude, known, self.solver, weather, frame.flux,
                self.sigmas, self.dut1_s,
            )  # fmt: skip
            if terrestrial_orientation(fix, frame.utc, self.dut1_s) is not None:
                self._frames[number] = replace(frame, fix=fix)
                some = True
        return some

    def _lifted(self, used: tuple[int, ...]) -> LiftedSky:
        """Return the stars of the frames that were used, with the air that lifts them."""
        places, weights = [], []
        for number in used:
            frame = self._frames[number]
            rows = frame.fix.matches[:, 0]
            seen = frame.detections
            sigma_px = seen.sigma_px if isinstance(seen, Detections) else None
            at = seen.uv if isinstance(seen, Detections) else np.asarray(seen, dtype=np.float64)
            places.append(at[rows])
            weights.append(np.ones(len(rows)) if sigma_px is None else sigma_px[rows] ** -2.0)
        uv = np.concatenate(places)
        rays, weight = self.camera.to_rays(uv), np.concatenate(weights) / self.camera.radians_per_px(uv) ** 2
        good = np.isfinite(rays[:, 0]) & np.isfinite(weight)
        relative = math.hypot(RELATIVE_SIGMA, self.sigmas.refraction(self.pressure_hpa, self.temperature_c))
        return LiftedSky(rays[good], weight[good], Weather(self.pressure_hpa, self.temperature_c), relative)

    def _placed(self, night: NightFix, mount: FixedMount) -> NightFix:
        """Add position and latitude if the vertical is known."""
        attitude = self.attitude
        if attitude is None:
            message = "the night gives the orientation to the Earth; a position needs the vertical: give Attitude.up"
            return replace(night, reason=Reason.VERTICAL_REQUIRED, message=message)
        assert isinstance(attitude, Attitude)
        pole = mount.rotation[:, 2]
        turned = EARTH_RAD_S * self.clock_sigma_s
        assert night.cov_rad2 is not None
        cov = night.cov_rad2 + turned**2 * np.outer(pole, pole)
        # The vertical is the same in every frame, and so is what the lens puts in doubt of it.
        doubt = max(vertical_doubt_deg(self._frames[number].fix) for number in night.used)
        place = honest_place(mount.rotation, cov, attitude, doubt_deg=doubt)
        latitude = None
        if night.axis_camera is not None:
            up = horizontal_frame(attitude)[:, 2]
            sine = float(np.clip(up @ night.axis_camera, -1, 1))
            off = 0.0
            if night.turn_chance < LEAST_CHANCE:  # the observed axis is that of Earth and mount combined
                off = math.degrees(float(np.linalg.norm(np.cross(pole, night.axis_camera))))
            sigma = math.hypot(attitude.tilt_deg, doubt, night.axis_sigma_deg, off)
            latitude = Estimate(math.degrees(math.asin(sine)), sigma)
        config = self.solver.config if isinstance(self.solver, SkybenchSolver) else SkybenchConfig()
        if heading_contradicts(place, config.heading_limit_deg(attitude, self.sigmas, self.camera)):
            message = f"the stars put the heading {place.heading_off_deg:.2f} deg from the one given"
            return replace(night, reason=Reason.INCONSISTENT, message=message, latitude_deg=latitude)
        return replace(
            night, ok=True, lat_deg=place.lat_deg, lon_deg=place.lon_deg, cov_km2=place.cov_km2,
            heading_off_deg=place.heading_off_deg, latitude_deg=latitude,
        )  # fmt: skip


def _seconds_between(one: Utc, other: Utc) -> float:
    """Return the elapsed seconds, including leap seconds."""
    (day, part), (other_day, other_part) = one.tt, other.tt
    return ((other_day - day) + (other_part - part)) * 86400.0


def _with_turn(night: NightFix, mount: FixedMount) -> NightFix:
    """Add the Earth's axis and rotation rate as measured by the frames."""
    chi2 = mount.turn_chi2
    if math.isnan(chi2):
        return night
    # Survival function of chi-squared with three degrees of freedom.
    chance = math.erfc(math.sqrt(chi2 / 2)) + math.sqrt(2 * chi2 / math.pi) * math.exp(-chi2 / 2)
    turn = mount.sky_turn
    speed = float(np.linalg.norm(turn))
    across = np.linalg.eigvalsh(mount.turn_cov[:2, :2])[-1]
    return replace(
        night,
        axis_camera=turn / speed,
        axis_sigma_deg=math.degrees(math.sqrt(float(across)) / EARTH_RAD_S),
        rate=Estimate(speed / EARTH_RAD_S, math.sqrt(float(mount.turn_cov[2, 2])) / EARTH_RAD_S),
        turn_chance=chance,
    )


def _with_sigma(estimate: Estimate) -> str:
    """Format a value to two digits of its standard deviation."""
    digits = 1 - math.floor(math.log10(estimate.sigma)) if estimate.sigma > 0 else 6
    digits = min(max(digits, 0), 15)
    return f"{estimate.value:.{digits}f} +- {estimate.sigma:.{digits}f}"


def _in_words(night: NightFix, mount: FixedMount, frames: int, clock_sigma_s: float) -> NightFix:
    """Add the statements on what the night shows and on what it cannot show."""
    told = [f"{len(night.used)} of {frames} frames give one orientation to the Earth, over {mount.span_s / 3600:.2f} h"]
    if night.left_out:
        told.append(f"frames {', '.join(map(str, night.left_out))} disagree with it and are left out")
    if night.wander_deg > 0:
        told.append(f"the mount wanders by {night.wander_deg:.4f} deg about each axis beyond the frames' noise")
    if night.rate is not None:
        told.append(
            f"the sky turns at {_with_sigma(night.rate)} of the Earth's rate, about an axis known within "
            f"{night.axis_sigma_deg:.1g} deg"
        )
        verdict = "the mount moved or the clock runs wrong" if night.turn_chance < LEAST_CHANCE else "nothing moved"
        told.append(f"{verdict} (probability of as much by chance {night.turn_chance:.2g})")
    untold = [
        "an offset of the clock is a longitude: 1 s is 15.04 arcsec, 464 m at the equator"
        + ("" if clock_sigma_s else "; the clock is taken as exact (clock_sigma_s = 0)"),
        "a turn of camera and ground together about the Earth's axis is a longitude, a tilt of the vertical is a place: "
        "stars show neither, and frames do not average it away",
        "a drift of the mount about the Earth's axis is a clock that runs fast or slow",
        "refraction that stands still in the frame is a distortion of the lens: a lens calibrated on these frames alone "
        "holds it",
    ]
    return replace(night, told=tuple(told), untold=tuple(untold))
