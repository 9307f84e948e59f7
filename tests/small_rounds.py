"""A round of small frames, for tests: rules, a secret, and everything that its four steps write."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from benchmark.rounds.rules import Rules, parse_rules
from benchmark.rounds.secret import RoundKey
from benchmark.rounds.steps import Drawn, commit, draw, pack_round

SECRET = bytes.fromhex("8f14e45fceea167a5a36dedd4bea2543")
RULES = """\
format: skybench-round-rules/1
name: small
title: Small frames for tests
sources: {site: Invented for tests.}
instruments:
  tilt_sigma_deg: {choice: [0.01, 0.2]}
  heading_sigma_deg: {choice: [0.5, 180.0]}
  utc_sigma_s: {choice: [0.001, 0.5]}
  focal_sigma: 0.001
  principal_point_sigma_px: {uniform: [0.1, 1.0]}
  pressure_sigma_hpa: 2.0
  temperature_sigma_c: 2.0
common:
  site: {latitude_deg: {sphere_latitude: [-60, 60]}, longitude_deg: {uniform: [-180, 180]}}
  time: {utc_start: {utc: ["2023-01-01T00:00:00Z", "2024-01-01T00:00:00Z"], sun_below_deg: -12}, exposure_s: 0.5}
  attitude: {azimuth_deg: {uniform: [0, 360]}, altitude_deg: {uniform: [45, 90]}, roll_deg: {uniform: [-180, 180]}}
  sky: {bortle: {integer: [2, 8]}}
kinds:
  - name: wide
    share: 3
    source: Invented for tests.
    scenario: {camera: {width: 120, height: 80, hfov_deg: {uniform: [70, 100]}, aperture_mm: 6}}
  - name: narrow
    share: 1
    source: Invented for tests.
    scenario: {camera: {width: 96, height: 96, hfov_deg: {uniform: [30, 40]}, aperture_mm: 12}}
"""


def small_rules() -> Rules:
    return parse_rules(RULES, "small.rules.yaml")


def small_key(secret: bytes = SECRET) -> RoundKey:
    return RoundKey.of(secret, small_rules().sha256, "")


@dataclass(frozen=True)
class SmallRound:
    """Folders of a round that was packed: published, private, and the solvers' set."""

    folder: Path
    truth: Path
    packed: Path
    drawn: Drawn


def make_round(place: Path, frames: int, contestants: dict[str, str]) -> SmallRound:
    folder, truth, packed = place / "public" / "round", place / "private" / "truth", place / "sets" / "set"
    commit(folder, SECRET, small_rules(), "small", frames, contestants)
    drawn = draw(folder, SECRET)
    pack_round(folder, drawn, truth, packed, 1)
    return SmallRound(folder, truth, packed, drawn)
