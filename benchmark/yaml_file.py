"""YAML files of unknown origin, such as tasks and solvers: limited in size, without aliases or duplicate keys."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from benchmark.errors import BenchmarkError
from generator.files import read_text_at_most
from generator.reading.strict_yaml import StrictLoader


class TextLoader(StrictLoader):
    """Loads all scalars as the text that is written, however YAML would interpret them."""


TextLoader.yaml_implicit_resolvers = {}


def read_yaml(
    path: Path, most_bytes: int, kind: type[BenchmarkError], loader: type[StrictLoader] = StrictLoader
) -> dict[str, Any]:
    """Read a YAML mapping.

    Parameters
    ----------
    path : Path
    most_bytes : int
        Larger files are refused.
    kind : type of BenchmarkError
        Type of the error to raise.
    loader : type of StrictLoader

    Raises
    ------
    BenchmarkError
        An error of the given type: the file cannot be read, or is not such YAML.
    """
    try:
        tree = yaml.load(read_text_at_most(path, most_bytes), Loader=loader)  # a SafeLoader underneath
    except RecursionError as error:
        raise kind(f"{path}: cannot be read (nested too deep)") from error
    except OSError as error:
        raise kind(f"{path}: cannot be read ({error.strerror})") from error
    # An integer of thousands of digits raises a ValueError, and so does invalid UTF-8.
    except (ValueError, yaml.YAMLError) as error:
        raise kind(f"{path}: cannot be read ({' '.join(str(error).split())})") from error
    if not isinstance(tree, dict):
        raise kind(f"{path}: expected a mapping of keys")
    return tree
