"""Sets of frames on which solvers are run, whatever their source, and what results say about them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from benchmark.frames.dataset import Dataset, Frame
from benchmark.frames.sites import with_sites

ALL = "all"
"""Name of the only split of frames that are not divided into splits."""
SUCCESS_METRIC = "success_10km"
"""Metric by which solvers are ranked where no task states one."""
_NAME_LETTERS = 40


@dataclass(frozen=True)
class Grading:
    """The graded quantity of a task.

    Attributes
    ----------
    name, unit : str
        The quantity in words, and its unit, which is empty for a pure number.
    values : tuple of float
        From easy to hard.
    harder : str
        Which values are harder: ``higher`` or ``lower``.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    harder: Literal["higher", "lower"]


@dataclass(frozen=True)
class FrameFacts:
    """What results say about their frames.

    Attributes
    ----------
    target : str
        Argument of `skybench bench run` that gets them: a task, a folder, a URL, a task's file.
    label : str
        Name and revision of a task, ``bortle@2``; for a folder or a dataset, its scenario's name and the start of a hash of
        scenario and truth.
    title : str
    split : str
        Split of a task or a dataset; `ALL` for a folder.
    condition : float or None
        Graded value of the frames, where only one was chosen.
    per_condition : int or None
        Number of frames at each value of a task's condition.
    grading : Grading or None
        None where the frames are not graded.
    metric : str
        Key of the metric by which solvers are ranked.
    definition_sha256 : str or None
        Hash of the meaning of the task's files, or of a dataset's manifest; None for a folder.
    scenario_name, scenario_sha256 : str
    truth_sha256 : str
        Hash of the truth of these frames, see `benchmark.frames.dataset.truth_digest`.
    rendered_with : mapping of str to str
        Versions of the generator, as recorded in the frames.
    rendered_again_with : mapping of str to str or None
        Versions of a later generator that rendered the same images and truth to the byte (`benchmark.run.confirm`).
    frozen : mapping of str to str or None
        Revisions of solvers, by name, that were fixed before the frames were drawn; None for frames that were not drawn so.
    """

    target: str
    label: str
    title: str
    split: str
    condition: float | None
    per_condition: int | None
    grading: Grading | None
    metric: str
    definition_sha256: str | None
    scenario_name: str
    scenario_sha256: str
    truth_sha256: str
    rendered_with: Mapping[str, str]
    frozen: Mapping[str, str] | None = None
    rendered_again_with: Mapping[str, str] | None = None

    @property
    def part(self) -> str:
        """Subset of the frames: the split, and the value of the condition where only one was chosen."""
        return self.split if self.condition is None else f"{self.split}-{self.condition:.12g}"

    @property
    def place(self) -> Path:
        """Folder of their results, relative to the root of all results."""
        return Path(self.label) / self.part


@dataclass(frozen=True, eq=False)
class FrameSet:
    """Frames for solvers, all from one scenario, and the facts about them."""

    facts: FrameFacts
    frames: tuple[Frame, ...]


def ungraded(dataset: Dataset, target: str, split: str = ALL, definition_sha256: str | None = None) -> FrameSet:
    """Make a set from the frames of a rendered folder or of a dataset, which no task grades."""
    facts = FrameFacts(
        target=target,
        label=ungraded_label(dataset.scenario_name, dataset.scenario_sha256, dataset.truth_sha256),
        title=dataset.scenario_name,
        split=split,
        condition=None,
        per_condition=None,
        grading=None,
        metric=SUCCESS_METRIC,
        definition_sha256=definition_sha256,
        scenario_name=dataset.scenario_name,
        scenario_sha256=dataset.scenario_sha256,
        truth_sha256=dataset.truth_sha256,
        rendered_with=dataset.provenance,
    )
    return FrameSet(facts, tuple(with_sites(dataset.frames)))


def ungraded_label(scenario_name: str, scenario_sha256: str, truth_sha256: str) -> str:
    """Label that depends only on the frames, not on where they are stored: the scenario's name and 12 digits of a hash."""
    name = re.sub(r"[^A-Za-z0-9._+-]+", "-", scenario_name).strip("-.")[:_NAME_LETTERS] or "frames"
    digest = hashlib.sha256(f"{scenario_sha256}:{truth_sha256}".encode()).hexdigest()
    return f"{name}@{digest[:12]}"
