"""The series that stands for the integral of refraction at low altitudes."""

from __future__ import annotations

import numpy as np
import pytest

from celnav.sky.ray_integral import air_at, ray_bending_rad
from celnav.sky.refraction import _low_bending


@pytest.mark.parametrize(
    "air", [(1010.0, 10.0), (600.0, -40.0), (1050.0, 45.0), (1050.0, -60.0), (100.0, -60.0), (1e-3, 0.0)]
)
def test_the_series_is_the_integral_to_rounding(air):
    given = air_at(*air, 0.5, 0.55)
    altitude = np.radians(np.linspace(-1.0, 15.0, 700))
    np.testing.assert_allclose(_low_bending(altitude, given), ray_bending_rad(altitude, given), rtol=0, atol=1e-12)
