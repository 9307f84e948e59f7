"""celnav's apparent places against Skyfield, an independent implementation with JPL's DE421."""

from pathlib import Path

import numpy as np
import pytest
import skyfield_data
from skyfield.api import Loader, Star, wgs84

from celnav.sky.astrometry import apparent_enu
from celnav.sky.catalog import load_catalog
from celnav.sky.earth_rotation import EarthOrientation

TOLERANCE_ARCSEC = 0.1
N_STARS = 60


@pytest.fixture(scope="module")
def ephemeris():
    # Not through skyfield_data's own function: that warns about the age of a table which is not read here.
    loader = Loader(Path(skyfield_data.__file__).parent / "data", verbose=False)
    planets = loader("de421.bsp")
    yield planets["earth"], loader.timescale(builtin=True)
    planets.close()


@pytest.fixture(scope="module")
def stars():
    catalog = load_catalog()
    bright = np.flatnonzero((catalog.v_mag < 4.5) & (catalog.hip > 0))
    chosen = np.random.default_rng(1).choice(bright, N_STARS, replace=False)
    # Arcturus and alpha Cen A move fastest and stand nearest; Polaris tests the pole.
    return catalog.take(np.concatenate((chosen, catalog.rows_of([69673, 71683, 11767]))))


@pytest.mark.parametrize("year", [2000, 2006, 2013, 2020, 2025])
@pytest.mark.parametrize("site", [(0.0, 0.0), (51.5, -0.1), (-33.9, 151.2), (78.2, 15.6), (-89.0, 120.0)])
def test_geometric_places_agree_with_skyfield(ephemeris, stars, year, site):
    earth, timescale = ephemeris
    time = timescale.utc(year, 3 + year % 7, 11, 4, 13, 7.25)
    observer = earth + wgs84.latlon(*site, elevation_m=0)
    sky = Star(
        ra_hours=np.degrees(stars.ra_rad) / 15,
        dec_degrees=np.degrees(stars.dec_rad),
        ra_mas_per_year=stars.pm_ra_mas_yr,
        dec_mas_per_year=stars.pm_dec_mas_yr,
        parallax_mas=stars.parallax_mas,
        epoch=2451545.0 + (1991.25 - 2000.0) * 365.25,
    )
    altitude, azimuth, _ = observer.at(time).observe(sky).apparent().altaz()
    alt, az = altitude.radians, azimuth.radians
    expected = np.column_stack((np.cos(alt) * np.sin(az), np.cos(alt) * np.cos(az), np.sin(alt)))
    ours = apparent_enu(
        stars,
        time.utc_iso(places=3),
        *site,
        pressure_hpa=0,
        orientation=EarthOrientation(float(time.dut1)),  # Skyfield's builtin time scale has no polar motion
    )
    separation = np.degrees(2 * np.arcsin(np.linalg.norm(ours - expected, axis=1) / 2)) * 3600
    assert separation.max() < TOLERANCE_ARCSEC
