"""The order of searches: near a last known position, the whole sky, and the whole sky at other focal lengths."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from celnav.identification.effort import Effort
from celnav.identification.identify import Identified, identify
from celnav.identification.question import Question
from celnav.identification.search_config import SearchConfig
from celnav.identification.sky_index import SkyIndex
from celnav.identification.verification import WHOLE_SKY


def identify_at_focal_lengths(
    question: Question,
    index: SkyIndex,
    config: SearchConfig,
    factors: Iterable[float],
    effort: Effort,
    share: float,
) -> Identified:
    """Find the orientation with the camera as it is given, and, where none is found, with other focal lengths in turn.

    A last known position is searched first, with `SearchConfig.near_share` of the effort. What the whole sky shows after
    that may contradict it: that is for the caller to judge.

    Parameters
    ----------
    question, index, config
        As of `identify`, which tolerates a focal length that is off by 6 %.
    factors : iterable of float
        On the focal length. They count only where detections are in order of brightness: without one the search is
        several times as long.
    effort : Effort
        What all searches together may spend; their bounds of chance count what all have tried.
    share : float
        Part of the effort that is kept for each of the factors.

    Returns
    -------
    Identified
        Detections are the rows of the question, and the factor `log_f` is on the focal length of its camera.
    """
    if question.near is not None:
        effort.allow(config.near_share * effort.max_work)
        found = identify(question, index, config, effort)
        if found.alignment is not None:
            return found
        question = replace(question, near=None)
    others = tuple(factors) if question.ranked else ()
    work_each = int(share * effort.max_work)
    kept = config.kept_for_rival(effort.max_work)
    as_given = effort.max_work - kept - len(others) * work_each - effort.work
    found = _identify_as_told(question, index, config, effort, as_given)
    for factor in others:
        if found.alignment is not None:
            break
        scaled, rows = _with_focal_length(question, factor)
        if not len(rows):
            continue
        found = _identify_as_told(scaled, index, config, effort, work_each)
        if found.alignment is not None:
            alignment = found.alignment
            found = replace(
                found,
                alignment=replace(
                    alignment, log_f=alignment.log_f + math.log(factor), detection=rows[alignment.detection]
                ),
            )
    return found


def _identify_as_told(
    question: Question, index: SkyIndex, config: SearchConfig, effort: Effort, work: int
) -> Identified:
    """Search with the attitude as it is told, where hypotheses come from it, and then, for a mount that moved, without it."""
    begun = effort.work
    if question.local is not None:
        effort.allow(config.told_share * work)
        found = identify(question, index, config, effort)
        if found.alignment is not None:
            return found
        question = replace(question, local=None, region=WHOLE_SKY)
    effort.allow(work - (effort.work - begun))
    return identify(question, index, config, effort)


def _with_focal_length(question: Question, factor: float) -> tuple[Question, NDArray[np.intp]]:
    """Scale the camera's focal length; also the rows of the detections that such a camera can have."""
    given = question.camera
    camera = replace(given, f_px=given.f_px * factor, fy_px=given.fy_px * factor)
    rays = camera.to_rays(question.uv)
    rows = np.flatnonzero(np.isfinite(rays[:, 0]))
    scaled = replace(
        question,
        camera=camera,
        uv=question.uv[rows],
        rays=rays[rows],
        mag=None if question.mag is None else question.mag[rows],
        solid_angle_sr=camera.solid_angle_sr,
    )
    return scaled, rows
