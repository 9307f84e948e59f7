"""YAML of camera files, without the features that make a file mean something other than it seems to."""

from __future__ import annotations

import functools
import re
from typing import Any

_CORE = "tag:yaml.org,2002:"
_OPENCV = f"{_CORE}opencv-matrix"
_LEADING_ZERO = "tag:celnav,leading-zero"
# Numbers as in YAML 1.2 (10.3.2), where 1e3 needs neither a point nor a sign; YAML 1.1 reads 10:30 to base 60.
_NUMBERS = (
    (_LEADING_ZERO, re.compile(r"[-+]?0[0-9]+$"), "-+0"),
    (f"{_CORE}int", re.compile(r"[-+]?(?:0|[1-9][0-9]*)$"), "-+0123456789"),
    (
        f"{_CORE}float",
        re.compile(
            r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
        ),
        "-+0123456789.",
    ),
)
_REPLACED = {f"{_CORE}{name}" for name in ("int", "float", "timestamp")}


def parse_yaml(text: str) -> object:
    """Return the content of a YAML text.

    Raises
    ------
    ValueError
        The text is no YAML, or has an alias, a tag other than OpenCV's, or a number with a leading zero; the message names
        the line.
    """
    import yaml

    # OpenCV writes "%YAML:1.0", which is not a YAML directive.
    if text.startswith("%YAML:"):
        text = text.partition("\n")[2]
    try:
        return yaml.load(text, Loader=_loader())
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error)
        raise ValueError(f"{problem}" + (f" in line {mark.line + 1}" if mark else "")) from None


@functools.cache
def _loader() -> Any:
    """Safe loader with the one tag that OpenCV writes, and without aliases, which can expand 400 bytes to gigabytes."""
    import yaml  # only cameras in YAML need it

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent: Any, index: Any) -> Any:
            event: Any = self.peek_event()  # type: ignore[no-untyped-call]
            problem = ""
            if isinstance(event, yaml.AliasEvent):
                problem = f"the alias *{event.anchor} is not read: write its value in its place"
            elif isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent) and event.tag not in (None, _OPENCV):
                tag = str(event.tag).replace(_CORE, "!!", 1)[:40]
                problem = f"the tag {tag} is not read: leave only the value"
            if problem:
                raise yaml.constructor.ConstructorError(None, None, problem, event.start_mark)
            return super().compose_node(parent, index)

    def matrix(loader: Loader, node: yaml.MappingNode) -> dict[Any, Any]:
        return loader.construct_mapping(node, deep=True)

    def refuse_leading_zero(loader: Loader, node: yaml.ScalarNode) -> Any:
        del loader
        sign = "-" if node.value[0] == "-" else ""
        digits = node.value.lstrip("+-0") or "0"
        problem = f"found {node.value[:40]}, which YAML may read as octal: write {sign}{digits[:40]}"
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)

    Loader.yaml_implicit_resolvers = {
        letter: [(tag, pattern) for tag, pattern in resolvers if tag not in _REPLACED]
        for letter, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    for tag, pattern, first in _NUMBERS:
        Loader.add_implicit_resolver(tag, pattern, list(first))
    Loader.add_constructor(_LEADING_ZERO, refuse_leading_zero)
    Loader.add_constructor(_OPENCV, matrix)
    return Loader
