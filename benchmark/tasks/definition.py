"""Definition of a task: strict files, and the hash that freezes their meaning."""

from __future__ import annotations

import hashlib
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from benchmark.errors import TaskError
from benchmark.instruments import Precision
from benchmark.stats.intervals import wilson
from benchmark.wrong_key import wrong_key
from benchmark.yaml_file import TextLoader, read_yaml
from generator.errors import ScenarioError
from generator.scenario.file import Scenario, parse_scenario
from generator.scenario.strict import Strict, listed

FOLDER = Path(__file__).parent
LARGEST_FILE_BYTES = 100_000
KM_PER_ARCSEC = 6371.0088 * math.pi / (180.0 * 3600.0)
"""Distance on a sphere of the Earth's mean radius (IUGG) per angle at its centre."""
TASK_SUFFIX = ".task.yaml"
SplitName = Literal["dev", "test"]
SPLITS: tuple[SplitName, ...] = ("dev", "test")
Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,39}$")]
FEWEST_VALUES, MOST_VALUES = 3, 40
"""Least and largest number of values of a task's condition."""
Numbers = Annotated[tuple[float, ...], Field(min_length=FEWEST_VALUES, max_length=MOST_VALUES), BeforeValidator(listed)]
Sigma = Annotated[float, Field(ge=0, le=360)]
Level = Annotated[Sigma | tuple[Sigma, ...], BeforeValidator(listed)]
RETIRED = {
    "calibration": "one of its seven conditions decided it; unknown-camera asks the same in fine steps",
}
"""Retired tasks of earlier versions, with the reason."""
SUCCESS_PATTERN = re.compile(r"success_(\d+(?:\.\d+)?)(km|arcsec|px)")


class Condition(Strict):
    """The graded quantity."""

    name: Annotated[str, Field(min_length=3, max_length=80)]
    """In words."""
    unit: Annotated[str, Field(max_length=20)]
    """Empty for a pure number."""
    values: Numbers
    """From easy to hard; the values of the scenario's sweep (in its order), of `instruments`, or of the frames so far."""
    harder: Literal["higher", "lower"]
    """Which values are harder."""

    @model_validator(mode="after")
    def _from_easy_to_hard(self) -> Condition:
        order = sorted(set(self.values), reverse=self.harder == "lower")
        if order != list(self.values):
            raise ValueError("values must run from easy to hard, each once")
        return self


class Instruments(Strict):
    """Precision with which solvers receive a frame's circumstances: one number for all conditions, or one for each.

    Errors are drawn anew for every frame (`benchmark.instruments`), and solvers receive the standard deviations. Quantities
    without an entry are supplied exactly.
    """

    tilt_sigma_deg: Level = 0.0
    """Standard deviation of the supplied vertical about each horizontal axis."""
    heading_sigma_deg: Level = 0.0
    """Standard deviation of the supplied heading; with 180 or more the supplied heading is random and declared unknown."""
    tilt_bias_sigma_deg: Level = 0.0
    """Standard deviation of an additional error of the vertical, constant in the camera throughout a sequence."""
    utc_sigma_s: Level = 0.0
    """Standard deviation of the time."""
    focal_sigma: Level = 0.0
    """Standard deviation of the focal length, relative."""
    focal_range: Level = 0.0
    """Half-width of an additional, uniform, relative error of the focal length; the stated standard deviation includes it."""
    principal_point_sigma_px: Level = 0.0
    """Standard deviation of each coordinate of the principal point."""
    distortion_sigma: Level = 0.0
    """Standard deviation of the lens's k1; above 0 the lens is supplied without its distortion."""
    pressure_sigma_hpa: Level = 0.0
    temperature_sigma_c: Level = 0.0

    @property
    def lengths(self) -> set[int]:
        """Numbers of levels of the quantities that have one value per condition."""
        return {len(given) for _, given in self if isinstance(given, tuple)}

    def at(self, level: int) -> Precision:
        """Precision at a condition."""
        return Precision(**{name: given[level] if isinstance(given, tuple) else given for name, given in self})


class Split(Strict):
    """One of the two sets of frames."""

    seed: Annotated[int, Field(ge=0, lt=2**63)]
    """Seed from which all its random streams derive."""


class Metric(Strict):
    """The metric by which the task's leaderboard is sorted."""

    name: Annotated[str, Field(pattern=f"^{SUCCESS_PATTERN.pattern}$")] = "success_10km"
    """Share of the frames with a fix within a limit of the truth. The limit is in km, or is an angle at the Earth's centre,
    which equals that between the true and the found vertical among the stars, in arcsec or in pixels at the image's
    middle."""
    unit: Literal["1"] = "1"
    better: Literal["higher"] = "higher"


class TaskDefinition(Strict):
    """The content of a task's file."""

    name: Name
    revision: Annotated[int, Field(ge=1, le=1000)]
    """Rises with every change of meaning; results of different revisions are never compared."""
    title: Annotated[str, Field(min_length=10, max_length=120)]
    licence: Literal["CC-BY-4.0"]
    """Licence of the frames."""
    scenario: Annotated[str, Field(pattern=r"^[a-z0-9-]+\.scenario\.yaml$")]
    """File next to this one, without seed and number of frames."""
    condition: Condition
    image: Literal["raw", "photo"] = "raw"
    """Image that solvers receive: the sensor's numbers, or the luma of the developed JPEG."""
    instruments: Instruments = Instruments()
    splits: dict[SplitName, Split]
    metric: Metric
    frames_per_condition: Annotated[int, Field(ge=10, le=10_000)]
    """For a task of sequences, the number of sequences."""
    half_width_points: Annotated[float, Field(gt=0, lt=50)]
    """Half of the widest 95 % interval of the metric at one condition, in percentage points, to one decimal."""

    @model_validator(mode="after")
    def _consistent(self) -> TaskDefinition:
        if set(self.splits) != set(SPLITS):
            raise ValueError(f"splits: give {' and '.join(SPLITS)}")
        if self.splits["dev"].seed == self.splits["test"].seed:
            raise ValueError("splits: dev and test must have different seeds")
        if self.instruments.lengths - {len(self.condition.values)}:
            raise ValueError(f"instruments: give one value for each of the {len(self.condition.values)} conditions")
        wide = widest_half_width_points(self.frames_per_condition)
        if abs(wide - self.half_width_points) > 0.05:
            raise ValueError(f"half_width_points: {self.frames_per_condition} frames give {wide:.1f}")
        return self


def widest_half_width_points(frames: int) -> float:
    """Half of the widest 95 % interval (Wilson) of a proportion of frames, in percentage points."""
    low, high = wilson(frames // 2, frames)
    return 50.0 * (high - low)


@dataclass(frozen=True)
class Task:
    """A task as it is run: definition, text of the scenario, and the hash of both.

    Attributes
    ----------
    definition : TaskDefinition
    definition_text : str
        The definition as YAML.
    scenario_text : str
        The scenario as YAML, without seed and number of frames.
    sha256 : str
        Hash of the meaning of definition and scenario: formatting and comments do not count.
    """

    definition: TaskDefinition
    definition_text: str
    scenario_text: str
    sha256: str

    @property
    def label(self) -> str:
        """Name and revision, as in ``bortle@2``."""
        return f"{self.definition.name}@{self.definition.revision}"

    @property
    def graded_by_what_is_told(self) -> bool:
        """Whether the conditions differ in what solvers are told, not in the scenario."""
        return bool(self.definition.instruments.lengths)

    @property
    def sequence_length(self) -> int:
        """Number of frames in each sequence; 1 for a task of single frames.

        A task of sequences is graded by the number of frames that a solver has seen of a sequence.
        """
        return self.scenario_of("dev").steps or 1

    @property
    def limit_km(self) -> float:
        """Error below which a frame is a success."""
        found = SUCCESS_PATTERN.fullmatch(self.definition.metric.name)
        assert found is not None
        limit, unit = float(found[1]), found[2]
        if unit == "px":
            limit *= math.degrees(math.atan(1.0 / self.scenario_of("dev").frame(0).camera.f_px)) * 3600.0
        return limit if unit == "km" else limit * KM_PER_ARCSEC

    @property
    def metric_key(self) -> str:
        """Key of the metric in results, which state the limit in km."""
        return f"success_{self.limit_km:.4g}km"

    def text_of(self, split: SplitName) -> str:
        """The scenario file of a split."""
        seed, frames = self.definition.splits[split].seed, self.definition.frames_per_condition
        if self.graded_by_what_is_told:  # no image may occur at two conditions: copies would link them
            frames *= len(self.definition.condition.values)
        return f"seed: {seed}\nframes: {frames}\n{self.scenario_text}"

    def scenario_of(self, split: SplitName) -> Scenario:
        """The scenario of a split."""
        return parse_scenario(self.text_of(split), f"{self.definition.scenario} ({split})")


def task_names() -> tuple[str, ...]:
    """Names of all tasks, sorted."""
    return tuple(sorted(path.name.removesuffix(TASK_SUFFIX) for path in FOLDER.glob(f"*{TASK_SUFFIX}")))


def load_task_file(path: Path) -> Task:
    """Read and check a user's own task from its file, ``NAME.task.yaml``, with its scenario next to it.

    Raises
    ------
    TaskError
        Its files are invalid, or it has the name of a task of skybench but differs from it.
    """
    name = path.name.removesuffix(TASK_SUFFIX)
    if not path.is_file():
        raise TaskError(f"{path}: no such file")
    task = load_task(name, path.parent)
    if name in task_names() and load_task(name).sha256 != task.sha256:
        raise TaskError(f"{path}: {name} is the name of a task of skybench; choose another for yours")
    return task


def load_task(name: str, folder: Path = FOLDER) -> Task:
    """Read and check a task by its name, with or without its revision.

    Raises
    ------
    TaskError
        There is no such task or revision, or its files are invalid.
    """
    bare, _, revision = name.partition("@")
    if bare in RETIRED and folder == FOLDER:
        raise TaskError(f"{bare}: this task is retired: {RETIRED[bare]}")
    path = folder / f"{bare}{TASK_SUFFIX}"
    if not path.is_file() or path.parent != folder:
        known = ", ".join(sorted(file.name.removesuffix(TASK_SUFFIX) for file in folder.glob(f"*{TASK_SUFFIX}")))
        raise TaskError(f"unknown task {name!r}; known: {known}")
    try:
        definition = TaskDefinition.model_validate(read_yaml(path, LARGEST_FILE_BYTES, TaskError))
    except ValidationError as error:
        raise TaskError(f"{path}: {wrong_key(error, TaskDefinition)}") from error
    if definition.name != bare:
        raise TaskError(f"{path}: name is {definition.name!r}, the file's name says {bare!r}")
    if revision and revision != str(definition.revision):
        raise TaskError(
            f"{name}: this version has revision {definition.revision} of it; use {bare}@{definition.revision}"
        )
    beside = folder / definition.scenario
    # All scalars as texts: the hash is of what is written, however YAML would interpret it.
    trees = [read_yaml(file, LARGEST_FILE_BYTES, TaskError, TextLoader) for file in (path, beside)]
    for key in ("seed", "frames"):
        if key in trees[1]:
            raise TaskError(f"{beside}: {key}: comes from the task; leave it out")
    texts = [file.read_text(encoding="utf-8") for file in (path, beside)]
    task = Task(definition, texts[0], texts[1], meaning_sha256(*trees))
    _check_scenario(task, beside)
    return task


def meaning_sha256(definition: dict[str, Any], scenario: dict[str, Any]) -> str:
    """SHA-256 of the meaning of a task's two files, given as trees of texts."""
    meaning = json.dumps([definition, scenario], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(meaning.encode()).hexdigest()


def _check_scenario(task: Task, path: Path) -> None:
    try:
        scenario = task.scenario_of("dev")
    except ScenarioError as error:
        raise TaskError(str(error)) from error
    develop = scenario.frame(0).sensor.develop
    if task.definition.image == "photo" and (
        develop is None or develop.photo is None or develop.photo.format != "jpeg"
    ):
        raise TaskError(f"{path}: sensor.develop.photo: solvers get the photograph, so give one, as JPEG")
    n = len(task.definition.condition.values)
    so_far = tuple(float(n) for n in range(scenario.steps or 1, 0, -1))
    if scenario.steps is not None and (task.definition.condition.values != so_far or task.graded_by_what_is_told):
        raise TaskError(
            f"{path}: time.count: a task of sequences is graded by their frames so far, from {scenario.steps} to 1"
        )
    expected = 1 if task.graded_by_what_is_told or scenario.steps is not None else n
    if scenario.combination_count != expected or len(scenario.axes) > 1:
        raise TaskError(
            f"{path}: sweeps {scenario.combination_count} combinations, the task needs {expected} on one axis"
        )
    for axis in scenario.axes:
        for sweep in axis:
            numbers = [value for value in sweep.values if isinstance(value, int | float)]
            if (
                len(axis) == 1
                and len(numbers) == n
                and not all(map(math.isclose, numbers, task.definition.condition.values))
            ):
                raise TaskError(f"{path}: sweep {'.'.join(sweep.path)} differs from the task's condition values")
