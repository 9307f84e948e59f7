"""Choices of the identification: its stages, and the numbers that were tuned."""

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
        Pairs are made of detections whose ranks differ by so much, first and last.
    sigma_px : float
        Noise that pairs may have.
    tolerance_px : float
        How far off a detection may be from the star that explains it under a raw hypothesis.
    scored : int
        Detections that score a hypothesis.
    """

    bright: int = bounded(least=1, most=10_000)
    lags: tuple[int, int] = bounded(least=0, most=10_000)
    sigma_px: float = bounded(least=0, most=1000)
    tolerance_px: float = bounded(least=0, most=1000)
    scored: int = bounded(150, 1, 10_000)

    def __post_init__(self) -> None:
        check_fields(self)


# Noise and tolerance, pixels: for good centroids, and for 4 px of noise or a focal length that is off by 3 %.
FINE, COARSE = (0.8, 5.0), (4.5, 20.0)
PAIR_STAGES = (
    Stage(4, (1, 3), *FINE, scored=40),
    Stage(8, (1, 3), *FINE, scored=60),
    Stage(6, (1, 2), *COARSE, scored=60),
    Stage(24, (1, 3), *FINE),
    Stage(14, (1, 3), *COARSE),
    Stage(40, (1, 3), *FINE),
    Stage(30, (4, 8), *FINE),
    Stage(30, (1, 2), *COARSE),
    Stage(30, (9, 29), *FINE),
    Stage(20, (4, 8), *COARSE),
    Stage(60, (1, 8), *FINE),
)
# In narrow fields the sky holds so many stars that a pair fits thousands of theirs: closer separations first, which good
# centroids have, and more pairs of detections before wider ones.
SHARP = (0.4, 4.0)
NARROW_STAGES = (
    Stage(4, (1, 3), *SHARP, scored=40),
    Stage(8, (1, 3), *SHARP, scored=60),
    Stage(14, (1, 3), *SHARP, scored=60),
    Stage(6, (1, 2), *FINE, scored=60),
    Stage(10, (4, 9), *SHARP, scored=60),
    Stage(24, (1, 3), *SHARP),
    Stage(6, (1, 2), *COARSE, scored=60),
    Stage(14, (1, 3), *FINE),
    Stage(40, (1, 3), *SHARP),
    Stage(14, (1, 3), *COARSE),
    Stage(30, (4, 8), *SHARP),
    Stage(30, (1, 2), *COARSE),
)
# Without an order of brightness pairs are as good as one another: many narrow windows before wide ones.
UNORDERED_STAGES = (
    Stage(8, (1, 3), *FINE),
    Stage(30, (1, 3), *FINE),
    Stage(12, (1, 1), *COARSE),
    Stage(40, (1, 8), *FINE),
    Stage(60, (1, 3), *COARSE),
)
# One star is off by less than the difference of two: a wider tolerance costs little.
SINGLE_STAGES = (
    Stage(6, (0, 0), 0.8, 6.0, scored=60),
    Stage(16, (0, 0), 0.8, 6.0),
    Stage(10, (0, 0), *COARSE),
    Stage(60, (0, 0), 0.8, 6.0),
    Stage(60, (0, 0), *COARSE),
)


@dataclass(frozen=True)
class SearchConfig:
    """Choices of the search.

    Attributes
    ----------
    pair_stages, narrow_stages, unordered_stages, single_stages : tuple of Stage
        Where the attitude to the horizon is not known; the same in narrow fields; without an order of brightness; and where
        the attitude is known.
    verified : int
        Detections that verify a hypothesis: enough for a bound far below the limit, few enough for half a millisecond.
    candidates : int
        Hypotheses of a batch that are verified. The true one is the best of its batch nearly always, and verifying more
        takes effort from batches to come.
    max_log10_false_alarm : float
        The bound that ends the search: one frame of chance in a million, at most.
    first_look, first_look_singles : int
        Detections that score all hypotheses of a batch before the better quarter is scored by all; and where they come
        from single stars: those are few, and each true detection makes only one, so they get the longer look.
    chance_sigmas : float
        A hypothesis is verified if its score exceeds the mean score of chance by so many standard deviations, and by
        the stars that it is made of.
    paired_depth, scored_depth, verified_depth : float
        Catalogue stars in the field per detection that makes hypotheses, scores them and verifies them, where
        detections are in order of brightness. More than one, because stars are missing and magnitudes differ.
    unordered_paired_depth, unordered_depth : float
        The same where they are in no order, per detection of the frame: all stars of the field count.
    narrowest_pair : float
        Least separation of a pair, as part of the widest: narrow ones leave the orientation about their axis open.
    pairs_at_once : int
        Pairs of detections in one batch.
    hypotheses_at_once : int
        Hypotheses that pairs for one batch are gathered for; a single pair may make twice as many. Large enough for
        array operations to pay, small enough for the search to end soon after the true one is met.
    sharp_scale : float
        Where a pixel is more than so many times the median pixel's angle, at the rim of some lenses, detections are
        left out: their direction says nothing.
    given_order_share : float
        Part of the work for the order given where there are no fluxes: it is only a guess.
    near_share : float
        Part of the work for the neighbourhood of a last known position; the rest is for the whole sky, so that a wrong one
        is noticed.
    told_share : float
        Part of the work on the camera as it is given that is for the attitude as it is told, where it is known so well that
        hypotheses are places; the rest is for any orientation, so that a mount that moved is noticed.
    least_rival : int
        Detections that another orientation must explain.
    rival_share : float
        Detections that must be unexplained for another orientation to be looked for among them, and that it must
        explain, as part of those that the first one explains.
    same_deg : float
        Orientations that differ by less are the same one, seen with a camera whose declared distortion or focal length
        is wrong.
    rival_work : int
        Work kept for the other orientation (half of the bound at most): a few batches of pairs of bright detections. Two
        skies in one frame show in the first.
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
        """Return the part of the bound of work that is kept for the other orientation."""
        return min(self.rival_work, max_work // 2)
