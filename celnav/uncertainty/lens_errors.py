"""From the covariance of a calibrated lens to that of the camera's orientation.

An error of the lens turns the orientation that the stars give. The attitude that was calibrated with the same lens is turned
too, and of a frame like those of the calibration by as much: only the difference enters the position. Parameters of the
lens are considered, not estimated (Schmidt 1966, Advances in Control Systems 3, 293): what one frame could add to the
calibration of many is left out.
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
    """Derivatives of the positions of directions in the camera frame, shape (n, 3), by parameters of the lens: (n, 2, m).

    Without ``fy_px`` among the names both focal lengths are ``f_px``.
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
    """How the orientation that stars give turns with the parameters of the lens, radians per unit, shape (3, m).

    Parameters
    ----------
    design : ndarray, shape (n, 2, 3 + k)
        Derivatives of the predictions by a turn, and by what was fitted of the camera.
    by_lens : ndarray, shape (n, 2, m)
        By the parameters of the lens.
    precision : ndarray, shape (n,)
        Inverse variances of the stars.
    held : ndarray, shape (3 + k,)
        Inverse variances that hold parameters.
    """
    numbers = 2 * len(design)
    weighted = (design * precision[:, None, None]).reshape(numbers, -1)
    normal = weighted.T @ design.reshape(weighted.shape) + np.diag(held)
    return np.asarray(-np.linalg.solve(normal, weighted.T @ by_lens.reshape(numbers, -1))[:3])


def lens_covariance(uncertainty: LensUncertainty, turn: F8, attitude_turn: F8 | None) -> F8:
    """Covariance of the orientation by the errors of the lens, (3, 3), rad^2.

    Parameters
    ----------
    uncertainty : LensUncertainty
        Of the calibration.
    turn : ndarray, shape (3, m)
        Of the orientation by the stars (`turn_by_lens`).
    attitude_turn : ndarray, shape (3, m), or None
        Of the attitude that it is compared with; None where that was not calibrated with this lens.
    """
    apart = turn if attitude_turn is None else turn - attitude_turn
    return np.asarray(apart @ uncertainty.cov @ apart.T)
