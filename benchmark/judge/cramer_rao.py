"""The Cramér-Rao bound: no unbiased solver's position can scatter less than the information in its stars' places allows.

The noise of the pixels is propagated to the position in three steps. (1) A star's pixels give Fisher information on its place
in the image (`benchmark.judge.place_information`). (2) The camera's projection converts it to information on the direction of
the sky. (3) Moving east or north turns the sky. Where the attitude is not known exactly, its error turns the sky as well, and
errors of the focal length and the principal point also move the stars. The information on the position is the Schur
complement that remains.

The stars are taken as identified, and distortion, air and time as known. A real solver knows less, so the bound holds. The
change of scale by refraction (below 1 % at 10 degrees of altitude) is neglected. Stars whose centre is outside the frame are
left out, and those near its edge count fully: on average over places the two effects cancel.

References
----------
S. M. Kay, Fundamentals of Statistical Signal Processing I, 1993, sections 3.9 and 10.8.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import erf
from scipy.stats import norm

import celnav
from benchmark.judge.geodesy import radii_of_curvature_km
from benchmark.judge.place_information import StarLight, place_information

F8 = NDArray[np.float64]

_NODE, _WEIGHT = leggauss(48)
"""Quadrature for a median: exact to 1e-6 for axis ratios up to 1000."""
_BLOCK_ROWS = 128
"""Rows of a block that is small enough for BLAS to use one thread."""
_DEPENDENT = 1e-10
"""Share of a measurement's derivatives below which what is left of them is rounding."""


@dataclass(frozen=True)
class Prior:
    """Prior knowledge of attitude and camera.

    Attributes
    ----------
    tilt_deg : float
        Standard deviation of the tilt about each horizontal axis; 0: exact.
    heading_deg : float
        Standard deviation of the heading; 0: exact, infinite: unknown (only the vertical is given).
    focal : float
        Standard deviation of the focal length, relative.
    principal_point_px : float
        Standard deviation of each of the principal point's coordinates.
    """

    tilt_deg: float = 0.0
    heading_deg: float = 0.0
    focal: float = 0.0
    principal_point_px: float = 0.0

    @property
    def sigmas(self) -> F8:
        """Standard deviations of turns about east, north, up (rad) and of the lens as in `lens_derivatives`, shape (6,)."""
        turns = np.radians([self.tilt_deg, self.tilt_deg, self.heading_deg])
        return np.concatenate((turns, [self.focal, self.principal_point_px, self.principal_point_px]))


EXACT = Prior()
VERTICAL = Prior(heading_deg=math.inf)


def displacement_turns(latitude_deg: float) -> F8:
    """Rotations of the sky that a displacement of the observer causes, shape (3, 2).

    Going north rotates the sky about east, from north to up. Going east rotates it about the Earth's axis, that is, by -1
    about north and by -tan(latitude) about up.

    Returns
    -------
    ndarray, shape (3, 2)
        Rotations about east, north and up (right-handed, rad) per kilometre east and per kilometre north, on WGS84.
    """
    east_km, north_km = radii_of_curvature_km(latitude_deg)
    tangent = math.tan(math.radians(latitude_deg))
    return np.column_stack((np.array([0.0, -1.0, -tangent]) / east_km, np.array([1.0, 0.0, 0.0]) / north_km))


def turn_derivatives(camera: celnav.Camera, R_cam: F8, uv: F8) -> F8:
    """Derivatives of stars' places with respect to rotations of the sky about east, north and up, px/rad.

    Parameters
    ----------
    camera : celnav.Camera
    R_cam : ndarray, shape (3, 3)
        ENU to camera.
    uv : ndarray, shape (n, 2)
        Places of the stars, px.

    Returns
    -------
    ndarray, shape (n, 2, 3)
        NaN outside the frame and where the projection has no derivative.
    """
    rays = camera.to_rays(uv)
    found = np.full((len(uv), 2, 3), math.nan)
    seen = camera.in_frame(uv) & np.isfinite(rays).all(axis=1)
    uv_by_ray = camera.project_with_derivatives(rays[seen])[1]
    # A rotation w moves the direction d by w x d, and g (w x d) = w (d x g).
    east, north, up = (rays[seen] @ R_cam).T[:, :, None]
    by_east, by_north, by_up = np.moveaxis((uv_by_ray.reshape(-1, 3) @ R_cam).reshape(-1, 2, 3), 2, 0)
    turned = (north * by_up - up * by_north, up * by_east - east * by_up, east * by_north - north * by_east)
    found[seen] = np.stack(turned, axis=2)
    return found


def lens_derivatives(camera: celnav.Camera, uv: F8) -> F8:
    """Derivatives of stars' places by relative focal length and coordinates of the principal point, shape (n, 2, 3), px.

    All projections scale with the focal length and shift with the principal point after applying their distortion.
    """
    by_focal = uv - np.array([camera.cx_px, camera.cy_px])
    return np.concatenate((by_focal[:, :, None], np.broadcast_to(np.eye(2), (len(uv), 2, 2))), axis=2)


def information_on_position(by_turn: F8, by_lens: F8, places: F8, latitude_deg: float, prior: Prior = EXACT) -> F8:
    """Fisher information that stars' places give on the horizontal position.

    Parameters
    ----------
    by_turn : ndarray, shape (n, 2, 3)
        See `turn_derivatives`; stars with NaN are ignored.
    by_lens : ndarray, shape (n, 2, 3)
        See `lens_derivatives`.
    places : ndarray, shape (n, 2, 2)
        Information on each star's place, 1/px^2.
    latitude_deg : float
        Latitude of the observer.
    prior : Prior
        Uncertainty of attitude and lens.

    Returns
    -------
    ndarray, shape (2, 2)
        East-north, 1/km^2.
    """
    usable = np.isfinite(by_turn).all(axis=(1, 2)) & np.isfinite(places).all(axis=(1, 2))
    free = np.flatnonzero(prior.sigmas > 0)
    turns = by_turn[usable]
    displaced = (turns.reshape(-1, 3) @ displacement_turns(latitude_deg)).reshape(-1, 2, 2)
    unknown = np.concatenate((turns, by_lens[usable]), axis=2)[:, :, free]
    stars = _rooted(places[usable], np.concatenate((displaced, unknown), axis=2)).reshape(-1, 2 + len(free))
    # What is known beforehand counts as further measurements, which do not depend on the position.
    known = np.column_stack((np.zeros((len(free), 2)), np.diag(1.0 / prior.sigmas[free])))
    root = _triangle(np.vstack((stars, known)))
    own = _without(root[:, 2:], root[:, :2])
    values, axes = np.linalg.eigh(own.T @ own)
    least = (_DEPENDENT * np.linalg.norm(root[:, :2])) ** 2
    return np.asarray((axes * np.where(values > least, values, 0.0)) @ axes.T)


def _rooted(places: F8, moves: F8) -> F8:
    """Multiply by upper triangular roots L of symmetric matrices, (n, 2, 2): transposed(L) @ L is the matrix; (n, 2, k)."""
    first = np.sqrt(places[:, 0, 0])
    shared = np.divide(places[:, 0, 1], first, out=np.zeros_like(first), where=first > 0)
    second = np.sqrt(np.maximum(places[:, 1, 1] - shared**2, 0.0))
    found = np.empty_like(moves)
    found[:, 0] = first[:, None] * moves[:, 0] + shared[:, None] * moves[:, 1]
    found[:, 1] = second[:, None] * moves[:, 1]
    return found


def _triangle(rows: F8) -> F8:
    """A matrix of fewer rows with the same products of its columns, by QR of blocks."""
    while len(rows) > _BLOCK_ROWS:
        blocks = math.ceil(len(rows) / _BLOCK_ROWS)
        padded = np.zeros((blocks * _BLOCK_ROWS, rows.shape[1]))
        padded[: len(rows)] = rows
        triangles = np.asarray(np.linalg.qr(padded.reshape(blocks, _BLOCK_ROWS, -1), mode="r"))
        rows = triangles.reshape(-1, rows.shape[1])
    return rows


def _without(unknown: F8, columns: F8) -> F8:
    """The parts of columns that no combination of the columns of `unknown` explains, by Gram and Schmidt.

    Their squares are the Schur complement. They keep the digits that are lost where information is subtracted from its like.
    """
    size = np.linalg.norm(unknown, axis=0)
    rest = unknown[:, size > 0] / size[size > 0]
    for _ in range(rest.shape[1]):
        size = np.linalg.norm(rest, axis=0)
        longest = int(size.argmax())
        if size[longest] <= _DEPENDENT:
            break
        unit = rest[:, longest] / size[longest]
        for _ in range(2):  # the first time leaves a rounded part along the unit vector
            rest = rest - np.outer(unit, unit @ rest)
            columns = columns - np.outer(unit, unit @ columns)
    return columns


def covariance_bound(information: F8) -> F8:
    """Inverse of a position's information, shape (2, 2), km^2; infinite where it does not determine the position."""
    values, vectors = np.linalg.eigh(information)
    if values[0] <= 1e-12 * max(values[1], 1e-300):
        return np.full((2, 2), math.inf)
    return np.asarray((vectors / values) @ vectors.T)


def position_information(light: StarLight, prior: Prior = EXACT) -> F8:
    """Fisher information of a frame's light on the horizontal position, east-north, shape (2, 2), 1/km^2."""
    camera = celnav.Camera.from_dict(dataclasses.asdict(light.camera))
    by_turn = turn_derivatives(camera, light.R_cam, light.uv)
    usable = np.isfinite(by_turn).all(axis=(1, 2)) & np.isfinite(light.background_e2)
    places = place_information(light.take(usable))
    by_lens = lens_derivatives(camera, light.uv[usable])
    return information_on_position(by_turn[usable], by_lens, places, light.latitude_deg, prior)


def position_bound(light: StarLight, prior: Prior = EXACT) -> F8:
    """Cramér-Rao bound on the covariance of the horizontal position.

    Parameters
    ----------
    light : StarLight
        Light of the frame, see `benchmark.judge.frame_bounds`.
    prior : Prior
        Prior knowledge of attitude and camera.

    Returns
    -------
    ndarray, shape (2, 2)
        East-north, km^2; infinite where the stars do not determine the position.
    """
    return covariance_bound(position_information(light, prior))


def bound_km(light: StarLight, prior: Prior = EXACT) -> float:
    """Root of the trace of `position_bound`: the least root-mean-square error, km; infinite where there is no bound."""
    return math.sqrt(float(np.trace(position_bound(light, prior))))


def median_error_km(covariance_km2: F8) -> float:
    """Median length of a zero-mean Gaussian error with a covariance, shape (2, 2); infinite if the covariance is.

    Let a <= b be the standard deviations along the axes. The probability that the length is below r is that of the component
    along b being r sin(t), times that of the component along a being within r cos(t), integrated over t by quadrature.
    """
    if not np.isfinite(covariance_km2).all():
        return math.inf
    a, b = np.sqrt(np.linalg.eigvalsh(covariance_km2))
    angle = math.pi / 4.0 * (_NODE + 1.0)

    def beyond_half(radius: float) -> float:
        density = norm.pdf(radius / b * np.sin(angle)) * radius / b * np.cos(angle)
        within = erf(radius * np.cos(angle) / (math.sqrt(2.0) * a))
        return math.pi / 2.0 * float(_WEIGHT @ (density * within)) - 0.5

    return float(brentq(beyond_half, 0.0, 4.0 * b))
