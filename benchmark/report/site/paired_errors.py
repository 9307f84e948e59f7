"""Errors of all solvers of a board over those of one of them, on the frames that both identify."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from benchmark.report.site.boards import Board, Entry
from benchmark.stats.clustered import Resamples, mean_estimates
from benchmark.stats.comparison import SMALLEST_ERROR_KM, exponential, paired
from benchmark.stats.frame_metrics import errors_km, identified, sites
from benchmark.stats.intervals import Estimate


def paired_errors(board: Board, reference: str) -> dict[str, Estimate]:
    """Geometric mean of the ratio of errors, each over the frames that a solver and the reference identify, by solver.

    A median of each solver's own identified fixes is of easy frames for a solver that identifies few; this is not. Errors
    below a metre count as a metre. Undefined where no frame is identified by both; 1 without an interval for the reference.

    Parameters
    ----------
    board : Board
    reference : str
        Label of one of the board's entries.
    """
    first = next(entry for entry in board.entries if entry.label == reference)
    others = [entry for entry in board.entries if entry is not first]
    found = dict(zip((entry.label for entry in others), _ratios(first, others, board.task.limit_km), strict=True))
    own = int(np.count_nonzero(identified(first.stored.frames, board.task.limit_km)))
    return found | {reference: Estimate(1.0 if own else math.nan, math.nan, math.nan, own)}


def _ratios(first: Entry, others: Sequence[Entry], limit_km: float) -> list[Estimate]:
    """Geometric means of the others' errors over the first's, on frames that both identify."""
    if not others:
        return []
    frames = first.stored.frames
    tables = [paired(frames, entry.stored.frames)[1] for entry in others]
    errors, known = np.maximum(errors_km(frames), SMALLEST_ERROR_KM), identified(frames, limit_km)
    logs = np.full((len(frames), len(tables)), math.nan)
    for k, table in enumerate(tables):
        both = known & identified(table, limit_km)
        logs[both, k] = np.log(np.maximum(errors_km(table)[both], SMALLEST_ERROR_KM) / errors[both])
    return [exponential(one) for one in mean_estimates(logs, Resamples.of(sites(frames)))]
