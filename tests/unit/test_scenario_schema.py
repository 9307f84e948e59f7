"""scenes/schema.json: up to date, itself valid, and of one mind with the reader."""

import json
from pathlib import Path

import jsonschema
import pytest
import yaml
from small_scenes import BASE

from generator.scenario.schema import scenario_schema

SCENES = Path(__file__).parents[2] / "scenes"
SCHEMA = json.loads((SCENES / "schema.json").read_text())


class PlainTimes(yaml.SafeLoader):
    """YAML without dates, as the reader has it."""


PlainTimes.yaml_implicit_resolvers = {
    letter: [pair for pair in resolvers if pair[0] != "tag:yaml.org,2002:timestamp"]
    for letter, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def test_published_schema_is_up_to_date() -> None:
    assert scenario_schema() == SCHEMA, "run: python tools/build_schema.py"


def test_schema_is_valid() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.yaml")), ids=lambda path: path.name)
def test_shipped_scenarios_satisfy_it(path) -> None:
    jsonschema.validate(yaml.load(path.read_text(), Loader=PlainTimes), SCHEMA)


@pytest.mark.parametrize(
    "change",
    [
        {"skyy": 1},
        {"seed": -1},
        {"frames": 0},
        {"sky": {"bortle": 12}},
        {"sky": {"bortle": {"sweep": []}}},
        {"site": {"latitude_deg": 95.0, "longitude_deg": 0.0}},
        {"site": {"latitude_deg": {"uniform": [1]}, "longitude_deg": 0.0}},
        {"camera": {"width": 100}},
    ],
)
def test_what_the_reader_refuses_the_schema_refuses(change) -> None:
    jsonschema.validate(BASE, SCHEMA)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(BASE | change, SCHEMA)
