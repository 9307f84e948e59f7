"""Truth of the stars in a frame, from the tracks that the integrator computed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from generator.frame.plan import FramePlan
from generator.optics.psf import FINE_PER_PX, psf_table

Floats = NDArray[np.float64]

WHOLE_SIGMAS = 9.0
"""A Gaussian centred this far inside the frame is entirely on the frame, to double precision."""


@dataclass(frozen=True)
class LitMoments:
    """The m moments of an exposure at which light of stars arrives near the frame.

    Attributes
    ----------
    star : (m,) int array
        Index of the star.
    u, v : (m,) arrays
        Its place, px.
    """

    star: NDArray[np.int64]
    u: Floats
    v: Floats

    @classmethod
    def of(cls, tracks: Any) -> LitMoments:
        """Return the moments of tracks (:class:`generator.plugins.star_tracks.StarTracks`)."""
        return cls(tracks.star, tracks.u, tracks.v)

    @classmethod
    def none(cls) -> LitMoments:
        """Return no moments."""
        return cls(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))

    @classmethod
    def together(cls, parts: Sequence[LitMoments]) -> LitMoments:
        """Return the moments of all parts of an exposure, whose stars have common indices."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


@dataclass(frozen=True)
class StarTruth:
    """Truth of n stars; other attributes are those of :class:`generator.frame.scene.ExpectedFrame`.

    Attributes
    ----------
    light_px : (n, 2) array
        First moment of the light on an unbounded sensor: `centroid_px` plus the contributions of the point spread
        function's asymmetry and lateral colour; NaN if no light arrives.
    hidden_fraction : (n,) array
        Fraction of the light that geometry, landscape and Moon hide.
    low_px, high_px : (n, 2) arrays
        Least and greatest u and v from which light arrives, without the point spread function; NaN if no light arrives.
    """

    u_px: Floats
    v_px: Floats
    start_px: Floats
    end_px: Floats
    centroid_px: Floats
    light_px: Floats
    electrons: Floats
    fraction_in_frame: Floats
    occluded: NDArray[np.bool_]
    hidden_fraction: Floats
    low_px: Floats
    high_px: Floats

    def joined(self, other: StarTruth) -> StarTruth:
        """Truth of these stars followed by others."""
        return StarTruth(
            *(np.concatenate([getattr(self, field.name), getattr(other, field.name)]) for field in fields(self))
        )

    def together(self) -> StarTruth:
        """Truth of all stars merged into one source; empty if there are none."""
        electrons = self.electrons
        if not len(electrons):
            return self
        weight = electrons if electrons.sum() > 0 else np.ones(len(electrons))

        def mean(values: Floats) -> Floats:
            lit = np.isfinite(values.sum(axis=-1) if values.ndim > 1 else values) & (weight > 0)
            if not lit.any():
                return np.full((1, *values.shape[1:]), np.nan)
            return np.average(values[lit], axis=0, weights=weight[lit])[None]

        return StarTruth(
            mean(self.u_px),
            mean(self.v_px),
            mean(self.start_px),
            mean(self.end_px),
            mean(self.centroid_px),
            mean(self.light_px),
            np.array([electrons.sum()]),
            mean(self.fraction_in_frame),
            np.array([self.occluded.mean() > 0.5]),
            mean(self.hidden_fraction),
            np.fmin.reduce(self.low_px)[None],
            np.fmax.reduce(self.high_px)[None],
        )

    @classmethod
    def empty(cls) -> StarTruth:
        """Truth of no stars."""
        nothing, pairs = np.zeros(0), np.zeros((0, 2))
        return cls(
            nothing, nothing, pairs, pairs, pairs, pairs, nothing, nothing, np.zeros(0, bool), nothing, pairs, pairs
        )


def star_truth(plan: FramePlan, tracks: Any, on_axis_e: Floats) -> StarTruth:
    """Truth of stars.

    Parameters
    ----------
    plan : FramePlan
    tracks : generator.plugins.star_tracks.StarTracks
    on_axis_e : (n, bands) array
        Each star's electrons on the axis, in the point spread function's wavelength bands.
    """
    camera = plan.spec.camera
    if camera.psf is None:
        sigma = camera.psf_sigma_px
        share = share_within(tracks.u, camera.width, sigma) * share_within(tracks.v, camera.height, sigma)
        light_px = tracks.centroid
    else:
        by_band = np.divide(on_axis_e, on_axis_e.sum(axis=1, keepdims=True), where=on_axis_e > 0, out=0 * on_axis_e)
        share = np.einsum("mb,mb->m", by_band[tracks.star], _table_shares(plan, tracks))
        light_px = tracks.centroid + _light_offset(plan, tracks, by_band)
    count = len(on_axis_e)
    in_frame = np.bincount(tracks.star, tracks.weight * share, count)
    fraction = np.divide(in_frame, tracks.light, out=np.zeros(count), where=tracks.light > 0)
    return StarTruth(
        tracks.u_px,
        tracks.v_px,
        tracks.start,
        tracks.end,
        tracks.centroid,
        light_px,
        on_axis_e.sum(axis=1) * tracks.light,
        fraction,
        tracks.visible_share < 0.5,
        1 - tracks.visible_share,
        *_corners(tracks, count),
    )


def _corners(tracks: Any, count: int) -> tuple[Floats, Floats]:
    """Least and greatest u and v, px, from which each source's light arrives, (n, 2) arrays; NaN if none does."""
    low, high = np.full((2, count, 2), np.nan)
    # The moments are in the order of their sources.
    lit, first = np.unique(tracks.star, return_index=True)
    for axis, position in enumerate((tracks.u, tracks.v)):
        if len(lit):
            low[lit, axis] = np.minimum.reduceat(position, first)
            high[lit, axis] = np.maximum.reduceat(position, first)
    return low, high


def between_lit_ends(truth: StarTruth, tracks: Any, dark_ends: NDArray[np.bool_]) -> StarTruth:
    """Truth of lights that flash, rise or set: starts and ends are where they first and last shine in the exposure.

    Parameters
    ----------
    truth : StarTruth
    tracks : generator.plugins.star_tracks.StarTracks
        Tracks whose moments are ordered by time for each source in turn.
    dark_ends : (n, 2) bool array
        Whether each is dark at the beginning and at the end.
    """
    start, end = truth.start_px.copy(), truth.end_px.copy()
    lit, first = np.unique(tracks.star, return_index=True)
    last = np.append(first[1:], len(tracks.star)) - 1
    for place, moments, dark in ((start, first, dark_ends[:, 0]), (end, last, dark_ends[:, 1])):
        late = dark[lit]
        place[lit[late]] = np.stack([tracks.u, tracks.v], axis=1)[moments[late]]
    return replace(truth, start_px=start, end_px=end)


def share_within(position_px: Floats, size: int, sigma_px: float) -> Floats:
    """Fraction of a Gaussian around `position_px` that falls on pixels 0 to size - 1, along one axis."""
    share = np.ones_like(position_px)
    inside = (position_px > WHOLE_SIGMAS * sigma_px) & (position_px < size - 1 - WHOLE_SIGMAS * sigma_px)
    rest = np.flatnonzero(~inside)
    ends = np.stack([size - 0.5 - position_px[rest], -0.5 - position_px[rest]]) / (math.sqrt(2) * sigma_px)
    share[rest] = 0.5 * (erf(ends[0]) - erf(ends[1]))
    return share


def _nearest_node(plan: FramePlan, tracks: Any, rows: int, columns: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of the field node nearest to each of m moments, (m,) arrays."""
    camera = plan.spec.camera
    row = np.rint(np.clip((tracks.v + 0.5) / camera.height, 0, 1) * (rows - 1))
    column = np.rint(np.clip((tracks.u + 0.5) / camera.width, 0, 1) * (columns - 1))
    return row.astype(np.intp), column.astype(np.intp)


def _light_offset(plan: FramePlan, tracks: Any, by_band: Floats) -> Floats:
    """First moment of each star's light minus its mean position, px, (n, 2) array; 0 if no light arrives.

    For each moment and band, the lateral chromatic shift and the first moment of the point spread function are weighted
    by the drawn part of the band's light; moments are weighted by their light.
    """
    camera = plan.spec.camera
    table = psf_table(camera)
    total, moment = table.light
    bands, rows, columns = total.shape
    row, column = _nearest_node(plan, tracks, rows, columns)
    node = row * columns + column
    weight = by_band[tracks.star] * total.reshape(bands, -1).T[node] * tracks.weight[:, None]
    away = np.stack([tracks.u - camera.projection.cx_px, tracks.v - camera.projection.cy_px], axis=1) / camera.corner_px
    count = len(by_band)
    lit = np.bincount(tracks.star, weight.sum(axis=1), count)
    offset = np.zeros((count, 2))
    geometric = np.zeros((count, 2))
    for axis, position in enumerate((tracks.u, tracks.v)):
        inward = moment[..., axis].reshape(bands, -1).T[node] + away[:, axis, None] * table.shift
        moved = np.einsum("mb,mb->m", weight, inward + position[:, None])
        offset[:, axis] = np.bincount(tracks.star, moved, count)
        geometric[:, axis] = np.bincount(tracks.star, tracks.weight * position, count)
    light = np.bincount(tracks.star, tracks.weight, count)
    means = [np.divide(sums, by[:, None], out=np.zeros_like(sums), where=by[:, None] > 0)
             for sums, by in ((offset, lit), (geometric, light))]  # fmt: skip
    return means[0] - means[1]


def _table_shares(plan: FramePlan, tracks: Any) -> Floats:
    """Fraction of the tabulated point spread function that falls on the sensor, at m moments, (m, bands) array.

    It is that of the nearest field node, to a fraction of a pixel, or the support's encircled energy if it is wholly inside.
    """
    camera = plan.spec.camera
    table = psf_table(camera)
    bands, rows, columns, size = table.stamps.shape[:4]
    half = (size - 1) / 2
    row, column = _nearest_node(plan, tracks, rows, columns)
    shares = table.cumulated[:, :, :, -1, -1].reshape(bands, -1).T[row * columns + column]
    reach = half / FINE_PER_PX + 1
    inside = (tracks.u > reach) & (tracks.u < camera.width - 1 - reach)
    inside &= (tracks.v > reach) & (tracks.v < camera.height - 1 - reach)
    rest = np.flatnonzero(~inside)

    def edges(position: Floats, extent: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        near = np.clip(np.rint((-0.5 - position) * FINE_PER_PX + half), 0, size)
        far = np.clip(np.rint((extent - 0.5 - position) * FINE_PER_PX + half) + 1, 0, size)
        return near.astype(np.intp), far.astype(np.intp)

    left, right = edges(tracks.u[rest], camera.width)
    top, bottom = edges(tracks.v[rest], camera.height)
    row, column = row[rest], column[rest]
    for band, cumulated in enumerate(table.cumulated):
        shares[rest, band] = (
            cumulated[row, column, bottom, right]
            - cumulated[row, column, top, right]
            - cumulated[row, column, bottom, left]
            + cumulated[row, column, top, left]
        )
    return shares
