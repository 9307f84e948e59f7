"""Results of many solvers on many frames: one random table, drawn anew for each solver column by column."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from unit.benchmark.fake_results import TASKS, FakeSolver, write_results

from benchmark.run.results import FRAMES_NAME, MATCHES_NAME, SUMMARY_NAME, read_summary, result_folder, write_result
from benchmark.stats.metrics import FIX

LEVELS = len(TASKS[0].levels)
ANSWERS = ["status", "reason", "error_km", "error_east_km", "error_north_km", "cov_ee_km2", "cov_en_km2", "cov_nn_km2",
           "confidence", "n_detections", "n_detected_stars", "n_matches", "n_correct", "time_ms", "detect_ms", "solve_ms",
           "peak_memory_mib"]  # fmt: skip


def write_large(root: Path, solvers: int, frames: int) -> Path:
    """Results of `solvers` on about `frames` frames of one task, in the documented layout."""
    write_results(root, TASKS[:1], (FakeSolver("solver-00", 1.0, 40.0),), max(frames // LEVELS, 1), ("own",))
    (folder,) = (path.parent for path in root.rglob(FRAMES_NAME))
    table, matches = pq.read_table(folder / FRAMES_NAME), pq.read_table(folder / MATCHES_NAME)
    source = read_summary(folder / SUMMARY_NAME).provenance
    for number in range(1, solvers):
        name = f"solver-{number:02d}"
        own = replace(source, solver=replace(source.solver, target=name), key=f"{number:012d}")
        write_result(result_folder(root, name, own), name, _drawn(table, number), matches, own)
    return root


def _drawn(table: pa.Table, number: int) -> pa.Table:
    """Another solver's outcomes: whole answers in another order within their condition."""
    frames: pd.DataFrame = table.to_pandas()
    draws = np.random.default_rng(number).random(len(frames))
    order = np.lexsort((draws, frames["condition"]))
    answers = frames[ANSWERS].iloc[order].reset_index(drop=True)
    frames = frames.sort_values("condition", kind="stable", ignore_index=True).assign(**answers)
    fixed = frames["status"] == FIX
    frames = frames.assign(
        lat_deg=frames["true_latitude_deg"].where(fixed), lon_deg=frames["true_longitude_deg"].where(fixed)
    ).sort_values("index", ignore_index=True)
    return pa.Table.from_pandas(frames, schema=table.schema, preserve_index=False)


if __name__ == "__main__":
    write_large(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
