"""Pixel-phase error of centroids: where it comes from, and that calibrations find it where it is and only there."""

from __future__ import annotations

import json

import numpy as np
import pytest
from calibration_sky import LAT_DEG, LON_DEG, apparent_stars, fisheye_positions, frame_of
from scipy.special import ndtr

import celnav
from celnav.calibrating.calibrate import calibrate
from celnav.calibrating.frames import CalibrationFrame
from celnav.calibrating.lens_form import LensForm
from celnav.calibrating.scatter.pixel_phase import FEWEST_PIXELS, MOST_CHANCE, PixelPhase, measure_pixel_phase
from celnav.calibrating.verdict import report, verdict
from celnav.detections import Detections

SIZE = (1200, 900)
LENS = (330.0, 612.0, 441.0, -0.012, 0.004, 0.0, 0.0)
AMPLITUDE_PX = np.array([-0.05, 0.03])
SIGMA_PX = 0.1
# Chi-squared of two degrees of freedom exceeds it with a probability of 0.001.
MOST_SQUARE = 13.8


def drawn(uv, amplitude_px):
    """Where stars are measured that noise has moved to `uv`: the error is one of the measured position."""
    at = uv
    for _ in range(60):
        at = uv + amplitude_px * np.sin(2 * np.pi * at)
    return at


def scattered(rng, count, amplitude_px=(0.0, 0.0)):
    """Measured positions, residuals and standard deviations of stars anywhere in a frame."""
    true, sigma_px = rng.uniform(0, 1000, (count, 2)), rng.uniform(0.05, 0.3, count)
    uv = drawn(true + rng.normal(0, 1, (count, 2)) * sigma_px[:, None], np.array(amplitude_px))
    return uv, uv - true, sigma_px


def square_of(phase, amplitude_px):
    return float(((np.array(phase.amplitude_px) - amplitude_px) ** 2 / np.array(phase.sigma_px) ** 2).sum())


def test_amplitudes_are_found_within_their_standard_deviations():
    # 400 degrees of freedom: chi-squared leaves 0.77 to 1.26 of them in less than one set of 1,000.
    squares = [
        square_of(measure_pixel_phase(*scattered(np.random.default_rng([seed, 3]), 800, AMPLITUDE_PX)), AMPLITUDE_PX)
        for seed in range(200)
    ]
    assert 0.77 < np.mean(squares) / 2 < 1.26


@pytest.mark.parametrize("count", [FEWEST_PIXELS + 20, 1000])
def test_none_is_found_in_noise(count):
    # Of 2,000 sets two are expected; more than 8 come by chance in 0.02 % of runs.
    found = sum(bool(measure_pixel_phase(*scattered(np.random.default_rng([seed, 5]), count))) for seed in range(2000))
    assert found <= 4 * MOST_CHANCE * 2000


def test_none_is_found_in_what_frames_share():
    """A lens that is wrong by 0.1 px, differently from one pixel to the next, is no error of the centroids."""
    found = 0
    for seed in range(1000):
        rng = np.random.default_rng([seed, 7])
        uv, off, sigma_px = scattered(rng, 300)
        frames = [
            (uv + rng.normal(0, 0.02, uv.shape), off + rng.normal(0, 0.02, off.shape), sigma_px) for _ in range(9)
        ]
        found += bool(measure_pixel_phase(*(np.concatenate(column) for column in zip(*frames, strict=True))))
    # One is expected; more than 5 come by chance in 0.06 % of runs.
    assert found <= 5


def test_none_is_sought_of_few_stars_and_of_whole_pixels():
    uv, off, sigma_px = scattered(np.random.default_rng(1), FEWEST_PIXELS - 1, (-0.1, -0.1))
    assert not measure_pixel_phase(uv, off, sigma_px)
    uv, off, sigma_px = scattered(np.random.default_rng(1), 1000, (-0.1, -0.1))
    assert measure_pixel_phase(uv, off, sigma_px)
    assert not measure_pixel_phase(np.round(2 * uv) / 2, off, sigma_px)
    assert not measure_pixel_phase(uv, 0 * off, sigma_px)
    assert PixelPhase().error_px(uv) == pytest.approx(0.0)


@pytest.mark.parametrize(("star_sigma_px", "amplitude_px"), [(0.6, -0.070), (0.7, -0.024), (0.8, -0.007), (1.2, 0.0)])
def test_windowed_centroids_of_sharp_stars_have_it(star_sigma_px, amplitude_px):
    rng, side, step = np.random.default_rng(0), 20, 20
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2) * step + step / 2
    true = grid + rng.uniform(-0.5, 0.5, grid.shape)
    edges = np.arange(side * step + 1) - 0.5
    image = 1000 + rng.normal(0, 5, (side * step, side * step))
    for u, v in true:
        light = [np.diff(ndtr((edges - at) / star_sigma_px)) for at in (v, u)]
        image += 2e5 * np.outer(*light)
    uv = celnav.detect(image.astype(np.float32)).uv
    apart = np.linalg.norm(uv[:, None] - true, axis=2)
    seen = apart.min(axis=1) < 1
    assert seen.sum() >= 390
    off = (uv - true[apart.argmin(axis=1)])[seen]
    found = measure_pixel_phase(uv[seen], off, np.full(seen.sum(), 0.01))
    assert found.amplitude_px == pytest.approx((amplitude_px, amplitude_px), abs=0.002)


def synthetic(seed, amplitude_px):
    """Two frames of a fisheye, calibrated with the lens' form given."""
    rng, frames = np.random.default_rng(seed), []
    R_cam = np.diag([-1.0, -1.0, 1.0])
    for utc in ("2021-08-05T05:30:00+00:00", "2021-08-05T08:10:00+00:00"):
        enu, v_mag = apparent_stars(utc, 6.0)
        uv = fisheye_positions(enu, R_cam, LENS)
        frame, _ = frame_of(utc, uv, v_mag, SIZE, rng, sigma_px=SIGMA_PX)
        found = frame.detections
        moved = Detections(drawn(frame.uv, amplitude_px), found.flux, found.shape, found.sigma_px)
        frames.append(CalibrationFrame(moved, frame.utc, SIZE, utc))
    guess = celnav.Camera("equidistant", *SIZE, LENS[0])
    return calibrate(frames, LAT_DEG, LON_DEG, camera=guess, form=LensForm("kannala_brandt", 2))


def test_calibration_takes_it_off_and_says_so():
    found = synthetic(0, AMPLITUDE_PX)
    assert square_of(found.pixel_phase, AMPLITUDE_PX) < MOST_SQUARE
    assert max(found.pixel_phase.sigma_px) < 0.006
    assert found.rms_px == pytest.approx(SIGMA_PX, rel=0.05)
    error = found.values - np.array(LENS[: len(found.values)])
    assert float(error @ np.linalg.solve(found.cov, error)) < 20.5  # five degrees of freedom: 0.1 % by chance
    assert "pixel-phase error of 0.05 px taken off" in verdict(found)
    assert "sin(2 pi u)" in report(found)
    content = json.loads(found.to_json())["calibration"]
    assert content["pixel_phase_px"] == pytest.approx(AMPLITUDE_PX, abs=0.02)


def test_calibration_without_it_finds_none():
    """By chance one in a thousand does."""
    found = synthetic(1, np.zeros(2))
    assert found.pixel_phase == PixelPhase()
    assert "taken off" not in verdict(found)
    assert "no pixel-phase error" in report(found)
    assert json.loads(found.to_json())["calibration"]["pixel_phase_px"] == [0.0, 0.0]
