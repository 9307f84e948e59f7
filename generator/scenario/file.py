"""Reading scenario files: strict YAML, errors that name the key, sweeps, and the hash that identifies a scenario."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml
from pydantic import ValidationError

from generator import __version__
from generator.errors import ScenarioError, TimeRangeError
from generator.files import read_text_at_most
from generator.identity.revision import generator_revision
from generator.places.times import Instant, earth_orientation
from generator.reading.strict_yaml import StrictLoader
from generator.scenario.messages import HEADER_KEYS, message
from generator.scenario.model import FrameSpec, SceneSpec, height_followers
from generator.scenario.sequences.sequence import Passage, SequenceSpec, frame_of, passage_of
from generator.scenario.strict import InputFile
from generator.scenario.variation import Draw, KeyPath, Observer, Sweep, describe, find_variations
from generator.seeds import random_stream

LARGEST_FILE_BYTES = 200_000
"""Largest size of a scenario file: hundreds of times that of a long one."""
LARGEST_FRAME_COUNT = 10_000_000
"""Largest number of frames: indices have at most seven digits."""
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
SEQUENCE_KEYS = ("path", "imu")
TIME_KEYS = ("every_s", "count")
"""Keys, at the top and in `time`, that make frames a sequence."""
Spec = TypeVar("Spec", bound=SceneSpec)


@dataclass(frozen=True)
class Scenario:
    """A validated scenario.

    Attributes
    ----------
    name, description : str
    seed : int
        Root of all random streams.
    repeats : int
        Frames, or sequences, per combination of swept values (the file's key ``frames``).
    template : dict
        The tree of frame values, sweeps and distributions included.
    axes : tuple of tuples of Sweep
        One axis per sweep or per zip name, slowest first.
    draws : tuple of Draw
        Distributions.
    source : str
        File name, for messages.
    files : tuple of InputFile
        Files that it names; their hashes are part of the scenario's hash.
    steps : int or None
        Frames in each sequence; None if frames are independent.
    """

    name: str
    description: str
    seed: int
    repeats: int
    template: dict[str, Any]
    axes: tuple[tuple[Sweep, ...], ...]
    draws: tuple[Draw, ...]
    source: str = field(compare=False)
    files: tuple[InputFile, ...] = ()
    steps: int | None = None

    @property
    def combination_count(self) -> int:
        """Number of combinations of swept values: the product of the axes' lengths."""
        return math.prod(len(axis[0].values) for axis in self.axes)

    @property
    def frames_per_combination(self) -> int:
        """Frames of one combination of swept values: repeats, times the frames of a sequence."""
        return self.repeats * (self.steps or 1)

    @property
    def frame_count(self) -> int:
        """Number of frames: combinations times repeats, times the frames of a sequence."""
        return self.combination_count * self.frames_per_combination

    @property
    def sequence_count(self) -> int:
        """Number of sequences; 0 if frames are independent."""
        return 0 if self.steps is None else self.combination_count * self.repeats

    @property
    def has_imu(self) -> bool:
        """Whether its sequences have an inertial unit."""
        return self.steps is not None and self.template.get("imu") is not None

    def sequences(self, first: int, stop: int) -> range:
        """Numbers of the sequences to which frames first to stop - 1 belong."""
        return range(0) if self.steps is None else range(first // self.steps, (stop - 1) // self.steps + 1)

    def frame(self, index: int) -> FrameSpec:
        """Return frame `index` (0 to frame_count - 1) with every value fixed; repeats of a combination stand together.

        Raises
        ------
        IndexError
            There is no such frame.
        ScenarioError
            The values are not acceptable.
        TimeRangeError
            The exposure is outside the Earth orientation table.
        """
        self._check_index(index)
        if self.steps is None:
            spec = self._read(self._values(index), FrameSpec)
        else:
            spec = frame_of(self.sequence(index // self.steps), index % self.steps)
        try:
            earth_orientation(Instant.parse(spec.time.utc_start).plus(spec.shutter_s / 2))
        except TimeRangeError as error:
            raise TimeRangeError(f"{self.source}: time.utc_start: frame {index}: {error}") from error
        return spec

    def sequence(self, number: int) -> SequenceSpec:
        """Return sequence `number` (0 to sequence_count - 1) with every value fixed; draws hold for all of its frames.

        Raises
        ------
        IndexError
            There is no such sequence.
        ScenarioError
            The values are not acceptable.
        """
        if not 0 <= number < self.sequence_count:
            raise IndexError(f"scenario '{self.name}' has {self.sequence_count} sequences, not one of number {number}")
        return self._read(self._values(number), SequenceSpec)

    def passage(self, index: int) -> Passage | None:
        """Return the place of frame `index` in its sequence; None for an independent frame. Raises as :meth:`frame`."""
        self._check_index(index)
        if self.steps is None:
            return None
        number, step = divmod(index, self.steps)
        return passage_of(self.sequence(number), number, step)

    def _check_index(self, index: int) -> None:
        if not 0 <= index < self.frame_count:
            raise IndexError(f"scenario '{self.name}' has frames 0 to {self.frame_count - 1}, not {index}")

    def _values(self, number: int) -> dict[str, Any]:
        """Return the tree of values of a frame or sequence, drawn from the streams of the scenario's seed."""
        return self.drawn(number, lambda draw: random_stream(self.seed, draw.stream, number))

    def drawn(self, number: int, stream_of: Callable[[Draw], np.random.Generator]) -> dict[str, Any]:
        """Return the tree of values of a frame or sequence, with its sweeps and draws; repeats of a combination are adjacent.

        Parameters
        ----------
        number : int
            Number of the frame or sequence.
        stream_of : callable
            Returns the random generator of a draw.

        Raises
        ------
        ScenarioError
            A draw is impossible.
        """
        chosen = self._swept(number // self.repeats)
        for draw in self.draws:
            if not draw.distribution.needs_site:
                chosen[draw.path] = draw.distribution.draw(stream_of(draw), None)
        for draw in self.draws:
            if draw.distribution.needs_site:
                observer = _observer(self.template, chosen)
                try:
                    value = draw.distribution.draw(stream_of(draw), observer)
                except ScenarioError as error:
                    what = "frame" if self.steps is None else "sequence"
                    raise ScenarioError(f"{self.source}: {'.'.join(draw.path)}: {what} {number}: {error}") from error
                chosen[draw.path] = value
        tree: dict[str, Any] = _resolve(self.template, chosen)
        return tree

    def _read(self, tree: dict[str, Any], kind: type[Spec]) -> Spec:
        """Validate a tree of values, after checking that its files are still as they were when the scenario was read."""
        files: list[InputFile] = []
        spec = _validate(tree, self.source, kind, files)
        known = {file.path: file.sha256 for file in self.files}
        for file in files:
            if known.get(file.path) != file.sha256:
                raise ScenarioError(
                    f"{self.source}: '{file.path}' changed since the scenario was read; run the command again"
                )
        return spec

    def _swept(self, combination: int) -> dict[KeyPath, Any]:
        """Return the values of the sweeps in one combination."""
        chosen: dict[KeyPath, Any] = {}
        for axis in reversed(self.axes):
            combination, position = divmod(combination, len(axis[0].values))
            chosen |= {sweep.path: sweep.values[position] for sweep in axis}
        return chosen

    def check(self) -> tuple[InputFile, ...]:
        """Validate every swept value, and both ends of every distribution, before any work.

        Returns
        -------
        tuple of InputFile
            Files that the scenario names in any of its frames, each once, by path.

        Raises
        ------
        ScenarioError
        """
        found: list[InputFile] = []
        for _ in self._representatives(found):
            pass
        named = {file.path: file for file in found}
        return tuple(named[path] for path in sorted(named))

    def _representatives(self, files: list[InputFile]) -> Iterator[SceneSpec]:
        """Yield validated frames or sequences for each swept value and both ends of each distribution; appends to `files`."""
        ends = [draw.distribution.typical() for draw in self.draws]
        first = {draw.path: values[0] for draw, values in zip(self.draws, ends, strict=True)}
        stride = 1
        for axis in reversed(self.axes):
            for position in range(len(axis[0].values)):
                values = _resolve(self.template, self._swept(position * stride) | first)
                yield _validate(values, self.source, self._kind, files)
            stride *= len(axis[0].values)
        for draw, limits in zip(self.draws, ends, strict=True):
            for limit in limits:
                values = _resolve(self.template, self._swept(0) | first | {draw.path: limit})
                yield _validate(values, self.source, self._kind, files)
        yield _validate(_resolve(self.template, self._swept(0) | first), self.source, self._kind, files)

    @property
    def _kind(self) -> type[FrameSpec] | type[SequenceSpec]:
        return FrameSpec if self.steps is None else SequenceSpec

    @functools.cached_property
    def sha256(self) -> str:
        """Hash that identifies the scenario's frames: of its content and of the generator's version and revision."""
        parts = (self.content_sha256, __version__, generator_revision())
        return hashlib.sha256(":".join(parts).encode()).hexdigest()

    @functools.cached_property
    def content_sha256(self) -> str:
        """Hash of the scenario's content, that is of its values with all defaults filled in."""
        first = {draw.path: draw.distribution.typical()[0] for draw in self.draws}
        spec = _validate(_resolve(self.template, self._swept(0) | first), self.source, self._kind)
        complete = spec.model_dump(mode="json")
        # A value that follows another one is not part of the content.
        complete["atmosphere"] |= dict.fromkeys(height_followers(self.template.get("atmosphere")))
        varied = {".".join(sweep.path): dataclasses.asdict(sweep) for axis in self.axes for sweep in axis}
        varied |= {".".join(draw.path): draw.meaning() for draw in self.draws}
        for path in [*self._swept(0), *first]:
            _forget(complete, path)
        meaning = {
            "format": 2,
            "name": self.name,
            "seed": self.seed,
            "frames": self.repeats,
            "frame": complete,
            "varied": varied,
            "axes": [[".".join(sweep.path) for sweep in axis] for axis in self.axes],
        }
        return hashlib.sha256(json.dumps(meaning, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def load_scenario(path: Path) -> Scenario:
    """Read, check and return a scenario file.

    Every swept value and both ends of every distribution are checked here, before any work.

    Raises
    ------
    ScenarioError
        The message names the file, the key, what was found and what is allowed.
    """
    try:
        text = read_text_at_most(path, LARGEST_FILE_BYTES)
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: is not UTF-8 text ({error.reason} at byte {error.start})") from error
    return parse_scenario(text, str(path))


def parse_scenario(text: str, source: str) -> Scenario:
    """Parse and check a scenario in YAML; `source` is its name in messages. Raises ScenarioError."""
    try:
        tree = yaml.load(text, Loader=StrictLoader)  # a SafeLoader underneath
    except yaml.MarkedYAMLError as error:
        where = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ScenarioError(f"{source}{where}: not valid YAML: {error.problem}") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ScenarioError(f"{source}: not valid YAML: {str(error).splitlines()[0]}") from error
    if not isinstance(tree, dict):
        raise ScenarioError(f"{source}: found {describe(tree)}, expected a mapping of keys such as site, time, camera")
    header = {key: tree.pop(key) for key in HEADER_KEYS if key in tree}
    name, description, seed = header.get("name"), header.get("description", ""), header.get("seed", 0)
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ScenarioError(f"{source}: name: found {describe(name)}, expected 1 to 64 of a-z, 0-9, _ and -")
    if not isinstance(description, str):
        raise ScenarioError(f"{source}: description: found {describe(description)}, expected text")
    if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**64:
        raise ScenarioError(f"{source}: seed: found {describe(seed)}, expected an integer from 0 to 2^64 - 1")
    repeats = header.get("frames", 1)
    if not isinstance(repeats, int) or isinstance(repeats, bool) or repeats < 1:
        raise ScenarioError(f"{source}: frames: found {describe(repeats)}, expected a positive integer")
    sweeps, draws = find_variations(tree, source)
    scenario = Scenario(
        name, description, seed, repeats, tree, _axes(sweeps, source), tuple(draws), source, steps=_steps(tree, source)
    )
    if scenario.frame_count > LARGEST_FRAME_COUNT:
        # Python prints no integer of thousands of digits.
        many = str(scenario.frame_count) if scenario.frame_count < 10**50 else "more than 10^50"
        raise ScenarioError(f"{source}: it makes {many} frames, expected at most {LARGEST_FRAME_COUNT}; lower frames")
    return dataclasses.replace(scenario, files=scenario.check())


def _steps(tree: dict[str, Any], source: str) -> int | None:
    """Return the number of frames in each sequence that a scenario's tree describes; None if frames are independent."""
    time = tree.get("time")
    if not any(key in tree for key in SEQUENCE_KEYS) and not (isinstance(time, dict) and set(time) & set(TIME_KEYS)):
        return None
    count = time.get("count") if isinstance(time, dict) else None
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise ScenarioError(
            f"{source}: time.count: found {describe(count)}, expected the number of frames of each sequence"
        )
    return count


def _axes(sweeps: list[Sweep], source: str) -> tuple[tuple[Sweep, ...], ...]:
    """Group sweeps into axes by their zip names, in the order of first appearance."""
    groups: dict[object, list[Sweep]] = {}
    for sweep in sweeps:
        groups.setdefault(sweep.zip_name or sweep.path, []).append(sweep)
    for group in groups.values():
        lengths = {len(sweep.values) for sweep in group}
        if len(lengths) > 1:
            listing = ", ".join(f"{'.'.join(sweep.path)} ({len(sweep.values)})" for sweep in group)
            raise ScenarioError(f"{source}: sweeps zipped as '{group[0].zip_name}' differ in length: {listing}")
    return tuple(tuple(group) for group in groups.values())


def _resolve(tree: Any, chosen: dict[KeyPath, Any], path: KeyPath = ()) -> Any:
    """Copy a tree, with its sweeps and distributions replaced by the chosen values."""
    if path in chosen:
        return chosen[path]
    if isinstance(tree, dict):
        return {key: _resolve(value, chosen, (*path, str(key))) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_resolve(value, chosen, (*path, str(place))) for place, value in enumerate(tree)]
    return tree


def _forget(tree: Any, path: KeyPath) -> None:
    """Remove the value at a path from a tree of mappings and lists, if present."""
    *parents, last = path
    for key in parents:
        if isinstance(tree, list):
            tree = tree[int(key)] if key.isdigit() and int(key) < len(tree) else None
        else:
            tree = tree.get(key) if isinstance(tree, dict) else None
    if isinstance(tree, dict):
        tree.pop(last, None)
    elif isinstance(tree, list) and last.isdigit() and int(last) < len(tree):
        tree[int(last)] = None


def _observer(template: dict[str, Any], chosen: dict[KeyPath, Any]) -> Observer | None:
    """Return the camera's place, at the start of its path if it has one; None if the file does not state it."""
    for place in (("site",), ("path", "waypoints", "0")):
        node: Any = template
        for key in place:
            if isinstance(node, list):
                node = node[int(key)] if int(key) < len(node) else None
            else:
                node = node.get(key) if isinstance(node, dict) else None
        found = _resolve(node, chosen, place)
        if isinstance(found, dict):
            latitude, longitude = found.get("latitude_deg"), found.get("longitude_deg")
            if isinstance(latitude, int | float) and isinstance(longitude, int | float):
                return Observer(float(latitude), float(longitude))
    return None


def _validate(tree: dict[str, Any], source: str, kind: type[Spec], files: list[InputFile] | None = None) -> Spec:
    """Validate a tree of values of a frame or sequence; the files that it names are appended to `files`."""
    try:
        return kind.model_validate(
            tree, context={"folder": Path(source).parent, "files": [] if files is None else files}
        )
    except ValidationError as error:
        # A list with rejected items is also reported as too short; the messages about the items say what is wrong.
        found = error.errors()
        inside = {problem["loc"][:depth] for problem in found for depth in range(len(problem["loc"]))}
        problems = [problem for problem in found if problem["type"] != "too_short" or problem["loc"] not in inside]
        raise ScenarioError("\n".join(message(problem, source) for problem in problems)) from error
