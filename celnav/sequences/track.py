"""Track of a vehicle: a Kalman filter over fixes, with the vehicle's motion and the mount's bias as states, and a smoother.

A camera mounted with a tilt error b displaces every fix by b times the Earth's radius, in a direction that rotates with the
vehicle's heading. While the vehicle turns, position and bias can therefore be separated, and a full orbit averages the bias
out (Teague & Chahl 2024, Drones 8(11) 652). Filter and smoother follow Rauch, Tung & Striebel 1965, AIAA J. 3(8) 1445; the
error-state form, which keeps the position on the ellipsoid and only its error in a plane, follows Sola 2017, arXiv
1711.02508. East and north rotate along the way, and abruptly at a pole, so velocities and covariances are transported along
the great circle.

Any fix may be a misidentification, the first one too. A fix that no filter accepts therefore starts another filter, and the
one with most of the recent fixes is the track (multiple hypotheses: Reid 1979, IEEE Trans. Autom. Control 24, 843; each fix
belongs to one of them here).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from celnav.checking import bounded, check_fields, finite_number, real_array
from celnav.errors import ConfigError
from celnav.fix import Fix
from celnav.horizon import radii_km
from celnav.sky.astrometry import enu_rotation
from celnav.sky.utc import Utc, parse_utc
from celnav.sky.wgs84 import MEAN_RADIUS_KM

F8 = NDArray[np.float64]

KM_PER_DEG = math.pi / 180 * MEAN_RADIUS_KM
# States: position error east, north (km); velocity east, north (km/s); mount tilt forward, right; heading bias (deg).
_N = 7
# Standard deviation of a heading from one frame, degrees: the effect of a centroid noise of 0.1 px at the edge.
_HEADING_SIGMA_DEG = 0.02
# Fixes that decide between hypotheses, and after which a hypothesis that none of them supports is dropped.
_RECENT = 20


@dataclass(frozen=True)
class TrackConfig:
    """Configuration of the filter.

    Attributes
    ----------
    speed_sigma_km_s : float
        Standard deviation of the unknown initial speed, along each axis.
    acceleration_km_s2 : float
        White-noise acceleration, km/s^2 per square root of hertz.
    tilt_bias_sigma_deg, heading_bias_sigma_deg : float
        Standard deviations of the mount's constant errors; zero for a mount without errors.
    bias_walk_deg : float
        Random walk of the biases, degrees per square root of a second.
    gate : float
        Squared normalised innovation, two degrees of freedom, beyond which a fix contradicts a hypothesis; 13.8 rejects one
        good fix in a thousand.
    """

    speed_sigma_km_s: float = bounded(0.1, 0)
    acceleration_km_s2: float = bounded(1e-4, 0)
    tilt_bias_sigma_deg: float = bounded(0.1, 0)
    heading_bias_sigma_deg: float = bounded(1.0, 0)
    bias_walk_deg: float = bounded(1e-5, 0)
    gate: float = bounded(13.8, 1e-9)

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class TrackPoint:
    """State of the vehicle at an instant.

    Attributes
    ----------
    time_s : float
        Seconds since the first fix.
    lat_deg, lon_deg : float
        Position.
    velocity_km_s : ndarray, shape (2,)
        Velocity to the east and to the north.
    tilt_bias_deg : ndarray, shape (2,)
        Tilt of the mount forward and to the right, as the displacement of the fix in degrees of arc.
    heading_bias_deg : float
        Heading of the mount minus the supplied one; without the turn of the meridian by the tilt, which `Fix.heading_off_deg`
        contains.
    cov : ndarray, shape (7, 7)
        Covariance of position (east, north, km), velocity (km/s), tilt bias and heading bias (deg).
    used : bool
        Whether the fix of this instant is one of the track's.
    gate : float
        Squared normalised innovation of the fix; 0 for the first one.
    """

    time_s: float
    lat_deg: float
    lon_deg: float
    velocity_km_s: F8
    tilt_bias_deg: F8
    heading_bias_deg: float
    cov: F8
    used: bool
    gate: float

    @property
    def cov_km2(self) -> F8:
        """Covariance of the position, east-north, km^2."""
        return self.cov[:2, :2]


@dataclass(frozen=True, eq=False)
class _Step:
    """One step for the smoother: the state before its fix, and the transition to it."""

    predicted: TrackPoint
    transition: F8
    filtered: TrackPoint


@dataclass
class _Hypothesis:
    """The filter that one fix started; it has a step for that fix and for each one since."""

    steps: list[_Step]

    @property
    def support(self) -> int:
        """How many of the recent fixes are its own."""
        return sum(step.filtered.used for step in self.steps[-_RECENT:])


@dataclass
class Track:
    """A track of one vehicle; feed it fixes in order of time.

    Fixes that contradict each other form hypotheses. The track is the one with most of the last 20 fixes; of several, the
    oldest. It can therefore change with a fix, as with the third one if the first was a misidentification.
    """

    config: TrackConfig = field(default_factory=TrackConfig)
    _hypotheses: list[_Hypothesis] = field(default_factory=list, repr=False)  # the oldest first
    _start: Utc | None = field(default=None, repr=False)

    @property
    def points(self) -> tuple[TrackPoint, ...]:
        """The filtered states, one for the fix that started the track and for each one since."""
        return tuple(step.filtered for step in self._steps)

    @property
    def _steps(self) -> list[_Step]:
        return max(self._hypotheses, key=lambda one: one.support).steps if self._hypotheses else []

    def update(self, fix: Fix, utc: str | datetime | Utc, heading_deg: float) -> TrackPoint | None:
        """Update the track with a fix.

        Parameters
        ----------
        fix : Fix
            The fix; a refusal is skipped. Solve it with the vertical alone, or with a standard deviation of the heading: a
            tilt of the mount also changes the heading that the stars imply, and would bias a fix whose heading is stated as
            exact. The standard deviation of the tilt belongs in this filter, not in the fix.
        utc : str, datetime or Utc
            Time of the fix, not before the previous one.
        heading_deg : float
            Heading of the mount (azimuth of its forward direction), as known to the vehicle.

        Returns
        -------
        TrackPoint or None
            The track's present state; None for a refusal, and for a fix without a covariance.

        Raises
        ------
        ConfigError
            For a fix before the previous one, and for numbers that are not finite or no covariance.
        """
        if not fix.ok or fix.cov_km2 is None:
            return None
        heading_deg = finite_number(heading_deg, "heading_deg", ConfigError)
        _check_fix(fix)
        instant = parse_utc(utc)
        if self._start is None:
            self._start = instant
        time_s = _elapsed_s(self._start, instant)
        if self._hypotheses and time_s < self._hypotheses[0].steps[-1].filtered.time_s:
            raise ConfigError("fixes must come in the order of time")
        free = True
        for one in sorted(self._hypotheses, key=lambda one: -one.support):
            predicted, transition = self._predict(one.steps[-1].filtered, time_s)
            filtered = _corrected(predicted, fix, heading_deg, self.config.gate if free else None)
            one.steps.append(_Step(predicted, transition, filtered))
            free = free and not filtered.used
        if free:
            self._hypotheses.append(_Hypothesis([self._first(fix, heading_deg, time_s)]))
        self._hypotheses = [one for one in self._hypotheses if one.support]
        return self._steps[-1].filtered

    def _first(self, fix: Fix, heading_deg: float, time_s: float) -> _Step:
        """Return the first step of a hypothesis, about whose position nothing else is known."""
        c = self.config
        sigmas = (1e4, 1e4, *[c.speed_sigma_km_s] * 2, *[c.tilt_bias_sigma_deg] * 2, c.heading_bias_sigma_deg)
        cov = np.diag(np.square(sigmas))
        start = TrackPoint(time_s, fix.lat_deg, fix.lon_deg, np.zeros(2), np.zeros(2), 0.0, cov, True, 0.0)
        return _Step(start, np.eye(_N), _corrected(start, fix, heading_deg, self.config.gate))

    def _predict(self, last: TrackPoint, time_s: float) -> tuple[TrackPoint, F8]:
        dt = time_s - last.time_s
        transition = np.eye(_N)
        transition[0, 2] = transition[1, 3] = dt
        noise = np.zeros((_N, _N))
        q = self.config.acceleration_km_s2**2
        for position, velocity in ((0, 2), (1, 3)):
            noise[position, position] = q * dt**3 / 3
            noise[position, velocity] = noise[velocity, position] = q * dt**2 / 2
            noise[velocity, velocity] = q * dt
        noise[4:, 4:] = np.eye(3) * self.config.bias_walk_deg**2 * dt
        lat, lon = moved(last.lat_deg, last.lon_deg, *(last.velocity_km_s * dt))
        turn = _carried(last.lat_deg, last.lon_deg, lat, lon)
        predicted = replace(
            last,
            time_s=time_s,
            lat_deg=lat,
            lon_deg=lon,
            velocity_km_s=turn[2:4, 2:4] @ last.velocity_km_s,
            cov=turn @ (transition @ last.cov @ transition.T + noise) @ turn.T,
        )
        return predicted, turn @ transition

    def smoothed(self) -> tuple[TrackPoint, ...]:
        """Return the states given all fixes, including later ones (Rauch-Tung-Striebel)."""
        if not self._steps:
            return ()
        points = [self._steps[-1].filtered]
        for step, after in zip(reversed(self._steps[:-1]), reversed(self._steps[1:]), strict=True):
            later = points[-1]
            filtered = step.filtered
            gain = filtered.cov @ after.transition.T @ _inverse(after.predicted.cov)
            correction = gain @ _difference(later, after.predicted)
            turn = _carried(later.lat_deg, later.lon_deg, after.predicted.lat_deg, after.predicted.lon_deg)
            covariance = filtered.cov + gain @ (turn @ later.cov @ turn.T - after.predicted.cov) @ gain.T
            points.append(_shifted(filtered, correction, covariance))
        return tuple(reversed(points))


def _check_fix(fix: Fix) -> None:
    """Raise `ConfigError` unless the position of a fix and its covariance are such."""
    finite_number(fix.lat_deg, "fix.lat_deg", ConfigError, -90.0, 90.0)
    finite_number(fix.lon_deg, "fix.lon_deg", ConfigError)
    assert fix.cov_km2 is not None
    cov = real_array(fix.cov_km2, "fix.cov_km2", ConfigError)
    if cov.shape != (2, 2) or not np.isfinite(cov).all() or np.linalg.eigvalsh(cov)[0] < 0:
        raise ConfigError("fix.cov_km2 must be a covariance of two finite variances, km^2")


def _inverse(cov: F8) -> F8:
    """Return the inverse of a covariance; rows and columns of states that are known exactly are zero in both."""
    free = np.flatnonzero(np.diag(cov) > 0)
    inverse = np.zeros_like(cov)
    inverse[np.ix_(free, free)] = np.linalg.inv(cov[np.ix_(free, free)])
    return inverse


def _elapsed_s(one: Utc, other: Utc) -> float:
    """Return the seconds from one instant to another, including leap seconds."""
    seconds = other.second_of_day_s - one.second_of_day_s
    return (other.mjd_day - one.mjd_day) * 86400 + seconds + (other.tai_utc_s - one.tai_utc_s)


def moved(lat_deg: float, lon_deg: float, east_km: float, north_km: float) -> tuple[float, float]:
    """Return the position a short way (compared with the Earth) east and north of another one, even across a pole.

    The vertical rotates along a great circle, by the distances over the radii of curvature at the starting point.
    """
    east_radius, north_radius = radii_km(math.radians(lat_deg))
    axes = enu_rotation(lat_deg, lon_deg)
    turn = np.array([east_km / east_radius, north_km / north_radius])
    angle = math.hypot(*turn)
    if angle == 0.0:
        return lat_deg, math.remainder(lon_deg, 360.0)
    x, y, z = math.cos(angle) * axes[2] + math.sin(angle) / angle * (turn @ axes[:2])
    return math.degrees(math.atan2(z, math.hypot(x, y))), math.degrees(math.atan2(y, x))


def offset_km(lat_deg: float, lon_deg: float, from_lat_deg: float, from_lon_deg: float) -> F8:
    """Return the offset of a position from another one nearby, east and north, km, shape (2,): the inverse of `moved`."""
    there = enu_rotation(from_lat_deg, from_lon_deg) @ enu_rotation(lat_deg, lon_deg)[2]
    sine = math.hypot(there[0], there[1])
    angle = math.atan2(sine, there[2])
    return np.asarray(there[:2] * (angle / sine if sine > 0 else 1.0) * radii_km(math.radians(from_lat_deg)))


def _carried(lat_deg: float, lon_deg: float, to_lat_deg: float, to_lon_deg: float) -> F8:
    """Return the rotation of a state, shape (7, 7), that is transported from one position to another.

    Directions keep their angle with the great circle between the two (parallel transport), while east and north rotate
    relative to it because meridians converge. Biases belong to the vehicle and keep their values.
    """
    here, there = enu_rotation(lat_deg, lon_deg), enu_rotation(to_lat_deg, to_lon_deg)
    axis = np.cross(here[2], there[2])
    # The rotation that takes one vertical to the other by the shortest way, in a form without a division by 0 if they agree.
    crossed = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    shortest = np.eye(3) + crossed + crossed @ crossed / max(1.0 + float(here[2] @ there[2]), 1e-9)
    turn = np.eye(_N)
    turn[:2, :2] = turn[2:4, 2:4] = there[:2] @ shortest @ here[:2].T
    return turn


def _difference(a: TrackPoint, b: TrackPoint) -> F8:
    velocity = _carried(a.lat_deg, a.lon_deg, b.lat_deg, b.lon_deg)[2:4, 2:4] @ a.velocity_km_s
    return np.concatenate(
        (
            offset_km(a.lat_deg, a.lon_deg, b.lat_deg, b.lon_deg),
            velocity - b.velocity_km_s,
            a.tilt_bias_deg - b.tilt_bias_deg,
            [a.heading_bias_deg - b.heading_bias_deg],
        )
    )


def _shifted(point: TrackPoint, error: F8, cov: F8) -> TrackPoint:
    lat, lon = moved(point.lat_deg, point.lon_deg, float(error[0]), float(error[1]))
    turn = _carried(point.lat_deg, point.lon_deg, lat, lon)
    return replace(
        point,
        lat_deg=lat,
        lon_deg=lon,
        velocity_km_s=turn[2:4, 2:4] @ (point.velocity_km_s + error[2:4]),
        tilt_bias_deg=point.tilt_bias_deg + error[4:6],
        heading_bias_deg=point.heading_bias_deg + float(error[6]),
        cov=turn @ (0.5 * (cov + cov.T)) @ turn.T,
    )


def _corrected(predicted: TrackPoint, fix: Fix, heading_deg: float, gate: float | None) -> TrackPoint:
    """Correct a predicted state by a fix, unless the fix is beyond the gate, or belongs to another hypothesis (None)."""
    assert fix.cov_km2 is not None
    s, c = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    observe = np.zeros((2, _N))
    observe[0, 0] = observe[1, 1] = 1.0
    # From forward and right of the vehicle to east and north.
    to_east_north = KM_PER_DEG * np.array([[s, c], [c, -s]])
    observe[:, 4:6] = to_east_north
    innovation = (
        offset_km(fix.lat_deg, fix.lon_deg, predicted.lat_deg, predicted.lon_deg)
        - to_east_north @ predicted.tilt_bias_deg
    )
    turn = _carried(fix.lat_deg, fix.lon_deg, predicted.lat_deg, predicted.lon_deg)[:2, :2]
    noise = turn @ fix.cov_km2 @ turn.T
    spread = observe @ predicted.cov @ observe.T + noise
    distance = float(innovation @ np.linalg.solve(spread, innovation))
    if gate is None or distance > gate:
        return replace(predicted, used=False, gate=distance)
    gain = predicted.cov @ observe.T @ np.linalg.inv(spread)
    left = np.eye(_N) - gain @ observe
    # Joseph's form stays positive definite with the large initial covariance.
    covariance = left @ predicted.cov @ left.T + gain @ noise @ gain.T
    corrected = replace(_shifted(predicted, gain @ innovation, covariance), used=True, gate=distance)
    if math.isfinite(fix.heading_off_deg) and corrected.cov[6, 6] > 0:
        return _with_heading(corrected, fix, s, c)
    return corrected


def _with_heading(point: TrackPoint, fix: Fix, sin_heading: float, cos_heading: float) -> TrackPoint:
    """Correct the heading's bias by the heading that the stars imply.

    A tilt moves the zenith, and the meridian turns by the tangent of the latitude times the move to the east. The tilt's
    covariance is considered, but the tilt is not corrected (Schmidt 1966, Adv. Control Syst. 3, 293), since the error of the
    supplied heading need not be constant, and would then pass for a tilt.
    """
    assert fix.cov_km2 is not None
    steep = math.tan(math.radians(point.lat_deg))
    observe = np.zeros(_N)
    observe[4:6], observe[6] = (steep * sin_heading, steep * cos_heading), 1.0
    noise = _HEADING_SIGMA_DEG**2 + steep**2 * float(fix.cov_km2[0, 0]) / KM_PER_DEG**2
    off = fix.heading_off_deg - point.heading_bias_deg - float(observe[4:6] @ point.tilt_bias_deg)
    gain = np.zeros(_N)
    gain[6] = float(point.cov[6] @ observe) / (float(observe @ point.cov @ observe) + noise)
    left = np.eye(_N) - np.outer(gain, observe)
    covariance = left @ point.cov @ left.T + noise * np.outer(gain, gain)
    return replace(point, heading_bias_deg=point.heading_bias_deg + float(gain[6]) * off, cov=covariance)
