"""Photographs of an observatory's all-sky camera (tests/data/allsky): calibrated from a blind start, and solved with it.

An independent fit of lens and mount to other nights of this camera, with another program's detections, found decentring p1 of
0.00065 to 0.00067 in a Kannala-Brandt lens with that term alone added, and 0.22 px left without it.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from celnav.__main__ import main
from celnav.calibrating.calibrate import calibrate
from celnav.calibrating.lens_form import LensForm
from celnav.command.calibration_frames import read_frames

FOLDER = Path(__file__).parents[2] / "data" / "allsky"
# Of the files' headers (OBSLAT, OBSLONG, OBSALT).
LAT_DEG, LON_DEG, HEIGHT_M = 34.4773, -111.4332, 2361.0


@pytest.fixture(scope="module")
def frames():
    return read_frames([str(FOLDER / name) for name in ("005.fits.bz2", "008.fits.bz2")])


def fitted(frames, **choices):
    form = LensForm("kannala_brandt", 3, **choices)
    return calibrate(frames, LAT_DEG, LON_DEG, height_m=HEIGHT_M, form=form)


def test_header_gives_the_middle_of_the_exposure(frames):
    # DATE-OBS 2018-08-06T05:17:04.752 and half of 60 s.
    assert frames[0].utc.second_of_day_s == pytest.approx(5 * 3600 + 17 * 60 + 34.752, abs=1e-3)


@pytest.mark.journey
def test_stars_are_predicted_to_a_tenth_of_a_pixel(frames):
    found = fitted(frames, aspect=True, decentring=True, prism=True, tilt=True)
    assert round(found.rms_px, 2) <= 0.12
    assert len(found.residuals.uv) > 1000
    assert len(found.attitudes) == 2
    assert found.pattern.rms_px < 0.05


@pytest.mark.journey
def test_decentring_is_what_others_found(frames):
    found = fitted(frames, decentring=True)
    assert found.values[found.form.names.index("p1")] == pytest.approx(0.00066, abs=0.00005)
    assert fitted(frames).rms_px > 0.2


@pytest.mark.journey
def test_a_photograph_is_solved_with_the_calibration_of_another_night(tmp_path, capsys):
    camera = str(tmp_path / "camera.json")
    place = ["--lat", str(LAT_DEG), "--lon", str(LON_DEG), "--height-m", str(HEIGHT_M)]
    assert main(["calibrate", str(FOLDER / "008.fits.bz2"), *place, "--models", "kannala_brandt", "--out", camera]) == 0
    assert "decentring" in capsys.readouterr().out
    given = ["--camera", camera, "--attitude", camera, "--height-m", str(HEIGHT_M)]
    assert main(["solve", str(FOLDER / "005.fits.bz2"), *given, "--json"]) == 0
    fix = json.loads(capsys.readouterr().out)
    off = np.array(
        [(fix["lon_deg"] - LON_DEG) * 111.3 * np.cos(np.radians(LAT_DEG)), (fix["lat_deg"] - LAT_DEG) * 110.9]
    )
    assert np.hypot(*off) < 4
    # The mount's wander is in the covariance: 9.2 is passed by chance in one of a hundred.
    assert off @ np.linalg.solve(np.array(fix["cov_km2"]), off) < 9.2
