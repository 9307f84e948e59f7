"""scenes/schema.json: up to date, itself valid, and of one mind with the reader."""

import json
from pathlib import Path

import jsonschema
import pytest
import yaml
from small_scenes import BASE

from generator.scenario.file import parse_scenario
from generator.scenario.schema import scenario_schema

SCENES = Path(__file__).parents[2] / "scenes"
SCHEMA = json.loads((SCENES / "schema.json").read_text())
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


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
    VALIDATOR.validate(yaml.load(path.read_text(), Loader=PlainTimes))


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
    VALIDATOR.validate(BASE)
    with pytest.raises(jsonschema.ValidationError):
        VALIDATOR.validate(BASE | change)


@pytest.mark.parametrize(
    "change",
    [
        {"motion": {"rate_deg_s": [{"uniform": [-1, 1]}, 0, {"sweep": [0, 2]}]}},
        {"motion": {"polynomial_deg": [[{"normal": [0, 1]}], [], []]}},
        {"camera": BASE["camera"] | {"vignetting": [{"uniform": [-0.3, -0.1]}]}},
        {"sky": {"cities": [{"distance_km": {"sweep": [10, 20]}, "azimuth_deg": 1, "radius_km": 5}]}},
    ],
)
def test_what_the_reader_varies_inside_lists_the_schema_accepts(change) -> None:
    parse_scenario(yaml.safe_dump(BASE | change), "varied.yaml").frame(0)
    VALIDATOR.validate(BASE | change)
    with pytest.raises(jsonschema.ValidationError):
        VALIDATOR.validate(BASE | {"motion": {"rate_deg_s": [{"uniform": [1]}, 0, 0]}})
