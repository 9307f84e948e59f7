"""The scenario reader: any file is a scenario whose frames can be asked for, or a ScenarioError."""

from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from fuzz.fuzzing import corpus, damaged, fuzzed, grafted
from hypothesis import given

from generator.errors import ScenarioError
from generator.scenario.file import load_scenario

FILES = corpus("scenario")
WHOLE = [path for path in FILES if path.name.startswith("whole-")]


def read(path: Path) -> None:
    """Everything that a scenario is asked for before it is rendered."""
    scenario = load_scenario(path)
    scenario.frame(0)
    scenario.frame(scenario.frame_count - 1)
    assert len(scenario.sha256) == 64


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_corpus(path) -> None:
    if path in WHOLE:
        read(path)
    else:
        with pytest.raises(ScenarioError):
            read(path)


@fuzzed(60)
@given(content=damaged([path.read_bytes() for path in FILES]))
def test_any_bytes(tmp_path_factory, content) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(content)
    with suppress(ScenarioError):
        read(path)


@fuzzed(60)
@given(tree=grafted([yaml.safe_load(path.read_text()) for path in WHOLE]))
def test_any_values(tmp_path_factory, tree) -> None:
    path = tmp_path_factory.getbasetemp() / "values.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    with suppress(ScenarioError):
        read(path)
