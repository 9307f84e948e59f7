"""The examples run as a reader would run them, and print what the documentation shows."""

import os
import re
import subprocess
import sys
from pathlib import Path

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
