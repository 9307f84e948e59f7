"""Definition of a task of photographs: a strict file with the SHA-256 of every photograph and the supplied camera."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from benchmark.errors import TaskError
from benchmark.place import Place
from benchmark.wrong_key import wrong_key
from benchmark.yaml_file import read_yaml
from generator.scenario.strict import Strict, listed

FOLDER = Path(__file__).parent
SUFFIX = ".yaml"
LARGEST_FILE_BYTES = 100_000
LARGEST_SOURCE_BYTES = 200_000_000
Values = Annotated[tuple[float, ...], Field(min_length=1, max_length=40), BeforeValidator(listed)]


class Condition(Strict):
    """The graded quantity; each photograph gets the smallest of these values that is not below its own."""

    name: Annotated[str, Field(min_length=3, max_length=80)]
    unit: Annotated[str, Field(max_length=20)]
    values: Values
    """From easy to hard."""
    harder: Literal["higher", "lower"]


FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}$")]


class Source(Strict):
    """A file: a photograph, or the centroids of a night."""

    file: FileName
    published: FileName | None = None
    """Name under which it is published, where another file of the task has the same."""
    condition: float | None = None
    """Missing for a night's centroids, of which each frame has its own."""
    bytes: Annotated[int, Field(gt=0, le=LARGEST_SOURCE_BYTES)]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    address: Annotated[str, Field(pattern=r"^https://[!-~]+$")] | None = None
    """Address of the file; by default the task's address and the file's name."""


class DrawnFrame(Strict):
    """A frame of which the centroids are known, and drawn (`benchmark.importing.drawn_centroids`)."""

    frame: FileName
    """Name of its FF file in the night's centroids."""
    night: FileName
    """The source that has them."""
    condition: float


class Site(Strict):
    """Position of the camera."""

    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    longitude_deg: Annotated[float, Field(ge=-360, le=360)]
    height_m: Annotated[float, Field(ge=-500, le=9000)]


class RealTaskDefinition(Strict):
    """The content of a task's file."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,39}$")]
    revision: Annotated[int, Field(ge=1, le=1000)]
    title: Annotated[str, Field(min_length=10, max_length=120)]
    licence: Annotated[str, Field(min_length=3, max_length=40)]
    """SPDX identifier of the photographs' licence."""
    credit: Annotated[str, Field(min_length=3, max_length=300)]
    origin: Annotated[str, Field(min_length=3, max_length=300)]
    """Where the photographs were published."""
    camera: Annotated[str, Field(pattern=r"^[a-z0-9-]+\.camera\.json$")]
    """File next to this one: the camera that solvers receive."""
    calibrated_on: str
    attitude: Literal["night", "time"] = "night"
    """Supplied attitude of the mount: that of another night, or predicted for the time of each photograph."""
    site: Site
    condition: Condition
    address: Annotated[str, Field(pattern=r"^https://[!-~]+/$")] | None = None
    sources: Annotated[tuple[Source, ...], Field(min_length=1, max_length=2000), BeforeValidator(listed)]
    drawn: Annotated[tuple[DrawnFrame, ...], Field(max_length=2000), BeforeValidator(listed)] = ()
    """Frames of a task of centroids, which has no photographs."""

    @property
    def conditions(self) -> tuple[float, ...]:
        """Condition of each frame."""
        return tuple(each.condition for each in self.drawn or self.sources if each.condition is not None)

    @model_validator(mode="after")
    def _consistent(self) -> RealTaskDefinition:
        if strangers := set(self.conditions) - set(self.condition.values):
            raise ValueError(f"condition {min(strangers):g} is none of {self.condition.values}")
        names = [source.file for source in self.sources]
        if len(set(names)) != len(names):
            raise ValueError("sources: a file is listed twice")
        if unknown := {each.night for each in self.drawn} - set(names):
            raise ValueError(f"drawn: night {min(unknown)} is none of the sources")
        if len({each.frame for each in self.drawn}) != len(self.drawn):
            raise ValueError("drawn: a frame is listed twice")
        if any((source.condition is None) != bool(self.drawn) for source in self.sources):
            raise ValueError(
                "condition: each photograph has one; of centroids each drawn frame has one, not their file"
            )
        return self


@dataclass(frozen=True)
class RealTask:
    """A task of photographs.

    Attributes
    ----------
    definition : RealTaskDefinition
    camera_file : Path
    sha256 : str
        Hash of the meaning of the definition and of the camera's file.
    """

    definition: RealTaskDefinition
    camera_file: Path
    sha256: str

    @property
    def label(self) -> str:
        """Name and revision, as in ``allsky-real@1``."""
        return f"{self.definition.name}@{self.definition.revision}"

    @property
    def place(self) -> Place:
        """Position of the camera."""
        site = self.definition.site
        return Place(site.latitude_deg, site.longitude_deg, site.height_m)

    def address_of(self, source: Source) -> str | None:
        """Where a file can be fetched; None where no address is known."""
        if source.address is not None or self.definition.address is None:
            return source.address
        return f"{self.definition.address}{source.file}"


def real_task_names() -> tuple[str, ...]:
    """Names of all tasks of photographs, sorted."""
    return tuple(sorted(path.name.removesuffix(SUFFIX) for path in FOLDER.glob(f"*{SUFFIX}")))


def is_real_task(target: str) -> bool:
    """Whether a target is the name of a task of photographs, with or without its revision."""
    return target.partition("@")[0] in real_task_names()


def load_real_task(name: str) -> RealTask:
    """Read a task of photographs by its name, with or without its revision.

    Raises
    ------
    TaskError
        There is no such task or revision, or its files are invalid.
    """
    bare, _, revision = name.partition("@")
    if bare not in real_task_names():
        raise TaskError(f"unknown task of photographs {name!r}; known: {', '.join(real_task_names())}")
    path = FOLDER / f"{bare}{SUFFIX}"
    tree = read_yaml(path, LARGEST_FILE_BYTES, TaskError)
    try:
        definition = RealTaskDefinition.model_validate(tree)
    except ValidationError as error:
        raise TaskError(f"{path}: {wrong_key(error, RealTaskDefinition)}") from error
    if revision and revision != str(definition.revision):
        raise TaskError(
            f"{name}: this version has revision {definition.revision} of it; use {bare}@{definition.revision}"
        )
    camera_file = FOLDER / definition.camera
    told = json.loads(camera_file.read_text(encoding="utf-8"))
    # The place from which photographs are fetched does not change them.
    kept = {key: value for key, value in tree.items() if key not in ("address", "origin", "credit")}
    kept["sources"] = [{key: each[key] for key in each if key != "address"} for each in tree["sources"]]
    keys = ("camera", "attitude") if definition.attitude == "night" else ("camera", "attitude", "calibration")
    meaning = json.dumps([kept, {key: told[key] for key in keys}], sort_keys=True)
    return RealTask(definition, camera_file, hashlib.sha256(meaning.encode()).hexdigest())
