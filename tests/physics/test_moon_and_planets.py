"""Sun, Moon and planets against Skyfield; the Moon's light."""

import numpy as np
import pytest
from skyfield.api import Loader, load_file, wgs84
from skyfield.magnitudelib import planetary_magnitude
from small_scenes import small_scenario

from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.light.photometry import BESSELL_V, GRID_NM
from generator.light.stellar_spectra import band_weights, star_spectra
from generator.places.astrometry import Air, Site, apparent_places
from generator.places.ephemeris import (
    KERNEL_PATH,
    MOON,
    PLANET_BV_MAG,
    PLANET_VI_MAG,
    PLANETS,
    SUN,
    apparent_enu,
    observe,
    planet_v_mag,
    planets,
)
from generator.places.times import Instant, earth_orientation
from generator.sky.moon_irradiance import earthshine_over_moonlight, moon_colours, moon_spectrum, moon_v_mag
from generator.sky.sunlight import SUN_BV_MAG, SUN_VI_MAG

TIMES = ("2020-01-15T20:00:00Z", "2021-06-10T04:00:00Z", "2023-10-14T11:00:00Z", "2018-07-27T21:00:00Z")
SITE = Site(52.0, 4.36, 10.0)
NO_AIR = Air(0.0, 10.0, 0.5)
NAMES = {"mercury": "mercury", "venus": "venus", "mars": "mars", "jupiter": "jupiter barycenter",
         "saturn": "saturn barycenter", "uranus": "uranus barycenter", "neptune": "neptune barycenter"}  # fmt: skip


@pytest.fixture(scope="module")
def sky(tmp_path_factory):
    kernel = load_file(str(KERNEL_PATH))
    yield kernel, Loader(str(tmp_path_factory.mktemp("skyfield"))).timescale(builtin=True)
    kernel.close()


def skyfield_time(timescale, text):
    date, clock = text[:-1].split("T")
    return timescale.utc(*(int(part) for part in date.split("-")), *(int(part) for part in clock.split(":")))


@pytest.mark.parametrize("text", TIMES)
def test_sun_moon_and_planets_stand_where_skyfield_has_them(sky, text) -> None:
    """Within 1 arcsec (Skyfield has UT1 but no polar motion, 0.3 arcsec)."""
    kernel, timescale = sky
    instant = Instant.parse(text)
    orientation = earth_orientation(instant)
    observer = kernel["earth"] + wgs84.latlon(SITE.latitude_deg, SITE.longitude_deg, SITE.height_m)
    time = skyfield_time(timescale, text)
    bodies = {"sun": SUN, "moon": MOON} | PLANETS
    for name, number in bodies.items():
        altitude, azimuth, distance = observer.at(time).observe(kernel[NAMES.get(name, name)]).apparent().altaz()
        a, h = azimuth.radians, altitude.radians
        theirs = np.array([np.sin(a) * np.cos(h), np.cos(a) * np.cos(h), np.sin(h)])
        body = observe(number, SITE, instant, orientation)
        ours = apparent_enu(body, SITE, instant, orientation, NO_AIR)
        assert np.degrees(np.linalg.norm(ours - theirs)) * 3600 < 1.0, name
        assert body.distance_km == pytest.approx(distance.km, rel=1e-6), name


@pytest.mark.parametrize("text", TIMES)
def test_magnitudes_of_planets_are_skyfield_s(sky, text) -> None:
    """Mallama & Hilton 2018 as Skyfield has it, which carries the rotation of Mars no more than we do: within 0.1 mag."""
    kernel, timescale = sky
    instant = Instant.parse(text)
    orientation = earth_orientation(instant)
    observer = kernel["earth"] + wgs84.latlon(SITE.latitude_deg, SITE.longitude_deg, SITE.height_m)
    for name, number in PLANETS.items():
        theirs = planetary_magnitude(observer.at(skyfield_time(timescale, text)).observe(kernel[NAMES[name]]))
        ours = planet_v_mag(name, observe(number, SITE, instant, orientation))
        assert ours == pytest.approx(float(theirs), abs=0.1), name


MALLAMA_BANDS_NM = (360, 436, 549, 641, 700, 798, 880)
MALLAMA_ALBEDOS = {
    "mercury": (0.087, 0.105, 0.142, 0.158, 0.172, 0.180, 0.208),
    "venus": (0.348, 0.658, 0.689, 0.658, 0.708, 0.640, 0.584),
    "mars": (0.060, 0.088, 0.170, 0.250, 0.288, 0.285, 0.330),
    "jupiter": (0.358, 0.443, 0.538, 0.513, 0.495, 0.389, 0.321),
}
"""Geometric albedos in U, B, V, Rc, R, Ic and I: Mallama, Krobusek & Pavlov 2017, Icarus 282, 19, table 7."""


@pytest.mark.parametrize("name", MALLAMA_ALBEDOS)
def test_colours_of_planets_are_sunlight_times_their_albedos(name) -> None:
    """B-V and V-I within 0.02 mag of the albedos' ratios; photons from 350 to 1000 nm within 4 % of sunlight times albedo."""
    _, b, v, _, _, i, _ = MALLAMA_ALBEDOS[name]
    assert PLANET_BV_MAG[name] == pytest.approx(SUN_BV_MAG + 2.5 * np.log10(v / b), abs=0.02)
    assert PLANET_VI_MAG[name] == pytest.approx(SUN_VI_MAG + 2.5 * np.log10(i / v), abs=0.02)
    sunlit = star_spectra([0.0], [SUN_BV_MAG], [SUN_VI_MAG])[0] * np.interp(
        GRID_NM, MALLAMA_BANDS_NM, MALLAMA_ALBEDOS[name]
    )
    sunlit *= BESSELL_V.zero_point / (sunlit @ band_weights(BESSELL_V))
    instant = Instant.parse(TIMES[0])
    bodies = planets(SITE, instant, earth_orientation(instant))
    row = list(PLANETS).index(name)
    ours = star_spectra([0.0], bodies.bv_mag[[row]], bodies.vi_mag[[row]])[0]
    seen = (GRID_NM >= 350) & (GRID_NM <= 1000)
    assert ours[seen].sum() == pytest.approx(sunlit[seen].sum(), rel=0.04)


def test_planets_are_drawn_as_stars() -> None:
    """Venus on 15 January 2020 at dusk: in the truth of the plan with its NAIF number, brighter than V -3.9."""
    towards = {"azimuth_deg": 220.0, "altitude_deg": 20.0}
    plan = plan_frame(
        small_scenario(time__utc_start="2020-01-15T17:30:00Z", attitude=towards, stars={"limiting_magnitude": 2.0}), 0
    )
    venus = plan.stars.star_id == 900_000_299
    assert venus.sum() == 1
    assert float(plan.stars.v_mag[venus][0]) < -3.9
    none = plan_frame(small_scenario(stars={"limiting_magnitude": 2.0, "planets": False}), 0)
    assert (none.stars.star_id < 900_000_000).all()
    instant = Instant.parse("2020-01-15T17:30:00Z")
    assert len(apparent_places(planets(SITE, instant, earth_orientation(instant)), SITE, instant,
                               earth_orientation(instant), NO_AIR).azimuth_deg) == 7  # fmt: skip


def test_moon_is_in_the_image_with_its_light() -> None:
    """A frame on the Moon: a resolved disk, with the Moon's light within 2 % (its points are stars of its colours)."""
    base = {"site": {"latitude_deg": 0.0, "longitude_deg": 0.0}, "time__utc_start": "2020-01-10T23:00:00Z"}
    sky = {"components": ["moonlight"]}
    plan = plan_frame(small_scenario(**base, sky=sky), 0)
    east, north, up = plan.sky.moon_enu
    assert up > 0.7
    attitude = {
        "azimuth_deg": float(np.degrees(np.arctan2(east, north))),
        "altitude_deg": float(np.degrees(np.arcsin(up))),
    }
    clean = {"bloom": {"share": 0}, "veiling_glare": 0}
    camera = {"width": 200, "height": 200, "hfov_deg": 4.0, "aperture_mm": 4} | clean
    scenario = small_scenario(**base, sky=sky, camera=camera, attitude=attitude, stars={"limiting_magnitude": 3.0})
    frame = render_expected(plan_frame(scenario, 0), layers=True)
    disk = frame.layers["stars"]
    radius = np.arcsin(1737.4 / plan.sky.moon.distance_km) * plan_frame(scenario, 0).spec.camera.f_px
    assert (disk > 0.5 * disk[disk > 0.1 * disk.max()].mean()).sum() == pytest.approx(np.pi * radius**2, rel=0.06)
    from generator.frame.plan import dimming_atmosphere
    from generator.frame.scene import quantum_efficiency
    from generator.light.atmosphere import airmass
    from generator.light.molecular_bands import slant_depth

    plan = plan_frame(scenario, 0)
    spectrum = plan.sky.moon_spectrum
    atmosphere = dimming_atmosphere(plan.spec.atmosphere)
    assert atmosphere is not None
    depth = slant_depth(GRID_NM, atmosphere, [float(airmass(plan.sky.moon_altitude_deg))])[0]
    electrons = np.trapezoid(spectrum * np.exp(-depth) * quantum_efficiency(plan.spec), GRID_NM)
    assert disk.sum() == pytest.approx(electrons * np.pi / 4 * 0.004**2 * 0.5, rel=0.02)


def test_opposition_surge() -> None:
    """A full Moon is up to 35 % brighter than at 7 deg (Krisciunas & Schaefer 1991, after Whitaker 1969); there and beyond, V
    is theirs within 0.07 mag."""
    ratio = 10 ** (-0.4 * (moon_v_mag(1.55) - moon_v_mag(7.0)))
    assert ratio == pytest.approx(1.35, abs=0.03)
    for phase in (7.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0, 97.0, 97.01, 120.0, 150.0):
        assert moon_v_mag(phase) == pytest.approx(-12.73 + 0.026 * phase + 4e-9 * phase**4, abs=0.07), phase
    assert moon_v_mag(0.0) == moon_v_mag(1.0)
    assert moon_v_mag(30.0, 2 * 384_400.0) == pytest.approx(moon_v_mag(30.0) + 5 * np.log10(2))


def test_colour_of_the_moon() -> None:
    """B-V 0.92 (Allen's Astrophysical Quantities, 12.4), within 0.06 mag; redder away from full Moon."""
    assert moon_colours(0.0)[0] == pytest.approx(0.92, abs=0.06)
    assert moon_colours(60.0)[0] == pytest.approx(0.92, abs=0.06)
    assert moon_colours(60.0) > moon_colours(0.0)
    found = moon_spectrum(-12.0, 40.0)
    assert -2.5 * np.log10(float(BESSELL_V.mean(GRID_NM, found)) / BESSELL_V.zero_point) == pytest.approx(-12.0)


@pytest.mark.parametrize("phase_deg", [90.0, 120.0, 150.0, 175.0])
def test_earthshine(phase_deg) -> None:
    """Light that the Earth sends to the Moon against its magnitude from space, -3.99 - 0.00106 a + 0.0002054 a^2 at 1 au
    (Mallama & Hilton 2018): fainter by 0.3 to 0.9 mag, by which the two measurements of its albedo differ."""
    a = 180 - phase_deg
    from_space = -3.99 - 1.060e-3 * a + 2.054e-4 * a**2 + 5 * np.log10(384_400 / 149_597_870.7)
    ashen = moon_v_mag(phase_deg) - 2.5 * np.log10(earthshine_over_moonlight(phase_deg))
    # Disk lit by the Sun as it is by the Earth: full Moon, fainter by the Sun's magnitude less the Earth's.
    earth = -26.76 + ashen - moon_v_mag(1.55)
    assert 0.3 < earth - from_space < 0.9
