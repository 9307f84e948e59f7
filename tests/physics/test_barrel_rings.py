"""The ring of a fisheye's barrel: light from the other side, lobes on the Moon's side, and that of a photograph."""

import math
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from physics.moon_alone import MOON, rendered
from scipy import integrate
from small_scenes import small_scenario

from generator.errors import ScenarioError
from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers
from generator.scenario.presets.camera_presets import PRESETS


def test_the_ring_of_a_barrel_is_lit_from_the_other_side() -> None:
    """Its crest, of an even hemisphere: half the wall's reflectance; of the Moon alone: opposite to it, by Lambert's law."""
    ring = {"radius_px": 70.0, "width_px": 4.0, "reflectance": 0.05}
    even = MOON | {
        "attitude": {"azimuth_deg": 0, "altitude_deg": 90},
        "camera__hfov_deg": 100,
        "sky": {"components": ["airglow"]},
        "sensor__noise": False,
    }
    plain, ringed = rendered(**even), rendered(**even, camera__barrel_ring=ring)
    added = ringed.electrons - plain.electrons
    (table,) = frame_layers(plan_frame(small_scenario(**even), 0)).values()
    altitude = np.linspace(0, 90, 2001)
    radiance = table.signal(np.ones((1, table.spectra.shape[1])), altitude, np.zeros_like(altitude))[0]
    polar = np.radians(90 - altitude)
    # Integral over a half of the sky of radiance x cosine at an upright wall, over pi.
    lit = -integrate.trapezoid(2 * radiance / radiance[-1] * np.sin(polar) ** 2, polar) / math.pi
    middle = float(plain.electrons[88:92, 133:137].mean())
    crest = [added[round(89.5 + 70 * math.sin(a)), round(134.5 + 70 * math.cos(a))] for a in np.arange(0, 6.28, 0.5)]
    assert np.mean(crest) / middle == pytest.approx(0.05 * lit, rel=0.03)
    assert np.ptp(crest) < 0.1 * np.mean(crest)
    moonlit = MOON | {"attitude": {"azimuth_deg": 0, "altitude_deg": 90}, "camera__hfov_deg": 30}
    frame = rendered(**moonlit, camera__barrel_ring=ring)
    light, f = float(frame.moon.electrons[0]), 135 / math.tan(math.radians(15))
    du, dv = frame.moon.u_px[0] - 134.5, frame.moon.v_px[0] - 89.5
    off_axis, away = math.atan(math.hypot(du, dv) / f), math.atan2(-dv, -du)
    row, column = 89.5 + 70 * math.sin(away), 134.5 + 70 * math.cos(away)
    # The truth's electrons include the pupil's cosine.
    wanted = 0.05 * light / math.cos(off_axis) * math.sin(off_axis) / math.pi / f**2
    assert frame.electrons[round(row), round(column)] == pytest.approx(wanted, rel=0.05)


@pytest.mark.parametrize(("side", "turn_deg"), [("near_side", 0.0), ("far_side", 180.0)])
def test_the_lobes_of_a_ring_lie_on_the_moons_side_and_on_the_other(side, turn_deg) -> None:
    """Of the Moon alone: the crest as a Lambert wall's there; away from it by the eighth power of the azimuth's cosine."""
    ring = {"radius_px": 70.0, "width_px": 4.0, "reflectance": 0.0, side: 0.05}
    moonlit = MOON | {"attitude": {"azimuth_deg": 0, "altitude_deg": 90}, "camera__hfov_deg": 30}
    plain, frame = rendered(**moonlit), rendered(**moonlit, camera__barrel_ring=ring)
    added = frame.electrons - plain.electrons
    light, f = float(frame.moon.electrons[0]), 135 / math.tan(math.radians(15))
    du, dv = frame.moon.u_px[0] - 134.5, frame.moon.v_px[0] - 89.5
    off_axis, towards = math.atan(math.hypot(du, dv) / f), math.atan2(dv, du) + math.radians(turn_deg)
    crest = 0.05 * light / math.cos(off_axis) * math.sin(off_axis) / math.pi / f**2
    for away_deg in (0.0, 20.0, 40.0, 120.0):
        azimuth = towards + math.radians(away_deg)
        row, column = round(89.5 + 70 * math.sin(azimuth)), round(134.5 + 70 * math.cos(azimuth))
        wanted = crest * max(math.cos(math.radians(away_deg)), 0) ** 8
        assert added[row, column] == pytest.approx(wanted, abs=0.05 * crest)


def test_rings_add_up_and_an_even_one_is_the_hemispheres_part() -> None:
    """Of an airglow without the Moon: the even part of the hemisphere's mean, all around; two rings are the sum of each."""
    even = {"radius_px": 50.0, "width_px": 4.0, "reflectance": 0.0, "even": 0.03}
    lambert = {"radius_px": 75.0, "width_px": 3.0, "reflectance": 0.05}
    values = MOON | {"attitude": {"azimuth_deg": 0, "altitude_deg": 90}, "sky": {"components": ["airglow"]}}
    alone, first, second, both = (
        rendered(**values, camera__barrel_ring=ring).electrons if ring else rendered(**values).electrons
        for ring in (None, even, lambert, [even, lambert])
    )
    np.testing.assert_allclose(both - alone, (first - alone) + (second - alone), atol=1e-3 * (both - alone).max())
    crest = [first[round(89.5 + 50 * math.sin(a)), round(134.5 + 50 * math.cos(a))] for a in np.arange(0, 6.28, 0.5)]
    base = [alone[round(89.5 + 50 * math.sin(a)), round(134.5 + 50 * math.cos(a))] for a in np.arange(0, 6.28, 0.5)]
    added = np.subtract(crest, base)
    assert np.ptp(added) < 0.03 * added.mean()
    (table,) = frame_layers(plan_frame(small_scenario(**values), 0)).values()
    altitude = np.linspace(0, 90, 2001)
    radiance = table.signal(np.ones((1, table.spectra.shape[1])), altitude, np.zeros_like(altitude))[0]
    polar = np.radians(90 - altitude)
    # Weighted as a flat pupil sees it.
    mean = -integrate.trapezoid(radiance / radiance[-1] * np.sin(2 * polar), polar)
    assert added.mean() / float(alone[88:92, 133:137].mean()) == pytest.approx(0.03 * mean, rel=0.03)


def test_a_ring_without_light_is_refused() -> None:
    with pytest.raises(ScenarioError, match="above 0"):
        small_scenario(camera__barrel_ring={"radius_px": 50, "reflectance": 0})


def test_the_rings_of_the_allsky_camera_are_those_of_its_photograph() -> None:
    """The clear photograph of the tests, which the ring's figures are not from: where its two rings are, by azimuth.

    The brightest radius of three sectors of 12 degrees that are in the frame, around 514 and 617 px: their median to 6 px.
    """
    spec = PRESETS["superstar-allsky"].camera
    stored = Path(__file__).parents[1] / "data/allsky/008.fits.bz2"
    light = fits.getdata(stored).astype(float) - 2320
    v, u = np.mgrid[0 : light.shape[0], 0 : light.shape[1]]
    du, dv = u - spec["cx_px"], v - spec["cy_px"]
    radius, azimuth = np.hypot(du, dv), np.degrees(np.arctan2(dv, du)) % 360
    _, rim, wide = spec["barrel_ring"]
    for ring, half in ((rim, 12), (wide, 45)):
        places = np.arange(ring["radius_px"] - half, ring["radius_px"] + half + 1, 3)
        crests = []
        for middle in (30, 150, 210):
            near = np.abs((azimuth - middle + 180) % 360 - 180) < 6
            profile = [np.median(light[near & (np.abs(radius - place) < 1.5)]) for place in places]
            crests.append(places[int(np.argmax(profile))])
        assert np.median(crests) == pytest.approx(ring["radius_px"], abs=6)
