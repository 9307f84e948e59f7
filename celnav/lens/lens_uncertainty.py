"""Uncertainty of a calibrated lens, and the attitude that was calibrated with it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.checking import real_array, shown
from celnav.errors import CameraError

_PARAMETER = re.compile(r"f_px|fy_px|cx_px|cy_px|k[1-6]|p[12]|s[1-4]|tau_[xy]_rad")
_ATTITUDE_KEYS = {"R_cam": "R_cam", "turn_by_lens_rad": "turn_by_lens", "star_cells_px": "star_cells"}
_MOST_CELLS = 1000
_LARGEST_COEFFICIENT = 1e9


@dataclass(frozen=True)
class LensUncertainty:
    """Uncertainty of a calibrated lens.

    Attributes
    ----------
    names : tuple of str
        Names of the parameters: ``f_px`` (for both axes unless ``fy_px`` is among them), ``cx_px``, ``cy_px``, ``k1``...,
        ``p1``, ``p2``, ``s1``..., ``tau_x_rad``, ``tau_y_rad``.
    rows : tuple of tuple of float
        Covariance of the parameters, with the attitudes of the calibration's frames free.
    R_cam : tuple of tuple of float
        The attitude that was calibrated with the lens (east-north-up to camera), whose errors are correlated with those of
        the lens; empty if there is none.
    turn_by_lens : tuple of tuple of float
        Rotation of that attitude in the camera frame per unit of each parameter, radians; three rows.
    star_cells : tuple of tuple of float
        u, v (px) and information (px^-2) of the calibration's stars, averaged over cells of the frame. Residuals of the
        lens form there have rotated the attitude too.

    Raises
    ------
    CameraError
        When a name is unknown, or the matrix is not a covariance of as many parameters.
    """

    names: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]
    R_cam: tuple[tuple[float, ...], ...] = ()
    turn_by_lens: tuple[tuple[float, ...], ...] = ()
    star_cells: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if unknown := [name for name in self.names if not _PARAMETER.fullmatch(name)]:
            raise CameraError(f"camera uncertainty: parameter {shown(unknown[0])} is not known")
        cov = real_array(self.rows, "camera uncertainty: covariance", CameraError)
        if len(set(self.names)) < len(self.names) or cov.shape != (len(self.names), len(self.names)):
            raise CameraError(f"camera uncertainty: covariance of shape {cov.shape} of {len(self.names)} parameters")
        if not (np.abs(cov) <= _LARGEST_COEFFICIENT**2).all() or (np.diag(cov) < 0).any():
            raise CameraError("camera uncertainty: covariance must hold finite numbers, and variances on its diagonal")
        scale = 1 / np.sqrt(np.where(np.diag(cov) > 0, np.diag(cov), 1.0))
        scaled = cov * scale[:, None] * scale
        if not np.allclose(scaled, scaled.T, rtol=0, atol=1e-6) or np.linalg.eigvalsh(scaled)[0] < -1e-6:
            raise CameraError(
                "camera uncertainty: covariance must be symmetric, and no combination of parameters negative"
            )
        object.__setattr__(self, "rows", tuple(tuple(row) for row in cov.tolist()))
        if len(self.R_cam) or len(self.turn_by_lens) or len(self.star_cells):
            shapes = {"R_cam": (3, 3), "turn_by_lens": (3, len(self.names)), "star_cells": (len(self.star_cells), 3)}
            for name, shape in shapes.items():
                array = real_array(getattr(self, name), f"camera uncertainty: {name}", CameraError)
                if (
                    array.shape != shape
                    or not (np.abs(array) <= _LARGEST_COEFFICIENT).all()
                    or len(array) > _MOST_CELLS
                ):
                    raise CameraError(
                        f"camera uncertainty: {name} of shape {array.shape} must be {shape}, of finite numbers"
                    )
                object.__setattr__(self, name, tuple(tuple(row) for row in array.tolist()))

    @property
    def cov(self) -> NDArray[np.float64]:
        """The covariance, shape (m, m)."""
        return np.array(self.rows)

    @classmethod
    def from_dict(cls, record: object) -> LensUncertainty:
        """Make one from the keys ``parameters`` and ``covariance``."""
        if not isinstance(record, Mapping) or not {"parameters", "covariance"} <= record.keys():
            raise CameraError("camera uncertainty must hold parameters and covariance")
        names = record["parameters"]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise CameraError("camera uncertainty: parameters must be a list of names")
        attitude = record.get("attitude")
        if attitude is None:
            return cls(tuple(names), record["covariance"])
        if not isinstance(attitude, Mapping) or not _ATTITUDE_KEYS.keys() <= attitude.keys():
            raise CameraError(f"camera uncertainty: attitude must hold {', '.join(_ATTITUDE_KEYS)}")
        values = {name: attitude[key] for key, name in _ATTITUDE_KEYS.items()}
        return cls(tuple(names), record["covariance"], **values)

    def to_dict(self) -> dict[str, Any]:
        """Return the mapping that `from_dict` reads."""
        content: dict[str, Any] = {"parameters": list(self.names), "covariance": [list(row) for row in self.rows]}
        if self.R_cam:
            content["attitude"] = {
                key: [list(row) for row in getattr(self, name)] for key, name in _ATTITUDE_KEYS.items()
            }
        return content
