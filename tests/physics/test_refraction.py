"""The generator's refraction against ERFA, and against Bennett's and Saemundsson's tables."""

import erfa
import numpy as np
import pytest

from generator.places.refraction import refraction_deg


def lift_arcmin(true_altitude_deg, pressure_hpa=1010.0, temperature_c=10.0, relative_humidity=0.0):
    altitude = np.atleast_1d(np.asarray(true_altitude_deg, float))
    air = {"pressure_hpa": pressure_hpa, "temperature_c": temperature_c, "relative_humidity": relative_humidity}
    return 60 * refraction_deg(altitude, **air)


@pytest.mark.parametrize(("apparent_deg", "arcmin"), [(15, 3.556), (20, 2.637), (30, 1.671), (45, 0.967), (60, 0.559)])
def test_high_altitudes_are_erfa_s_refco(apparent_deg, arcmin) -> None:
    """ERFA refco A = 58.070", B = -0.0650" at 1010 hPa, 10 deg C, 550 nm, dry; within 0.003'."""
    assert lift_arcmin(apparent_deg - arcmin / 60)[0] == pytest.approx(arcmin, abs=0.003)


@pytest.mark.parametrize(("true_deg", "arcmin"), [(0, 28.982), (1, 21.744), (2, 16.926), (5, 9.674), (10, 5.408)])
def test_low_altitudes_follow_saemundsson(true_deg, arcmin) -> None:
    """Within 4 %: the two nominal airs differ by 3 % in their constants."""
    assert lift_arcmin(true_deg)[0] == pytest.approx(arcmin, rel=0.04)


def test_is_continuous_and_falls_with_altitude() -> None:
    altitude = np.linspace(-2, 90, 4000)
    lift = lift_arcmin(altitude)
    assert np.abs(np.diff(lift)).max() < 0.5
    assert np.all(np.diff(lift[altitude > -1]) <= 1e-12)
    assert lift[-1] == pytest.approx(0, abs=1e-9)


def test_agrees_with_erfa_s_own_observed_places() -> None:
    """Against erfa.atco13 with air: 0.001 arcsec above 30 deg."""
    utc = (2458849.5, 0.25)
    _, zenith_air, *_ = erfa.atco13(
        np.radians(np.linspace(0, 359, 400)), np.full(400, 0.5), 0.0, 0.0, 0.0, 0.0, *utc, -0.177, 0.1, 0.9, 0.0, 0.0, 0.0,
        850.0, -5.0, 0.3, 0.55,
    )  # fmt: skip
    _, zenith_none, *_ = erfa.atco13(
        np.radians(np.linspace(0, 359, 400)), np.full(400, 0.5), 0.0, 0.0, 0.0, 0.0, *utc, -0.177, 0.1, 0.9, 0.0, 0.0, 0.0,
        0.0, 0.0, 0.0, 0.55,
    )  # fmt: skip
    high = zenith_air < np.radians(60)
    assert high.sum() > 100
    lift = lift_arcmin(90 - np.degrees(zenith_none[high]), 850.0, -5.0, 0.3)
    difference_arcsec = 60 * lift - np.degrees(zenith_none - zenith_air)[high] * 3600
    assert np.abs(difference_arcsec).max() < 0.001


def test_no_air_does_not_bend() -> None:
    assert lift_arcmin([0.0, 45.0], pressure_hpa=0.0).tolist() == [0.0, 0.0]


def test_the_series_is_solved() -> None:
    """True zenith distance = observed + A tan + B tan^3 of the observed one, from the zenith to 15 deg: 1e-8 arcsec."""
    altitude = np.linspace(15.0, 90.0, 2000)
    refa, refb = erfa.refco(1040.0, -30.0, 0.0, 0.55)
    observed = np.radians(90 - altitude - lift_arcmin(altitude, 1040.0, -30.0, 0.0) / 60)
    true = observed + refa * np.tan(observed) + refb * np.tan(observed) ** 3
    assert np.degrees(np.abs(true - np.radians(90 - altitude))).max() * 3600 < 1e-8
