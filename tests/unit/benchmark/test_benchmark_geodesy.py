import math

import pytest

from benchmark.judge.geodesy import (
    MEAN_RADIUS_KM,
    WGS84_A_KM,
    WGS84_E2,
    east_north_km,
    geodesic_km,
    radii_of_curvature_km,
)

# Metres. The first two are printed in Karney (2013), tables 2 and 4; the last is Flinders Peak to Buninyong, the test
# line of the Geocentric Datum of Australia manual (54 972.271 m); the others are values of GeographicLib 2.1.
PUBLISHED = [
    ((40.0, 0.0, 41.79331020506, 137.84490004377), 10_000_000.0),
    ((-30.0, 0.0, 29.9, 179.8), 19_989_832.827610),
    ((0.0, 0.0, 0.5, 179.5), 19_936_288.578965),
    ((0.0, 0.0, 0.5, 179.7), 19_944_127.420750),
    ((0.0, 0.0, 0.0, 180.0), 20_003_931.458625),
    ((0.0, 0.0, 0.0, 179.0), 19_926_188.851996),
    ((0.0, 0.0, 0.0, 179.5), 19_980_861.908891),
    ((90.0, 0.0, -90.0, 0.0), 20_003_931.458625),
    ((45.0, 10.0, -45.0, -170.0), 20_003_931.458625),
    ((10.0, 20.0, -9.99, -160.02), 20_002_789.076262),
    ((48.1, 11.5, 48.10001, 11.5), 1.111923),
    ((89.999, 0.0, 89.999, 180.0), 223.387959),
    ((5.0, 179.99, 5.1, -179.99), 11_278.492435),
    ((0.0, 0.0, 1.0, 0.0), 110_574.388558),
    ((-37.951033416667, 144.424867888889, -37.652821138889, 143.926495527778), 54_972.271139),
]


@pytest.mark.parametrize(("points", "metres"), PUBLISHED)
def test_matches_published_geodesics_within_a_millimetre(points, metres):
    assert 1000.0 * geodesic_km(*points) == pytest.approx(metres, abs=1e-3)
    lat1, lon1, lat2, lon2 = points
    assert 1000.0 * geodesic_km(lat2, lon2, lat1, lon1) == pytest.approx(metres, abs=1e-3)


def test_a_degree_of_the_equator_is_an_arc_of_its_circle():
    assert geodesic_km(0.0, 0.0, 0.0, 1.0) == pytest.approx(math.radians(1.0) * WGS84_A_KM, rel=1e-12)


def test_coincident_points_are_at_no_distance():
    assert geodesic_km(48.1, 11.5, 48.1, 11.5) == 0.0
    assert geodesic_km(90.0, 0.0, 90.0, 77.0) == pytest.approx(0.0, abs=1e-9)


def test_longitude_wraps():
    assert geodesic_km(10.0, 350.0, 11.0, 10.0) == pytest.approx(geodesic_km(10.0, -10.0, 11.0, 370.0), rel=1e-12)


def test_never_longer_than_half_a_meridian():
    # The longest geodesic on an oblate ellipsoid joins the poles: half a meridian, GeographicLib's 20 003 931.4586 m.
    for lon in range(170, 181):
        for lat in (-60.0, -5.0, 0.0, 0.2, 30.0):
            distance = geodesic_km(lat, 0.0, -lat + 0.1, lon)
            assert distance <= 20_003.931459 + 1e-6
            assert distance > math.pi * WGS84_A_KM * math.sqrt(1.0 - WGS84_E2) - 1200.0


@pytest.mark.parametrize("bad", [(math.nan, 0, 0, 0), (0, math.inf, 0, 0), (90.1, 0, 0, 0), (0, 0, -91, 0)])
def test_impossible_coordinates_are_refused(bad):
    with pytest.raises(ValueError, match="must"):
        geodesic_km(*bad)


def test_direction_is_the_published_one():
    # Flinders Peak to Buninyong, Geocentric Datum of Australia manual: azimuth 306 deg 52' 05.37".
    line = (-37.951033416667, 144.424867888889, -37.652821138889, 143.926495527778)
    east, north = east_north_km(*line)
    assert math.degrees(math.atan2(east, north)) % 360 == pytest.approx(306 + 52 / 60 + 5.37 / 3600, abs=1e-6)
    assert math.hypot(east, north) == pytest.approx(geodesic_km(*line), rel=1e-12)


def test_direction_of_nearly_antipodal_points():
    # Karney (2013), table 4: the azimuth at the first point is 161.890524 deg.
    east, north = east_north_km(-30.0, 0.0, 29.9, 179.8)
    assert math.degrees(math.atan2(east, north)) == pytest.approx(161.890524, abs=1e-4)
    assert east_north_km(10.0, 20.0, 10.0, 20.0) == (0.0, 0.0)


def test_constants_and_radii_of_wgs84():
    """NIMA TR8350.2: a, e^2 and the mean radius; a short way along a meridian and a parallel has the radii."""
    assert WGS84_A_KM == 6378.137
    assert pytest.approx(6.69437999014e-3, rel=1e-12) == WGS84_E2
    assert pytest.approx(6371.0087714, abs=1e-7) == MEAN_RADIUS_KM
    for latitude in (0.0, 37.0, -71.0):
        east_km, north_km = radii_of_curvature_km(latitude)
        step = 1e-3
        north = geodesic_km(latitude - step, 10.0, latitude + step, 10.0)
        east = geodesic_km(latitude, 10.0 - step, latitude, 10.0 + step)
        assert north == pytest.approx(north_km * math.radians(2 * step), rel=1e-8)
        assert east == pytest.approx(east_km * math.cos(math.radians(latitude)) * math.radians(2 * step), rel=1e-8)
