"""Expected electrons and truth of a frame. A long exposure is the sum of parts, each with the light of its own time."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from generator.frame.exposure.parts import part_count, plan_part, without_sky
from generator.frame.plan import FramePlan
from generator.frame.scene import ExpectedFrame, render_under_one_sky
from generator.frame.star_truth import LitMoments, StarTruth
from generator.light.photometry import radiance_from_surface_brightness, surface_brightness_from_radiance

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


def render_expected(plan: FramePlan, layers: bool = False, channels: bool = True) -> ExpectedFrame:
    """Render a frame's expected electrons, and the truth of its stars.

    With `layers`, each component is also rendered separately. Without `channels`, pixels of a colour sensor are rendered
    only in their own channel, which gives the same electrons in less time.

    If the plan is long, it is rendered in parts. Its stars' truth is that of the sum of their light: means are weighted by
    the electrons of each part, starts and ends are those of the first and the last part in which a star is near the frame,
    and the place half-way is that of the middle part.

    Raises
    ------
    GeneratorError
        Twilight is requested and the Sun is up at some time of the exposure.
    """
    if not plan.is_long:
        return render_under_one_sky(plan, layers, channels)
    count = part_count(plan.spec.time.exposure_s)
    whole = render_under_one_sky(plan_part(plan, 0, 1 / count), layers, channels)
    star_parts, lamp_parts, moon_parts, lit_parts = [_stars_of(whole)], [whole.lamps], [whole.moon], [whole.lit]
    zenith = _zenith_radiance(whole)
    for number in range(1, count):
        part = render_under_one_sky(plan_part(plan, number / count, (number + 1) / count), layers, channels)
        star_parts.append(_stars_of(part))
        lamp_parts.append(part.lamps)
        moon_parts.append(part.moon)
        lit_parts.append(part.lit)
        zenith += _zenith_radiance(part)
        whole = replace(
            whole,
            electrons=whole.electrons + part.electrons,
            sky_electrons=whole.sky_electrons + part.sky_electrons,
            channels={name: light + part.channels[name] for name, light in whole.channels.items()},
            layers=_added(whole.layers, part.layers),
            cover=None if whole.cover is None or part.cover is None else whole.cover + part.cover,
        )
    stars = merged(star_parts)
    objects = StarTruth.empty()
    if len(plan.objects):
        # Objects have time spans of their own; their light does not depend on the sky.
        objects = render_under_one_sky(without_sky(plan)).objects
    return replace(
        whole,
        u_px=stars.u_px,
        v_px=stars.v_px,
        start_px=stars.start_px,
        end_px=stars.end_px,
        centroid_px=stars.centroid_px,
        light_px=stars.light_px,
        star_electrons=stars.electrons,
        fraction_in_frame=stars.fraction_in_frame,
        occluded=stars.occluded,
        hidden_fraction=stars.hidden_fraction,
        low_px=stars.low_px,
        high_px=stars.high_px,
        lit=LitMoments.together(lit_parts),
        cover=None if whole.cover is None else whole.cover / np.float32(count),
        objects=objects,
        lamps=merged(lamp_parts),
        moon=_moon([part for part in moon_parts if len(part.electrons)]),
        zenith_mag_arcsec2=float(surface_brightness_from_radiance(zenith / count)) if zenith > 0 else None,
    )


def _stars_of(part: ExpectedFrame) -> StarTruth:
    """Truth of a part's stars."""
    return StarTruth(
        part.u_px,
        part.v_px,
        part.start_px,
        part.end_px,
        part.centroid_px,
        part.light_px,
        part.star_electrons,
        part.fraction_in_frame,
        part.occluded,
        part.hidden_fraction,
        part.low_px,
        part.high_px,
    )


def _zenith_radiance(part: ExpectedFrame) -> float:
    return 0.0 if part.zenith_mag_arcsec2 is None else float(radiance_from_surface_brightness(part.zenith_mag_arcsec2))


def _added(first: dict[str, Singles], second: dict[str, Singles]) -> dict[str, Singles]:
    """Sums of layers by name; a layer that one of them lacks is black there."""
    both = {name: first[name] + second[name] for name in first.keys() & second.keys()}
    return first | second | both


def merged(parts: Sequence[StarTruth]) -> StarTruth:
    """Truth of n stars over an odd number of equal parts of an exposure, in order of time."""
    column = {field.name: np.stack([getattr(part, field.name) for part in parts]) for field in fields(StarTruth)}
    electrons = column["electrons"]

    def mean(name: str) -> Floats:
        values = column[name]
        arrives = (electrons > 0).reshape(electrons.shape + (1,) * (values.ndim - 2)) & np.isfinite(values)
        weight = np.where(arrives, electrons.reshape(arrives.shape[:2] + (1,) * (values.ndim - 2)), 0.0)
        total = weight.sum(axis=0)
        none = np.nan if values.ndim > 2 else 0.0
        summed = (weight * np.where(arrives, values, 0.0)).sum(axis=0)
        return np.divide(summed, total, out=np.full(total.shape, none), where=total > 0)

    hidden = _hidden_fraction(electrons, column["hidden_fraction"])
    half_way = parts[len(parts) // 2]
    return StarTruth(
        half_way.u_px,
        half_way.v_px,
        _first_known(column["start_px"]),
        _first_known(column["end_px"][::-1]),
        mean("centroid_px"),
        mean("light_px"),
        electrons.sum(axis=0),
        mean("fraction_in_frame"),
        hidden > 0.5,
        hidden,
        np.fmin.reduce(column["low_px"]),
        np.fmax.reduce(column["high_px"]),
    )


def _hidden_fraction(electrons: Floats, hidden: Floats) -> Floats:
    """Fraction of the light of n stars that is hidden, from electrons that arrive and fractions in each part, (p, n) arrays.

    Where a part is hidden altogether, its light without cover is taken to be the mean of the other parts'.
    """
    seen = hidden < 1
    open_e = np.divide(electrons, 1 - hidden, out=np.zeros_like(electrons), where=seen)
    known = seen.sum(axis=0)
    usual = np.divide(open_e.sum(axis=0), known, out=np.ones(known.shape), where=known > 0)
    open_e = np.where(seen, open_e, usual)
    total = open_e.sum(axis=0)
    share = np.divide(electrons.sum(axis=0), total, out=1 - hidden.mean(axis=0), where=total > 0)
    return np.clip(1 - share, 0.0, 1.0)


def _first_known(places: Floats) -> Floats:
    """The first of the places (p, n, 2) of each star that is not NaN."""
    known = np.isfinite(places).all(axis=2)
    return np.asarray(places[np.argmax(known, axis=0), np.arange(places.shape[1])])


def _moon(parts: Sequence[StarTruth]) -> StarTruth:
    """Truth of the Moon from the parts in which it is drawn."""
    if not parts:
        return StarTruth.empty()
    whole = functools.reduce(StarTruth.joined, parts).together()
    lit = [part for part in parts if part.electrons[0] > 0] or parts
    half_way = lit[len(lit) // 2]
    return replace(
        whole, u_px=half_way.u_px, v_px=half_way.v_px, start_px=lit[0].start_px, end_px=lit[-1].end_px
    )  # fmt: skip
