"""Parts of an exposure: their plans, with the light of their own time if the whole exposure is long."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from generator.frame.moon.path import site_of
from generator.frame.plan import (
    LONGEST_LIGHT_S,
    FramePlan,
    airmass_above,
    refracting_air,
    through_clouds,
    under_clouds,
)
from generator.optics.motion import Motion
from generator.places.astrometry import ApparentPlaces
from generator.places.times import SECONDS_PER_DAY
from generator.scenario.model import SkySpec
from generator.sky.clouds import behind_cloud, level_or_up
from generator.sky.state import sky_state

Floats = NDArray[np.float64]


def part_count(exposure_s: float) -> int:
    """Least odd number of equal parts of an exposure that are no longer than LONGEST_LIGHT_S.

    If it is odd, the middle of the exposure is that of a part.
    """
    return 2 * math.ceil((math.ceil(exposure_s / LONGEST_LIGHT_S) - 1) / 2) + 1


def plan_part(plan: FramePlan, start: float, stop: float) -> FramePlan:
    """Return the plan of a part of each row's exposure, from fraction `start` to `stop`.

    In a long exposure, its extinction, cloud and diffuse sky are those of the part's middle; otherwise they remain those
    of the whole exposure's middle. The plan's stars are all stars of the whole exposure, even if they are below the horizon
    during the part.
    """
    whole = plan.spec
    part_s = (stop - start) * whole.time.exposure_s
    spec = whole.model_copy(update={"time": whole.time.model_copy(update={"exposure_s": part_s})})
    # Rows of a rolling shutter are exposed one after the other, so parts overlap by the readout.
    share = whole.time.exposure_s / whole.shutter_s
    first, last = start * share, stop * share + (1 - share)
    samples = plan.directions.shape[1]
    if plan.is_long:
        samples = 2 * math.ceil((samples - 1) * (last - first) / 2) + 1
    part = replace(
        plan,
        spec=spec,
        utc_start=plan.utc_start.plus(start * whole.time.exposure_s),
        directions=_within(plan.directions, first, last, samples),
        motion=_motion_within(plan.motion, first, last, spec.shutter_s),
        objects=plan.objects.within(first, last),
    )
    return _in_its_own_light(part, plan, first, last, samples) if plan.is_long else part


def _in_its_own_light(part: FramePlan, whole: FramePlan, first: float, last: float, samples: int) -> FramePlan:
    """Return the plan of a part with places, extinction, cloud and sky of its middle."""
    spec = part.spec
    utc_mid = part.utc_start.plus(spec.shutter_s / 2)
    under = under_clouds(whole.spec, whole.utc_mid, whole.passage)
    # The same cloud drifts on if the exposure lasts over midnight.
    under = replace(under, wind_days=under.wind_days + utc_mid.since(whole.utc_mid) / SECONDS_PER_DAY)
    sky = sky_state(
        site_of(part),
        utc_mid,
        part.orientation,
        refracting_air(spec.atmosphere),
        spec.sky.clouds,
        part.scenario.seed,
        under,
        through_clouds(spec),
    )
    places = ApparentPlaces(part.directions[:, samples // 2])
    depth, transmission = part.cloud_optical_depth, part.cloud_transmission
    if sky.clouds is not None:
        depth, transmission = sky.clouds.depth_and_transmission(level_or_up(places.enu))
    unlisted = part.unlisted
    if unlisted is not None:
        assert whole.unlisted_v_mag is not None
        directions = _within(unlisted.directions, first, last, samples)
        there = ApparentPlaces(directions[:, samples // 2])
        unlisted = replace(
            unlisted,
            directions=directions,
            v_mag=behind_cloud(whole.unlisted_v_mag, sky.clouds, there.enu),
            airmass=_airmass(part, there),
        )
    return replace(
        part,
        utc_mid=utc_mid,
        middle=places,
        sky=sky,
        airmass=_airmass(part, places),
        cloud_optical_depth=depth,
        cloud_transmission=transmission,
        unlisted=unlisted,
    )


def _airmass(plan: FramePlan, places: ApparentPlaces) -> Floats:
    """Airmass of n places; 0 if extinction is off."""
    if not plan.spec.atmosphere.extinction:
        return np.zeros(len(places.enu))
    return airmass_above(plan.horizon, places.altitude_deg)


def without_sky(plan: FramePlan) -> FramePlan:
    """Return the plan without stars, Moon and diffuse sky: flying objects, and lights of the ground."""
    none = np.zeros(0, np.intp)
    return replace(
        plan,
        spec=plan.spec.model_copy(update={"sky": SkySpec(components=())}),
        stars=plan.stars[none],
        directions=plan.directions[none],
        airmass=plan.airmass[none],
        cloud_optical_depth=plan.cloud_optical_depth[none],
        cloud_transmission=plan.cloud_transmission[none],
        scintillation=plan.scintillation[none],
        unlisted=None,
    )


def _within(values: Floats, start: float, stop: float, samples: int) -> Floats:
    """Resample (n, k, …) samples, linear in between over the whole exposure, evenly over a part of it."""
    last = values.shape[1] - 1
    if last < 1:
        return values
    place = np.linspace(start, stop, samples) * last
    before = np.minimum(np.floor(place).astype(np.intp), last - 1)
    weight = (place - before).reshape(1, -1, *([1] * (values.ndim - 2)))
    return np.asarray((1 - weight) * values[:, before] + weight * values[:, before + 1])


def _motion_within(motion: Motion, start: float, stop: float, shutter_s: float) -> Motion:
    """Return attitudes over a part of the exposure, as many as over the whole."""
    if len(motion.R_cam) == 1:
        return motion
    share = np.linspace(0, 1, len(motion.R_cam))
    follow = Slerp(share, Rotation.from_matrix(motion.R_cam))
    turned = follow(start + (stop - start) * share).as_matrix()
    return replace(motion, time_s=shutter_s * share, R_cam=turned, R_mid=follow([(start + stop) / 2]).as_matrix()[0])
