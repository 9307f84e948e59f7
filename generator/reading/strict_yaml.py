"""YAML without features that make a file mean something other than it seems to."""

from __future__ import annotations

import re
from typing import Any

import yaml

_CORE = "tag:yaml.org,2002:"
_LEADING_ZERO = "tag:skybench,leading-zero"
"""Of numbers such as 045, which YAML 1.1 reads as octal (37) and 1.2 as decimal."""
_INTEGER = re.compile(r"[-+]?(?:0|[1-9][0-9_]*|0b[01_]+|0x[0-9a-fA-F_]+)$")
_FLOAT = re.compile(
    r"(?:[-+]?(?:[0-9][0-9_]*\.[0-9_]*(?:[eE][-+]?[0-9]+)?|[0-9][0-9_]*[eE][-+]?[0-9]+"
    r"|\.[0-9][0-9_]*(?:[eE][-+]?[0-9]+)?|\.(?:inf|Inf|INF))|\.(?:nan|NaN|NAN))$"
)
"""As in YAML 1.2: neither a point nor the exponent's sign is needed."""
_OWN_NUMBERS = (
    (_LEADING_ZERO, re.compile(r"[-+]?0[0-9_]+$"), "-+0"),
    (f"{_CORE}int", _INTEGER, "-+0123456789"),
    (f"{_CORE}float", _FLOAT, "-+0123456789."),
)
"""Tag, pattern and possible first characters. Numbers of base 60, as YAML 1.1 reads 10:30, are text."""
_REPLACED = {f"{_CORE}{name}" for name in ("timestamp", "int", "float")}


class StrictLoader(yaml.SafeLoader):
    """Safe YAML without duplicate keys, aliases, tags, octal or base-60 numbers, or conversion of times to dates."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse an alias and an explicit tag."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        mark: Any = event.start_mark
        if isinstance(event, yaml.AliasEvent):
            raise yaml.constructor.ConstructorError(None, None, "aliases are not allowed", mark)
        if isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent) and event.tag is not None:
            tag = event.tag.replace(_CORE, "!!", 1)[:40]
            problem = f"tags are not allowed; remove {tag} and leave the value"
            raise yaml.constructor.ConstructorError(None, None, problem, mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Refuse a key that is given twice, or is a list or a mapping."""
        seen: set[str] = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                problem = "a key must be a plain word, not a list or a mapping"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            if key_node.value in seen:
                problem = f"the key '{key_node.value}' is given twice"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            seen.add(key_node.value)
        return super().construct_mapping(node, deep)


class StrictDumper(yaml.SafeDumper):
    """Writes safe YAML, with quotes around text that a StrictLoader takes for a number, too, and without aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write a part that stands in two places twice."""
        del data
        return True


def strict_text(tree: Any, **options: Any) -> str:
    """Return data as YAML that a StrictLoader reads as it was; `options` are those of ``yaml.safe_dump``."""
    return str(yaml.dump(tree, Dumper=StrictDumper, **options))


def _refuse_leading_zero(loader: StrictLoader, node: yaml.ScalarNode) -> Any:
    del loader
    found = node.value
    digits = found.replace("_", "").lstrip("+-0") or "0"
    problem = f"found {found[:40]}, a number with a leading zero, which YAML may take for octal; write "
    problem += f"{'-' if found[0] == '-' else ''}{digits[:40]}, or in quotes if it is text"
    raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)


StrictLoader.yaml_implicit_resolvers = {
    letter: [(tag, pattern) for tag, pattern in resolvers if tag not in _REPLACED]
    for letter, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _tag, _pattern, _first in _OWN_NUMBERS:
    for _class in (StrictLoader, StrictDumper):
        _class.add_implicit_resolver(_tag, _pattern, list(_first))
StrictLoader.add_constructor(_LEADING_ZERO, _refuse_leading_zero)
