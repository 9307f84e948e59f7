"""Reading scenario files: strict YAML, errors that name the key, sweeps, and the hash that identifies a scenario."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import hashlib
import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import BaseModel, ValidationError

from generator import __version__
from generator.errors import ScenarioError
from generator.scenario.model import FrameSpec
from generator.scenario.strict import InputFile
from generator.scenario.variation import Draw, KeyPath, Observer, Sweep, describe, find_variations
from generator.seeds import random_stream

LARGEST_FILE_BYTES = 1_000_000
"""Hundreds of times the size of a long scenario."""
LARGEST_FRAME_COUNT = 10_000_000
"""Indices of at most seven digits."""
HEADER_KEYS = ("name", "description", "seed", "frames")
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_UNIT_SUFFIX = re.compile(
    r"_(deg|rad|arcsec|arcmin|nm|um|mm|cm|m|km|s|ms|us|min|h|px|e|e_s|dn|mag|hpa|pa|mbar|c|k|f|du)$"
)


class _StrictLoader(yaml.SafeLoader):
    """Safe YAML without duplicate keys, aliases or dates made of times."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.constructor.ConstructorError(None, None, "aliases are not allowed", event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            if key_node.value in seen:
                problem = f"the key '{key_node.value}' is given twice"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            seen.add(key_node.value)
        return super().construct_mapping(node, deep)


_StrictLoader.yaml_implicit_resolvers = {
    letter: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:timestamp"]
    for letter, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


@dataclass(frozen=True)
class Scenario:
    """A validated scenario.

    Attributes
    ----------
    name, description : str
    seed : int
        Root of all random streams.
    repeats : int
        Frames per combination of swept values (the file's key ``frames``).
    template : dict
        The tree of frame values, sweeps and distributions included.
    axes : tuple of tuples of Sweep
        One axis per sweep or per zip name, slowest first.
    draws : tuple of Draw
        Distributions.
    source : str
        File name, for messages.
    files : tuple of InputFile
        Files that it names; their hashes are part of its own.
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

    @property
    def combination_count(self) -> int:
        """Number of combinations of swept values: the product of the axes' lengths."""
        return math.prod(len(axis[0].values) for axis in self.axes)

    @property
    def frame_count(self) -> int:
        """Number of frames: combinations times repeats."""
        return self.combination_count * self.repeats

    def frame(self, index: int) -> FrameSpec:
        """Return frame `index` (0 to frame_count - 1) with every value fixed; repeats of a combination stand together.

        Raises
        ------
        IndexError
            There is no such frame.
        ScenarioError
            The values are not acceptable.
        """
        if not 0 <= index < self.frame_count:
            raise IndexError(f"scenario '{self.name}' has frames 0 to {self.frame_count - 1}, not {index}")
        chosen = self._swept(index // self.repeats)
        for draw in self.draws:
            if not draw.distribution.needs_site:
                chosen[draw.path] = draw.distribution.draw(random_stream(self.seed, draw.stream, index), None)
        for draw in self.draws:
            if draw.distribution.needs_site:
                observer = _observer(_resolve(self.template.get("site"), chosen, ("site",)))
                try:
                    value = draw.distribution.draw(random_stream(self.seed, draw.stream, index), observer)
                except ScenarioError as error:
                    raise ScenarioError(f"{self.source}: {'.'.join(draw.path)}: frame {index}: {error}") from error
                chosen[draw.path] = value
        files: list[InputFile] = []
        spec = _validate(_resolve(self.template, chosen), self.source, files)
        known = {file.path: file.sha256 for file in self.files}
        for file in files:
            if known.get(file.path) != file.sha256:
                raise ScenarioError(
                    f"{self.source}: '{file.path}' changed since the scenario was read; run the command again"
                )
        return spec

    def _swept(self, combination: int) -> dict[KeyPath, Any]:
        """Values of the sweeps in one combination."""
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

    def _representatives(self, files: list[InputFile]) -> Iterator[FrameSpec]:
        """Validated frames in which every swept value, and both ends of every distribution, occur; adds to `files`."""
        ends = [draw.distribution.typical() for draw in self.draws]
        first = {draw.path: values[0] for draw, values in zip(self.draws, ends, strict=True)}
        stride = 1
        for axis in reversed(self.axes):
            for position in range(len(axis[0].values)):
                yield _validate(_resolve(self.template, self._swept(position * stride) | first), self.source, files)
            stride *= len(axis[0].values)
        for draw, values in zip(self.draws, ends, strict=True):
            for value in values:
                yield _validate(
                    _resolve(self.template, self._swept(0) | first | {draw.path: value}), self.source, files
                )
        yield _validate(_resolve(self.template, self._swept(0) | first), self.source, files)

    @functools.cached_property
    def sha256(self) -> str:
        """Hash of the scenario's content: values with all defaults filled in, and skybench's version."""
        first = {draw.path: draw.distribution.typical()[0] for draw in self.draws}
        complete = _validate(_resolve(self.template, self._swept(0) | first), self.source).model_dump(mode="json")
        varied = {".".join(sweep.path): dataclasses.asdict(sweep) for axis in self.axes for sweep in axis}
        varied |= {".".join(draw.path): draw.meaning() for draw in self.draws}
        for path in [*self._swept(0), *first]:
            _forget(complete, path)
        meaning = {
            "format": 1,
            "skybench": __version__,
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
        With the file, the key, what was found and what is allowed.
    """
    try:
        if path.stat().st_size > LARGEST_FILE_BYTES:
            raise ScenarioError(f"{path}: larger than {LARGEST_FILE_BYTES} bytes, which no scenario is")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: is not UTF-8 text ({error.reason} at byte {error.start})") from error
    return parse_scenario(text, str(path))


def parse_scenario(text: str, source: str) -> Scenario:
    """Check and return the scenario in a YAML text; `source` is its name in messages. Raises ScenarioError."""
    try:
        tree = yaml.load(text, Loader=_StrictLoader)  # a SafeLoader underneath
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
    scenario = Scenario(name, description, seed, repeats, tree, _axes(sweeps, source), tuple(draws), source)
    if scenario.frame_count > LARGEST_FRAME_COUNT:
        raise ScenarioError(f"{source}: it makes {scenario.frame_count} frames, more than {LARGEST_FRAME_COUNT}")
    return dataclasses.replace(scenario, files=scenario.check())


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
    """Copy a tree, with chosen values in place of its sweeps and distributions."""
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


def _observer(site: Any) -> Observer | None:
    """The site's position, when it has one."""
    if not isinstance(site, dict):
        return None
    latitude, longitude = site.get("latitude_deg"), site.get("longitude_deg")
    if not isinstance(latitude, int | float) or not isinstance(longitude, int | float):
        return None
    return Observer(float(latitude), float(longitude))


def _validate(tree: dict[str, Any], source: str, files: list[InputFile] | None = None) -> FrameSpec:
    """Check a frame's tree of values; the files that it names are added to `files`."""
    try:
        return FrameSpec.model_validate(
            tree, context={"folder": Path(source).parent, "files": [] if files is None else files}
        )
    except ValidationError as error:
        # A list whose items are refused is also reported as too short; the items' own messages say what is wrong.
        problems = [problem for problem in error.errors() if problem["type"] != "too_short" or error.error_count() == 1]
        raise ScenarioError("\n".join(_message(problem, source) for problem in problems)) from error


def _message(problem: Any, source: str) -> str:
    """One line: file, key path, what was found, what is allowed."""
    location = problem["loc"]
    where = ".".join(str(part) for part in location)
    kind, context = problem["type"], problem.get("ctx", {})
    if kind == "extra_forbidden":
        return f"{source}: {where}: unknown key{_suggestion(location)}"
    if kind == "missing":
        return f"{source}: {where}: missing; every scenario needs it"
    if kind == "value_error":
        return f"{source}: {where}: {context['error']}" if where else f"{source}: {context['error']}"
    bounds = {"greater_than_equal": ("ge", ">="), "greater_than": ("gt", ">"), "less_than_equal": ("le", "<="),
              "less_than": ("lt", "<")}  # fmt: skip
    if kind in bounds:
        limit, sign = bounds[kind]
        expected = f"a value {sign} {context[limit]}"
    else:
        expected = problem["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    unit = _UNIT_SUFFIX.search(str(location[-1])) if location else None
    if isinstance(problem["input"], str) and unit and kind.startswith(("float", "int")):
        expected += f" in {unit.group(1)}, without a unit of its own"
    return f"{source}: {where}: found {describe(problem['input'])}, expected {expected}"


def _suggestion(location: tuple[Any, ...]) -> str:
    """Name the keys allowed where an unknown key was found, the most similar first."""
    model: Any = FrameSpec
    for part in location[:-1]:
        fields = getattr(model, "model_fields", {})
        model = fields[part].annotation if part in fields else None
        choices = [choice for choice in get_args(model) if isinstance(choice, type) and issubclass(choice, BaseModel)]
        model = choices[0] if choices else model
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        return ""
    known = [field.alias or name for name, field in model.model_fields.items()]
    if model is FrameSpec:
        known += HEADER_KEYS
    wanted = str(location[-1])
    stem = _UNIT_SUFFIX.sub("", wanted)
    for key in known:
        if _UNIT_SUFFIX.sub("", key) == stem and key != wanted:
            unit = _UNIT_SUFFIX.search(key)
            return f"; this quantity is '{key}'" + (f", in {unit.group(1)}" if unit else ", without a unit")
    close = difflib.get_close_matches(wanted, known, n=1)
    return (f"; did you mean '{close[0]}'?" if close else "") + f" Allowed: {', '.join(known)}"
