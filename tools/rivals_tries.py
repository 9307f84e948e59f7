"""Try settings of the peers' detectors on the dev split: python tools/rivals_tries.py [--frames 12] [--solver tetra3rs].

Each peer has five tries; ruststartracker, seiza and astrometry-net have eight. The first uses the library's defaults.
Prints a Markdown table: frames within 10 km of the truth, and fixes farther off. docs/rivals.md says which settings were
chosen. Needs the extra `peers`, and what `make rivals` installs. Solvers that are programs are tried as copies with other
settings.
"""

from __future__ import annotations

import argparse
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmark.frames.dataset import Frame, load_image
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import DEFAULT_DATA, FrameChoice
from benchmark.judge.answers import Response, judge_answer
from benchmark.protocol import SolverUnderTest
from benchmark.run.contestants import contestant_of
from benchmark.run.sessions import ask
from benchmark.solvers.registry import solver_folder
from benchmark.solvers.ruststartracker.adapter import RustStarTracker
from benchmark.solvers.tetra3rs.adapter import Tetra3rs
from benchmark.solvers.zenith_fixer.adapter import ZenithFixer
from benchmark.stats.metrics import FIX, SUCCESS_KM

CONDITIONS = (
    ("attitude", 0.0), ("bortle", 6.0), ("bortle", 7.0), ("clutter", 4000.0), ("clutter", 8000.0),
    ("thesis-mag", 3.0), ("optics", 10.0), ("weather", 1.0), ("motion", 2.0),
)  # fmt: skip
RENDERED = 24
"""Number of frames of each condition that are rendered; the first of them are tried."""
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

_GUIDE = {"bg_sub_mode": "local_median", "sigma_mode": "local_median_abs", "filtsize": 15}
"""What cedar-solve's own documentation calls the best extraction, though slow."""
_FITS = ["--no-plots", "--overwrite", "--no-tweak", "--parity", "pos", "--crpix-center"]
_BRIGHTEST = ["--objs", "100", "--depth", "30,60,100"]
_LOOSE = ["--code-tolerance", "0.03", "--pixel-error", "2"]
"""For wide fields, whose quads do not lie in the plane of the picture as the program takes them to."""
_TO_7_6 = {"FAINTEST_MAG": 7.6, "DETECTION": {}}
PROGRAMS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "cedar-solve": {
        "defaults": {},
        "local medians of 15 px, its guide's best": {"EXTRACTION": _GUIDE},
        "local medians of 15 px, 4 sigma": {"EXTRACTION": _GUIDE | {"sigma": 4}},
        "global median deviation, 4 sigma": {"EXTRACTION": {"sigma_mode": "global_median_abs", "sigma": 4}},
        "global median deviation, 4 sigma, blobs of 3 px": {
            "EXTRACTION": {"sigma_mode": "global_median_abs", "sigma": 4, "binary_open": False, "min_area": 3}
        },
    },
    "astrometry-net": {
        "its own numbers of detections": {"SETTINGS": _FITS},
        "100 detections": {"SETTINGS": [*_FITS, *_BRIGHTEST]},
        "100 detections, quads to 0.02": {"SETTINGS": [*_FITS, *_BRIGHTEST, "--code-tolerance", "0.02"]},
        "100 detections, quads to 0.03, stars to 2 px": {"SETTINGS": [*_FITS, *_BRIGHTEST, *_LOOSE]},
        "the same, detections from 5 sigma": {"SETTINGS": [*_FITS, *_BRIGHTEST, *_LOOSE, "--nsigma", "5"]},
        "the same, middle 45 deg": {"SETTINGS": [*_FITS, *_BRIGHTEST, *_LOOSE], "WIDEST_DEG": 45.0},
        "the same, middle 20 deg": {"SETTINGS": [*_FITS, *_BRIGHTEST, *_LOOSE], "WIDEST_DEG": 20.0},
        "the same, image halved": {"SETTINGS": [*_FITS, *_BRIGHTEST, *_LOOSE, "--downsample", "2"]},
    },
    "seiza": {
        "defaults, stars to 7.6": _TO_7_6,
        "200 detections, stars to 7.6": _TO_7_6 | {"DETECTION": {"max_stars": 200}},
        "centroids refined, stars to 7.6": _TO_7_6 | {"REFINED": True},
        "3 sigma, blobs of 2 px, stars to 7.6": _TO_7_6 | {"DETECTION": {"sigma": 3.0, "min_area": 2}},
        "background in tiles of 32 px, stars to 7.6": _TO_7_6 | {"DETECTION": {"tile_size": 32}},
        "blobs to 10 times as long as wide, stars to 7.6": _TO_7_6 | {"DETECTION": {"max_elongation": 10.0}},
        "defaults, stars to 6.5": {"DETECTION": {}},
        "blobs to 10 times as long as wide, stars to 6.5": {},
    },
}
"""Constants of the programs that each try changes."""
CATALOGUE = Path("celnav/data/ybsc")
"""Files that the program reads besides the folder of its solver in a checkout."""
Asks = Callable[[Frame], Response]


def change(path: Path, pattern: str, by: str) -> None:
    """Replace the one place of a file that a regular expression matches."""
    text, changed = re.subn(pattern, by, path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    if changed != 1:
        raise SystemExit(f"{path.name}: {changed} places match {pattern!r}; mend tools/rivals_tries.py")
    path.write_text(text, encoding="utf-8")


@contextmanager
def asking(name: str, words: str) -> Iterator[Asks]:
    """How a frame is put to a solver with one of its settings, with the supplied focal length only."""
    if name in TRIES:
        solver = TRIES[name][words]
        yield lambda frame: ask(solver, frame, load_image(frame))
        return
    folder = solver_folder(name).folder
    with tempfile.TemporaryDirectory() as root:
        copy = Path(root) / "benchmark" / "solvers" / name
        shutil.copytree(folder, copy)
        shutil.copytree(folder.parents[2] / CATALOGUE, Path(root) / CATALOGUE)
        for constant, value in PROGRAMS[name][words].items():
            change(copy / "program.py", rf"^({constant}\b.*?) = (\[\n( .*\n)*\]|.*)$", rf"\g<1> = {value!r}")
        change(copy / "solver.yaml", r"^focal_retries: true$", "focal_retries: false")
        session = contestant_of(copy).make_session(1)
        try:
            yield lambda frame: session.answer(frame, None)
        finally:
            session.close()


def main() -> None:
    tries = {name: list(settings) for name, settings in (*TRIES.items(), *PROGRAMS.items())}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=12, help="of each condition")
    parser.add_argument("--solver", choices=sorted(tries), action="append")
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA)
    asked = parser.parse_args()
    heads = [f"{task} {condition:g}" for task, condition in CONDITIONS]
    print(f"| solver | settings | {' | '.join(heads)} | all |\n|-|-|{'-|' * len(heads)}-|", flush=True)
    sets = [
        open_frames(task, FrameChoice("dev", RENDERED, condition, asked.data, 1)).frames[: asked.frames]
        for task, condition in CONDITIONS
    ]
    for name in asked.solver or tries:
        for words in tries[name]:
            cells, right, wrong = [], 0, 0
            with asking(name, words) as asks:
                for frames in sets:
                    scores = [judge_answer(frame, asks(frame), None).score for frame in frames]
                    hits = sum(score.error_km < SUCCESS_KM for score in scores)
                    cells.append(str(hits))
                    right += hits
                    wrong += sum(score.status == FIX for score in scores) - hits
            total = sum(map(len, sets))
            print(f"| {name} | {words} | {' | '.join(cells)} | {right} of {total}, {wrong} wrong |", flush=True)


if __name__ == "__main__":
    main()
