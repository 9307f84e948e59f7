"""False-alarm bound for a few stars that agree in position and in brightness.

If clouds, twilight or a bright sky leave only a handful of stars, these are among the brightest of their field, and a single
zero point converts all their fluxes to magnitudes. A detection can then agree by chance only with the few stars of its own
magnitude, and faint false detections with none. Missing stars cost nothing, however bright the limiting magnitude is.

For a given orientation, zero point and radius, the set of stars that each detection may be is fixed. Randomly placed
detections then agree independently of one another, each with the probability that such a star is within the radius. The
probability of k or more agreements is at most the k-th elementary symmetric polynomial of these probabilities (Boole's
inequality over all sets of k). It is multiplied by a union bound over the zero points, widths and radii tried, and over the
orientations that remain possible, in steps as in `verification`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.identification.pairing import candidate_pairs, first_of_each, mutual_nearest, nowhere_far_off
from celnav.identification.search import enu_rotations
from celnav.identification.sky_index import F4, F8
from celnav.identification.verification import (
    FOCAL_STEP,
    TURN_STEP,
    Alignment,
    Region,
    log10_focal_shell,
    rotation_of,
    turning_derivatives,
)

# Largest differences, to either side, between the magnitudes of a detection and its star, which are due to colours,
# extinction, vignetting and saturation. They are also the steps in which zero points are tried.
WIDTHS_MAG = (0.5, 1.0)
RADII_PX = (2.4, 1.2, 0.6, 0.3)
# Fewer agreements prove nothing; more agreements, or frames with more detections, do not need this kind of evidence.
FEWEST_AGREEING, MOST_AGREEING, MOST_DETECTIONS = 3, 24, 60
# Fraction of the allowed false alarms that is assigned to this test.
SHARE = 0.25
# Radius around a detection in which stars are counted for their local density, excluding those at the detection itself.
_AROUND_PX = 80.0
# Radii, in turn, within which stars and detections are matched while the orientation is fitted to them.
_FIT_RADII_PX = (4.0, 2.0, 2.0)


@dataclass(frozen=True, eq=False)
class ToldOrientation:
    """The orientations that an exact attitude relative to the horizon allows: one for each position.

    Attributes
    ----------
    local : ndarray, shape (3, 3)
        East-north-up to camera.
    to_terrestrial : ndarray, shape (3, 3)
        Celestial to terrestrial frame.
    """

    local: F8
    to_terrestrial: F8

    def nearest(self, rotation: F8) -> F8:
        """Return the allowed orientation, sky to camera, that has the same zenith as another one, shape (3, 3)."""
        x, y, z = (self.to_terrestrial @ rotation.T @ self.local[:, 2]).tolist()
        lat, lon = math.atan2(z, math.hypot(x, y)), math.atan2(y, x)
        return np.asarray(self.local @ enu_rotations(np.array([lat]), np.array([lon]))[0] @ self.to_terrestrial)

    def fitted(self, camera: Camera, uv: F8, xyz: F8, rotation: F8) -> F8:
        """Return the allowed orientation near `rotation` that best fits the stars `xyz` (n, 3) to the detections; (3, 3)."""
        rotation = self.nearest(rotation)
        for radius in _FIT_RADII_PX:
            dirs = xyz @ rotation.T
            predicted, by_direction = camera.project_with_derivatives(dirs)
            seen, star = mutual_nearest(uv, nowhere_far_off(predicted), radius)
            if len(seen) < 2:
                return rotation
            # A rotation about east moves the position north; one about the Earth's axis moves it east.
            axes = np.column_stack((self.local[:, 0], rotation @ self.to_terrestrial[2]))
            design = turning_derivatives(dirs[star], by_direction[star]) @ axes
            residual = uv[seen] - predicted[star]
            scale = max(float(np.median(np.abs(residual))), 0.1)
            weight = 1.0 / (1.0 + np.einsum("ni,ni->n", residual, residual) / (3 * scale) ** 2)
            weighted = (design * weight[:, None, None]).reshape(-1, 2)
            normal = weighted.T @ design.reshape(-1, 2)
            step = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(2), weighted.T @ residual.ravel())
            rotation = self.nearest(rotation_of(axes @ step) @ rotation)
        return rotation


@dataclass(frozen=True, eq=False)
class Sparse:
    """Test of an orientation that explains a few stars in a frame with few detections.

    Attributes
    ----------
    seen_mag : ndarray, shape (m,)
        Magnitudes of the detections up to a common zero point; NaN where unknown.
    star_mag : ndarray, shape (n,)
        Magnitudes of the stars.
    area_px : float
        Area of the frame that shows the sky.
    told : ToldOrientation or None
        The allowed orientations if an exact attitude is supplied.
    """

    seen_mag: F8
    star_mag: F4
    area_px: float
    told: ToldOrientation | None

    def judged(
        self, found: Alignment, camera: Camera, uv: F8, xyz: F8, region: Region, finest_rad: float, searches: int
    ) -> Alignment:
        """Return the hypothesis with the smaller of its own false-alarm bound and the one that uses brightness.

        Parameters
        ----------
        found : Alignment
            Result of `verification.verify`.
        camera : Camera
            The camera.
        uv : ndarray, shape (m, 2)
            Detections with refraction removed.
        xyz : ndarray, shape (n, 3)
            Stars of the sky that may be seen.
        region : Region
            Orientations among which the hypothesis was searched for.
        finest_rad : float
            Smallest pixel scale among the detections.
        searches : int
            Number of searches that share the allowed false alarms.
        """
        own = replace(found, log10_false_alarm=min(0.0, found.log10_false_alarm - math.log10(1 - SHARE)))
        if not FEWEST_AGREEING <= len(found.detection) <= MOST_AGREEING:
            return own
        other = self._as_told(found, camera, uv, xyz)
        agreeing = self._agreeing(other, camera, uv, xyz)
        bounds = [
            chance
            + region.log10_steps(TURN_STEP * radius * finest_rad)
            + (0.0 if self.told is not None else log10_focal_shell(camera, other.log_f, radius))
            for radius, chance in agreeing.items()
        ]
        bound = min(bounds, default=0.0) + math.log10(searches / SHARE)
        if bound >= own.log10_false_alarm:
            return own
        return replace(other, log10_false_alarm=bound)

    def _as_told(self, found: Alignment, camera: Camera, uv: F8, xyz: F8) -> Alignment:
        """Return the hypothesis adapted to an exactly known attitude and the camera as supplied."""
        if self.told is None:
            return found
        rotation = self.told.fitted(camera, uv, xyz, found.rotation)
        predicted = nowhere_far_off(camera.project(xyz @ rotation.T))
        seen, star = mutual_nearest(uv, predicted, RADII_PX[0])
        sigma = found.sigma_px
        if len(seen) > 1:
            # Two parameters are fitted.
            fitted = math.sqrt(len(seen) / (len(seen) - 1))
            sigma = fitted * 1.4826 * float(np.median(np.abs(uv[seen] - predicted[star])))
        return Alignment(rotation, 0.0, seen, star, sigma, 0.0)

    def _agreeing(self, found: Alignment, camera: Camera, uv: F8, xyz: F8) -> dict[float, float]:
        """Bound the probability that randomly placed detections agree as well under an orientation."""
        centre = np.array([camera.cx_px, camera.cy_px])
        predicted = centre + math.exp(found.log_f) * (camera.project(xyz @ found.rotation.T) - centre)
        rows = np.flatnonzero(camera.in_frame(predicted, RADII_PX[0]))
        spread = 1 + TURN_STEP + (0.0 if self.told is not None else FOCAL_STEP)
        return log10_agreeing(self.seen_mag, self.star_mag[rows], uv, predicted[rows], self.area_px, spread)


def log10_symmetric(chances: F8, k: int) -> float:
    """Return the decimal logarithm of the k-th elementary symmetric polynomial of some numbers, at most 0.

    It bounds the probability that k or more of m independent events with these probabilities, shape (m,), happen.
    """
    if k <= 0:
        return 0.0
    possible = chances[chances > 0]
    if k > len(possible):
        return -math.inf
    scale = float(possible.max())
    sums = np.zeros(k + 1)
    sums[0] = 1.0
    for chance in (possible / scale).tolist():
        sums[1:] += chance * sums[:-1]
    return min(0.0, math.log10(sums[k]) + k * math.log10(scale))


def log10_agreeing(
    seen_mag: F8, star_mag: NDArray[np.floating], uv: F8, predicted: F8, area_px: float, spread: float
) -> dict[float, float]:
    """Bound, for each radius, the probability that randomly placed detections agree as well in position and brightness.

    Parameters
    ----------
    seen_mag, star_mag : ndarray, shapes (m,), (n,)
        Magnitudes of the detections, NaN where unknown, and of the stars.
    uv, predicted : ndarray, shapes (m, 2), (n, 2)
        Detections, and predicted positions of the stars.
    area_px : float
        Area of the frame that shows the sky.
    spread : float
        Factor on each radius for chance agreements, which allows for orientations between the steps.

    Returns
    -------
    dict
        For each radius, pixels, the decimal logarithm of the bound, including the choice of zero point, width and radius.
    """
    seen, star, distance = candidate_pairs(uv, predicted, RADII_PX[0])
    offset = star_mag[None].astype(np.float64) - seen_mag[:, None]
    zero = offset[seen, star]
    best = dict.fromkeys(RADII_PX, 0.0)
    if np.isfinite(zero).sum() < FEWEST_AGREEING:
        return best
    separation = np.hypot(uv[:, None, 0] - predicted[None, :, 0], uv[:, None, 1] - predicted[None, :, 1])
    around = (separation > 3 * RADII_PX[0]) & (separation <= _AROUND_PX)
    for width in WIDTHS_MAG:
        numbers = np.round(np.nanmax(offset) / width) - np.round(np.nanmin(offset) / width) + 1
        log10_tried = math.log10(float(numbers) * len(WIDTHS_MAG) * len(RADII_PX))
        for number in np.unique(np.round(zero[np.isfinite(zero)] / width)):
            able = np.abs(offset - number * width) <= width
            density = np.maximum(
                np.count_nonzero(able, axis=1) / area_px,
                np.count_nonzero(able & around, axis=1) / (math.pi * _AROUND_PX**2),
            )
            agree = able[seen, star]
            for radius in RADII_PX:
                chosen = np.flatnonzero(agree & (distance <= radius))
                # No detection and no star counts twice.
                k = min(len(first_of_each(seen[chosen])), len(first_of_each(star[chosen])))
                if k >= FEWEST_AGREEING:
                    chances = -np.expm1(-math.pi * (spread * radius) ** 2 * density)
                    best[radius] = min(best[radius], log10_symmetric(chances, k) + log10_tried)
    return best
