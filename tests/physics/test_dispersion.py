"""Atmospheric dispersion: against ERFA, and in the pixels."""

import erfa
import numpy as np
import pytest
from small_scenes import small_scenario

from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.places.astrometry import Air, Site
from generator.places.dispersion import dispersion_deg, may_disperse

SITE, AIR = Site(45.0, 0.0, 0.0), Air(1013.0, 15.0, 0.5)
WAVELENGTHS = np.array([350.0, 450.0, 550.0, 650.0, 1000.0])


@pytest.mark.parametrize("altitude_deg", [16.0, 25.0, 45.0, 80.0])
def test_dispersion_is_the_difference_of_erfa_s_refractions(altitude_deg) -> None:
    """A tan z + B tan^3 z of ``refco`` at both wavelengths, the second at its own apparent place: within 0.002 arcsec."""

    def series(zenith_distance, nm):
        a, b = erfa.refco(AIR.pressure_hpa, AIR.temperature_c, AIR.relative_humidity, nm / 1000)
        return a * np.tan(zenith_distance) + b * np.tan(zenith_distance) ** 3

    seen = np.radians(90 - altitude_deg)
    true = seen + series(seen, 550.0)
    for nm, lift in zip(WAVELENGTHS, dispersion_deg(np.array([altitude_deg]), WAVELENGTHS, SITE, AIR)[0], strict=True):
        at = seen
        for _ in range(20):
            at = true - series(at, nm)
        assert 3600 * lift == pytest.approx(3600 * np.degrees(seen - at), abs=0.002)


def test_nine_arcseconds_at_five_degrees() -> None:
    """Between 450 and 650 nm at 5 deg of altitude; blue stands higher."""
    lift = 3600 * dispersion_deg(np.array([5.0]), WAVELENGTHS, SITE, AIR)[0]
    assert lift[1] - lift[3] == pytest.approx(9, abs=0.7)
    assert np.all(np.diff(lift) < 0)
    assert lift[2] == pytest.approx(0, abs=1e-4)


def test_the_bound_that_needs_no_wavelength_holds() -> None:
    altitude = np.linspace(0.0, 89.0, 200)
    widest = np.ptp(dispersion_deg(altitude, WAVELENGTHS, SITE, AIR), axis=1)
    for least_deg in (1e-5, 1e-4, 1e-3):
        assert not np.any((widest > least_deg) & ~may_disperse(altitude, least_deg, SITE, AIR))


NARROW = {"width": 240, "height": 160, "hfov_deg": 1.5, "aperture_mm": 50, "bloom": {"share": 0}, "veiling_glare": 0}


def low_stars(centre_nm, **more):
    """A telescope of 22 arcsec a pixel at a low star through a filter of 60 nm."""
    low = plan_frame(small_scenario(camera={"width": 400, "height": 60, "hfov_deg": 120, "aperture_mm": 4},
                                    attitude={"azimuth_deg": 200, "altitude_deg": 5}), 0)  # fmt: skip
    near = np.abs(low.middle.altitude_deg - 5) + np.abs((low.middle.azimuth_deg - 200) / 40) + 0.3 * low.stars.v_mag
    best = int(np.argmin(near))
    pointing = {
        "azimuth_deg": float(low.middle.azimuth_deg[best]),
        "altitude_deg": float(low.middle.altitude_deg[best]),
    }
    curve = [[centre_nm - 31, 0], [centre_nm - 30, 0.5], [centre_nm + 30, 0.5], [centre_nm + 31, 0]]
    plan = plan_frame(
        small_scenario(
            camera=NARROW | more,
            attitude=pointing,
            sky=None,
            sensor={"quantum_efficiency": curve},
            time__exposure_s=0.01,
        ),
        0,
    )
    frame = render_expected(plan)
    star = int(np.nanargmin(np.hypot(frame.u_px - 119.5, frame.v_px - 79.5)))
    u, v = round(float(frame.u_px[star])), round(float(frame.v_px[star]))
    stamp = frame.electrons[v - 9 : v + 10, u - 9 : u + 10].astype(float)
    rows, columns = np.mgrid[v - 9 : v + 10, u - 9 : u + 10]
    moment = np.array([np.sum(stamp * columns), np.sum(stamp * rows)]) / stamp.sum()
    return plan, frame, star, moment


@pytest.mark.parametrize("psf", [{}, {"psf": {"moffat": {"fwhm_px": 2.0, "beta": 4.0}, "support_px": 8}}])
def test_stars_low_in_the_sky_are_spread_along_the_vertical(psf) -> None:
    """Blue and red light of a star at 5 deg are 0.4 px apart in the image, as computed; truth has the light's centroid."""
    plan, blue, star, at_blue = low_stars(450.0, **psf)
    _, red, _, at_red = low_stars(650.0, **psf)
    altitude = plan.middle.altitude_deg[star]
    assert 3 < altitude < 8
    site = Site(plan.spec.site.latitude_deg, plan.spec.site.longitude_deg, 0.0)
    lift = dispersion_deg(np.array([altitude]), np.array([450.0, 650.0]), site, Air(1010.0, 10.0, 0.5))[0]
    wanted_px = np.radians(lift[0] - lift[1]) * plan.spec.camera.f_px
    assert at_red[1] - at_blue[1] == pytest.approx(wanted_px, abs=0.05)
    assert wanted_px > 0.3
    assert at_red[0] - at_blue[0] == pytest.approx(0, abs=0.02)
    for frame, moment in ((blue, at_blue), (red, at_red)):
        assert frame.light_px[star] == pytest.approx(moment, abs=0.03)


def test_wide_lenses_high_in_the_sky_have_none() -> None:
    from generator.frame.dispersion import dispersion_parameters

    plan = plan_frame(small_scenario(camera__hfov_deg=60), 0)
    assert dispersion_parameters(plan, plan.directions) == {}


@pytest.mark.parametrize(("height_m", "temperature_c"), [(0.0, 10.0), (4000.0, -25.0), (11000.0, -50.0)])
def test_refraction_between_wavelengths_is_straight_in_the_refractivity(height_m, temperature_c) -> None:
    """Twelve bands at once against each by its own integral, arcsec."""
    site, air = Site(50.0, 10.0, height_m), Air(1010.0 * np.exp(-height_m / 8000), temperature_c, 0.6)
    bands = np.linspace(377.0, 973.0, 12)
    altitude = np.array([0.2, 0.5, 1.0, 3.0, 10.0, 40.0, 80.0])
    alone = np.concatenate([dispersion_deg(altitude, band[None], site, air) for band in bands], axis=1)
    error = 3600 * np.abs(dispersion_deg(altitude, bands, site, air) - alone)
    assert error.max() < 0.02
    assert error[2:].max() < 0.001
