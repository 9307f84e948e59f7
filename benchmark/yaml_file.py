"""YAML files of unknown origin, as tasks and solvers have them: limited in size, without aliases or keys given twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from benchmark.errors import BenchmarkError
from generator.files import read_text_at_most
from generator.reading.strict_yaml import StrictLoader


class TextLoader(StrictLoader):
    """All scalars as the texts that are written, whatever YAML makes of them."""


TextLoader.yaml_implicit_resolvers = {}


def read_yaml(
    path: Path, most_bytes: int, kind: type[BenchmarkError], loader: type[StrictLoader] = StrictLoader
) -> dict[str, Any]:
    """Read a mapping of keys.

    Parameters
    ----------
    path : Path
    most_bytes : int
        Larger files are not read.
    kind : type of BenchmarkError
        What to raise.
    loader : type of StrictLoader

    Raises
    ------
    BenchmarkError
        Of the given kind: the file cannot be read, or is no such YAML.
    """
    try:
        tree = yaml.load(read_text_at_most(path, most_bytes), Loader=loader)  # a SafeLoader underneath
    except RecursionError as error:
        raise kind(f"{path}: cannot be read (nested too deep)") from error
    except OSError as error:
        raise kind(f"{path}: cannot be read ({error.strerror})") from error
    # An integer of thousands of digits is a ValueError, as is what is no UTF-8.
    except (ValueError, yaml.YAMLError) as error:
        raise kind(f"{path}: cannot be read ({' '.join(str(error).split())})") from error
    if not isinstance(tree, dict):
        raise kind(f"{path}: expected a mapping of keys")
    return tree
