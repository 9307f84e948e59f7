"""Propagation of the covariance of a calibrated lens to the camera's orientation.

An error of the lens rotates the orientation that the stars give. It also rotated the attitude that was calibrated with the
same lens, and by as much if the frame is like those of the calibration; only the difference enters the position. The
lens parameters are "considered", not estimated (Schmidt 1966, Advances in Control Systems 3, 293): what a single frame could
add to a calibration from many is neglected.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.lens.lens_uncertainty import LensUncertainty

F8 = NDArray[np.float64]

_STEPS = {"f_px": 1e-2, "fy_px": 1e-2, "cx_px": 1e-2, "cy_px": 1e-2}
_TERM_STEP = 1e-6


def lens_derivatives(camera: Camera, rays: F8, names: tuple[str, ...]) -> F8:
    """Derivatives, shape (n, 2, m), of the positions of camera-frame directions, shape (n, 3), by parameters of the lens.

    If ``fy_px`` is not among the names, ``f_px`` stands for both focal lengths.
    """
    columns = []
    for name in names:
        step = _STEPS.get(name, _TERM_STEP)
        ahead, behind = (_changed(camera, name, sign * step, "fy_px" in names).project(rays) for sign in (1, -1))
        columns.append((ahead - behind) / (2 * step))
    return np.nan_to_num(np.stack(columns, axis=2))


def _changed(camera: Camera, name: str, by: float, own_fy: bool) -> Camera:
    if name == "f_px" and not own_fy:
        return replace(camera, f_px=camera.f_px + by, fy_px=camera.fy_px + by)
    if name in _STEPS:
        return replace(camera, **{name: getattr(camera, name) + by})
    key, number = ("tilt_rad", "xy".index(name[4])) if name.startswith("tau_") else (name[0], int(name[1:]) - 1)
    values = [*getattr(camera, key), *[0.0] * 6][: max(len(getattr(camera, key)), number + 1)]
    values[number] += by
    changed: dict[str, Any] = {key: tuple(values)}
    return replace(camera, **changed)


def turn_by_lens(design: F8, by_lens: F8, precision: F8, held: F8) -> F8:
    """Rotation of the orientation that stars give per unit of each lens parameter, radians per unit, shape (3, m).

    Parameters
    ----------
    design : ndarray, shape (n, 2, 3 + k)
        Derivatives of the predictions by a rotation and by the fitted camera parameters.
    by_lens : ndarray, shape (n, 2, m)
        Derivatives by the parameters of the lens.
    precision : ndarray, shape (n,)
        Inverse variances of the stars.
    held : ndarray, shape (3 + k,)
        Inverse variances of the priors of the fitted parameters.
    """
    numbers = 2 * len(design)
    weighted = (design * precision[:, None, None]).reshape(numbers, -1)
    normal = weighted.T @ design.reshape(weighted.shape) + np.diag(held)
    return np.asarray(-np.linalg.solve(normal, weighted.T @ by_lens.reshape(numbers, -1))[:3])


def lens_covariance(uncertainty: LensUncertainty, turn: F8, attitude_turn: F8 | None) -> F8:
    """Covariance of the orientation due to errors of the lens, shape (3, 3), rad^2.

    Parameters
    ----------
    uncertainty : LensUncertainty
        Uncertainty of the calibrated lens.
    turn : ndarray, shape (3, m)
        Rotation of the orientation that the stars give, per unit of each parameter (`turn_by_lens`).
    attitude_turn : ndarray, shape (3, m), or None
        The same for the attitude that it is compared with; None if that was not calibrated with this lens.
    """
    apart = turn if attitude_turn is None else turn - attitude_turn
    return np.asarray(apart @ uncertainty.cov @ apart.T)
