"""Pictures of one set of sites under each disturbance of light and blur that the thesis omits.

All settings share sites, instants and, except for the disturbance, every pixel's light, so that they can be compared in
pairs. The night is that of a full Moon near an equinox: with the Sun 12 deg below the horizon the Moon is up at every site.
"""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from typing import Any

import celnav
from benchmark.frames.dataset import load_image, open_dataset
from benchmark.studies.common.contestants import judge_detections
from benchmark.studies.common.progress import Advance
from benchmark.studies.common.records import Row, row_of
from benchmark.studies.thesis import contestants as who
from generator.reading.strict_yaml import strict_text
from generator.scenario.file import Scenario, parse_scenario

MOST_FRAMES = 40
"""Frames per setting; a recall of one half is then known to 15 points."""
CLEAR, FEW_STARS = "clear", "limiting magnitude 4"
SHARED: MappingProxyType[str, Any] = MappingProxyType(
    {
        "site": {"latitude_deg": {"uniform": [-60, 60]}, "longitude_deg": {"uniform": [-180, 180]}},
        "time": {
            "utc_start": {"utc": ["2020-03-09T06:00:00Z", "2020-03-10T06:00:00Z"], "sun_below_deg": -12},
            "exposure_s": 0.5,
        },
        "sky": {"bortle": 1, "components": ["airglow", "zodiacal", "milky_way", "starlight", "skyglow"]},
        "stars": {"limiting_magnitude": 7.0},
    }
)
# The keys that a setting changes; sections are merged.
SETTINGS: MappingProxyType[str, dict[str, dict[str, Any]]] = MappingProxyType(
    {
        CLEAR: {},
        FEW_STARS: {"stars": {"limiting_magnitude": 4.0}},
        "full Moon": {"sky": {"components": [*SHARED["sky"]["components"], "moonlight"]}},
        "cloud of optical depth 3 over half the sky": {
            "sky": {"clouds": {"altitude_km": 3, "mean_optical_depth": 3.0, "coverage": 0.5, "wind_m_s": 20}}
        },
        "defocus to sigma 3 px": {"camera": {"psf_sigma_px": 3.0}},
        "turning 4 deg/s, trails of 11 px": {"motion": {"rate_deg_s": [4.0, 0.0, 0.0]}},
        "hot pixels, one in a thousand": {"sensor": {"hot_pixel_fraction": 0.001, "hot_pixel_e_s": 4000}},
    }
)
NAMES = (who.ADAPTIVE, who.BASELINE, who.BRIGHTEST_N)


def part_of(setting: str) -> str:
    """Name of a setting's part of the study."""
    return f"disturbed pictures: {setting}"


def disturbed_scenario(scenario: Scenario, setting: str, n_frames: int) -> Scenario:
    """Make the scenario of a setting: the camera of the thesis' sets, the shared night, and the disturbance.

    Parameters
    ----------
    scenario : Scenario
        The thesis' sets.
    setting : str
        A key of `SETTINGS`.
    n_frames : int
    """
    tree: dict[str, Any] = {**scenario.template, **SHARED}
    for section, changes in SETTINGS[setting].items():
        tree[section] = {**tree.get(section, {}), **changes}
    header = {"name": f"{scenario.name}-disturbed", "seed": scenario.seed, "frames": n_frames}
    return parse_scenario(strict_text({**header, **tree}), scenario.source)


def solve_disturbed(scenario: Scenario, n_frames: int, folder: Path, progress: Advance) -> tuple[Row, ...]:
    """Render and solve all settings.

    Parameters
    ----------
    scenario : Scenario
        The thesis' sets.
    n_frames : int
        Number of frames of each setting.
    folder : Path
        Folder for the frames, with a subfolder per setting.
    progress : callable
        Called after each frame.
    """
    from generator.frame.render import render_dataset  # loads Mitsuba

    contestants = [contestant for contestant in who.registered() if contestant.name in NAMES]
    rows: list[Row] = []
    for number, setting in enumerate(SETTINGS):
        made = disturbed_scenario(scenario, setting, n_frames)
        render_dataset(made, folder / f"setting-{number}", lambda frame: progress())
        limit = made.frame(0).stars.limiting_magnitude
        for frame in open_dataset(folder / f"setting-{number}").frames:
            detections = celnav.detect(load_image(frame))
            outcomes = judge_detections(frame, detections, contestants)
            for contestant, outcome in zip(contestants, outcomes, strict=True):
                rows.append(row_of(part_of(setting), limit, contestant.name, outcome))
    return tuple(rows)
