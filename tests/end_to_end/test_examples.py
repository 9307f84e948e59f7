"""The examples run as a reader would run them, and print what the documentation shows."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from generator.frame.render import render_dataset
from generator.scenario.file import parse_scenario

ROOT = Path(__file__).parents[2]


def test_a_turn_of_the_vehicle_averages_the_tilt_of_its_mount_away():
    done = subprocess.run(
        [sys.executable, ROOT / "examples" / "heading_orbit.py"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    km = {what.strip(): float(value) for what, value in re.findall(r"^(.+?) +([\d.]+) km$", done.stdout, re.MULTILINE)}
    shown = (ROOT / "docs" / "solver.md").read_text(encoding="utf-8")
    assert set(km) == {"single fixes, median", "mean of the turn", "filter at the end", "smoother, median"}
    assert all(what in shown for what in km)
    # 0.058 deg of tilt are 6.48 km. Of a fix with 0.16 km along each axis, the mean of 36 has 0.027 km along each.
    assert 6.2 < km["single fixes, median"] < 6.8
    assert km["mean of the turn"] < 0.027 * 4.3
    # The filter also estimates the tilt and a velocity, which makes the last position less certain than the mean's.
    assert km["filter at the end"] < 0.3
    assert km["smoother, median"] < 0.2


def carried_attitude():
    path = ROOT / "examples" / "carried_attitude.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    return example


def small_flight(frames):
    return parse_scenario(
        f"""
name: flights
seed: 5
frames: {frames}
time: {{utc_start: 2020-01-15T20:00:00Z, exposure_s: 0.2, every_s: 15, count: 2}}
site: {{latitude_deg: 52.0, longitude_deg: 4.36}}
attitude: {{azimuth_deg: 0, altitude_deg: 65, roll_deg: 4}}
imu: {{rate_hz: 20, gyro: {{bias_sigma_deg_h: 20}}}}
camera: {{width: 120, height: 80, focal_length_mm: 4, pixel_pitch_um: 32, aperture_mm: 2.8}}
""",
        "flights.yaml",
    )


def test_each_sequence_is_carried_by_its_own_gyroscope(tmp_path, capsys):
    example = carried_attitude()
    render_dataset(small_flight(1), tmp_path / "one", exr=False)
    render_dataset(small_flight(2), tmp_path / "two", exr=False)
    example.main(tmp_path / "one")
    title, *alone = capsys.readouterr().out.splitlines()
    example.main(tmp_path / "two")
    first, _, *lines = capsys.readouterr().out.splitlines()
    assert (first, lines[2], lines[3]) == ("sequence 0", "sequence 1", title)
    assert len(lines) == 6
    assert lines[:2] == alone, "the first sequence does not change for the second"
    off = [float(line.split()[1]) for line in (lines[1], lines[5])]
    # A turn of 35 deg/h (three biases, one sigma) is 9 arcmin in a quarter of a minute.
    assert 0.5 < min(off) < max(off) < 36


def test_the_example_of_sequences_refuses_other_folders_in_a_line(tmp_path):
    with pytest.raises(SystemExit, match="no frames of sequences with an imu"):
        carried_attitude().main(tmp_path)


@pytest.mark.journey
def test_a_gyroscope_carries_the_attitude_and_its_bias_tilts_it(tmp_path, capsys):
    text = (ROOT / "scenes" / "sequence.yaml").read_text(encoding="utf-8")
    fewer = text.replace("every_s: 5, count: 12", "every_s: 15, count: 3")
    assert fewer != text
    render_dataset(parse_scenario(fewer, "sequence.yaml"), tmp_path / "frames", exr=False)
    carried_attitude().main(tmp_path / "frames")
    title, *lines = capsys.readouterr().out.splitlines()
    assert title in (ROOT / "docs" / "sequences.md").read_text(encoding="utf-8")
    rows = [[float(cell) for cell in line.split()] for line in lines]
    assert [row[0] for row in rows] == pytest.approx([0.1, 15.1, 30.1])
    assert rows[0][1:3] == pytest.approx([0.0, rows[0][3]], abs=1e-6)
    # Three biases of 20 deg/h (one sigma) are 35 deg/h: 17 arcmin in half a minute.
    assert 17 / 4 < rows[2][1] < 17 * 3
    # One arc minute of tilt is 1.85 km; a turn about the vertical moves the fix less.
    assert 0.2 * 1.85 * rows[2][1] < rows[2][2] < 1.1 * 1.85 * rows[2][1]
    assert max(row[3] for row in rows) < 0.3
