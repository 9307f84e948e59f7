"""Decentring of a lens and tilt of its sensor, applied to normalised image coordinates after the radial mapping.

The terms are those of OpenCV's 12 and 14 coefficients (``cv::projectPoints``), for every lens model. With (a, b) the
coordinates that they take, q = a^2 + b^2, and (a', b') those they return:

    a' = a + 2 p1 a b + p2 (q + 2 a^2) + s1 q + s2 q^2
    b' = b + p1 (q + 2 b^2) + 2 p2 a b + s3 q + s4 q^2

Decentring p1, p2: Brown 1966, Photogrammetric Engineering 32, 444. Thin prism s1..s4: Weng, Cohen & Herniou 1992, IEEE TPAMI
14, 965. The sensor's tilt by tau_x about u and tau_y about v (Louhichi et al. 2007, Meas. Sci. Technol. 18, 2616) is the
homography (a'', b'', 1) ~ H (a', b', 1), H = [[R33, 0, -R13], [0, R33, -R23], [0, 0, 1]] R, R = R_y(tau_y) R_x(tau_x).

The pinhole models take the terms as functions of the undistorted coordinates x/z, y/z and add the displacement to the
radially distorted ones, as OpenCV does; the fisheyes take (a, b) = g(theta) (cos phi, sin phi) itself.

The functions use only arithmetic, so they work on arrays of both NumPy and Dr.Jit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def displacement(a: Any, b: Any, p: Sequence[Any], s: Sequence[Any]) -> tuple[Any, Any]:
    """Displacement (a' - a, b' - b) at normalised coordinates, by p1, p2 and s1..s4 (or no s)."""
    p1, p2 = p
    q = a * a + b * b
    along_a, along_b = 2 * p1 * a * b + p2 * (q + 2 * a * a), p1 * (q + 2 * b * b) + 2 * p2 * a * b
    if not len(s):
        return along_a, along_b
    s1, s2, s3, s4 = s
    return along_a + q * (s1 + s2 * q), along_b + q * (s3 + s4 * q)


def displacement_slopes(a: Any, b: Any, p: Sequence[Any], s: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
    """Derivatives of the displacement: of its first component with respect to a and b, then of its second."""
    p1, p2 = p
    across = 2 * p1 * a + 2 * p2 * b
    aa, bb = 2 * p1 * b + 6 * p2 * a, 6 * p1 * b + 2 * p2 * a
    if not len(s):
        return aa, across, across, bb
    s1, s2, s3, s4 = s
    q = a * a + b * b
    first, second = 2 * (s1 + 2 * s2 * q), 2 * (s3 + 2 * s4 * q)
    return aa + first * a, across + first * b, across + second * a, bb + second * b


def tilt_matrix(tau_x: float, tau_y: float) -> NDArray[np.float64]:
    """Homography H of a sensor tilted by angles, rad, (3, 3): ``cv::detail::computeTiltProjectionMatrix``."""
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, sx], [0.0, -sx, cx]])
    about_y = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]])
    turn = about_y @ about_x
    onto = np.array([[turn[2, 2], 0.0, -turn[0, 2]], [0.0, turn[2, 2], -turn[1, 2]], [0.0, 0.0, 1.0]])
    return np.asarray(onto @ turn)


def through(matrix: Sequence[Sequence[Any]], a: Any, b: Any) -> tuple[Any, Any, Any]:
    """Apply a homography to a point; returns the mapped point and the third coordinate, which is positive in front."""
    third = matrix[2][0] * a + matrix[2][1] * b + matrix[2][2]
    return (
        (matrix[0][0] * a + matrix[0][1] * b + matrix[0][2]) / third,
        (matrix[1][0] * a + matrix[1][1] * b + matrix[1][2]) / third,
        third,
    )
