"""What a round's secret draws, and what solvers are told of it."""

from __future__ import annotations

import dataclasses
import hashlib
import hmac
import itertools
import math
import stat
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import stats
from small_rounds import RULES, SECRET, small_key, small_rules
from typer.testing import CliRunner

import celnav
from benchmark.cli.app import app
from benchmark.errors import RoundError
from benchmark.instruments import Precision, round_to, step_of, told
from benchmark.judge.frame_bounds import ground_speed_km_s
from benchmark.protocol import CameraRecord, Observation
from benchmark.rounds.commitment import Terms, commitment_sha256
from benchmark.rounds.drawing import draw_frames
from benchmark.rounds.rules import load_rules, parse_rules, rules_names
from benchmark.rounds.secret import RoundKey, new_secret, read_secret, secret_for
from generator.places.times import Instant

FALSE_ALARM = 1e-4
"""Of each statistical test here, were its draws made anew; the secret is fixed, so that they are the same each time."""


def drawn(count: int, secret: bytes = SECRET) -> list[dict]:
    return [yaml.safe_load(frame.scenario_text) for frame in draw_frames(small_rules(), small_key(secret), count)]


def test_draws_depend_on_secret_and_index_alone() -> None:
    assert draw_frames(small_rules(), small_key(), 8)[:3] == draw_frames(small_rules(), small_key(), 3)
    others = draw_frames(small_rules(), small_key(bytes(reversed(SECRET))), 8)
    assert not {frame.name for frame in others} & {frame.name for frame in draw_frames(small_rules(), small_key(), 8)}


def test_keys_are_those_of_the_standard() -> None:
    """HMAC-SHA-256 by hand (RFC 2104), so that anyone can draw a round in any language."""
    key = RoundKey.of(SECRET, "ab" * 32, "beacon")

    def by_hand(secret: bytes, words: bytes) -> bytes:
        block = secret + bytes(64 - len(secret))
        inner = hashlib.sha256(bytes(b ^ 0x36 for b in block) + words).digest()
        return hashlib.sha256(bytes(b ^ 0x5C for b in block) + inner).digest()

    assert key.key == by_hand(SECRET, b"skybench-round/1:" + b"ab" * 32 + b":beacon")
    assert key.digest("name", 7) == by_hand(key.key, b"name:7") == hmac.new(key.key, b"name:7", "sha256").digest()


def test_places_times_and_poses_are_drawn_over_their_whole_ranges_and_apart() -> None:
    trees = drawn(600)
    sines = [math.sin(math.radians(tree["site"]["latitude_deg"])) for tree in trees]
    edge = math.sin(math.radians(60.0))
    columns = {
        "latitude": stats.uniform(-edge, 2 * edge).cdf(sines),
        "longitude": stats.uniform(-180, 360).cdf([tree["site"]["longitude_deg"] for tree in trees]),
        "azimuth": stats.uniform(0, 360).cdf([tree["attitude"]["azimuth_deg"] for tree in trees]),
        "altitude": stats.uniform(45, 45).cdf([tree["attitude"]["altitude_deg"] for tree in trees]),
        "seed": np.array([tree["seed"] for tree in trees]) / 2.0**63,
    }
    for name, values in columns.items():
        assert stats.kstest(values, "uniform").pvalue > FALSE_ALARM, name
    columns["time"] = np.array([Instant.parse(tree["time"]["utc_start"]).mjd for tree in trees])
    columns["bortle"] = np.array([tree["sky"]["bortle"] for tree in trees])
    # The time depends on the place by the Sun alone: not on the longitude within a year.
    for one, other in itertools.combinations(columns, 2):
        assert stats.spearmanr(columns[one], columns[other]).pvalue > FALSE_ALARM, (one, other)
        # Neither does a frame's draw tell the next frame's.
        assert stats.spearmanr(columns[one][:-1], columns[other][1:]).pvalue > FALSE_ALARM, (one, other)


def observation() -> Observation:
    camera = CameraRecord("pinhole", 120, 80, 71.2345678, 71.2345678, 59.87654, 39.12345)
    pointing = celnav.Pointing(123.456789, 61.234567, -17.654321)
    return Observation(
        camera, "2023-05-06T07:08:09.123456Z", pointing.R_cam, pressure_hpa=1001.234, temperature_c=9.876
    )


PRECISION = Precision(0.1, 0.7, 0.05, 0.001, 0.3, 2.0, 1.5)


def test_what_is_told_has_the_errors_that_are_stated() -> None:
    """Each error over its stated sigma is standard Gaussian: chi-squared of 1500 draws, two-sided, at FALSE_ALARM."""
    seen, key, n = observation(), small_key(), 1500
    found = [told(seen, PRECISION, key.stream("told", index)) for index in range(n)]
    turns = np.array([one.R_cam.T @ seen.R_cam for one in found])
    tilt = np.degrees([one.tilt_sigma_deg for one in found])
    errors = {
        "east": np.degrees(turns[:, 2, 1] - turns[:, 1, 2]) / 2 / [one.tilt_sigma_deg for one in found],
        "north": np.degrees(turns[:, 0, 2] - turns[:, 2, 0]) / 2 / [one.tilt_sigma_deg for one in found],
        "heading": np.degrees(turns[:, 1, 0] - turns[:, 0, 1]) / 2 / [one.heading_sigma_deg for one in found],
        "time": np.array([Instant.parse(one.utc).since(Instant.parse(seen.utc)) / one.utc_sigma_s for one in found]),
        "focal": np.array([(one.camera.f_px / seen.camera.f_px - 1) / one.focal_sigma for one in found]),
        "u": np.array([(one.camera.cx_px - seen.camera.cx_px) / one.principal_point_sigma_px for one in found]),
        "v": np.array([(one.camera.cy_px - seen.camera.cy_px) / one.principal_point_sigma_px for one in found]),
        "pressure": np.array([(one.pressure_hpa - seen.pressure_hpa) / one.pressure_sigma_hpa for one in found]),
        "temperature": np.array([(one.temperature_c - seen.temperature_c) / one.temperature_sigma_c for one in found]),
    }
    assert (tilt > 0).all()
    for name, values in errors.items():
        tail = stats.chi2(n).cdf(float(np.sum(values**2)))
        assert FALSE_ALARM / 2 < tail < 1 - FALSE_ALARM / 2, name
    for one, other in itertools.combinations(errors, 2):
        assert stats.pearsonr(errors[one], errors[other]).pvalue > FALSE_ALARM, (one, other)


def test_nothing_is_told_to_more_digits_than_the_instrument_has() -> None:
    one = told(observation(), PRECISION, small_key().stream("told", 4))
    pointing = celnav.Pointing.of(one.R_cam)
    for angle in (pointing.azimuth_deg, pointing.altitude_deg, pointing.roll_deg):
        assert angle == pytest.approx(round(angle, 2), abs=1e-6)
    assert float(one.utc[17:-1]) == round(float(one.utc[17:-1]), 2)
    assert (one.camera.f_px, one.camera.cx_px) == (round(one.camera.f_px, 2), round(one.camera.cx_px, 1))
    assert (one.pressure_hpa, one.temperature_c) == (round(one.pressure_hpa), round(one.temperature_c, 1))
    assert [step_of(sigma) for sigma in (0.2, 0.19, 2.0, 1.9, 0.001)] == pytest.approx([0.1, 0.01, 1.0, 0.1, 1e-4])
    assert (round_to(0.123456, 0.01), round_to(1234.6, 10.0), round_to(-0.001, 0.01)) == (0.12, 1230.0, 0.0)


def test_an_unknown_heading_is_turned_over_the_whole_circle() -> None:
    unknown = dataclasses.replace(PRECISION, heading_sigma_deg=180.0)
    found = [told(observation(), unknown, small_key().stream("told", index)) for index in range(80)]
    assert {one.heading_sigma_deg for one in found} == {math.inf}
    azimuths = [celnav.Pointing.of(one.R_cam).azimuth_deg / 360 for one in found]
    assert stats.kstest(azimuths, "uniform").pvalue > FALSE_ALARM


def test_an_error_of_the_time_is_an_error_of_the_longitude() -> None:
    """The equator moves at 465.10 m/s (WGS84: 2 pi 6378.137 km in a sidereal day of 86164.0905 s); the poles stand still."""
    assert ground_speed_km_s(0.0) == pytest.approx(2 * math.pi * 6378.137 / 86164.0905, rel=1e-6)
    assert ground_speed_km_s(60.0) == pytest.approx(ground_speed_km_s(0.0) * 0.5 * 1.0025, rel=1e-3)
    assert ground_speed_km_s(90.0) == pytest.approx(0.0, abs=1e-12)


TERMS = Terms("first", 40, "2026-11-22T00:00:00Z", "ab" * 32, "0.2.0", "cd" * 8, {"skybench": "0123"}, "")


@pytest.mark.parametrize(
    "change",
    [
        {"name": "second"},
        {"frames": 41},
        {"date_utc": "2026-11-23T00:00:00Z"},
        {"rules_sha256": "ac" * 32},
        {"generator_revision": "ce" * 8},
        {"contestants": {"skybench": "0124"}},
        {"contestants": {"skybench": "0123", "late": "9"}},
        {"beacon": "drand"},
    ],
)
def test_a_commitment_binds_every_term_and_the_secret(change) -> None:
    first = commitment_sha256(SECRET, TERMS)
    assert commitment_sha256(SECRET, dataclasses.replace(TERMS, **change)) != first
    assert commitment_sha256(SECRET[:-1] + b"\0", TERMS) != first


def test_a_secret_is_new_private_and_of_128_bits(tmp_path) -> None:
    path = tmp_path / "private" / "secret.hex"
    secret = new_secret(path)
    assert (len(secret), read_secret(path), stat.S_IMODE(path.stat().st_mode)) == (16, secret, 0o600)
    with pytest.raises(RoundError, match="choose a new file"):
        new_secret(path)
    for text, words in (
        ("0123abcd", "found 8 characters, expected 32"),
        ("0" * 32, "too few|different digits"),
        ("g" * 32, "32 hexadecimal digits"),
        ("ab" * 16 + "ab", "found 34"),
        ("é" * 32, "cannot be read"),
        ("a" * 2000, "larger than any secret"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(RoundError, match=words) as caught:
            read_secret(path)
        assert text not in str(caught.value)


def draw_command(secret: Path, out: Path, *more: str) -> tuple[int, str]:
    arguments = ("bench", "round", "draw", "--secret", str(secret), "--frames", "2", "--out", str(out), *more)
    done = CliRunner().invoke(app, arguments)
    return done.exit_code, " ".join(done.output.split())


def test_a_second_round_needs_a_secret_of_its_own(tmp_path) -> None:
    """It would have the frames of the first one, whose secret may be known."""
    rules = tmp_path / "small.rules.yaml"
    rules.write_text(RULES)
    secret = tmp_path / "secret.hex"
    assert draw_command(secret, tmp_path / "first", "--rules", str(rules))[0] == 0
    before = secret.read_text()
    code, words = draw_command(secret, tmp_path / "second", "--rules", str(rules))
    assert (code, secret.read_text()) == (2, before)
    assert "choose a new file" in words
    assert not (tmp_path / "second").exists()


@pytest.mark.parametrize("ended_by", [RoundError, KeyboardInterrupt])
def test_a_draw_without_a_commitment_leaves_no_secret(tmp_path, monkeypatch, ended_by) -> None:
    def interrupted(*_: object) -> None:
        raise ended_by("stopped")

    monkeypatch.setattr("benchmark.rounds.steps.write_commitment", interrupted)
    assert draw_command(tmp_path / "secret.hex", tmp_path / "first")[0] != 0
    assert not (tmp_path / "secret.hex").exists()


def test_a_commitment_that_was_made_keeps_its_secret(tmp_path) -> None:
    commitment = tmp_path / "commitment.json"
    with suppress(KeyboardInterrupt), secret_for(commitment, tmp_path / "secret.hex"):
        commitment.write_text("{}")
        raise KeyboardInterrupt
    assert (tmp_path / "secret.hex").exists()


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (
            "tilt_sigma_deg: {choice: [0.01, 0.2]}",
            "tilt_sigma_deg: 0",
            r"instruments\.tilt_sigma_deg: found 0, expected 0\.0001",
        ),
        ("  focal_sigma: 0.001\n", "", r"instruments\.focal_sigma: give"),
        ("latitude_deg: {sphere_latitude: [-60, 60]}", "latitude_deg: 52", r"site\.latitude_deg: must be drawn"),
        ("sky: {bortle: {integer: [2, 8]}}", "sky: {bortle: {sweep: [2, 8]}}", "leave out sweeps"),
        ("sky: {bortle", "seed: 4\n  sky: {bortle", "comes from the round's secret"),
        ("sky: {bortle", "drift: {mount_deg: 0.2}\n  sky: {bortle", "drift"),
        ("sky: {bortle", "foreground: {horizon: {file: a.csv}}\n  sky: {bortle", "a.csv"),
        ("name: narrow", "name: wide", "give each name once"),
        ("sky: {bortle", "sky: &all {bortle", "all"),
        ("share: 3", "share: 0", r"kinds\.0\.share"),
        ("aperture_mm: 12", "aperture_m: 12", "aperture_m"),
        ("title:", "more: 1\ntitle:", "more"),
        ("title:", "more: " + "[" * 9000 + "\ntitle:", "nested too deep"),
        ("title:", "more: " + "9" * 5000 + "\ntitle:", "not valid YAML"),
    ],
)
def test_rules_that_cannot_be_drawn_by_are_refused(before, after, words) -> None:
    assert before in RULES
    text = RULES.replace(before, after)
    if "&all" in text:
        text += "more: *all\n"
    with pytest.raises(RoundError, match=words):
        parse_rules(text, "mine.rules.yaml")


def test_the_rules_that_come_with_skybench_can_be_drawn_by() -> None:
    for name in rules_names():
        rules = load_rules(name)
        assert rules.file.name == name
        frames = draw_frames(rules, RoundKey.of(SECRET, rules.sha256, ""), 60)
        assert {frame.kind for frame in frames} == {kind.name for kind in rules.file.kinds}
        assert len({frame.scenario.content_sha256 for frame in frames}) == 60
        named = set(rules.file.common) | set(rules.file.instruments)
        assert named - {"stars"} <= set(rules.file.sources)
    with pytest.raises(RoundError, match="those that come with skybench: open-sky"):
        load_rules("no-such-rules")
