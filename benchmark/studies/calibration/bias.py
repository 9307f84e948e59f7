r"""First-order effect of a wrong camera, attitude, clock or sky on a position.

A solver that rotates its sky until predicted and observed positions agree minimises sum |d_i - D_i t|^2 over small rotations
t, where d_i is the contribution of the fault to the observed minus predicted position of star i (px), and D_i the derivative
of the predicted position with respect to the rotation. Its answer moves by the t of that least-squares problem, which is
linear in d. Faults that rotate the whole sky, or the horizon, add to t directly and leave no residual, so no fit can detect
them.

A rotation of the sky by t (east, north, up; right-handed, rad) relative to the horizon is a displacement of the observer.
Going north by n rotates the sky about east by n; going east by e rotates it about the Earth's axis, by -e about north and -e
tan(latitude) about up. Where the heading is supplied, the two displacements are fitted to all three components of t with the
stars' own weight; where only the vertical is, they are the first two.

The formulas hold for a camera of any lens model in any direction, on a sphere for the astronomy and on WGS84 for the
kilometres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.judge.cramer_rao import displacement_turns
from benchmark.judge.geodesy import ROTATION_RAD_S
from benchmark.studies.calibration.lens import derivatives, project, with_k1
from generator.scenario.projection import Projection

F8 = NDArray[np.float64]

Horizon = Literal["whole attitude", "vertical alone"]
Weights = Literal["pixel", "angle"]
FREE = ("focal length", "cx", "cy", "r^3", "r^5")


@dataclass(frozen=True, eq=False)
class View:
    """The part of a frame on which a prediction depends.

    Attributes
    ----------
    rays : ndarray, shape (n, 3)
        Apparent directions of the stars, unit vectors in the camera frame.
    R_cam : ndarray, shape (3, 3)
        ENU to camera.
    latitude_deg : float
        Latitude of the observer.
    lens : Projection
        Lens that the solver receives where there is no fault.
    half_diagonal_px : float
        Half of the frame's diagonal.
    """

    rays: F8
    R_cam: F8
    latitude_deg: float
    lens: Projection
    half_diagonal_px: float

    @cached_property
    def from_centre(self) -> F8:
        """Positions of the stars in the declared camera relative to its principal point, px, shape (n, 2)."""
        return project(self.rays, self.lens) - [self.lens.cx_px, self.lens.cy_px]

    @cached_property
    def by_direction(self) -> F8:
        """Derivatives of these positions with respect to the components of the stars' directions, shape (n, 2, 3)."""
        return derivatives(self.rays, self.lens)


@dataclass(frozen=True, eq=False)
class Misfit:
    """A fault as it enters the solver's least squares.

    Attributes
    ----------
    shift_px : ndarray, shape (n, 2)
        Contribution to observed minus predicted positions.
    turn_rad : ndarray, shape (3,)
        Rotation of the sky relative to the horizon (east, north, up) that leaves no residual.
    """

    shift_px: F8
    turn_rad: F8 = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Estimator:
    """The least squares of a solver.

    Attributes
    ----------
    horizon : str
        The part of the attitude that it receives.
    weights : str
        Whether errors count in pixels or in angle.
    free_sigmas : tuple of float
        Standard deviations, before the fit, of the camera's five corrections, in the order of `FREE`: of the logarithm of the
        focal length, of the principal point (px), and of the factors q of q (r/half diagonal)^2 and ^4; empty for none.
    noise_px : float
        Noise of a centroid along each axis; sets the weight of the priors.
    """

    horizon: Horizon = "whole attitude"
    weights: Weights = "pixel"
    free_sigmas: tuple[float, ...] = ()
    noise_px: float = 0.1


def turning_derivatives(view: View) -> F8:
    """Derivatives of positions with respect to rotations of the sky about the camera's axes, px/rad, shape (n, 2, 3).

    A rotation t moves a direction s by t x s.
    """
    return view.by_direction @ -_cross_matrices(view.rays)


def _cross_matrices(rays: F8) -> F8:
    """Matrices, shape (n, 3, 3), that map t to s x t for each direction s."""
    x, y, z = rays.T
    zero = np.zeros_like(x)
    return np.stack((np.stack((zero, -z, y), 1), np.stack((z, zero, -x), 1), np.stack((-y, x, zero), 1)), axis=1)


def camera_derivatives(view: View) -> F8:
    """Derivatives of positions with respect to the corrections in `FREE`, shape (n, 2, 5)."""
    place = view.from_centre
    q = (np.sum(place**2, axis=1) / view.half_diagonal_px**2)[:, None]
    across, down = np.zeros_like(place), np.zeros_like(place)
    across[:, 0], down[:, 1] = 1.0, 1.0
    return np.stack((place, across, down, q * place, q**2 * place), axis=2)


def position_bias_km(view: View, misfit: Misfit, estimator: Estimator) -> F8:
    """First-order error of a position, east and north, km, shape (2,).

    Parameters
    ----------
    view : View
    misfit : Misfit
        Misfit of the fault, or the sum over several.
    estimator : Estimator
        Estimator of the solver: least squares with Gaussian priors on the camera's corrections.
    """
    design = turning_derivatives(view) @ view.R_cam  # by rotations about east, north and up
    if estimator.free_sigmas:
        design = np.concatenate((design, camera_derivatives(view)), axis=2)
    to_weight = _to_angle(view) if estimator.weights == "angle" else np.broadcast_to(np.eye(2), (len(design), 2, 2))
    rows = (to_weight @ design).reshape(-1, design.shape[2])
    seen = (to_weight @ misfit.shift_px[:, :, None]).ravel()
    normal = rows.T @ rows
    free = np.arange(3, design.shape[2])
    normal[free, free] += (estimator.noise_px / np.array(estimator.free_sigmas)) ** 2
    turn = np.linalg.solve(normal, rows.T @ seen)[:3] + misfit.turn_rad
    moves = displacement_turns(view.latitude_deg)
    if estimator.horizon == "vertical alone":
        return np.asarray(np.linalg.solve(moves[:2], turn[:2]))
    information = np.linalg.inv(np.linalg.inv(normal)[:3, :3])
    return np.asarray(np.linalg.solve(moves.T @ information @ moves, moves.T @ information @ turn))


def _to_angle(view: View) -> F8:
    """Matrices, shape (n, 2, 2), that map a displacement in px to one in rad along two directions across the ray."""
    rays = view.rays
    # Any axis far from the ray gives a basis of the plane perpendicular to it.
    axis = np.eye(3)[np.argmin(np.abs(rays), axis=1)]
    one = np.cross(rays, axis)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    basis = np.stack((one, np.cross(rays, one)), axis=2)
    return np.linalg.inv(view.by_direction @ basis)


def focal_misfit(view: View, part: float) -> Misfit:
    """Declared focal length (1 + part) times the true one: observed minus predicted is -part x (position from the centre)."""
    return Misfit(-part * view.from_centre)


def centre_misfit(view: View, shift_px: F8) -> Misfit:
    """Declared principal point shifted by `shift_px`, shape (2,): all positions are shifted by its negative."""
    return Misfit(np.broadcast_to(-shift_px, (len(view.rays), 2)))


def k1_misfit(view: View, k1: float) -> Misfit:
    """A first radial coefficient that is `k1` too large: predicted positions move outward by k1 x (argument)^2 x position.

    The argument is the tangent of the angle off the axis for perspective lenses, the angle for fisheyes.
    """
    bent = with_k1(view.lens, k1)
    if bent is None:
        raise ValueError(f"{view.lens.model} has no k1")
    return Misfit(project(view.rays, view.lens) - project(view.rays, bent))


def projection_misfit(view: View) -> Misfit:
    """A stereographic lens declared as pinhole.

    Observed is 2 f tan(theta/2), predicted f tan(theta), theta off the axis: to the third order they differ by -f theta^3/4.
    """
    return Misfit(project(view.rays, replace(view.lens, model="stereographic")) - project(view.rays, view.lens))


def attitude_misfit(view: View, turn_rad: F8) -> Misfit:
    """Declared R_cam rotated by `turn_rad` (about east, north, up) before it; the sky seems rotated by the inverse."""
    return Misfit(np.zeros((len(view.rays), 2)), -np.asarray(turn_rad, dtype=np.float64))


def clock_misfit(view: View, late_s: float) -> Misfit:
    """A declared time later than the true one: the sky is expected to have rotated further about the Earth's axis.

    The rotation is the Earth's rate times the delay, about (0, cos, sin) of the latitude: the position moves west by 464 m x
    cos(latitude) per second.
    """
    latitude = math.radians(view.latitude_deg)
    axis = np.array([0.0, math.cos(latitude), math.sin(latitude)])
    return Misfit(np.zeros((len(view.rays), 2)), ROTATION_RAD_S * late_s * axis)


def refraction_misfit(view: View, pressure_hpa: float, temperature_c: float) -> Misfit:
    """Air declared absent: stars are higher than predicted, by the refraction.

    The refraction at apparent altitude h, in arc minutes, is cot(h + 7.31/(h + 4.4)), with h in degrees, at 1010 hPa and 10
    deg C, and proportional to pressure over absolute temperature (Bennett 1982, Journal of Navigation 35, 255).
    """
    zenith = view.R_cam[:, 2]
    sine = view.rays @ zenith
    altitude_deg = np.degrees(np.arcsin(np.clip(sine, -1, 1)))
    arcmin = 1 / np.tan(np.radians(altitude_deg + 7.31 / (altitude_deg + 4.4)))
    angle = np.radians(arcmin / 60) * pressure_hpa / 1010 * 283 / (273 + temperature_c)
    # Each star is rotated upwards about the horizontal axis perpendicular to its vertical circle.
    axis = np.cross(view.rays, zenith)
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12)
    return Misfit(np.einsum("nij,nj->ni", turning_derivatives(view), axis * angle[:, None]))


def epoch_misfit(view: View, pole: F8, declared_pole: F8, local_angle_rad: float) -> Misfit:
    """A declared date with another celestial pole, at the same Earth rotation angle.

    Between two dates the celestial intermediate system rotates by the difference (dX, dY) of the pole's coordinates, that is,
    by (dY, -dX, 0) about the axes from which the Earth rotation angle is counted (X grows by 20.04 arcsec per year). Proper
    motion, which differs from star to star, is neglected.

    Parameters
    ----------
    view : View
    pole, declared_pole : ndarray, shape (2,)
        X and Y of the celestial intermediate pole, rad, at the true and at the declared date.
    local_angle_rad : float
        Earth rotation angle plus longitude.
    """
    dx, dy = np.asarray(declared_pole) - np.asarray(pole)
    sky_turn = np.array([dy, -dx, 0.0])
    latitude = math.radians(view.latitude_deg)
    c, s = math.cos(local_angle_rad), math.sin(local_angle_rad)
    to_enu = np.array(
        [
            [-s, c, 0.0],
            [-math.sin(latitude) * c, -math.sin(latitude) * s, math.cos(latitude)],
            [math.cos(latitude) * c, math.cos(latitude) * s, math.sin(latitude)],
        ]
    )
    # The predicted sky is rotated by this; the observed one seems rotated by the inverse.
    return Misfit(np.zeros((len(view.rays), 2)), -to_enu @ sky_turn)
