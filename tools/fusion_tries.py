"""Try the standard deviation for fused solvers without a covariance: python tools/fusion_tries.py [--data out/tasks].

Takes the positions of each unfused solver on the leaderboard's `uav@1` from its row, and passes them through
`benchmark.solvers.fusion` with one value of `OWN_SIGMA_KM` after another; no frame is solved again. Prints Markdown: frames
within 30 km after 8 to 1 frames, fixes beyond, and the mean NEES (ideally 2). docs/rivals.md contains dated results.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.frames.dataset import Frame
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import FrameChoice
from benchmark.protocol import Answer
from benchmark.run.packed import read_packed
from benchmark.solvers import fusion
from benchmark.solvers.registry import solvers_by_themselves
from benchmark.stats.metrics import FIX
from celnav.sequences.track import moved, offset_km

SIGMAS_KM = (0.5, 1.0, 3.0, 10.0, 30.0)
TRACKS_BY_ITSELF = "skybench"


def place_of(frame: Frame) -> tuple[float, float]:
    return frame.conditions.latitude_deg, frame.conditions.longitude_deg


def stated(frame: Frame, row: Any) -> Answer:
    """The answer in a row, without the covariance."""
    if row.status != FIX:
        return Answer(ok=False, reason=row.reason)
    return Answer(True, "", *moved(*place_of(frame), row.error_east_km, row.error_north_km))


def outcome(frames: Sequence[Frame], answers: Sequence[Answer]) -> list[str]:
    """Table cells for one value."""
    filtered = fusion.Fusion()
    right: dict[int, int] = {}
    wrong, nees = 0, []
    for frame, alone in zip(frames, answers, strict=True):
        assert frame.observation.sequence is not None
        answer = filtered.answer(alone, frame.observation)
        if answer.lat_deg is None or answer.lon_deg is None or answer.cov_km2 is None:
            continue
        off = offset_km(answer.lat_deg, answer.lon_deg, *place_of(frame))
        near, seen = math.hypot(*off) < 30.0, frame.observation.sequence.index + 1
        right[seen] = right.get(seen, 0) + near
        wrong += not near
        nees.append(float(off @ np.linalg.solve(answer.cov_km2, off)))
    return [" ".join(str(right[seen]) for seen in sorted(right, reverse=True)), str(wrong), f"{np.mean(nees):.2f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("out/tasks"))
    frames = open_frames("uav@1", FrameChoice(data=parser.parse_args().data)).frames
    print("| solver | km | right | wrong | NEES |\n|-|-|-|-|-|")
    for row in read_packed(Path("results/leaderboard/uav@1/dev.json")):
        if row.solver not in solvers_by_themselves() or row.solver == TRACKS_BY_ITSELF:
            continue
        found = {one.frame_id: one for one in row.frames.itertuples()}
        answers = [stated(frame, found[frame.frame_id]) for frame in frames]
        for fusion.OWN_SIGMA_KM in SIGMAS_KM:
            print(f"| {row.solver} | {fusion.OWN_SIGMA_KM:g} | {' | '.join(outcome(frames, answers))} |")


if __name__ == "__main__":
    main()
