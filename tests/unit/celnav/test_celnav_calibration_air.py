"""Covariances of a calibration hold the air that nobody measured."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_sky import LAT_DEG, LON_DEG, apparent_stars, frame_of, perspective_positions

import celnav
from celnav.calibrating.lens_form import LensForm
from celnav.calibrating.scatter.air import (
    USUAL_PRESSURE_SIGMA_HPA,
    USUAL_TEMPERATURE_SIGMA_C,
    relative_sigma,
)

UTC = "2021-08-05T05:30:00+00:00"
SIZE = (1200, 900)
F_PX, SIGMA_PX = 2400.0, 0.02
R_ZENITH = np.eye(3)
# Refractivity of dry air at 15 deg C and 1013.25 hPa, 574 nm (Allen, Astrophysical Quantities, 1976, section 57).
REFRACTIVITY = 2.775e-4
DRAWS = 12


def calibrated(rng, hpa=1010.0, celsius=10.0, **air):
    """A narrow camera that looks at the zenith, calibrated under one air and imaged under another."""
    enu, v_mag = apparent_stars(UTC, 7.5, hpa=hpa, celsius=celsius)
    near = enu[:, 2] > 0.9
    enu, v_mag = enu[near], v_mag[near]
    uv = perspective_positions(enu, R_ZENITH, [F_PX, 600.0, 450.0])
    frame, _ = frame_of(UTC, uv, v_mag, SIZE, rng, sigma_px=SIGMA_PX, missing=0, false=0, scatter_mag=0.02)
    guess = celnav.Camera("pinhole", *SIZE, F_PX, F_PX, 600.0, 450.0)
    return celnav.calibrate([frame], LAT_DEG, LON_DEG, camera=guess, form=LensForm("pinhole", 0), **air)


def test_the_refraction_is_as_uncertain_as_its_air() -> None:
    sea = celnav.usual_weather(0.0)
    known = relative_sigma(sea, pressure_given=True, temperature_given=True)
    assert known == pytest.approx(0.01)
    # Ideal gas: 10.1 hPa or 2.8315 K are 1 %.
    cold = relative_sigma(sea, pressure_given=True, temperature_given=False)
    assert np.hypot(known, USUAL_TEMPERATURE_SIGMA_C / 283.15) == pytest.approx(cold)
    low = relative_sigma(sea, pressure_given=False, temperature_given=True)
    assert np.hypot(known, USUAL_PRESSURE_SIGMA_HPA / 1010.0) == pytest.approx(low)
    assert relative_sigma(celnav.Weather(0.0), pressure_given=False, temperature_given=False) == 0.0


def test_air_shrinks_the_sky_about_the_zenith_by_its_refractivity() -> None:
    rng = np.random.default_rng(5)
    guessed, told = calibrated(rng), calibrated(np.random.default_rng(5), pressure_hpa=1013.25, temperature_c=15.0)
    by_air = np.sqrt(guessed.sigmas["f_px"] ** 2 - told.sigmas["f_px"] ** 2) / F_PX
    more = np.sqrt(
        relative_sigma(celnav.usual_weather(0.0), pressure_given=False, temperature_given=False) ** 2 - 0.01**2
    )
    # Over the field the square of the secant of the zenith distance goes from 1.00 to 1.11.
    usual = REFRACTIVITY * 1010.0 / 1013.25 * 288.15 / 283.15
    assert 1.0 < by_air / (more * usual) < 1.11
    # The same stars and the same noise under a higher pressure.
    shift = calibrated(np.random.default_rng(5), hpa=1040.0).values[0] - guessed.values[0]
    assert -1.11 < shift / (F_PX * usual * 30.0 / 1010.0) < -1.0


@pytest.mark.slow
def test_the_focal_length_is_as_far_off_as_claimed_under_any_air() -> None:
    rng = np.random.default_rng(8)
    z = []
    for _ in range(DRAWS):
        hpa = 1010.0 + rng.normal(0, USUAL_PRESSURE_SIGMA_HPA)
        found = calibrated(rng, hpa, 10.0 + rng.normal(0, USUAL_TEMPERATURE_SIGMA_C))
        z.append((found.values[0] - F_PX) / found.sigmas["f_px"])
    # Chi-squared of 12 degrees of freedom per degree lies within 0.18 to 2.75 in 99.8 % of sets; the noise of the stars alone
    # would make it 10.
    assert 0.18 < np.mean(np.square(z)) < 2.75
