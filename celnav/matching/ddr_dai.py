"""Dynamic distance ratios after Dai et al.: ratios of distances and accumulated angle, no absolute distance.

Only the paper's abstract and introduction are open, and the method is reconstructed from them: no anchor star; a first
criterion of angles between any two neighbours and ratios of distances; then, for each star of the catalogue, a match degree
from the angle accumulated counterclockwise under that criterion, the highest of which wins. The thresholds are ours.

For a reference star, the neighbours have distances d and bearings beta. Two of them, i nearer than j, form a feature
(d_i/d_j, beta_j - beta_i). It depends on neither the scale nor the rotation of the pattern, and a missing star removes only
the features that it is part of. A look-up table of the features of all catalogue stars collects votes. For the candidates
with most votes, the scale and rotation are found that bring most neighbours together, which satisfies both criteria for
every two of them. The steps, counterclockwise, between neighbours that both agree are added up, and their fraction of the
full turn is the match degree.

References
----------
Y. Dai, C. Shi, L. Ben, H. Zhu, R. Zhang, S. Wu, S. Shan, Y. Xu, W. Zhou, "Star Identification Algorithm Based on Dynamic
Distance Ratio Matching", Remote Sensing 17(1), 62, 2025, doi 10.3390/rs17010062.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from celnav.cache import cached, digest
from celnav.checking import bounded, check_fields
from celnav.fix import Reason
from celnav.matching.confirmation import keep_mutually_nearest, log10_chance
from celnav.matching.history import History
from celnav.matching.patterns import (
    MAX_LIMIT_DECIMAG,
    PatternConfig,
    Patterns,
    bearings,
    load_patterns,
    pattern_stars,
    separations,
)
from celnav.matching.protocol import Identification, Observation
from celnav.sky.catalog import load_catalog

F8 = NDArray[np.float64]
_TURN = 2 * math.pi
# Least number of detections: three neighbours or fewer agree with some star under some scale and rotation.
LEAST_DETECTIONS = 5


@dataclass(frozen=True)
class DaiConfig:
    """Configuration of the matcher. Frozen and hashable.

    Attributes
    ----------
    limit_decimag : int
        Magnitude limit of the catalogue, in tenths of a magnitude.
    radius_deg : float
        Radius within which stars are neighbours.
    neighbours : int
        Number of neighbours used for a reference detection: the brightest if fluxes are known, else the nearest.
    ratio_bin, angle_bin_deg : float
        Bins of the look-up table.
    references : int
        Number of reference detections tried, from the centre of the frame outwards.
    candidates : int
        Number of stars with most votes whose match degree is computed.
    largest_scale : float
        Factor by which image distances may be larger or smaller than those of the catalogue.
    match_tolerance_deg : float
        Distance within which two neighbours agree.
    min_degree : float
        Least match degree, the accumulated angle as a fraction of the full turn.
    max_log10_false_alarm : float
        As for the thesis' matcher; scales and rotations are counted.
    """

    limit_decimag: int = bounded(40, -20, MAX_LIMIT_DECIMAG)
    radius_deg: float = bounded(45.0, 0.01, 90)
    neighbours: int = bounded(24, 3, 200)
    ratio_bin: float = bounded(0.02, 0.001, 1)
    angle_bin_deg: float = bounded(2.0, 0.1, 90)
    references: int = bounded(15, 1, 10_000)
    candidates: int = bounded(20, 1, 10_000)
    largest_scale: float = bounded(1.5, 1.001, 100)
    match_tolerance_deg: float = 0.5
    min_degree: float = 0.3
    max_log10_false_alarm: float = -4.0

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def patterns(self) -> PatternConfig:
        """Configuration of the database whose neighbours are compared."""
        return PatternConfig(limits_decimag=(self.limit_decimag,), radius_deg=self.radius_deg)

    @property
    def n_angle(self) -> int:
        """Number of bins of the angle over the full turn."""
        return math.ceil(360 / self.angle_bin_deg - 1e-9)

    @property
    def n_ratio(self) -> int:
        """Number of bins of the ratio from 0 to 1."""
        return math.ceil(1 / self.ratio_bin - 1e-9)

    def features(self, theta_rad: F8, bearing_rad: F8) -> NDArray[np.int64]:
        """Return the bins of all pairs of neighbours.

        Parameters
        ----------
        theta_rad, bearing_rad : ndarray, shape (n,)
            Neighbours in order of distance.

        Returns
        -------
        ndarray of int64, shape (n (n - 1) / 2,)
            Bin of each pair.
        """
        near, far = np.triu_indices(len(theta_rad), 1)
        ratio = theta_rad[near] / np.maximum(theta_rad[far], 1e-12)
        turn = (bearing_rad[far] - bearing_rad[near]) % _TURN / _TURN
        ratio_bin = np.minimum((ratio / self.ratio_bin).astype(np.int64), self.n_ratio - 1)
        return np.asarray(ratio_bin * self.n_angle + (turn * self.n_angle).astype(np.int64) % self.n_angle)


@dataclass(frozen=True, eq=False)
class RatioTable:
    """Stars by feature: those of bin b are ``star[start[b]:start[b + 1]]``, listed as often as they have it."""

    start: NDArray[np.int64]
    star: NDArray[np.int16]

    def votes(self, bins: NDArray[np.int64], n_stars: int) -> NDArray[np.int64]:
        """Count, for each star, its features in the same bin as one of the given features; shape (n_stars,)."""
        first, length = self.start[bins], self.start[bins + 1] - self.start[bins]
        positions = np.arange(int(length.sum())) + np.repeat(first - np.cumsum(length) + length, length)
        return np.bincount(self.star[positions], minlength=n_stars)


@dataclass(frozen=True, eq=False)
class Agreement:
    """Neighbours that agree under one scale and one rotation.

    Attributes
    ----------
    image, pattern : ndarray of int, shape (m,)
        Rows that coincide, one to one.
    scale : float
        Image distance over catalogue distance.
    degree : float
        Accumulated angle as a fraction of the full turn.
    log10_false_alarm : float
        Bound on the decimal logarithm of the probability that chance does as well.
    """

    image: NDArray[np.intp]
    pattern: NDArray[np.intp]
    scale: float
    degree: float
    log10_false_alarm: float


def accumulated_angle(bearing_rad: F8, agrees: NDArray[np.bool_]) -> float:
    """Return the fraction of the full turn covered by counterclockwise steps between neighbours that both agree.

    Parameters
    ----------
    bearing_rad : ndarray, shape (n,)
        Bearings of all neighbours considered.
    agrees : ndarray of bool, shape (n,)
        Which of the neighbours agree.
    """
    order = np.argsort(bearing_rad % _TURN, kind="stable")
    bearing, good = bearing_rad[order] % _TURN, agrees[order]
    if len(bearing) < 2:
        return 0.0
    step = (np.roll(bearing, -1) - bearing) % _TURN
    # Rounding may make the sum over all steps exceed the full turn.
    return min(float(step[good & np.roll(good, -1)].sum() / _TURN), 1.0)


def agree(image_theta: F8, image_bearing: F8, pattern_theta: F8, pattern_bearing: F8, config: DaiConfig) -> Agreement:
    """Find the scale and rotation under which most neighbours agree, and the angle that they accumulate.

    Parameters
    ----------
    image_theta, image_bearing : ndarray, shape (n,)
        Neighbours in the image, radians.
    pattern_theta, pattern_bearing : ndarray, shape (m,)
        Neighbours in the catalogue, radians.
    config : DaiConfig
        Tolerances.
    """
    nothing = Agreement(np.empty(0, np.intp), np.empty(0, np.intp), 1.0, 0.0, 0.0)
    tolerance = math.radians(config.match_tolerance_deg)
    reach = math.log(config.largest_scale)
    scale_step, n_turn = 0.02, 180
    n_scale = math.ceil(2 * reach / scale_step)
    log_scale = np.log(np.maximum(image_theta[:, None], 1e-12) / np.maximum(pattern_theta[None, :], 1e-12))
    i, j = np.nonzero(np.abs(log_scale) < reach)
    if len(i) == 0:
        return nothing
    log_scale = log_scale[i, j]
    turn = (image_bearing[i] - pattern_bearing[j]) % _TURN
    row = np.minimum(((log_scale + reach) / scale_step).astype(np.intp), n_scale - 1)
    column = (turn / _TURN * n_turn).astype(np.intp) % n_turn
    histogram = np.bincount(row * n_turn + column, minlength=n_scale * n_turn).reshape(n_scale, n_turn)
    # A peak may straddle the edges of its bin, hence sums over two by two bins.
    wide = histogram + np.roll(histogram, -1, axis=1)
    wide[:-1] += wide[1:].copy()
    peak_row, peak_column = np.unravel_index(int(np.argmax(wide)), wide.shape)
    scale = math.exp((peak_row + 1) * scale_step - reach)
    rotation = (peak_column + 1) / n_turn * _TURN
    near = (np.abs(log_scale - math.log(scale)) <= scale_step) & (np.abs(_wrap(turn - rotation)) <= _TURN / n_turn)
    for _ in range(2):
        if not near.any():
            return nothing
        # Far neighbours determine the scale best; the ratio of sums weights them accordingly.
        scale = float(image_theta[i[near]].sum() / pattern_theta[j[near]].sum())
        rotation += float(np.median(_wrap(turn[near] - rotation)))
        along = image_theta[i] - scale * pattern_theta[j]
        across = _wrap(turn - rotation) * np.sin(image_theta[i])
        near = np.hypot(along, across) <= tolerance
    rows, columns = keep_mutually_nearest(i[near], j[near], np.hypot(along[near], across[near]))
    agrees = np.zeros(len(image_theta), dtype=bool)
    agrees[rows] = True
    area = math.pi * tolerance**2 / (2 * math.pi * (1 - math.cos(math.radians(config.radius_deg))))
    chance = log10_chance(len(rows), len(image_theta) * len(pattern_theta) * area) + math.log10(n_scale * n_turn)
    return Agreement(rows, columns, scale, accumulated_angle(image_bearing, agrees), chance)


@dataclass(frozen=True)
class DaiMatcher:
    """Identifies stars by distance ratios and accumulated angle."""

    config: DaiConfig = field(default_factory=DaiConfig)

    def identify(self, observation: Observation, history: History | None = None) -> Identification:
        """Identify the stars; see `celnav.matching.Matcher`. The history is neither read nor extended."""
        config = self.config
        catalogue = load_patterns(config.patterns)[0]
        table = load_ratios(config)
        if len(observation.rays) < LEAST_DETECTIONS:
            return Identification(
                Reason.TOO_FEW_DETECTIONS,
                f"{len(observation.rays)} detections; ddr-dai needs a reference star and {LEAST_DETECTIONS - 1} neighbours",
            )
        rank = np.arange(len(observation.rays)) if observation.flux is None else np.argsort(-observation.flux)
        # Use only as many detections as the catalogue has stars in the field, so that reference stars are in the catalogue.
        if observation.flux is not None:
            share = observation.camera.solid_angle_sr / (4 * math.pi)
            rank = rank[: max(config.neighbours, round(len(catalogue) * share))]
        middle = np.array([(observation.camera.width - 1) / 2, (observation.camera.height - 1) / 2])
        central = rank[np.argsort(np.linalg.norm(observation.uv[rank] - middle, axis=1), kind="stable")]
        best, best_degree, best_count = None, 0.0, 0
        for reference in central[: config.references]:
            neighbour = self._neighbours(observation, rank, int(reference))
            if len(neighbour) < LEAST_DETECTIONS - 1:
                continue
            theta = separations(observation.rays[reference], observation.rays[neighbour])
            bearing = bearings(observation.rays[reference], observation.rays[neighbour])
            votes = table.votes(config.features(theta, bearing), len(catalogue))
            for star in np.argsort(-votes, kind="stable")[: config.candidates]:
                rows = slice(catalogue.start[star], catalogue.start[star + 1])
                found = agree(
                    theta,
                    bearing,
                    catalogue.theta_rad[rows].astype(np.float64),
                    catalogue.bearing_rad[rows].astype(np.float64),
                    config,
                )
                if (found.degree, len(found.image)) > (best_degree, best_count):
                    best = (int(reference), neighbour, int(star), found)
                    best_degree, best_count = found.degree, len(found.image)
            if best is not None and self._accepted(best[3], len(catalogue)):
                break
        if best is None or not self._accepted(best[3], len(catalogue)):
            message = f"no reference star is identified: at best {best_degree:.0%} of the turn agrees"
            return Identification(Reason.NO_HYPOTHESIS, message, confidence=best_degree)
        return self._conclude(catalogue, *best)

    def _neighbours(self, observation: Observation, rank: NDArray[np.intp], reference: int) -> NDArray[np.intp]:
        """Return the detections around a reference, in order of distance."""
        theta = separations(observation.rays[reference], observation.rays[rank])
        within = np.flatnonzero((theta <= math.radians(self.config.radius_deg)) & (rank != reference))
        if observation.flux is None:
            within = within[np.argsort(theta[within], kind="stable")]
        chosen = within[: self.config.neighbours]
        return rank[chosen[np.argsort(theta[chosen], kind="stable")]]

    def _accepted(self, found: Agreement, n_stars: int) -> bool:
        sure = found.log10_false_alarm + math.log10(n_stars) <= self.config.max_log10_false_alarm
        return sure and found.degree >= self.config.min_degree

    def _conclude(
        self, catalogue: Patterns, reference: int, neighbour: NDArray[np.intp], star: int, found: Agreement
    ) -> Identification:
        other = catalogue.neighbour[catalogue.start[star] + found.pattern]
        pairs = np.column_stack((neighbour[found.image], catalogue.star_id[other]))
        return Identification(
            Reason.OK,
            matches=np.vstack(([[reference, catalogue.star_id[star]]], pairs)).astype(np.int64),
            confidence=min(found.degree, 1.0),
            details={
                "reference_detection": reference,
                "neighbours": len(neighbour),
                "neighbours_matched": len(found.image),
                "scale": found.scale,
            },
        )


@lru_cache(maxsize=4)
def load_ratios(config: DaiConfig) -> RatioTable:
    """Return the look-up table of a configuration, from the cache if it is there."""
    catalogue = load_patterns(config.patterns)[0]

    def build() -> Mapping[str, NDArray[np.generic]]:
        bins, stars = [], []
        for star in range(len(catalogue)):
            rows = slice(catalogue.start[star], catalogue.start[star + 1])
            found = config.features(
                catalogue.theta_rad[rows].astype(np.float64), catalogue.bearing_rad[rows].astype(np.float64)
            )
            bins.append(found)
            stars.append(np.full(len(found), star, dtype=np.int16))
        every, owner = np.concatenate(bins), np.concatenate(stars)
        order = np.argsort(every, kind="stable")
        start = np.searchsorted(every[order], np.arange(config.n_ratio * config.n_angle + 1))
        return {"start": start.astype(np.int64), "star": owner[order]}

    stars = pattern_stars(load_catalog(), config.limit_decimag)
    key = digest(Path(__file__).read_bytes(), repr(config), stars.star_id.tobytes(), stars.vectors.tobytes())
    arrays = cached("ratios", key, build)
    return RatioTable(arrays["start"].astype(np.int64), arrays["star"].astype(np.int16))


def _wrap(angle: F8) -> F8:
    return np.asarray((angle + math.pi) % _TURN - math.pi)
