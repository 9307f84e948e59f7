"""How every target of this room is run: a few repeatable examples daily, as many as asked for under `make fuzz`."""

import os
from collections.abc import Callable
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

CORPUS = Path(__file__).parent / "corpus"
EXAMPLES_VARIABLE = "SKYBENCH_FUZZ_EXAMPLES"
HUGE = 10**400 + 1
"""An integer beyond the range of floating-point numbers."""

TEXTS = st.text(max_size=20) | st.sampled_from(["\ud800", "\x00", "<script>", "..", "/etc/passwd", "nan", "x" * 500])
NUMBERS = (
    st.floats()
    | st.integers()
    | st.sampled_from([HUGE, -HUGE, 2**31, 2**63, 1e308, -1e308, 5e-324, 0, -0.0, True, None])
)
WITHIN_DOUBLES = st.floats() | st.integers(-(2**70), 2**70) | st.sampled_from([1e308, -1e308, 5e-324, True, None])
"""Numbers without integers beyond the range of floating-point ones."""


def values(numbers: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    """Numbers, texts, and lists and mappings of them."""
    return st.recursive(
        numbers | TEXTS,
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=3),
        max_leaves=6,
    )


ODD = values(NUMBERS)
"""Any value that JSON and YAML can hold, those that trouble readers among them."""


def fuzzed(daily: int) -> Callable:
    """Settings of a target: `daily` examples, the same on every run, unless EXAMPLES_VARIABLE asks for another number."""
    asked = os.environ.get(EXAMPLES_VARIABLE)
    return settings(
        max_examples=int(asked) if asked else daily,
        derandomize=not asked,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )


def corpus(target: str) -> list[Path]:
    """Committed inputs of a target: whole ones, and those that once broke a reader."""
    found = sorted(path for path in (CORPUS / target).iterdir() if path.is_file())
    assert found, target
    return found


def damaged(contents: list[bytes]) -> st.SearchStrategy[bytes]:
    """One of the contents with up to eight wounds: bytes overwritten, cut out, doubled, put in; or any bytes at all."""
    wounds = st.lists(
        st.tuples(
            st.sampled_from(["overwrite", "cut", "double", "insert", "end"]),
            st.floats(0, 1, exclude_max=True),
            st.binary(min_size=1, max_size=8),
            st.integers(1, 200),
        ),
        max_size=8,
    )
    return st.builds(_wounded, st.sampled_from(contents), wounds) | st.binary(max_size=300)


def _wounded(content: bytes, wounds: list[tuple[str, float, bytes, int]]) -> bytes:
    for kind, place, new, length in wounds:
        at = int(place * len(content))
        before, after = content[:at], content[at:]
        content = {
            "overwrite": before + new + after[len(new) :],
            "cut": before + after[length:],
            "double": before + after[:length] + after,
            "insert": before + new + after,
            "end": before,
        }[kind]
    return content


def grafted(trees: list[object], odd: st.SearchStrategy[object] = ODD) -> st.SearchStrategy[object]:
    """One of the trees of mappings and lists with up to three of its values replaced by odd ones, or removed."""
    changes = st.lists(st.tuples(st.integers(0, 10_000), odd, st.booleans()), min_size=1, max_size=3)
    return st.builds(_grafted, st.sampled_from(trees), changes)


def _grafted(tree: object, changes: list[tuple[int, object, bool]]) -> object:
    for number, new, removed in changes:
        places = list(_places(tree))
        tree = _changed(tree, places[number % len(places)], new, removed)
    return tree


def _places(tree: object) -> list[tuple]:
    """Paths of all values in a tree, its own, the empty path, first."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [(), *((key, *path) for key, value in items for path in _places(value))]


def _changed(tree: object, path: tuple, new: object, removed: bool) -> object:
    if not path:
        return new
    key, *rest = path
    pairs = list(tree.items() if isinstance(tree, dict) else enumerate(tree))
    kept = [
        (name, _changed(value, tuple(rest), new, removed) if name == key else value)
        for name, value in pairs
        if not (removed and not rest and name == key)
    ]
    return dict(kept) if isinstance(tree, dict) else [value for _, value in kept]
