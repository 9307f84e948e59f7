"""Input and output of a matcher."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.fix import Reason
from celnav.matching.history import History


@dataclass(frozen=True, eq=False)
class Observation:
    """Detections and the camera that made them.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        Pixel positions.
    rays : ndarray, shape (n, 3)
        The positions as unit vectors in the camera frame.
    flux : ndarray, shape (n,), or None
        Brightness in any linear unit.
    camera : Camera
        The camera.
    sigma_px : ndarray, shape (n,), or None
        Standard deviation of each position along each axis; None if unknown.
    R_cam : ndarray, shape (3, 3), or None
        Rotation from ENU to camera, if known. Patterns do not need it; only rejection by the geometry of the fix does.
    streak_px : ndarray, shape (n, 2), or None
        Vector from one end of each detection's streak to the other, in either sense; 0 for a detection without a streak.
    sigma_across_px : ndarray, shape (n,), or None
        Standard deviation across the streak.
    """

    uv: NDArray[np.float64]
    rays: NDArray[np.float64]
    flux: NDArray[np.float64] | None
    camera: Camera
    sigma_px: NDArray[np.float64] | None = None
    R_cam: NDArray[np.float64] | None = None
    streak_px: NDArray[np.float64] | None = None
    sigma_across_px: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class Identification:
    """Detections identified as stars, or the reason why they are not.

    Attributes
    ----------
    reason : Reason
        `Reason.OK`, or the reason of the refusal.
    message : str
        The reason in words.
    matches : ndarray of int64, shape (m, 2)
        Index of the detection and star id of each match; the reference star, if the matcher has one, comes first.
    confidence : float
        0 to 1, as the matcher defines it.
    details : mapping
        Further diagnostics.
    """

    reason: Reason
    message: str = ""
    matches: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    confidence: float = 0.0
    details: Mapping[str, float | int | str] = field(default_factory=dict)


class Matcher(Protocol):
    """Identifies stars without knowledge of the camera's position or pointing."""

    def identify(self, observation: Observation, history: History | None = None) -> Identification:
        """Identify the stars; `history` is read and extended if the caller passes one, and only then."""
        ...
