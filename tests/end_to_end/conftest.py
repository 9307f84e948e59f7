"""What several files of tests share: twelve tiny frames, and two small ones with a source of every kind."""

from pathlib import Path

import pytest
import yaml
from small_scenes import BASE
from tiny_dataset import SPEC, TINY

from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.scenario.file import load_scenario, parse_scenario

_TRAIL = {"v_mag": 0.0, "end_s": 0.1}


def _trail(kind: str, azimuth_deg: float) -> dict[str, object]:
    ends = {"start": (azimuth_deg, 55.0), "end": (azimuth_deg + 8, 62.0)}
    return _TRAIL | {"kind": kind} | {
        name: {"azimuth_deg": azimuth, "altitude_deg": altitude} for name, (azimuth, altitude) in ends.items()
    }  # fmt: skip


@pytest.fixture(scope="module")
def scenario_path(tmp_path_factory) -> Path:
    """The scenario of twelve tiny frames."""
    path = tmp_path_factory.mktemp("scenario") / "tiny.yaml"
    path.write_text(yaml.safe_dump(TINY, sort_keys=False))
    return path


@pytest.fixture(scope="module")
def dataset(scenario_path, tmp_path_factory) -> Path:
    """The twelve tiny frames, made without a disturbance."""
    folder = tmp_path_factory.mktemp("dataset") / "tiny"
    report = generate(load_scenario(scenario_path), scenario_path.read_text(), folder, SPEC)
    assert not report.missing
    return folder


@pytest.fixture(scope="session")
def small_set(tmp_path_factory) -> Path:
    """Stars, planets, Moon, satellite, aircraft, meteor and cosmic rays on 240 x 160 pixels, under two skies."""
    tree = BASE | {
        "name": "small-set",
        "time": {"utc_start": "2020-01-12T22:00:00Z", "exposure_s": 0.1},
        "camera": BASE["camera"] | {"width": 240, "height": 160, "hfov_deg": 60},
        "attitude": {"azimuth_deg": 110, "altitude_deg": 55, "roll_deg": 0},
        "sensor": {"cosmic_rays": {"rate_s": 100, "charge_e_px": 1000}},
        "sky": {"bortle": {"sweep": [3, 7]}},
        "stars": {"limiting_magnitude": 6.5},
        "foreground": {"trails": [_trail("satellite", 80), _trail("aircraft", 120), _trail("meteor", 140)]},
    }
    text = yaml.safe_dump(tree)
    folder = tmp_path_factory.mktemp("small") / "set"
    generate(parse_scenario(text, "set.yaml"), text, folder, DatasetSpec(shard_size=1))
    return folder
