"""What several files of tests share: a dataset of two small frames with a source of every kind that a scenario can place."""

from pathlib import Path

import pytest
import yaml
from small_scenes import BASE

from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.scenario.file import parse_scenario

_TRAIL = {"v_mag": 0.0, "end_s": 0.1}


def _trail(kind: str, azimuth_deg: float) -> dict[str, object]:
    ends = {"start": (azimuth_deg, 55.0), "end": (azimuth_deg + 8, 62.0)}
    return _TRAIL | {"kind": kind} | {
        name: {"azimuth_deg": azimuth, "altitude_deg": altitude} for name, (azimuth, altitude) in ends.items()
    }  # fmt: skip


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
