"""A round's frames with their truth, in a folder that no solver sees: missing ones are rendered, then all are read."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path

from benchmark.errors import RoundError
from benchmark.frames.dataset import Frame, open_dataset, truth_digest
from benchmark.frames.frame_set import ALL, SUCCESS_METRIC, FrameFacts, FrameSet
from benchmark.frames.identity import FrameIdentity, identity_of
from benchmark.instruments import told
from benchmark.rounds.commitment import Commitment
from benchmark.rounds.drawing import DrawnFrame
from benchmark.rounds.secret import RoundKey
from generator.errors import GeneratorError
from generator.frame.render import render_dataset
from generator.processes import follow_parent

LATER = "later"
"""Part of the results for solvers that were not settled before the frames were drawn."""


def frame_folder(folder: Path, drawn: DrawnFrame) -> Path:
    """Folder of one frame with its truth."""
    return folder / f"{drawn.index:05d}"


def render_frames(
    frames: Sequence[DrawnFrame], folder: Path, jobs: int, progress: Callable[[int], None] = lambda frames: None
) -> None:
    """Render the missing frames, each into its own folder; an interrupted run is continued.

    Raises
    ------
    RoundError
        A frame cannot be rendered, or a process ended.
    """
    try:
        if jobs == 1:
            for frame in frames:
                _render(frame, folder)
                progress(1)
            return
        with ProcessPoolExecutor(min(jobs, len(frames)), get_context("spawn"), follow_parent) as pool:
            for done in as_completed([pool.submit(_render, frame, folder) for frame in frames]):
                done.result()
                progress(1)
    except (GeneratorError, OSError) as error:
        raise RoundError(f"{folder}: {error}") from error
    except BrokenProcessPool as error:
        raise RoundError(f"{folder}: a process that rendered has ended (out of memory?); use fewer --jobs") from error


def _render(frame: DrawnFrame, folder: Path) -> None:
    render_dataset(frame.scenario, frame_folder(folder, frame), exr=False)


def read_frames(drawn: Sequence[DrawnFrame], folder: Path, key: RoundKey) -> tuple[Frame, ...]:
    """Read rendered frames under the names and with the circumstances that solvers receive, in the order of the names.

    Raises
    ------
    DatasetError, RoundError
        A frame is missing, damaged, or of another scenario.
    """
    return tuple(sorted(_read(drawn, folder, key), key=lambda frame: frame.frame_id))


def _read(drawn: Sequence[DrawnFrame], folder: Path, key: RoundKey) -> Iterator[Frame]:
    for one in drawn:
        found = open_dataset(frame_folder(folder, one))
        if found.scenario_sha256 != one.scenario.sha256:
            raise RoundError(
                f"{frame_folder(folder, one)}: holds a frame of another scenario or generator; delete it and run "
                "`skybench bench round pack` again"
            )
        (frame,) = found.frames
        yield dataclasses.replace(
            frame,
            frame_id=one.name,
            index=one.index,
            observation=told(frame.observation, one.precision, key.stream("told", one.index)),
            record_path=frame.image_path.with_suffix(".json"),
        )


def check_different(frames: Sequence[Frame]) -> dict[str, FrameIdentity]:
    """Identity of each frame by its name; no two may be equal. Raises RoundError."""
    found = {frame.frame_id: identity_of(frame) for frame in frames}
    if len({identity.image_sha256 for identity in found.values()}) < len(found):
        raise RoundError("two frames have the same image, which would link them; the rules leave too little to chance")
    return found


def frame_set(found: Commitment, drawn: Sequence[DrawnFrame], frames: Sequence[Frame], later: bool = False) -> FrameSet:
    """The frames of a round, with what results say about them."""
    scenarios = "".join(sorted(frame.scenario.sha256 for frame in drawn))
    terms = found.terms
    facts = FrameFacts(
        target=terms.name,
        label=found.label,
        title=f"Round {terms.name}",
        split=LATER if later else ALL,
        condition=None,
        per_condition=None,
        grading=None,
        metric=SUCCESS_METRIC,
        definition_sha256=found.sha256,
        scenario_name=terms.name,
        scenario_sha256=hashlib.sha256(scenarios.encode()).hexdigest(),
        truth_sha256=truth_digest(frames),
        rendered_with={"skybench": terms.skybench, "generator_revision": terms.generator_revision},
        frozen=dict(terms.contestants),
    )
    return FrameSet(facts, tuple(frames))
