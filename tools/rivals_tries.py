"""Try settings of the peers' detectors on the dev split: python tools/rivals_tries.py [--frames 12] [--solver tetra3rs].

Each peer has five tries, ruststartracker eight, the first with the library's defaults. Prints a Markdown table: frames
within 10 km of the truth, and fixes farther off. docs/rivals.md says which settings were taken. Needs the extra `peers` and
ruststartracker.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmark.frames.dataset import load_image
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import DEFAULT_DATA, FrameChoice
from benchmark.judge.answers import judge_answer
from benchmark.protocol import SolverUnderTest
from benchmark.run.sessions import ask
from benchmark.solvers.ruststartracker.adapter import RustStarTracker
from benchmark.solvers.tetra3rs.adapter import Tetra3rs
from benchmark.solvers.zenith_fixer.adapter import ZenithFixer
from benchmark.stats.metrics import FIX, SUCCESS_KM

CONDITIONS = (
    ("attitude", 0.0), ("bortle", 6.0), ("bortle", 7.0), ("clutter", 4000.0), ("clutter", 8000.0),
    ("thesis-mag", 3.0), ("optics", 10.0), ("weather", 1.0), ("motion", 2.0),
)  # fmt: skip
RENDERED = 24
"""Frames of each condition that are rendered; the first of them are tried."""
_STRICT = {
    "matched_filter_sigma": None,
    "max_elongation": 1.6,
    "max_sharpness": 0.7,
    "min_pixels": 5,
    "deblend": "reject",
}
_USUAL: dict[str, Any] = {"threshold_quantile": 0.99, "extraction": {}}
TRIES: Mapping[str, Mapping[str, SolverUnderTest]] = {
    "tetra3rs": {
        "defaults": Tetra3rs({}),
        "no matched filter": Tetra3rs({"matched_filter_sigma": None}),
        "no matched filter, round and soft blobs of 5 px": Tetra3rs(_STRICT),
        "local background, 64 px": Tetra3rs({"local_bg_block_size": 64}),
        "sharpness to 0.7, deblended": Tetra3rs({"max_sharpness": 0.7, "deblend": "reject"}),
    },
    "ruststartracker": {
        "defaults": RustStarTracker(**_USUAL, min_matches=10),
        "to the brightest pixel in 100,000": RustStarTracker(**_USUAL, min_matches=10, brightest_quantile=0.99999),
        "8 matches": RustStarTracker(**_USUAL, min_matches=8),
        "8 matches, to the brightest pixel in 1,000": RustStarTracker(
            **_USUAL, min_matches=8, brightest_quantile=0.999
        ),
        "8 matches, 3 to 100 px, threshold 0.995": RustStarTracker(min_matches=8),
        "9 matches, 3 to 100 px, threshold 0.995": RustStarTracker(min_matches=9),
        "10 matches, 3 to 100 px, threshold 0.995": RustStarTracker(),
        "12 matches, 3 to 100 px, threshold 0.995": RustStarTracker(min_matches=12),
    },
    "zenith-fixer": {
        "60, sigma 1.0 px": ZenithFixer(psf_sigma_px=1.0),
        "60, sigma 1.5 px": ZenithFixer(),
        "60, sigma 2.0 px": ZenithFixer(psf_sigma_px=2.0),
        "30, sigma 1.0 px": ZenithFixer(most=30, psf_sigma_px=1.0),
        "120, sigma 1.5 px": ZenithFixer(most=120),
    },
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=12, help="of each condition")
    parser.add_argument("--solver", choices=sorted(TRIES), action="append")
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA)
    asked = parser.parse_args()
    heads = [f"{task} {condition:g}" for task, condition in CONDITIONS]
    print(f"| solver | settings | {' | '.join(heads)} | all |\n|-|-|{'-|' * len(heads)}-|", flush=True)
    sets = [
        open_frames(task, FrameChoice("dev", RENDERED, condition, asked.data, 1)).frames[: asked.frames]
        for task, condition in CONDITIONS
    ]
    for name in asked.solver or TRIES:
        for words, solver in TRIES[name].items():
            cells, right, wrong = [], 0, 0
            for frames in sets:
                scores = [judge_answer(frame, ask(solver, frame, load_image(frame)), None).score for frame in frames]
                hits = sum(score.error_km < SUCCESS_KM for score in scores)
                cells.append(str(hits))
                right += hits
                wrong += sum(score.status == FIX for score in scores) - hits
            total = sum(map(len, sets))
            print(f"| {name} | {words} | {' | '.join(cells)} | {right} of {total}, {wrong} wrong |", flush=True)


if __name__ == "__main__":
    main()
