"""Where stars fall in the image: against ERFA and OpenCV, and against Skyfield."""

import contextlib
from pathlib import Path

import cv2
import erfa
import numpy as np
import pytest
import skyfield_data
from skyfield.api import Loader, Star, wgs84
from small_scenes import small_scenario

from generator.frame.exposure.expected import render_expected
from generator.frame.plan import LONGEST_CHORD_S, plan_frame, refracting_air
from generator.places.astrometry import MAS_TO_RAD, Site, apparent_places
from generator.places.catalogue import load_catalogue
from generator.places.times import Instant, earth_orientation

RNG = np.random.default_rng(20260101)
PLACES = [
    (
        float(np.degrees(np.arcsin(RNG.uniform(-1, 1)))),
        float(RNG.uniform(-180, 180)),
        f"{RNG.integers(2000, 2026)}-{RNG.integers(1, 13):02d}-{RNG.integers(1, 28):02d}T{RNG.integers(0, 24):02d}:17:23Z",
    )
    for _ in range(20)
]


def scenario_at(latitude, longitude, utc, **more):
    return small_scenario(
        site__latitude_deg=latitude,
        site__longitude_deg=longitude,
        time__utc_start=utc,
        camera__width=1080,
        camera__height=720,
        sky=None,
        stars={"limiting_magnitude": 5.0},
        **more,
    )


def test_places_midway_are_those_of_mid_exposure() -> None:
    """The longest exposure whose middle is midway: within 0.2 mas from 5 deg up, 2 mas at the horizon, on the equator."""
    values = {"camera__hfov_deg": 170, "camera__model": "equidistant", "time__exposure_s": LONGEST_CHORD_S}
    plan = plan_frame(scenario_at(0.0, 30.0, "2021-03-04T01:00:00Z", **values), 0)
    spec = plan.spec
    site = Site(spec.site.latitude_deg, spec.site.longitude_deg, spec.site.height_m)
    wanted = apparent_places(plan.stars, site, plan.utc_mid, plan.orientation, refracting_air(spec.atmosphere))
    apart_mas = np.linalg.norm(plan.middle.enu - wanted.enu, axis=1) / MAS_TO_RAD
    high = wanted.altitude_deg > 5
    assert high.sum() > 500
    assert (~high).sum() > 20
    assert 0 < apart_mas[high].max() < 0.2
    assert apart_mas.max() < 2


@pytest.mark.parametrize(("latitude", "longitude", "utc"), PLACES)
def test_against_erfa_and_opencv(latitude, longitude, utc) -> None:
    """Within 0.01 px over a 120 deg field, for 20 random sites and dates.

    ERFA's atco13 does the whole chain to observed azimuth and zenith distance, its own refraction included; OpenCV projects.
    """
    plan = plan_frame(scenario_at(latitude, longitude, utc), 0)
    expected = render_expected(plan)
    middle = Instant.parse(utc).plus(0.25)
    orientation = earth_orientation(middle)
    stars = plan.stars
    azimuth, zenith, *_ = erfa.atco13(
        np.radians(stars.ra_deg),
        np.radians(stars.dec_deg),
        stars.pm_ra_mas_yr * MAS_TO_RAD / np.cos(np.radians(stars.dec_deg)),
        stars.pm_dec_mas_yr * MAS_TO_RAD,
        np.maximum(stars.parallax_mas, 0) / 1000,
        0.0,
        middle.utc1,
        middle.utc2,
        orientation.ut1_utc_s,
        np.radians(longitude),
        np.radians(latitude),
        0.0,
        np.radians(orientation.polar_motion_x_arcsec / 3600),
        np.radians(orientation.polar_motion_y_arcsec / 3600),
        1010.0,
        10.0,
        0.5,
        0.55,
    )
    enu = np.stack([np.sin(azimuth) * np.sin(zenith), np.cos(azimuth) * np.sin(zenith), np.cos(zenith)], axis=-1)
    focal = 540 / np.tan(np.radians(60))
    camera = np.array([[focal, 0, 539.5], [0, focal, 359.5], [0, 0, 1]])
    R_cam = np.array([[-1.0, 0, 0], [0, -1, 0], [0, 0, 1]])
    rotation, _ = cv2.Rodrigues(R_cam)
    uv = cv2.projectPoints(enu, rotation, np.zeros(3), camera, None)[0][:, 0]
    in_frame = (uv > -0.5).all(axis=1) & (uv[:, 0] < 1079.5) & (uv[:, 1] < 719.5) & (enu[:, 2] > 0.1)
    assert in_frame.sum() > 50
    difference = np.hypot(expected.u_px - uv[:, 0], expected.v_px - uv[:, 1])[in_frame]
    assert difference.max() < 0.01


def test_apparent_places_against_skyfield() -> None:
    """Without refraction, within 0.05 arcsec of Skyfield given the same Earth orientation."""
    latitude, longitude, utc = 52.0, 4.36, "2021-08-12T23:10:05Z"
    plan = plan_frame(scenario_at(latitude, longitude, utc, atmosphere={"refraction": False}), 0)
    middle = Instant.parse(utc).plus(0.25)
    orientation = earth_orientation(middle)
    loader = Loader(Path(skyfield_data.__file__).parent / "data", verbose=False)
    leap_seconds = 37
    timescale = loader.timescale(builtin=True, delta_t=32.184 + leap_seconds - orientation.ut1_utc_s)
    timescale.polar_motion_table = (
        np.array([middle.mjd - 1 + 2400000.5, middle.mjd + 1 + 2400000.5]),
        np.full(2, orientation.polar_motion_x_arcsec),
        np.full(2, orientation.polar_motion_y_arcsec),
    )
    time = timescale.utc(2021, 8, 12, 23, 10, 5.25)
    stars = plan.stars[np.arange(0, len(plan.stars), 7)]
    target = Star(
        ra_hours=stars.ra_deg / 15,
        dec_degrees=stars.dec_deg,
        ra_mas_per_year=stars.pm_ra_mas_yr,
        dec_mas_per_year=stars.pm_dec_mas_yr,
        parallax_mas=np.maximum(stars.parallax_mas, 0),
    )
    with contextlib.closing(loader("de421.bsp")) as planets:
        observer = (planets["earth"] + wgs84.latlon(latitude, longitude)).at(time)
        altitude, azimuth, _ = observer.observe(target).apparent().altaz()
    rows = np.arange(0, len(plan.stars), 7)
    across = (plan.middle.azimuth_deg[rows] - azimuth.degrees + 180) % 360 - 180
    across *= np.cos(np.radians(altitude.degrees)) * 3600
    along = (plan.middle.altitude_deg[rows] - altitude.degrees) * 3600
    assert np.hypot(across, along).max() < 0.05


def test_stars_move_with_the_sky_during_the_exposure() -> None:
    """A star on the equator at the zenith drifts 15.04 arcsec a second westwards: to the image's right."""
    scenario = small_scenario(
        site={"latitude_deg": 0.0, "longitude_deg": 0.0},
        time__exposure_s=100.0,
        sky=None,
        stars={"limiting_magnitude": 7.0},
    )
    plan = plan_frame(scenario, 0)
    start, end = plan.start.enu, plan.end.enu
    high = (plan.middle.altitude_deg > 80) & (np.abs(plan.stars.dec_deg) < 5)
    assert high.sum() > 3
    travel_arcsec = np.degrees(np.linalg.norm(end - start, axis=1)[high]) * 3600 / 100
    np.testing.assert_allclose(travel_arcsec, 15.041 * np.cos(np.radians(plan.dec_deg[high])), rtol=2e-3)
    assert (end[high, 0] < start[high, 0]).all()


def test_bright_stars_have_their_published_places() -> None:
    """Sirius, Vega and Polaris at J2000.0 (SIMBAD, 0.1 arcsec)."""
    catalogue = load_catalogue()
    for hip, ra_deg, dec_deg, v_mag in [
        (32349, 101.287155, -16.716116, -1.46),
        (91262, 279.234735, 38.783689, 0.03),
        (11767, 37.954561, 89.264109, 2.02),
    ]:
        row = int(np.nonzero(catalogue.hip == hip)[0][0])
        across = (catalogue.ra_deg[row] - ra_deg) * np.cos(np.radians(dec_deg))
        assert np.hypot(across, catalogue.dec_deg[row] - dec_deg) * 3600 < 0.1
        assert catalogue.v_mag[row] == pytest.approx(v_mag, abs=0.005)


def test_choice_of_stars_around_a_direction_loses_none() -> None:
    """Against the places of all stars, at ten sites and times from 1975 to 2027: the horizon, and a field of 20 deg."""
    from generator.frame.plan import FIELD_MARGIN_DEG
    from generator.places.astrometry import Air, Site, apparent_places, stars_within
    from generator.places.ephemeris import icrs_from_enu

    catalogue = load_catalogue()[np.arange(0, 60000, 5)]
    for number, (latitude, longitude, utc) in enumerate(PLACES[:10]):
        instant = Instant.parse(f"{1975 + 5 * number if number < 9 else 2027}{utc[4:]}")
        if number == 9:
            instant = Instant.parse("2027-06-01T03:00:00Z")
        site, orientation = Site(latitude, longitude), earth_orientation(instant)
        places = apparent_places(catalogue, site, instant, orientation, Air(1010, 10, 0.5))
        rotation = icrs_from_enu(site, instant, orientation)
        for axis, angle_deg in ((np.array([0.0, 0.0, 1.0]), 90.0), (np.array([0.6, 0.8, 0.0]), 20.0)):
            inside = places.enu @ axis > np.cos(np.radians(angle_deg))
            chosen = stars_within(catalogue, rotation @ axis, angle_deg + FIELD_MARGIN_DEG)
            assert not (inside & ~chosen).any()
            assert (places.enu[chosen] @ axis).min() > np.cos(np.radians(angle_deg + 2 * FIELD_MARGIN_DEG))


def test_places_agree_with_erfa_one_star_at_a_time() -> None:
    """Against ERFA's own chain in one call (atco13, polar motion and UT1 included), without air: 1e-6 arcsec."""
    from generator.places.astrometry import Air, Site, apparent_places

    catalogue = load_catalogue()[np.arange(0, 20000, 20)]
    instant, site = Instant.parse("2019-08-04T20:00:00Z"), Site(-33.0, 151.0, 800.0)
    orientation = earth_orientation(instant)
    places = apparent_places(catalogue, site, instant, orientation, Air(0.0, 10, 0.5))
    declination = np.radians(catalogue.dec_deg)
    mas = np.pi / 180 / 3.6e6
    azimuth, zenith_distance, *_ = erfa.atco13(
        np.radians(catalogue.ra_deg), declination, catalogue.pm_ra_mas_yr * mas / np.cos(declination),
        catalogue.pm_dec_mas_yr * mas, np.maximum(catalogue.parallax_mas, 0) / 1000, 0.0, instant.utc1, instant.utc2,
        orientation.ut1_utc_s, np.radians(site.longitude_deg), np.radians(site.latitude_deg), site.height_m,
        np.radians(orientation.polar_motion_x_arcsec / 3600), np.radians(orientation.polar_motion_y_arcsec / 3600),
        0.0, 0.0, 0.0, 0.55,
    )  # fmt: skip
    wanted = np.stack(
        [np.sin(azimuth) * np.sin(zenith_distance), np.cos(azimuth) * np.sin(zenith_distance), np.cos(zenith_distance)],
        axis=-1,
    )
    assert np.degrees(np.linalg.norm(places.enu - wanted, axis=1)).max() * 3600 < 1e-6


def test_intermediate_places_of_the_whole_catalogue_are_erfa_s() -> None:
    """Against ERFA's atciq from decade to decade, stars beside the Sun among them: within 1e-6 mas."""
    from generator.places.astrometry import Site, intermediate_places, star_parameters

    catalogue = load_catalogue()
    declination = np.radians(catalogue.dec_deg)
    for utc, site in [
        ("1980-05-04T20:11:00Z", Site(-70.0, 30.0)),
        ("2001-12-21T03:00:00Z", Site(0.0, -120.0, 2500.0)),
        ("2026-08-12T17:45:00Z", Site(89.0, 170.0)),
    ]:
        instant = Instant.parse(utc)
        orientation = earth_orientation(instant)
        wanted = erfa.s2c(
            *erfa.atciq(
                np.radians(catalogue.ra_deg), declination, catalogue.pm_ra_mas_yr * MAS_TO_RAD / np.cos(declination),
                catalogue.pm_dec_mas_yr * MAS_TO_RAD, np.maximum(catalogue.parallax_mas, 0) / 1000,
                np.zeros(len(catalogue)), star_parameters(site, instant, orientation),
            )
        )  # fmt: skip
        found = intermediate_places(catalogue, site, instant, orientation).cirs
        assert np.degrees(np.linalg.norm(found - wanted, axis=1)).max() * 3600e3 < 1e-6
        # A part of the catalogue has the same places: what is known of the whole goes along.
        rows = np.arange(7, len(catalogue), 1000)
        part = intermediate_places(catalogue[rows].joined(catalogue[np.arange(9)]), site, instant, orientation).cirs
        np.testing.assert_allclose(part, np.concatenate([found[rows], found[:9]]), atol=1e-15)


def test_intermediate_places_serve_the_whole_exposure() -> None:
    """An hour later, places from one set of intermediate places differ from those computed afresh by under 0.1 arcsec."""
    from generator.places.astrometry import Air, Site, apparent_places, intermediate_places, observed_places

    catalogue = load_catalogue()[np.arange(0, 5000, 5)]
    instant, site, air = Instant.parse("2022-03-04T20:00:00Z"), Site(52.0, 4.36), Air(0.0, 10, 0.5)
    later, orientation = instant.plus(3600.0), earth_orientation(instant)
    reused = observed_places(intermediate_places(catalogue, site, instant, orientation), site, later, orientation, air)
    afresh = apparent_places(catalogue, site, later, orientation, air)
    assert np.degrees(np.linalg.norm(reused.enu - afresh.enu, axis=1)).max() * 3600 < 0.1
