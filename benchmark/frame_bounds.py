"""Cramér-Rao bounds of all frames of a dataset folder, from its records and its truth table."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmark.cramer_rao import EXACT, AttitudePrior, StarLight, bound_km, star_light
from benchmark.dataset import Frame, open_dataset
from benchmark.errors import DatasetError

F8 = NDArray[np.float64]

_STREAK_COLUMNS = ("start_u_px", "start_v_px", "end_u_px", "end_v_px")


def frame_bounds(folder: Path, prior: AttitudePrior = EXACT) -> dict[str, float]:
    """Least root mean square position error of each frame that has a bound, km, by frame id.

    Parameters
    ----------
    folder : Path
        Dataset folder; its records say the width of the point spread function (``optics.psf_sigma_px``), without which
        a frame has no bound. Where the truth table has the ends of the stars' streaks, they count.
    prior : AttitudePrior
        What the solver was told of the attitude.

    Raises
    ------
    DatasetError
    """
    bounds = {frame_id: bound_km(light, prior) for frame_id, light in frame_lights(folder).items()}
    return {frame_id: bound for frame_id, bound in bounds.items() if math.isfinite(bound)}


def frame_lights(folder: Path) -> dict[str, StarLight]:
    """Light of each frame whose record says the width of the point spread function, by frame id."""
    streaks = _read_streaks(folder / "stars.parquet")
    lights = {}
    for frame in open_dataset(folder).frames:
        sigma_px = _psf_sigma_px(folder / f"{frame.frame_id}.json")
        if sigma_px is not None:
            lights[frame.frame_id] = star_light(frame, sigma_px, _of_frame(streaks, frame))
    return lights


def _of_frame(streaks: Mapping[str, F8], frame: Frame) -> F8 | None:
    found = streaks.get(frame.frame_id)
    return found if found is not None and len(found) == len(frame.truth.uv) else None


def _psf_sigma_px(path: Path) -> float | None:
    optics = json.loads(path.read_text(encoding="utf-8")).get("optics", {})
    sigma_px = optics.get("psf_sigma_px") if isinstance(optics, dict) else None
    if sigma_px is None:
        return None
    if isinstance(sigma_px, bool) or not isinstance(sigma_px, int | float) or not 0.0 < sigma_px < 1000.0:
        raise DatasetError(f"{path}: optics.psf_sigma_px must be a positive number of pixels, found {sigma_px!r}")
    return float(sigma_px)


def _read_streaks(path: Path) -> dict[str, F8]:
    """End minus start of each star's streak by frame, in the table's order; empty where the table has no such columns."""
    try:
        names = pq.read_schema(path).names
        if any(name not in names for name in _STREAK_COLUMNS):
            return {}
        table = pq.read_table(path, columns=["frame_id", *_STREAK_COLUMNS])
    except (pa.ArrowException, OSError) as error:
        raise DatasetError(f"{path}: not a readable Parquet file ({error}); render the dataset again") from error
    frame_ids = np.asarray(table["frame_id"].to_pylist(), dtype=str)
    start_u, start_v, end_u, end_v = (table[name].to_numpy() for name in _STREAK_COLUMNS)
    streak = np.nan_to_num(np.column_stack((end_u - start_u, end_v - start_v)).astype(np.float64))
    order = np.argsort(frame_ids, kind="stable")
    names_, starts = np.unique(frame_ids[order], return_index=True)
    return dict(zip(names_.tolist(), np.split(streak[order], starts[1:]), strict=True)) if len(frame_ids) else {}
