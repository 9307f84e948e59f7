"""Bennett's refraction against its published values."""

import numpy as np
import pytest

from celnav.sky.refraction import bennett_arcmin, refract, unrefract

# 1010 hPa, 10 deg C; the formula of Bennett 1982, evaluated elsewhere.
TABLE_ARCMIN = {
    0: 34.478, 0.5: 28.754, 1: 24.329, 2: 18.216, 5: 9.883, 10: 5.392,
    15: 3.636, 20: 2.703, 30: 1.717, 45: 0.995, 60: 0.575, 75: 0.266,
}  # fmt: skip


@pytest.mark.parametrize(("altitude_deg", "arcmin"), TABLE_ARCMIN.items())
def test_bennett_table(altitude_deg, arcmin):
    assert bennett_arcmin(altitude_deg) == pytest.approx(arcmin, abs=0.0006)


def test_pressure_and_temperature_scale():
    ratio = bennett_arcmin(20.0, 505.0, 10.0) / bennett_arcmin(20.0)
    assert ratio == pytest.approx(0.5)
    assert bennett_arcmin(20.0, 1010.0, -20.0) / bennett_arcmin(20.0) == pytest.approx(283 / 253)


def test_within_three_percent_of_saemundsson_above_ten_degrees():
    """The inverse formula of Saemundsson 1986, R = 1.02 cot(h + 10.3 / (h + 5.11)) from the true altitude h."""
    true_deg = np.arange(10.0, 80.0)
    saemundsson = 1.02 / np.tan(np.radians(true_deg + 10.3 / (true_deg + 5.11)))
    np.testing.assert_allclose(bennett_arcmin(true_deg + saemundsson / 60), saemundsson, rtol=0.03)


def test_refract_and_unrefract_are_inverse_and_lift():
    altitude = np.radians(np.concatenate((np.linspace(5, 89.9, 50), [90.0])))
    azimuth = np.linspace(0, 6, 51)
    dirs = np.column_stack((np.cos(altitude) * np.sin(azimuth), np.cos(altitude) * np.cos(azimuth), np.sin(altitude)))
    seen = refract(dirs, 1010.0, 10.0)
    assert (seen[:48, 2] > dirs[:48, 2]).all()
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 1, atol=1e-12)
    back = unrefract(seen, 1010.0, 10.0)
    arcsec = np.degrees(np.linalg.norm(back - dirs, axis=1)) * 3600
    # Bennett's formula is -0.08 arcsec at the zenith itself, where lifting has no direction.
    assert arcsec.max() < 0.1
