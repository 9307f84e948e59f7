"""Configuration of the identification: its stages and the tuned parameters."""

from __future__ import annotations

from dataclasses import dataclass

from celnav.checking import bounded, check_fields


@dataclass(frozen=True)
class Stage:
    """One stage of the search.

    Attributes
    ----------
    bright : int
        Hypotheses come from this many of the first detections.
    lags : tuple of int
        Pairs consist of detections whose ranks differ by this range, first to last.
    sigma_px : float
        Noise that pairs may have.
    tolerance_px : float
        Largest distance between a detection and the star that explains it under a raw hypothesis.
    scored : int
        Number of detections that score a hypothesis.
    skipped : float
        Fraction of these that make no hypotheses, the brightest. Stages that skip any are only for frames in which bright
        detections are too many for stars (`celnav.identification.bright_lights`).
    """

    bright: int = bounded(least=1, most=10_000)
    lags: tuple[int, int] = bounded(least=0, most=10_000)
    sigma_px: float = bounded(least=0, most=1000)
    tolerance_px: float = bounded(least=0, most=1000)
    scored: int = bounded(150, 1, 10_000)
    skipped: float = bounded(0, 0, 1)

    def __post_init__(self) -> None:
        check_fields(self)


# Noise and tolerance, pixels, for good centroids, and for 4 px of noise or a focal length that is off by 3 %.
FINE, COARSE = (0.8, 5.0), (4.5, 20.0)
# Lamps, satellites and hot pixels are as often bright as faint, stars mostly faint. Where bright detections are too many for
# stars (`bright_lights`), stars are most of the fainter ones, and some pairs of these come before more of the brightest.
DEEP = 300
PAIR_STAGES = (
    Stage(4, (1, 3), *FINE, scored=40),
    Stage(8, (1, 3), *FINE, scored=60),
    Stage(6, (1, 2), *COARSE, scored=60),
    Stage(8, (1, 3), *FINE, scored=DEEP, skipped=0.5),
    Stage(8, (1, 3), *FINE, scored=DEEP, skipped=0.75),
    Stage(24, (1, 3), *FINE),
    Stage(8, (1, 3), *FINE, scored=DEEP, skipped=0.25),
    Stage(20, (1, 3), *FINE, scored=DEEP, skipped=0.5),
    Stage(14, (1, 3), *COARSE),
    Stage(40, (1, 3), *FINE),
    Stage(30, (4, 8), *FINE),
    Stage(30, (1, 2), *COARSE),
    Stage(30, (9, 29), *FINE),
    Stage(20, (4, 8), *COARSE),
    Stage(60, (1, 8), *FINE),
)
# For narrow fields the sky contains so many stars that a pair of detections fits thousands of pairs of stars. Tight
# tolerances on separations, which good centroids satisfy, and more pairs of detections therefore come before wider ones.
SHARP = (0.4, 4.0)
NARROW_STAGES = (
    Stage(4, (1, 3), *SHARP, scored=40),
    Stage(8, (1, 3), *SHARP, scored=60),
    Stage(8, (1, 3), *SHARP, scored=DEEP, skipped=0.5),
    Stage(8, (1, 3), *SHARP, scored=DEEP, skipped=0.75),
    Stage(14, (1, 3), *SHARP, scored=60),
    Stage(6, (1, 2), *FINE, scored=60),
    Stage(8, (1, 3), *SHARP, scored=DEEP, skipped=0.3),
    Stage(16, (1, 3), *SHARP, scored=DEEP, skipped=0.5),
    Stage(10, (4, 9), *SHARP, scored=60),
    Stage(24, (1, 3), *SHARP),
    Stage(6, (1, 2), *COARSE, scored=60),
    Stage(14, (1, 3), *FINE),
    Stage(40, (1, 3), *SHARP),
    Stage(14, (1, 3), *COARSE),
    Stage(30, (4, 8), *SHARP),
    Stage(30, (1, 2), *COARSE),
)
# Without an order of brightness all pairs are equally good, so many narrow windows come before wide ones.
UNORDERED_STAGES = (
    Stage(8, (1, 3), *FINE),
    Stage(30, (1, 3), *FINE),
    Stage(12, (1, 1), *COARSE),
    Stage(40, (1, 8), *FINE),
    Stage(60, (1, 3), *COARSE),
)
# The error of one star is smaller than that of the difference of two, and a wider tolerance costs little.
SINGLE = (0.8, 6.0)
SINGLE_STAGES = (
    Stage(6, (0, 0), *SINGLE, scored=60),
    Stage(16, (0, 0), *SINGLE),
    Stage(8, (0, 0), *SINGLE, scored=DEEP, skipped=0.5),
    Stage(8, (0, 0), *SINGLE, scored=DEEP, skipped=0.75),
    Stage(10, (0, 0), *COARSE),
    Stage(30, (0, 0), *SINGLE, scored=DEEP, skipped=0.5),
    Stage(60, (0, 0), *SINGLE),
    Stage(60, (0, 0), *COARSE),
)


@dataclass(frozen=True)
class SearchConfig:
    """Configuration of the search.

    Attributes
    ----------
    pair_stages, narrow_stages, unordered_stages, single_stages : tuple of Stage
        Stages for an unknown attitude relative to the horizon; for the same in narrow fields; for detections without an
        order of brightness; and for a known attitude.
    verified : int
        Number of detections that verify a hypothesis: enough for a bound far below the limit, few enough for half a
        millisecond.
    candidates : int
        Number of hypotheses of a batch that are verified. The true one is nearly always the best of its batch, and
        verifying more takes effort from later batches.
    max_log10_false_alarm : float
        False-alarm bound that ends the search: at most one chance identification in a million frames.
    first_look, first_look_singles : int
        Number of detections that score all hypotheses of a batch before the better quarter is scored by all; the second is
        for hypotheses from single stars. Those are few, and each true detection gives only one true hypothesis, so they are
        scored by more detections.
    chance_sigmas : float
        A hypothesis is verified if its score exceeds the mean score by chance by this many standard deviations, and by
        the number of stars that it is made of.
    paired_depth, scored_depth, verified_depth : float
        Number of catalogue stars in the field per detection that makes, scores and verifies hypotheses, if detections are
        ordered by brightness. The values exceed one because stars are missing and magnitudes differ.
    skipped_depth : float
        `paired_depth` of stages that skip the brightest detections, per detection to the last of the stage: less than one,
        because these stages are for frames of which many bright detections are false.
    unordered_paired_depth, unordered_depth : float
        The same for detections without an order, per detection of the frame, since all stars of the field count.
    narrowest_pair : float
        Least separation of a pair, as a fraction of the widest; narrow pairs do not determine the rotation about their axis.
    pairs_at_once : int
        Number of pairs of detections in one batch.
    hypotheses_at_once : int
        Number of hypotheses for which pairs are gathered into one batch; a single pair may give twice as many. Large enough
        for efficient array operations, small enough for the search to end soon after reaching the true one.
    sharp_scale : float
        Detections where a pixel spans more than this many times the median pixel's angle, at the rim of some lenses, are
        left out, because their directions carry no information.
    given_order_share : float
        Fraction of the work for the given order if there are no fluxes, since that order is only a guess.
    near_share : float
        Fraction of the work for the neighbourhood of a last known position; the rest is for the whole sky, so that a wrong
        position is noticed.
    told_share : float
        Fraction of the work with the supplied camera that is spent on the supplied attitude, if that is known so well that
        hypotheses are positions; the rest is for any orientation, so that a mount that has moved is noticed.
    least_rival : int
        Least number of detections that another orientation must explain.
    rival_share : float
        Number of detections that must be unexplained for a search for another orientation among them, and that it must
        explain, as a fraction of those that the first one explains.
    same_deg : float
        Orientations that differ by less than this count as the same, seen with a camera whose stated distortion or focal
        length is wrong.
    rival_work : int
        Work reserved for the other orientation (at most half of the bound): a few batches of pairs of bright detections.
        Two skies in one frame show in the first batch.
    """

    pair_stages: tuple[Stage, ...] = PAIR_STAGES
    narrow_stages: tuple[Stage, ...] = NARROW_STAGES
    unordered_stages: tuple[Stage, ...] = UNORDERED_STAGES
    single_stages: tuple[Stage, ...] = SINGLE_STAGES
    verified: int = bounded(120, 1, 100_000)
    candidates: int = bounded(2, 1, 100)
    max_log10_false_alarm: float = -6.0
    first_look: int = bounded(36, 1, 100_000)
    first_look_singles: int = bounded(80, 1, 100_000)
    chance_sigmas: float = bounded(2.5, 0)
    paired_depth: float = bounded(2.2, 0.01, 100)
    scored_depth: float = bounded(2.2, 0.01, 100)
    verified_depth: float = bounded(1.6, 0.01, 100)
    skipped_depth: float = bounded(0.6, 0.01, 100)
    unordered_paired_depth: float = bounded(1.1, 0.01, 100)
    unordered_depth: float = bounded(1.2, 0.01, 100)
    narrowest_pair: float = bounded(0.12, 0, 1)
    pairs_at_once: int = bounded(8, 1, 10_000)
    hypotheses_at_once: int = bounded(12_000, 1, 1_000_000)
    sharp_scale: float = bounded(4.0, 1)
    given_order_share: float = bounded(1 / 3, 0, 1)
    near_share: float = bounded(0.5, 0, 1)
    told_share: float = bounded(0.6, 0, 1)
    least_rival: int = bounded(8, 1)
    rival_share: float = bounded(0.5, 0, 1)
    same_deg: float = bounded(2.0, 0, 180)
    rival_work: int = bounded(600_000, 0)

    def __post_init__(self) -> None:
        check_fields(self)

    def kept_for_rival(self, max_work: int) -> int:
        """Return the part of the work that is reserved for the search for another orientation."""
        return min(self.rival_work, max_work // 2)
