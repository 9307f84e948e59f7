"""What makes a frame differ from any solver's model: scattered stars, another refraction, false stars."""

from __future__ import annotations

import math
from typing import Any

import erfa
import numpy as np
import pytest
import yaml
from scipy import stats

from generator.frame.plan import plan_frame
from generator.places.catalogue import load_catalogue
from generator.places.catalogue_scatter import scattered
from generator.scenario.file import Scenario, parse_scenario

BASE = {
    "name": "wrong-models",
    "site": {"latitude_deg": 52.0, "longitude_deg": 4.36},
    "time": {"utc_start": "2020-01-15T20:00:00Z", "exposure_s": 0.5},
    "camera": {"width": 320, "height": 240, "hfov_deg": 60, "aperture_mm": 4},
    "attitude": {"azimuth_deg": 120, "altitude_deg": 40},
}


def scenario_of(tree: dict[str, Any]) -> Scenario:
    return parse_scenario(yaml.safe_dump(tree, sort_keys=False), "test")


def test_scattered_places_and_magnitudes_have_the_stated_standard_deviations():
    stars = load_catalogue()
    found = scattered(stars, 300.0, 0.2, np.random.default_rng(1))
    before, after = (np.radians([one.ra_deg, one.dec_deg]) for one in (stars, found))
    arcsec = np.degrees(erfa.seps(*before, *after)) * 3600
    # The distance of two Gaussian coordinates is Rayleigh's; one of n numbers passes with 1 - 1e-4.
    assert stats.kstest(arcsec, stats.rayleigh(scale=300.0).cdf).pvalue > 1e-4
    around = erfa.pas(*before, *after)
    assert stats.kstest(around, stats.uniform(-math.pi, 2 * math.pi).cdf).pvalue > 1e-4
    assert stats.kstest(found.v_mag - stars.v_mag, stats.norm(scale=0.2).cdf).pvalue > 1e-4
    assert (found.star_id == stars.star_id).all()


def test_scatter_is_drawn_anew_in_each_frame_and_by_index_alone():
    scenario = scenario_of(BASE | {"frames": 3, "stars": {"scatter_arcsec": 60.0}})
    plain = plan_frame(scenario_of(BASE | {"frames": 3}), 1)
    first, again, other = plan_frame(scenario, 1), plan_frame(scenario, 1), plan_frame(scenario, 2)
    assert (first.stars.ra_deg == again.stars.ra_deg).all()
    there = dict(zip(plain.stars.star_id, plain.stars.dec_deg, strict=True))
    offsets = [
        {
            star: dec - there[star]
            for star, dec in zip(plan.stars.star_id, plan.stars.dec_deg, strict=True)
            if star in there
        }
        for plan in (first, other)
    ]
    both = sorted(set(offsets[0]) & set(offsets[1]))
    one, two = (np.array([offset[star] for star in both]) * 3600 for offset in offsets)
    assert len(both) > 500
    assert stats.pearsonr(one, two).pvalue > 1e-4
    assert np.std(one) == pytest.approx(60.0, rel=0.1)


def test_a_refraction_factor_multiplies_the_refraction():
    """Refraction at 45 deg of altitude in standard air is 58.2 arcsec at 1010 hPa and 10 deg C (Allen)."""

    def altitudes(factor):
        tree = BASE | {"atmosphere": {"refraction_factor": factor}}
        plan = plan_frame(scenario_of(tree), 0)
        return dict(zip(plan.stars.star_id, plan.middle.altitude_deg, strict=True))

    plain, more = altitudes(1.0), altitudes(1.1)
    star = min(plain, key=lambda one: abs(plain[one] - 45.0))
    assert (more[star] - plain[star]) * 3600 == pytest.approx(0.1 * 58.2, rel=0.02)


def test_glints_stand_in_the_image_with_magnitudes_of_their_range():
    tree = BASE | {"foreground": {"glints": {"count": 400, "v_mag": [2.0, 5.0]}}, "frames": 2}
    plan, other = (plan_frame(scenario_of(tree), index) for index in (0, 1))
    objects = plan.objects
    assert (len(objects), set(objects.kind), len(set(objects.number.tolist()))) == (400, {"glint"}, 400)
    assert (objects.directions == objects.directions[:, :1]).all()
    seen = objects.directions[:, 0] @ plan.motion.R_mid.T
    f_px = 160 / math.tan(math.radians(30))
    u, v = f_px * seen[:, 0] / seen[:, 2] + 159.5, f_px * seen[:, 1] / seen[:, 2] + 119.5
    for values, low, width in ((u, -0.5, 320), (v, -0.5, 240), (objects.v_mag, 2.0, 3.0)):
        assert stats.kstest(values, stats.uniform(low, width).cdf).pvalue > 1e-4
    assert not np.isin(objects.v_mag, other.objects.v_mag).any()


def test_frames_without_these_keys_are_of_the_scenario_that_they_were():
    plain = scenario_of(BASE)
    same = BASE | {
        "atmosphere": {"refraction_factor": 1.0}, "stars": {"scatter_arcsec": 0.0, "scatter_mag": 0.0},
        "foreground": {"glints": None},
    }  # fmt: skip
    assert scenario_of(same).content_sha256 == plain.content_sha256
    assert scenario_of(BASE | {"stars": {"scatter_mag": 0.1}}).content_sha256 != plain.content_sha256
