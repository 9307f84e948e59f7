"""The parameters of a lens projection, and the distance from the axis up to which it is valid.

Models: OpenCV's pinhole with rational and tangential distortion (Brown 1966, Photogrammetric Engineering 32, 444),
Kannala & Brandt 2006 (IEEE TPAMI 28, 1335) as in cv2.fisheye, and the ideal fisheye projections r = f g(theta) with g =
theta, 2 sin(theta/2), 2 tan(theta/2), sin(theta) (Schneider, Schwalbe & Maas 2009, ISPRS J. 64, 259). Decentring, thin
prism and tilt of the sensor are those of :mod:`generator.scenario.lens.image_plane`, for every model. The mapping
itself is in :mod:`generator.plugins.lens`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from generator.scenario.lens.image_plane import displacement, displacement_slopes, through, tilt_matrix

LensModel = Literal[
    "pinhole",
    "brown_conrady",
    "kannala_brandt",
    "equidistant",
    "equisolid",
    "stereographic",
    "orthographic",
]
MODELS: tuple[LensModel, ...] = get_args(LensModel)
COEFFICIENTS = {"brown_conrady": 6, "kannala_brandt": 4}
"""Number of radial coefficients of the models that have any; p1, p2, s1..s4 and the tilt belong to all models."""
PINHOLE_LIKE = ("pinhole", "brown_conrady")
LARGEST_TILT_RAD = 0.5
LARGEST_COEFFICIENT = 1e9
"""Largest value of k, p and s: far beyond any lens, but with powers within the range of a float."""
LARGEST_RADIUS = 1e3
"""Tangent of the widest angle (89.94 deg) at which pinhole-like models are used."""
LARGEST_THETA = {
    "kannala_brandt": math.pi,
    "equidistant": math.pi,
    "equisolid": math.pi,
    "stereographic": math.radians(178.0),
    "orthographic": math.radians(89.9),
}

ANGLE_STEPS = 1001
AROUND: NDArray[np.float64] = np.linspace(0, 2 * np.pi, 72, endpoint=False)[:, None]
"""Directions around the axis at which a lens without symmetry is examined."""
BETWEEN = 0.998
"""Lower bound of the distance from the axis between two such directions relative to that at them: below cos(2.5 deg)."""


class ProjectionError(ValueError):
    """The coefficients do not make a usable lens."""


@dataclass(frozen=True)
class Projection:
    """A projection: pixel centres at integers, u right, v down; camera frame x right, y down, z along the boresight.

    Attributes
    ----------
    model : str
        One of MODELS.
    f_px, fy_px, cx_px, cy_px : float
    k : tuple of float
        brown_conrady: k1..k6 of OpenCV's rational model; kannala_brandt: k1..k4 of cv2.fisheye. Missing ones are 0.
    p, s, tilt_rad : tuple of float
        Of any model: p1, p2; s1..s4; tau_x, tau_y. Missing ones are 0.
    """

    model: str
    f_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k: tuple[float, ...] = ()
    p: tuple[float, ...] = ()
    s: tuple[float, ...] = ()
    tilt_rad: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        most_k = COEFFICIENTS.get(self.model, 0)
        for name, given, most in (
            ("k", self.k, most_k),
            ("p", self.p, 2),
            ("s", self.s, 4),
            ("tilt_rad", self.tilt_rad, 2),
        ):
            if len(given) > most:
                raise ProjectionError(f"{name}: found {len(given)} numbers, expected at most {most} for {self.model}")
            if any(abs(coefficient) > LARGEST_COEFFICIENT for coefficient in given):
                raise ProjectionError(
                    f"{name}: found {list(given)}, expected -{LARGEST_COEFFICIENT:g} to {LARGEST_COEFFICIENT:g}"
                )
        if any(abs(angle) > LARGEST_TILT_RAD for angle in self.tilt_rad):
            raise ProjectionError(
                f"tilt_rad: found {list(self.tilt_rad)}, expected -{LARGEST_TILT_RAD} to {LARGEST_TILT_RAD}"
            )

    @property
    def full_k(self) -> tuple[float, ...]:
        """All radial coefficients of the model, zeros filled in."""
        return self.k + (0.0,) * (COEFFICIENTS.get(self.model, 0) - len(self.k))

    @property
    def full_p(self) -> tuple[float, ...]:
        """p1 and p2, with zeros filled in, if any is given and always for brown_conrady; otherwise empty."""
        return _filled(self.p, 2) if self.p or self.model == "brown_conrady" else ()

    @property
    def full_s(self) -> tuple[float, ...]:
        """s1..s4, with zeros filled in, if any is given; otherwise empty."""
        return _filled(self.s, 4) if self.s else ()

    @property
    def full_tilt_rad(self) -> tuple[float, ...]:
        """tau_x and tau_y, with zeros filled in, if any is given; otherwise empty."""
        return _filled(self.tilt_rad, 2) if self.tilt_rad else ()

    @property
    def centred(self) -> bool:
        """Whether the lens is symmetrical around its axis: no decentring, no thin prism, no tilt."""
        return not (any(self.p) or any(self.s) or any(self.tilt_rad))

    @property
    def limit(self) -> float:
        """Largest argument for which the radial mapping increases: tan(theta) for brown_conrady, theta (rad) else."""
        if self.model == "pinhole":
            return LARGEST_RADIUS
        if self.model == "brown_conrady":
            radii = np.tan(np.linspace(0, math.atan(LARGEST_RADIUS), 40001))
            return _monotonic_limit(self._rational_slope(radii), radii)
        if self.model == "kannala_brandt":
            thetas = np.linspace(0, LARGEST_THETA["kannala_brandt"], 40001)
            return _monotonic_limit(self._polynomial_slope(thetas), thetas)
        return LARGEST_THETA[self.model]

    def _rational_slope(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        k1, k2, k3, k4, k5, k6 = self.full_k
        q = r * r
        above, below = 1 + q * (k1 + q * (k2 + q * k3)), 1 + q * (k4 + q * (k5 + q * k6))
        above_slope, below_slope = k1 + q * (2 * k2 + q * 3 * k3), k4 + q * (2 * k5 + q * 3 * k6)
        slope = above / below + 2 * q * (above_slope * below - above * below_slope) / below**2
        return np.where(np.minimum.accumulate(below) > 1e-6, slope, -1.0)

    def _polynomial_slope(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        k1, k2, k3, k4 = self.full_k
        q = theta * theta
        return 1 + q * (3 * k1 + q * (5 * k2 + q * (7 * k3 + q * 9 * k4)))

    def radius(self, argument: float) -> float:
        """Distance from the principal point over the focal length, at tan(theta) (pinhole-like) or theta (rad)."""
        if self.model == "pinhole":
            return argument
        if self.model == "brown_conrady":
            k1, k2, k3, k4, k5, k6 = self.full_k
            q = argument**2
            return argument * (1 + q * (k1 + q * (k2 + q * k3))) / (1 + q * (k4 + q * (k5 + q * k6)))
        if self.model == "kannala_brandt":
            k1, k2, k3, k4 = self.full_k
            q = argument**2
            return argument * (1 + q * (k1 + q * (k2 + q * (k3 + q * k4))))
        half = argument / 2
        ideal = {
            "equidistant": argument,
            "equisolid": 2 * math.sin(half),
            "stereographic": 2 * math.tan(half),
            "orthographic": math.sin(argument),
        }
        return ideal[self.model]

    @property
    def largest_radius(self) -> float:
        """Distance from the principal point over the focal length at the end of the valid range."""
        return self.radius(self.limit)

    def corner_px(self, width: int, height: int) -> float:
        """Distance of the frame's furthest corner from the principal point, px."""
        across = max(self.cx_px + 0.5, width - 0.5 - self.cx_px)
        down = max(self.cy_px + 0.5, height - 0.5 - self.cy_px)
        return math.hypot(across, down)

    def axis_angle_deg(self, radius: float) -> float:
        """Angle from the axis, deg, at a distance from the principal point over the focal length; no tangential terms."""
        return float(self.axis_angles_deg(np.array([radius]))[0])

    def axis_angles_deg(self, radii: NDArray[np.float64]) -> NDArray[np.float64]:
        """Angles from the axis, deg, at n distances from the principal point over the focal length, (n,) array."""
        theta, argument = self._angles()
        return np.asarray(np.degrees(np.interp(radii, [self.radius(value) for value in argument], theta)))

    def angle_deg(self, distance_px: float) -> float:
        """Angle from the axis, deg, beyond which no light falls within a distance, px, from the principal point."""
        wanted = distance_px / min(self.f_px, self.fy_px)
        theta, argument = self._angles()
        reached = np.array([self.radius(value) for value in argument])
        if not self.centred:
            a, b, orderly = self._bent(argument, reached)
            # Nothing is drawn where the image is folded.
            reached = BETWEEN * np.where(orderly, np.hypot(a, b), np.inf).min(axis=0)
        last = int(np.flatnonzero(reached <= wanted)[-1])
        return float(np.degrees(theta[min(last + 1, len(theta) - 1)]))

    def _bent(
        self, argument: NDArray[np.float64], reached: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return normalised coordinates with decentring and tilt around the axis, (72, n), at n radial arguments.

        The third array states whether the mapping keeps its orientation there; `argument` holds arguments of the radial
        mapping, `reached` their radii.
        """
        p, s = _filled(self.p, 2), self.full_s
        over = argument if self.model in PINHOLE_LIKE else reached
        x, y = over * np.cos(AROUND), over * np.sin(AROUND)
        move_a, move_b = displacement(x, y, p, s)
        aa, ab, ba, bb = displacement_slopes(x, y, p, s)
        a, b = reached * np.cos(AROUND) + move_a, reached * np.sin(AROUND) + move_b
        along, around = self._stretch(argument, reached)
        # Derivatives of the radial mapping itself, rotated to each direction.
        cosine, sine = np.cos(AROUND), np.sin(AROUND)
        aa = aa + along * cosine**2 + around * sine**2
        bb = bb + along * sine**2 + around * cosine**2
        mixed = (along - around) * cosine * sine
        orderly = aa * bb - (ab + mixed) * (ba + mixed) > 0
        if any(self.tilt_rad):
            a, b, ahead = through(tilt_matrix(*self.full_tilt_rad).tolist(), a, b)
            orderly &= ahead > 0
        return a, b, orderly

    def _stretch(
        self, argument: NDArray[np.float64], reached: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64] | float, NDArray[np.float64] | float]:
        """Factors along and across the radius from the coordinates before the radial mapping to the radially mapped ones."""
        if self.model != "brown_conrady":
            return 1.0, 1.0
        return self._rational_slope(argument), reached / np.maximum(argument, 1e-12) + (argument < 1e-12)

    def _angles(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Angles from the axis over the valid range, rad, and the arguments of the radial mapping there."""
        pinhole_like = self.model in PINHOLE_LIKE
        theta = np.linspace(0, math.atan(self.limit) if pinhole_like else self.limit, ANGLE_STEPS)
        return theta, np.tan(theta) if pinhole_like else theta

    def check_frame(self, width: int, height: int, image_circle_px: float | None) -> None:
        """Refuse distortion that stops increasing inside the frame (or inside the image circle, when there is one).

        The image of an ideal fisheye ends where its sky ends; outside the frame is black. Raises ProjectionError.
        """
        if self.model not in COEFFICIENTS and self.centred:
            return
        across = max(self.cx_px + 0.5, width - 0.5 - self.cx_px) / self.f_px
        down = max(self.cy_px + 0.5, height - 0.5 - self.cy_px) / self.fy_px
        needed = math.hypot(across, down)
        if image_circle_px is not None:
            needed = min(needed, image_circle_px / min(self.f_px, self.fy_px))
        if self.model in COEFFICIENTS:
            self._check_growth(needed)
        if any(self.s) or any(self.tilt_rad) or (any(self.p) and self.model != "brown_conrady"):
            self._check_orientation(needed)

    def _check_growth(self, needed: float) -> None:
        full_turn = self.model == "kannala_brandt" and self.limit >= LARGEST_THETA["kannala_brandt"] - 1e-9
        reach = self.largest_radius
        if reach < needed and not full_turn:
            raise ProjectionError(
                f"k: the distortion stops increasing at {reach * self.f_px:.1f} px from the principal point, "
                f"inside the frame, which reaches {needed * self.f_px:.1f} px; correct k, or set image_circle_px below it"
            )

    def _check_orientation(self, needed: float) -> None:
        _, argument = self._angles()
        reached = np.array([self.radius(value) for value in argument])
        a, b, orderly = self._bent(argument, reached)
        folded = ~orderly & ((np.hypot(a, b) < needed) | (reached < needed))
        if folded.any():
            least = float(reached[np.flatnonzero(folded.any(axis=0))[0]])
            raise ProjectionError(
                f"p, s, tilt_rad: the image folds over {least * self.f_px:.1f} px from the principal point, inside the "
                f"frame, which reaches {needed * self.f_px:.1f} px; correct them, or set image_circle_px below it"
            )


def _filled(given: tuple[float, ...], count: int) -> tuple[float, ...]:
    """Return the coefficients, padded with zeros."""
    return given + (0.0,) * (count - len(given))


def _monotonic_limit(slope: NDArray[np.float64], grid: NDArray[np.float64]) -> float:
    """Last point of the grid up to which the slope stays positive."""
    positive = slope > 1e-6
    return float(grid[-1] if positive.all() else grid[max(int(np.argmin(positive)) - 1, 0)])
