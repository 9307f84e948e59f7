"""Verification of a hypothesis: predict the field, count agreements, and bound the probability of a chance agreement.

The probability that chance explains k agreements of m detections is a binomial tail, bounded by Chernoff's inequality
(Chernoff 1952, Ann. Math. Statist. 23, 493). It is multiplied by a union bound over the trials, in one of two ways, of which
the smaller counts. The first multiplies by the hypotheses and radii that were tried; then the stars that made the hypothesis
prove nothing. The second multiplies by the number of all orientations and focal lengths that remain possible, in steps so
small that each of them agrees, within a somewhat larger radius, with a step; then every star counts. The first is smaller if
there are many stars, the second if there are few or a last known position is given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from celnav.camera import Camera
from celnav.identification.pairing import candidate_pairs, mutual_nearest
from celnav.identification.sky_index import F8

CROWD_PX = 80.0
FOCAL_PRIOR = 0.03  # standard deviation of the logarithm of the focal length while hypotheses are verified
MOST_LOG_F = 0.12  # beyond it the search would have to start with another focal length
_RADII = (1.0, 0.6, 0.35)
# Steps that cover all orientations and focal lengths: largest shift of a position between a step and the values that it
# represents, in units of the agreement radius.
TURN_STEP, FOCAL_STEP = 0.5, 0.25
# Number of searches for one frame where the caller does not count them: three focal lengths; two orders of detections, or a
# second search of the whole sky; each with and without the supplied attitude.
SEARCHES = 12


@dataclass(frozen=True, eq=False)
class Alignment:
    """A hypothesis with the detections that it explains.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Sky to camera.
    log_f : float
        Natural logarithm of the factor on the camera's focal length.
    detection, star : ndarray, shape (m,)
        Pairs that agree: rows of the positions and of the stars.
    sigma_px : float
        Robust standard deviation of their residuals along each axis.
    log10_false_alarm : float
        Decimal logarithm of the bound on the probability that chance does as well, over all trials.
    """

    rotation: F8
    log_f: float
    detection: NDArray[np.intp]
    star: NDArray[np.intp]
    sigma_px: float
    log10_false_alarm: float


@dataclass(frozen=True)
class Region:
    """The set of orientations that remain possible given the inputs.

    Attributes
    ----------
    volume : float
        Measure of the set, radians to the power of `dimensions`; the set of all rotations has 8 pi^2.
    dimensions : int
        3, or 2 if a known heading ties the orientation to the position.
    """

    volume: float = 8 * math.pi**2
    dimensions: int = 3

    def log10_steps(self, step_rad: float) -> float:
        """Return the decimal logarithm of the number of steps such that every orientation is within `step_rad` of one."""
        # The corner of a cube is sqrt(dimensions) half sides from its centre.
        side = 2 * step_rad / math.sqrt(self.dimensions)
        return max(math.log10(self.volume) - self.dimensions * math.log10(side), 0.0)


WHOLE_SKY = Region()


def rotation_of(vector: F8) -> F8:
    """Return the rotation matrix of a rotation vector (Rodrigues).

    This avoids scipy, whose import would take several times as long as solving from centroids.
    """
    x, y, z = vector.tolist()
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    if angle < 1e-12:
        return np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
    s, c = math.sin(angle) / angle, 2 * (math.sin(angle / 2) / angle) ** 2
    return np.array(
        [
            [1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
            [c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x],
            [c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)],
        ]
    )


def turning_derivatives(dirs: F8, by_direction: F8) -> F8:
    """Derivatives of pixel positions by a small rotation of the sky, shape (n, 2, 3): J (w x d) for each axis w."""
    x, y, z = dirs.T
    a, b, c = by_direction[:, :, 0], by_direction[:, :, 1], by_direction[:, :, 2]
    x, y, z = x[:, None], y[:, None], z[:, None]
    derivatives = np.empty_like(by_direction)
    derivatives[:, :, 0] = c * y - b * z
    derivatives[:, :, 1] = a * z - c * x
    derivatives[:, :, 2] = b * x - a * y
    return derivatives


def log10_chance(agreeing: int, tried: int, chance: float) -> float:
    """Decimal logarithm of Chernoff's bound on `agreeing` or more successes in `tried` trials of probability `chance`."""
    if agreeing <= 0 or tried <= 0:
        return 0.0
    part = min(agreeing / tried, 1.0)
    if part <= chance:
        return 0.0
    divergence = part * math.log(part / chance)
    if part < 1:
        divergence += (1 - part) * math.log((1 - part) / (1 - chance))
    return -tried * divergence / math.log(10)


def verify(
    camera: Camera,
    uv: F8,
    xyz: F8,
    rotation: F8,
    tolerance_px: float,
    *,
    log10_tried: float,
    free_stars: int,
    region: Region,
    finest_rad: float,
    area_px: float,
    searches: int = SEARCHES,
    expected: int | None = None,
) -> Alignment:
    """Refine a hypothesis on the field and bound its false-alarm probability.

    Parameters
    ----------
    camera : Camera
        The camera.
    uv : ndarray, shape (m, 2)
        Detections with refraction removed.
    xyz : ndarray, shape (n, 3)
        Stars of the sky that may be seen.
    rotation : ndarray, shape (3, 3)
        Sky to camera.
    tolerance_px : float
        Largest error of positions under the hypothesis.
    log10_tried : float
        Decimal logarithm of the number of hypotheses tried.
    free_stars : int
        Number of agreements that prove nothing, because the hypothesis was made from them.
    region : Region
        Orientations among which the hypothesis was searched for.
    finest_rad : float
        Smallest pixel scale (`Camera.radians_per_px`) among the detections.
    area_px : float
        Area of the frame that shows the sky.
    searches : int
        Number of searches that share the allowed false alarms.
    expected : int, optional
        Number of the first stars among which the detections are expected by their number. If it is less than n, agreement
        with these alone is judged too.
    """
    log_f, radius = 0.0, tolerance_px
    rounds = 3 if tolerance_px <= 6 else 4
    centre = np.array([camera.cx_px, camera.cy_px])
    rows = _may_be_seen(camera, xyz, rotation, tolerance_px)
    sky = xyz[rows]
    none = np.empty(0, dtype=np.intp)
    detection, star, sigma, inside = none, none, tolerance_px, np.zeros(len(rows), dtype=bool)
    residual = np.empty((0, 2))
    for round_ in range(rounds):
        dirs = sky @ rotation.T
        ideal = camera.project(dirs)
        factor = math.exp(log_f)
        predicted = centre + factor * (ideal - centre)
        inside = camera.in_frame(predicted, radius)
        kept = np.flatnonzero(inside)
        detection, star = mutual_nearest(uv, predicted[kept], radius)
        star = kept[star]
        if len(detection) < max(3, free_stars):
            return Alignment(rotation, log_f, detection, rows[star], sigma, 0.0)
        residual = uv[detection] - predicted[star]
        size = np.abs(residual).ravel()
        # Four parameters are fitted, so with few stars the residuals are smaller than the noise.
        fitted = math.sqrt(len(star) / max(len(star) - 2, 1))
        sigma = fitted * 1.4826 * float(np.partition(size, len(size) // 2)[len(size) // 2])
        if round_ == rounds - 1:
            break
        design = np.empty((len(star), 2, 4))
        design[:, :, :3] = factor * turning_derivatives(dirs[star], camera.project_with_derivatives(dirs[star])[1])
        design[:, :, 3] = factor * (ideal[star] - centre)
        scale = max(sigma, 0.1)
        weight = 1.0 / (1.0 + np.einsum("ni,ni->n", residual, residual) / (3 * scale) ** 2)
        weighted = (design * weight[:, None, None]).reshape(-1, 4)
        normal = weighted.T @ design.reshape(-1, 4)
        normal[3, 3] += (scale / FOCAL_PRIOR) ** 2
        gradient = weighted.T @ residual.ravel()
        gradient[3] -= (scale / FOCAL_PRIOR) ** 2 * log_f
        try:
            step = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(4), gradient)
        except np.linalg.LinAlgError:
            break
        rotation = rotation_of(step[:3]) @ rotation
        log_f = min(max(log_f + float(step[3]), -MOST_LOG_F), MOST_LOG_F)
        radius = min(radius, max(3.5 * sigma, 1.2))
    length = np.sqrt(np.einsum("ni,ni->n", residual, residual))
    n_free = free_stars + (1 if abs(log_f) > 1e-3 else 0)
    # The fit could choose among all places within the tolerance, in each of its dimensions.
    tried = log10_tried + 3 * math.log10(max(tolerance_px / radius, 1.0))
    best = 0.0
    depths = {len(xyz), len(xyz) if expected is None else min(expected, len(xyz))}
    radii = radius * np.array(_RADII)
    # Areas in which a star may be by chance: each radius, and each radius widened by the steps in rotation and focal length.
    areas = math.pi * np.concatenate((radii, (1 + TURN_STEP + FOCAL_STEP) * radii)) ** 2
    for depth in depths:
        crowding = _crowding(uv, predicted[inside & (rows < depth)], radius, area_px)
        chances = np.maximum((-np.expm1(-areas[:, None] * crowding)).mean(axis=1), 1e-12).tolist()
        among = length[rows[star] < depth]
        for k, r in enumerate(radii.tolist()):
            agreeing = int(np.count_nonzero(among <= r))
            made = tried + log10_chance(agreeing - n_free, len(uv), chances[k])
            steps = region.log10_steps(TURN_STEP * r * finest_rad) + log10_focal_shell(camera, log_f, r)
            covered = steps + math.log10(searches) + log10_chance(agreeing, len(uv), chances[k + len(_RADII)])
            best = min(best, made, covered)
    total = min(0.0, best + math.log10(2 * len(_RADII) * len(depths)))
    return Alignment(rotation, log_f, detection, rows[star], sigma, total)


def log10_focal_shell(camera: Camera, log_f: float, radius_px: float) -> float:
    """Return the decimal logarithm of the factor on the false-alarm bound for the choice of a focal length.

    The supplied focal length is the most likely: the n-th shell around it gets 1/(n (n + 1)) of the allowed false alarms.
    """
    half_diagonal = math.hypot(camera.width, camera.height) / 2
    shell = max(math.ceil(abs(log_f) * half_diagonal / (2 * FOCAL_STEP * radius_px) + 1e-9), 1)
    return math.log10(2 * shell * (shell + 1))


def _may_be_seen(camera: Camera, xyz: F8, rotation: F8, tolerance_px: float) -> NDArray[np.intp]:
    """Return the rows of the stars that the frame may show after rotation and focal length are refined."""
    middle, reach = field_cone(camera)
    rows = np.flatnonzero(xyz @ (rotation.T @ np.array(middle)) > math.cos(min(reach + 0.1, math.pi)))
    predicted = camera.project(xyz[rows] @ rotation.T)
    # Refinement moves a corner by up to the effect of the largest change of focal length, and the field by its rotation.
    margin = math.expm1(MOST_LOG_F) * math.hypot(camera.width, camera.height) / 2 + 2 * tolerance_px
    return np.asarray(rows[camera.in_frame(predicted, margin)])


def _crowding(seen: F8, predicted: F8, radius_px: float, area_px: float) -> F8:
    """Return the density of predicted stars that chance meets at each detection, per square pixel, shape (n,).

    Where the sky is crowded, both stars and detections crowd, so chance must be judged locally and not by the frame's mean
    alone. The star that a detection agrees with is no evidence of a crowd, unless the whole frame is as crowded.
    """
    reach = max(CROWD_PX, 3 * radius_px)
    detection, _, distance = candidate_pairs(seen, predicted, reach)
    disc_px = math.pi * reach**2
    near = np.bincount(detection, minlength=len(seen)) / disc_px
    others = np.bincount(detection[distance > radius_px], minlength=len(seen)) / disc_px
    return np.asarray(np.maximum(others, np.minimum(near, len(predicted) / area_px)))


@lru_cache(maxsize=32)
def field_cone(camera: Camera) -> tuple[tuple[float, float, float], float]:
    """Return the direction of the frame's centre, and the largest angle from it to the frame's border, radians."""
    middle = camera.to_rays(np.array([[(camera.width - 1) / 2, (camera.height - 1) / 2]]))[0]
    u, v = np.linspace(-0.5, camera.width - 0.5, 9), np.linspace(-0.5, camera.height - 0.5, 9)
    border = np.concatenate(
        [np.column_stack((u, np.full(9, y))) for y in (v[0], v[-1])]
        + [np.column_stack((np.full(9, x), v)) for x in (u[0], u[-1])]
    )
    cosine = camera.to_rays(border) @ middle
    reach = math.pi if np.isnan(cosine).any() else float(np.arccos(np.clip(cosine.min(), -1, 1)))
    return (float(middle[0]), float(middle[1]), float(middle[2])), reach
