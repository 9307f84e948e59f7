"""Orientations of several cameras and their common position: one adjustment of stars, mountings and attitudes.

The unknowns are the position, the orientation of the body, and that of each camera. The stars of a camera measure its
orientation relative to the Earth; its mounting links that to the body's; an attitude, of a camera or of the body, links an
orientation to the position. Each has its covariance (Gauss-Markov); an unknown heading has no weight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.attitude import Attitude
from celnav.horizon import doubted, horizontal_frame, kilometres, rotation_vector
from celnav.identification.verification import rotation_of
from celnav.sky.astrometry import enu_rotation

F8 = NDArray[np.float64]

# Least standard deviation of any observation: 6 cm on the ground.
_LEAST_SIGMA_RAD = 1e-8
_LEAST_COS_LATITUDE = 1e-9


@dataclass(frozen=True, eq=False)
class Seen:
    """Observations of one camera.

    Attributes
    ----------
    rotation, cov_rad2 : ndarray, shape (3, 3), or None
        Rotation from the terrestrial frame to the camera by its stars, and the covariance of a small rotation in the camera
        frame; None if the camera was not identified.
    mounting : ndarray, shape (3, 3), or None
        Body to camera.
    mounting_sigma_rad : float
        Standard deviation of the mounting about each axis.
    attitude : Attitude or None
        Orientation relative to the horizon from the camera's own sensor.
    doubt_deg : float
        Standard deviation about each axis by which the camera's lens puts that attitude in doubt.
    """

    rotation: F8 | None
    cov_rad2: F8 | None
    mounting: F8 | None
    mounting_sigma_rad: float
    attitude: Attitude | None
    doubt_deg: float = 0.0


@dataclass(frozen=True, eq=False)
class Body:
    """Result of the adjustment.

    Attributes
    ----------
    rotation, cov_rad2 : ndarray, shape (3, 3), or None
        Terrestrial frame to body, with the covariance of a small rotation in the body frame; None without a mounting.
    lat_deg, lon_deg : float
        Position; NaN if no attitude is known.
    cov_km2 : ndarray, shape (2, 2), or None
        Covariance of the position in the axes east and north.
    chi2 : float
        Weighted sum of squared residuals.
    freedom : int
        Number of observations minus unknowns.
    apart_rad : float
        Largest angle between a camera's stars and the body with its mounting, or between an attitude's vertical and the
        position; NaN if there is nothing to compare.
    """

    rotation: F8 | None
    cov_rad2: F8 | None
    lat_deg: float
    lon_deg: float
    cov_km2: F8 | None
    chi2: float
    freedom: int
    apart_rad: float

    @property
    def chance(self) -> float:
        """Probability of as large a `chi2` by chance; NaN without degrees of freedom."""
        from scipy.special import chdtrc

        return float(chdtrc(self.freedom, self.chi2)) if self.freedom > 0 else math.nan


@dataclass(eq=False)
class _State:
    """State of the iteration: rotations from the terrestrial frame to body and cameras, and the position."""

    body: F8 | None
    cameras: list[F8]
    lat_rad: float
    lon_rad: float

    @property
    def enu(self) -> F8:
        return enu_rotation(math.degrees(self.lat_rad), math.degrees(self.lon_rad))


def adjust_body(seen: Sequence[Seen], attitude: Attitude | None) -> Body | None:
    """Adjust all observations together; None if no camera is identified.

    Parameters
    ----------
    seen : sequence of Seen
        The cameras. One that is neither identified nor mounted on a body with an identified camera contributes nothing.
    attitude : Attitude or None
        Attitude of the body, from a sensor that its cameras share.
    """
    anchored = [one for one in seen if one.rotation is not None and one.mounting is not None]
    used = [one for one in seen if one.rotation is not None or (one.mounting is not None and anchored)]
    if not used:
        return None
    state, attitudes = _start(used, anchored, attitude)
    placed = any(one is not None for one in attitudes)
    size = 5 + 3 * len(used)
    normal = right = np.zeros(0)
    chi2 = 0.0
    freedom = 0
    for _ in range(20):
        rows = _observations(state, used, attitudes)
        normal, right, chi2, freedom = np.zeros((size, size)), np.zeros(size), 0.0, 0
        for design, residual, information in rows:
            normal += design.T @ information @ design
            right += design.T @ information @ residual
            chi2 += float(residual @ information @ residual)
            freedom += int(np.count_nonzero(np.diag(information)))
        free = _unknowns(placed, state.body is not None, len(used))
        step = np.zeros(size)
        step[free] = np.linalg.solve(normal[np.ix_(free, free)], right[free])
        freedom -= len(free)
        _advance(state, step)
        if float(np.abs(step).max()) < 1e-11:
            break
    cov = np.zeros((size, size))
    cov[np.ix_(free, free)] = np.linalg.inv(normal[np.ix_(free, free)])
    return Body(
        state.body,
        None if state.body is None else cov[2:5, 2:5],
        math.degrees(state.lat_rad) if placed else math.nan,
        math.degrees(math.remainder(state.lon_rad, 2 * math.pi)) if placed else math.nan,
        kilometres(cov[:2, :2], state.lat_rad) if placed else None,
        chi2,
        freedom,
        _apart(state, used, attitudes) if freedom > 0 else math.nan,
    )


def _start(
    used: Sequence[Seen], anchored: Sequence[Seen], attitude: Attitude | None
) -> tuple[_State, list[Attitude | None]]:
    """Return the initial state, and the attitudes of the cameras and, last, of the body, less certain if stars contradict."""
    body = None
    cov = np.zeros((3, 3))
    if anchored:
        best = min(anchored, key=lambda one: one.mounting_sigma_rad**2 + float(np.trace(_cov(one))) / 3)
        assert best.rotation is not None
        assert best.mounting is not None
        body = best.mounting.T @ best.rotation
        cov = best.mounting.T @ (_cov(best) + best.mounting_sigma_rad**2 * np.eye(3)) @ best.mounting
    cameras, attitudes = [], []
    for one in used:
        if one.rotation is not None:
            rotation, known = one.rotation, _cov(one)
        else:
            assert body is not None
            assert one.mounting is not None
            rotation = one.mounting @ body
            known = one.mounting @ cov @ one.mounting.T + one.mounting_sigma_rad**2 * np.eye(3)
        cameras.append(rotation)
        attitudes.append(None if one.attitude is None else doubted(rotation, known, one.attitude, one.doubt_deg))
    attitudes.append(None if attitude is None or body is None else doubted(body, cov, attitude))
    state = _State(body, cameras, 0.0, 0.0)
    for known_attitude, oriented in zip(attitudes, [*cameras, body], strict=True):
        if known_attitude is not None and oriented is not None:
            zenith = horizontal_frame(known_attitude)[:, 2] @ oriented
            state.lat_rad = math.asin(float(np.clip(zenith[2], -1, 1)))
            state.lon_rad = math.atan2(float(zenith[1]), float(zenith[0]))
            break
    return state, attitudes


def _cov(one: Seen) -> F8:
    assert one.cov_rad2 is not None
    return one.cov_rad2 + _LEAST_SIGMA_RAD**2 * np.eye(3)


def _unknowns(placed: bool, has_body: bool, cameras: int) -> NDArray[np.intp]:
    """Return the columns of the unknowns: east and north; rotation of the body; rotations of the cameras."""
    free = list(range(2)) if placed else []
    free += list(range(2, 5)) if has_body else []
    return np.array(free + list(range(5, 5 + 3 * cameras)), dtype=np.intp)


def _observations(state: _State, used: Sequence[Seen], attitudes: Sequence[Attitude | None]) -> list[tuple[F8, F8, F8]]:
    """Return the design matrix, residual and information matrix of each observation."""
    size = 5 + 3 * len(used)
    rows = []
    for number, one in enumerate(used):
        columns = slice(5 + 3 * number, 8 + 3 * number)
        now = state.cameras[number]
        if one.rotation is not None:
            design = np.zeros((3, size))
            design[:, columns] = np.eye(3)
            rows.append(
                (design, rotation_vector(one.rotation @ now.T), np.asarray(np.linalg.inv(_cov(one)), dtype=np.float64))
            )
        if one.mounting is not None and state.body is not None:
            design = np.zeros((3, size))
            design[:, columns], design[:, 2:5] = np.eye(3), -one.mounting
            off = rotation_vector(one.mounting @ state.body @ now.T)
            rows.append((design, off, np.eye(3) / max(one.mounting_sigma_rad, _LEAST_SIGMA_RAD) ** 2))
        if (own := attitudes[number]) is not None:
            rows.append(_of_attitude(own, now, columns, state, size))
    if (shared := attitudes[-1]) is not None and state.body is not None:
        rows.append(_of_attitude(shared, state.body, slice(2, 5), state, size))
    return rows


def _turn(attitude: Attitude, rotation: F8, enu: F8) -> tuple[F8, F8]:
    """Return the attitude's horizontal frame, and the rotation from it to that of the position, in the local frame."""
    frame = horizontal_frame(attitude)
    if attitude.kind == "up":
        local = frame.T @ rotation @ enu.T
        heading = math.atan2(local[1, 0] - local[0, 1], local[0, 0] + local[1, 1])
        frame = frame @ rotation_of(np.array([0.0, 0.0, heading]))
    return frame, rotation_vector(frame.T @ rotation @ enu.T)


def _of_attitude(attitude: Attitude, rotation: F8, columns: slice, state: _State, size: int) -> tuple[F8, F8, F8]:
    frame, turn = _turn(attitude, rotation, state.enu)
    cos_lat = max(math.cos(state.lat_rad), _LEAST_COS_LATITUDE)
    design = np.zeros((3, size))
    # As in `horizon.place_from_rotation`: a step east or north rotates the horizon of the position.
    design[:, :2] = np.array([[0.0, 1.0], [-1.0, 0.0], [-math.sin(state.lat_rad) / cos_lat, 0.0]])
    design[:, columns] = -frame.T
    tilt = 1 / max(math.radians(attitude.tilt_deg), _LEAST_SIGMA_RAD) ** 2
    heading = 0.0
    if attitude.kind == "rotation":
        heading = 1 / max(math.radians(attitude.heading_deg), _LEAST_SIGMA_RAD) ** 2
    return design, turn, np.diag([tilt, tilt, heading])


def _advance(state: _State, step: F8) -> None:
    """Apply a step to the state, in place."""
    cos_lat = max(math.cos(state.lat_rad), _LEAST_COS_LATITUDE)
    state.lat_rad += float(np.clip(step[1], -0.1, 0.1))
    state.lon_rad += float(step[0]) / cos_lat
    if abs(state.lat_rad) > math.pi / 2:
        state.lat_rad = math.copysign(math.pi, state.lat_rad) - state.lat_rad
        state.lon_rad += math.pi
    if state.body is not None:
        state.body = rotation_of(step[2:5]) @ state.body
    state.cameras = [
        rotation_of(step[5 + 3 * number : 8 + 3 * number]) @ one for number, one in enumerate(state.cameras)
    ]


def _apart(state: _State, used: Sequence[Seen], attitudes: Sequence[Attitude | None]) -> float:
    offs = [
        rotation_vector(one.rotation @ (one.mounting @ state.body).T)
        for one in used
        if one.rotation is not None and one.mounting is not None and state.body is not None
    ]
    for attitude, rotation in zip(attitudes, [*state.cameras, state.body], strict=True):
        if attitude is not None and rotation is not None:
            offs.append(_turn(attitude, rotation, state.enu)[1][:2])
    return max((float(np.linalg.norm(one)) for one in offs), default=0.0)
