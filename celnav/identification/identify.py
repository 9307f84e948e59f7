"""From detections to the orientation of the camera, in stages with more and looser hypotheses.

The first stages use a few bright detections and expect half a pixel of noise; later ones allow more detections (clutter may
be brighter than the stars) and more noise (or a wrong focal length). The search ends with the first hypothesis whose
false-alarm bound passes, or when the effort is spent; every batch of hypotheses takes a known part of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from celnav.identification.bright_lights import bright_lights
from celnav.identification.effort import (
    BATCH_WORK,
    HYPOTHESIS_WORK,
    PASSED_OVER_WORK,
    POLISH_WORK,
    VERIFICATION_WORK,
    VERIFIED_PAIR_WORK,
    Effort,
)
from celnav.identification.low_lights import high_detections
from celnav.identification.question import Question
from celnav.identification.search import (
    View,
    best_hypotheses,
    choose_pairs,
    enu_rotations,
    pair_hypotheses,
    polish,
    scoring_work,
    single_star_hypotheses,
)
from celnav.identification.search_config import SearchConfig, Stage
from celnav.identification.sky_index import F4, F8, NARROW, SkyIndex
from celnav.identification.verification import Alignment, field_cone, verify


@dataclass(frozen=True, eq=False)
class Identified:
    """Result of the search.

    Attributes
    ----------
    alignment : Alignment or None
        The accepted orientation (ICRS to camera).
    rival : Alignment or None
        Another orientation that passes too, and explains at least half as many detections.
    effort : Effort
        Effort spent on the search.
    """

    alignment: Alignment | None
    rival: Alignment | None
    effort: Effort


@dataclass(frozen=True, eq=False)
class _Order:
    """Detections in the order in which they are tried.

    Attributes
    ----------
    rows : ndarray, shape (n,)
        Rows of the question.
    ranked : bool
        Whether the order is assumed to be one of brightness.
    """

    rows: NDArray[np.intp]
    ranked: bool


@dataclass(frozen=True, eq=False)
class _Batch:
    """A batch of hypotheses that are scored together.

    Attributes
    ----------
    rotations : ndarray of float32, shape (h, 3, 3)
        Camera to sky.
    stage : Stage
        Stage that they come from.
    view : View
        Detections that score them.
    n_stars : float
        Number of stars of the whole sky that compete for those detections.
    passed_over : int
        Number of hypotheses that the last known position excluded.
    """

    rotations: F4
    stage: Stage
    view: View
    n_stars: float
    passed_over: int = 0


def identify(question: Question, index: SkyIndex, config: SearchConfig, effort: Effort) -> Identified:
    """Find the orientation that explains the detections, and whether another one explains them about as well.

    The work is charged to `effort`; the hypotheses that it has counted in earlier searches enter the false-alarm bound.
    """
    # A part is reserved for the rival, so that even a hypothesis found last is compared with others.
    kept = config.kept_for_rival(effort.max_work)
    effort.limit = min(effort.limit, effort.max_work - kept)
    search = _Search(question, index, config, effort)
    found, looked_at = search.run()
    if found is None:
        return Identified(None, None, effort)
    unexplained = np.zeros(len(question.uv), dtype=bool)
    unexplained[looked_at] = True
    unexplained[found.detection] = False
    effort.allow(kept)
    rival = search.rival(found, np.flatnonzero(unexplained))
    if rival is not None and len(rival.detection) > 2 * len(found.detection):
        found, rival = rival, None
    return Identified(found, rival, effort)


@dataclass(frozen=True, eq=False)
class _Search:
    """One search: a question, the tables of the sky, the configuration, and the effort."""

    question: Question
    index: SkyIndex
    config: SearchConfig
    effort: Effort

    @property
    def per_field(self) -> float:
        """Number of fields of the camera that make up the sky."""
        return 4 * math.pi / self.question.solid_angle_sr

    @property
    def made_of(self) -> int:
        """Number of detections that a hypothesis is made of."""
        return 2 if self.question.local is None else 1

    def run(self) -> tuple[Alignment | None, NDArray[np.intp]]:
        """Go through the stages until a hypothesis passes or the effort is spent.

        Returns
        -------
        Alignment or None, ndarray
            The accepted hypothesis, with rows of the question, and the rows that verified it.
        """
        orders = self._orders()
        limit, begun = self.effort.limit, self.effort.work
        for number, order in enumerate(orders):
            last = number == len(orders) - 1
            share = 1.0 if last else self.config.given_order_share
            self.effort.limit = begun + int(share * (limit - begun))
            for batch in self._batches(order):
                if not self.effort.affords(self._work(batch, order)):
                    break
                found = self._judge(batch, order, self.question.searches * len(orders))
                if found is not None:
                    # Convert to rows of the detections, whatever the order in which they were tried.
                    return replace(found, detection=order.rows[found.detection]), order.rows[: self.config.verified]
        return None, orders[0].rows[:0]

    def rival(self, found: Alignment, rest: NDArray[np.intp]) -> Alignment | None:
        """Look for another orientation among the detections `rest` that the accepted one leaves unexplained.

        This reveals two exposures in one frame, a reflection, or a wrong hypothesis that passed.
        """
        least = max(self.config.least_rival, self.config.rival_share * len(found.detection))
        if len(rest) < least:
            return None
        mag = None if self.question.mag is None else self.question.mag[rest]
        others = replace(self.question, uv=self.question.uv[rest], rays=self.question.rays[rest], mag=mag)
        # The false-alarm bound of this search counts only its own trials. A deadline does not stop it: it is short, and an
        # orientation that was not compared with others must not be returned.
        effort = Effort(self.effort.limit - self.effort.work)
        rival, _ = replace(self, question=others, effort=effort).run()
        self.effort.work += effort.work
        self.effort.hypotheses += effort.hypotheses
        if rival is None or len(rival.detection) < least:
            return None
        cosine = (float(np.trace(rival.rotation @ found.rotation.T)) - 1) / 2
        if cosine > math.cos(math.radians(self.config.same_deg)):
            return None
        return replace(rival, detection=rest[rival.detection])

    def _orders(self) -> list[_Order]:
        """Return the orders to try: as given (brightest first); without fluxes, also one that spreads over all detections.

        If lights crowd near the horizon, the detections above them come first.
        """
        question = self.question
        bright = np.arange(min(len(question.uv), 300))
        scale = question.radians_per_px(bright)
        sharp = bright[scale <= self.config.sharp_scale * _median_of_known(scale)] if len(bright) else bright
        rows = np.concatenate((sharp, np.arange(len(bright), len(question.uv))))
        orders = [_Order(rows, True)]
        high = high_detections(question.camera, question.rays[rows], question.up)
        if high is not None:
            orders.insert(0, _Order(rows[high], True))
        n = len(rows)
        if not question.ranked and n > 12:
            # A step coprime to n visits every detection once, and puts it far from its place in the given order.
            step = next(k for k in range(int(0.618 * n), n + 2) if math.gcd(k, n) == 1)
            orders.append(_Order(rows[(np.arange(n) * step) % n], False))
        return orders

    def _batches(self, order: _Order) -> Iterator[_Batch]:
        """Yield the hypotheses of all stages."""
        question, config = self.question, self.config
        ordered = config.narrow_stages if self.per_field > NARROW else config.pair_stages
        by_pairs = ordered if order.ranked else config.unordered_stages
        stages = by_pairs if question.local is None else config.single_stages
        if not bright_lights(None if question.mag is None else question.mag[order.rows]):
            stages = tuple(stage for stage in stages if not stage.skipped)
        most = order.rows[: max((stage.scored for stage in stages), default=0)]
        rays = question.rays[most].astype(np.float32)
        scale = question.radians_per_px(most).astype(np.float32)
        done: set[tuple[float, int, int]] = set()
        for stage in stages:
            view = View(rays[: stage.scored], scale[: stage.scored])
            in_field = (
                config.scored_depth * len(view.rays) if order.ranked else config.unordered_depth * len(order.rows)
            )
            of_stage = self._from_pairs if question.local is None else self._from_single_stars
            for rotations, passed_over in self._gathered(of_stage(stage, view, order, done)):
                yield _Batch(rotations, stage, view, in_field * self.per_field, passed_over)

    def _gathered(self, made: Iterator[tuple[F4, int]]) -> Iterator[tuple[F4, int]]:
        """Join the hypotheses that a last known position leaves into batches of the usual size."""
        if self.question.near is None:
            yield from made
            return
        parts: list[F4] = []
        kept = passed_over = 0
        for rotations, more in made:
            near = rotations[self.question.near.holds(rotations)]
            parts.append(near)
            kept, passed_over = kept + len(near), passed_over + more + len(rotations) - len(near)
            if kept + passed_over / 4 >= self.config.hypotheses_at_once:
                yield np.concatenate(parts), passed_over
                parts, kept, passed_over = [], 0, 0
        if kept:
            yield np.concatenate(parts), passed_over

    def _paired_stars(self, stage: Stage, view: View, order: _Order) -> float:
        """Return the number of stars of the whole sky among which those of the stage's detections are expected."""
        config, (start, end) = self.config, _ranks(stage, view)
        if not order.ranked:
            return config.unordered_paired_depth * len(order.rows) * self.per_field
        return (config.skipped_depth if start else config.paired_depth) * end * self.per_field

    def _from_pairs(
        self, stage: Stage, view: View, order: _Order, done: set[tuple[float, int, int]]
    ) -> Iterator[tuple[F4, int]]:
        """Yield rotations from the stage's pairs of detections, and how many the last known position excludes.

        `done` holds the pairs of earlier stages, and is extended.
        """
        config = self.config
        level = self.index.at_least(self._paired_stars(stage, view, order))
        ranks = _ranks(stage, view)
        widest = min(level.pair_limit_rad, 2 * field_cone(self.question.camera)[1])
        pairs = choose_pairs(view.rays, ranks, stage.lags, (config.narrowest_pair * widest, widest))
        pairs = pairs[np.array([(stage.sigma_px, int(i), int(j)) not in done for i, j in pairs], dtype=bool)]
        if not len(pairs):
            return
        done.update((stage.sigma_px, int(i), int(j)) for i, j in pairs)
        # Without a vertical, refraction remains in the positions: it shortens separations of stars above 20 deg by at most
        # 0.25 %, and by no more than 0.03 deg.
        slack = (5e-5, 0.0) if self.question.up is not None else (5e-5, 2.5e-3)
        # The deeper the level, the more stars fit a pair, and the fewer pairs of detections go into a batch.
        window = 14 * stage.sigma_px * float(view.radians_per_px[slice(*ranks)].max())
        fitting = 2 * len(level.first) * min(1.0, window / level.pair_limit_rad)
        at_once = int(np.clip(config.hypotheses_at_once / fitting, 1, config.pairs_at_once))
        near = self.question.near
        allowed = None if near is None else near.allowed(view.rays[: ranks[1]], self.index.xyz[: level.n])
        for chunk in np.array_split(pairs, math.ceil(len(pairs) / at_once)):
            yield from pair_hypotheses(
                view, chunk, level, self.index.axes, stage.sigma_px, slack, 2 * config.hypotheses_at_once, allowed
            )

    def _from_single_stars(
        self, stage: Stage, view: View, order: _Order, done: set[tuple[float, int, int]]
    ) -> Iterator[tuple[F4, int]]:
        """Yield rotations from the stage's detections, each matched with all stars, and 0; `done` as for pairs."""
        local, to_terrestrial = self.question.local, self.question.celestial_to_terrestrial
        assert local is not None
        stars = self.index.xyz[: self.index.at_least(self._paired_stars(stage, view, order)).n] @ to_terrestrial.T
        ranks = range(*_ranks(stage, view))
        fresh = np.array([i for i in ranks if (stage.sigma_px, i, i) not in done], dtype=np.intp)
        done.update((stage.sigma_px, int(i), int(i)) for i in fresh)
        # A star may be in a given direction at two latitudes.
        at_once = max(1, 2 * self.config.hypotheses_at_once // (2 * len(stars)))
        for start in range(0, len(fresh), at_once):
            rays = view.rays[fresh[start : start + at_once]].astype(np.float64)
            lat, lon, _ = single_star_hypotheses(rays @ local, stars)
            # Two products of long matrices take half of the time of products of many small ones.
            enu_from_sky = (enu_rotations(lat, lon).reshape(-1, 3) @ to_terrestrial).reshape(-1, 3, 3)
            sky_from_camera = np.swapaxes(enu_from_sky, 1, 2).reshape(-1, 3) @ local.T
            yield sky_from_camera.astype(np.float32).reshape(-1, 3, 3), 0

    def _first_look(self) -> int:
        return self.config.first_look if self.question.local is None else self.config.first_look_singles

    def _verification(self, order: _Order, view: View) -> tuple[NDArray[np.intp], int]:
        """Return the rows of the detections that verify a hypothesis, and among how many stars of the sky they may be."""
        verified = order.rows[: max(self.config.verified, len(view.rays))]
        in_field = (
            self.config.verified_depth * len(verified)
            if order.ranked
            else self.config.unordered_depth * len(order.rows)
        )
        return verified, int(min(max(in_field, 30) * self.per_field, len(self.index.xyz)))

    def _expected(self, order: _Order, verified: NDArray[np.intp]) -> int | None:
        """Return among how many stars of the sky the brightest detections are expected; None without an order."""
        return int(self.config.verified_depth * len(verified) * self.per_field) if order.ranked else None

    def _verification_work(self, order: _Order, view: View) -> int:
        verified, n_stars = self._verification(order, view)
        return VERIFICATION_WORK + VERIFIED_PAIR_WORK * int(len(verified) * n_stars / self.per_field)

    def _work(self, batch: _Batch, order: _Order) -> int:
        """Return the largest work that `_judge` may take."""
        n = len(batch.rotations)
        scoring = scoring_work(n, len(batch.view.rays), self._first_look())
        candidates = min(self.config.candidates, n)
        each = POLISH_WORK + self._verification_work(order, batch.view)
        passed_over = PASSED_OVER_WORK * batch.passed_over
        return BATCH_WORK + HYPOTHESIS_WORK * n + passed_over + scoring + candidates * each

    def _judge(self, batch: _Batch, order: _Order, searches: int) -> Alignment | None:
        """Score the hypotheses of a batch, verify the best, and return one that passes."""
        effort, config, question, view = self.effort, self.config, self.question, batch.view
        n = len(batch.rotations)
        effort.work += BATCH_WORK + HYPOTHESIS_WORK * n + PASSED_OVER_WORK * batch.passed_over
        effort.work += scoring_work(n, len(view.rays), self._first_look())
        effort.hypotheses += n
        if n == 0:
            return None
        level = self.index.at_least(batch.n_stars)
        tolerance = batch.stage.tolerance_px
        best, scores = best_hypotheses(
            batch.rotations, view, tolerance, level, self.index, config.candidates, self._first_look()
        )
        # Expected score by chance: half the probability that a star is within the tolerance, for each detection.
        by_chance = float(np.sum(np.minimum(1.0, level.n * (tolerance * view.radians_per_px) ** 2 / 4))) / 2
        least = by_chance + config.chance_sigmas * math.sqrt(by_chance) + 1.0
        half = 0.5 * len(view.rays)
        best = best[scores >= min(least, half)]
        effort.work += POLISH_WORK * len(best)
        polished, after = polish(best, view, tolerance, level, self.index)
        verified, n_stars = self._verification(order, view)
        stars = self.index.xyz[:n_stars].astype(np.float64)
        region = question.region if question.near is None else question.near.region
        sparse = question.sparse(verified, self.index.v_mag[:n_stars])
        promising = polished[after >= min(least + self.made_of, half)]
        finest_rad = float(question.radians_per_px(verified).min()) if len(promising) else 0.0
        for rotation in promising:
            effort.work += self._verification_work(order, view)
            found = verify(
                question.camera,
                question.uv[verified],
                stars,
                rotation.T,
                tolerance,
                log10_tried=math.log10(effort.hypotheses),
                free_stars=self.made_of,
                region=region,
                finest_rad=finest_rad,
                area_px=question.area_px,
                searches=searches,
                expected=self._expected(order, verified),
            )
            if sparse is not None:
                uv = question.uv[verified]
                found = sparse.judged(found, question.camera, uv, stars, region, finest_rad, searches)
            effort.best_log10_false_alarm = min(effort.best_log10_false_alarm, found.log10_false_alarm)
            if found.log10_false_alarm <= config.max_log10_false_alarm:
                return found
        return None


def _ranks(stage: Stage, view: View) -> tuple[int, int]:
    """Return the first rank in brightness of the detections that make hypotheses, and the one after the last."""
    start = int(stage.skipped * len(view.rays))
    return start, min(start + stage.bright, len(view.rays))


def _median_of_known(values: F8) -> float:
    """Median of the values that are not NaN; NaN if all are."""
    known = np.sort(values)  # NaN come last
    n = len(values) - int(np.isnan(values).sum())
    return float(known[(n - 1) // 2] + known[n // 2]) / 2 if n else math.nan
