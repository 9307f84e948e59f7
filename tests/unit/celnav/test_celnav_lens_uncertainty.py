"""The covariance of a lens: in camera files, checked, carried into pixels; refraction's part; the bound of a blind start."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import celnav
from celnav.calibrating import all_frames, blind_start, joint_fit
from celnav.calibrating.frames import CalibrationFrame, Site, sky_over
from celnav.detections import Detections
from celnav.errors import CalibrationError, CameraError
from celnav.lens.lens_uncertainty import LensUncertainty
from celnav.position import Weather
from celnav.sky.refraction import unrefract_rays
from celnav.sky.utc import parse_utc
from celnav.uncertainty.lens_errors import lens_derivatives
from celnav.uncertainty.refraction_errors import refraction_derivatives

LENS = celnav.Camera("kannala_brandt", 1200, 900, 330.0, k=(-0.01, 0.002), p=(1e-4, 0.0))
KNOWN = LensUncertainty(
    ("f_px", "cx_px", "k1"), ((0.01, 0.0, -1e-6), (0.0, 0.04, 0.0), (-1e-6, 0.0, 1e-8)),
    R_cam=((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)), turn_by_lens=((0.0, 0.003, 0.0),) * 3,
    star_cells=((10.0, 20.0, 400.0),),
)  # fmt: skip


def test_it_is_kept_in_camera_files(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(replace(LENS, uncertainty=KNOWN).to_json())
    read = celnav.Camera.from_json(path)
    assert read == LENS
    assert read.uncertainty == KNOWN
    assert celnav.read_camera_file(path).camera.uncertainty == KNOWN
    assert "uncertainty" not in LENS.to_dict()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parameters": ["f_px", "cx_px", "mass"]}, "mass"),
        ({"covariance": [[1, 0], [0, 1]]}, "shape"),
        ({"covariance": [[1, 2, 0], [2, 1, 0], [0, 0, 1]]}, "negative"),
        ({"covariance": [[1, 0, 0], [0, float("nan"), 0], [0, 0, 1]]}, "finite"),
        ({"attitude": {"R_cam": [[1, 0, 0]]}}, "turn_by_lens"),
    ],
)
def test_what_is_no_covariance_is_refused(change, message):
    record = json.loads(replace(LENS, uncertainty=KNOWN).to_json())
    record["uncertainty"] |= change
    with pytest.raises(CameraError, match=message):
        celnav.Camera.from_dict(record)


def test_derivatives_by_the_lens_are_those_of_its_formula():
    """Kannala & Brandt: u = cx + f theta (1 + k1 theta^2 + k2 theta^4) cos(phi)."""
    lens = replace(LENS, p=())
    theta, phi = 0.7, 0.3
    ray = np.array([[np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]])
    by = lens_derivatives(lens, ray, ("f_px", "cx_px", "k1"))[0]
    direction = np.array([np.cos(phi), np.sin(phi)])
    radius = theta * (1 - 0.01 * theta**2 + 0.002 * theta**4)
    assert by[:, 0] == pytest.approx(radius * direction, rel=1e-6)
    assert by[:, 1] == pytest.approx([1.0, 0.0], abs=1e-9)
    assert by[:, 2] == pytest.approx(330 * theta**3 * direction, rel=1e-5)


def test_refraction_moves_positions_as_more_pressure_does():
    camera, up = celnav.Camera.pinhole(1080, 720, 60), np.array([0.0, -0.6, 0.8])
    rays = camera.to_rays([[100.0, 200.0], [900.0, 500.0], [540.0, 30.0]])
    apparent = [unrefract_rays(rays, up, pressure, 10.0) for pressure in (1000.0, 1001.0)]
    # One thousandth more refraction takes off as much more: the unrefracted position is moved away from the zenith.
    moved = camera.project(apparent[1]) - camera.project(apparent[0])
    by = refraction_derivatives(camera, apparent[0], up, 1000.0, 10.0)[:, :, 0]
    assert moved == pytest.approx(-by / 1000, rel=0.02)


@pytest.mark.parametrize("count", [1, 40])
def test_a_blind_start_that_finds_nothing_is_bounded(count, monkeypatch):
    rng = np.random.default_rng(3)
    utc = parse_utc("2021-08-05T05:30:00Z")
    found = Detections(rng.uniform(0, 900, (60, 2)), np.ones(60), (900, 1200), None)
    frame = CalibrationFrame(found, utc, (1200, 900), "clutter")
    sky = sky_over(Site(34.5, -111.4, Weather()), utc, 4.0)
    work = []
    monkeypatch.setattr(blind_start, "identify_middle", lambda *given: work.append(given[4]))
    monkeypatch.setattr(blind_start, "identify_narrow", lambda *given: work.append(given[3]))
    field = joint_fit.Field([frame] * count, [sky] * count, [np.ones(60, dtype=bool)] * count)
    with pytest.raises(CalibrationError, match="no frame shows stars"):
        all_frames.first_frame(field)
    assert 1e9 < sum(work) < (1.8e9 if count == 1 else 4.0e9)
