"""Exposures of more than two minutes: light that changes, and stars that rise and set."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from small_scenes import small_scenario

from generator.errors import GeneratorError
from generator.frame.exposure.expected import render_expected
from generator.frame.exposure.parts import part_count
from generator.frame.plan import LONGEST_LIGHT_S, FramePlan, plan_frame
from generator.frame.record import star_table
from generator.frame.scene import ExpectedFrame, render_under_one_sky
from generator.frame.star_truth import StarTruth
from generator.places.times import Instant

DELFT = {"latitude_deg": 52, "longitude_deg": 4.36, "height_m": 0}
EAST: dict[str, Any] = {
    "site": DELFT,
    "camera": {"width": 160, "height": 120, "hfov_deg": 60, "aperture_mm": 20},
    "attitude": {"azimuth_deg": 100, "altitude_deg": 10, "roll_deg": 0},
    "stars": {"limiting_magnitude": 6.0},
}
NONE = {"limiting_magnitude": -2.0, "planets": False}
EVENING = Instant.parse("2020-01-15T22:00:00Z")


def exposed(start: Instant, exposure_s: float, **overrides: Any) -> FramePlan:
    """Plan of a frame to the east."""
    time = {"utc_start": start.isoformat(), "exposure_s": exposure_s}
    return plan_frame(small_scenario(**(EAST | overrides), time=time), 0)


def electrons_of(plan: FramePlan, expected: ExpectedFrame) -> dict[int, float]:
    """Electrons of the stars in the frame, by number."""
    inside = expected.fraction_in_frame > 0.99
    return dict(zip(plan.stars.star_id[inside].tolist(), expected.star_electrons[inside].tolist(), strict=True))


@pytest.mark.parametrize(
    ("exposure_s", "parts"), [(LONGEST_LIGHT_S, 1), (120.1, 3), (360.0, 3), (361.0, 5), (3600, 31)]
)
def test_parts_are_odd_in_number_and_short(exposure_s: float, parts: int) -> None:
    assert part_count(exposure_s) == parts


def test_an_exposure_has_the_light_of_the_shorter_frames_that_add_up_to_it() -> None:
    """An hour to the eastern horizon under a Bortle sky, and 31 frames."""
    overrides = {"sky": {"bortle": 3}}
    plan = exposed(EVENING, 3600.0, **overrides)
    whole = render_expected(plan, layers=True)
    summed, layers = np.zeros(whole.electrons.shape), dict.fromkeys(whole.layers, 0.0)
    stars: dict[int, float] = {}
    places: dict[int, list[tuple[float, float, float]]] = {}
    for number in range(31):
        short_plan = exposed(EVENING.plus(number * 3600 / 31), 3600 / 31, **overrides)
        short = render_expected(short_plan, layers=True)
        summed += short.electrons
        for name, light in short.layers.items():
            layers[name] += light.sum(dtype=float)
        for star, own_e, place in zip(
            short_plan.stars.star_id.tolist(), short.star_electrons, short.centroid_px, strict=True
        ):
            if own_e > 0 and np.isfinite(place).all():
                stars[star] = stars.get(star, 0.0) + own_e
                places.setdefault(star, []).append((own_e, *place))
    np.testing.assert_allclose(whole.electrons, summed, rtol=1e-4, atol=1e-6 * summed.max())
    for name, light in whole.layers.items():
        assert light.sum(dtype=float) == pytest.approx(layers[name], rel=1e-5), name
    compared = electrons_of(plan, whole)
    assert len(compared) > 60
    ratio = np.array([own_e / stars[star] for star, own_e in compared.items()])
    assert np.median(ratio) == pytest.approx(1, abs=1e-5)
    # A short frame leaves out a star that rises after its middle.
    np.testing.assert_allclose(ratio, 1, atol=0.03)
    risen = [row for row, altitude in enumerate(plan.middle.altitude_deg) if altitude < 0]
    seen = [row for row in risen if plan.stars.star_id[row] in compared]
    assert len(seen) > 5
    for row in seen:
        own_e, u, v = np.array(places[int(plan.stars.star_id[row])]).T
        by_light = [np.average(axis, weights=own_e) for axis in (u, v)]
        np.testing.assert_allclose(whole.centroid_px[row], by_light, atol=0.15)


def test_twilight_is_that_of_every_part() -> None:
    """With the Sun from -3 to -12 deg, an hour has the light of 120 frames of 30 s, not that of its middle."""
    sunset = Instant.parse("2020-03-20T18:10:00Z")
    dusk = {"sky": {"components": ["twilight"]}, "stars": NONE, "attitude": {"azimuth_deg": 0, "altitude_deg": 90}}
    dusk["camera"] = EAST["camera"] | {"width": 16, "height": 12, "hfov_deg": 10}
    plan = exposed(sunset, 3600.0, **dusk)
    # Every tenth frame of 30 s; light is smooth, so the trapezoidal sum holds to a percent.
    moments = np.linspace(0, 3600 - 30, 25)
    light = [
        render_expected(exposed(sunset.plus(float(at)), 30.0, **dusk)).electrons.mean(dtype=float) for at in moments
    ]
    mean = np.trapezoid(light, moments) / moments[-1]
    whole = render_expected(plan).electrons.mean(dtype=float) * 30 / 3600
    assert whole == pytest.approx(mean, rel=0.02)
    of_middle = render_under_one_sky(plan).electrons.mean(dtype=float) * 30 / 3600
    assert whole > 5 * of_middle


def test_the_sun_may_not_rise_within_an_exposure() -> None:
    dawn = Instant.parse("2020-03-21T05:10:00Z")
    with pytest.raises(GeneratorError, match=r"the Sun is .* above the horizon"):
        render_expected(exposed(dawn, 3600.0, sky={"components": ["twilight"]}))


CONSTANT: dict[str, Any] = {"atmosphere": {"extinction": False}, "sky": None, "attitude__altitude_deg": 40}
TRAIL = {"kind": "satellite", "v_mag": 2, "start_s": 100.0, "end_s": 220.0,
         "start": {"azimuth_deg": 90, "altitude_deg": 30}, "end": {"azimuth_deg": 110, "altitude_deg": 50}}  # fmt: skip
KINDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "turning": {"motion": {"rate_deg_s": [0.0, 0.003, 0.0], "samples": 61}},
    "rolling shutter": {"sensor__rolling_shutter": {"line_time_us": 50000.0}},
    "flying": {"foreground": {"trails": [TRAIL]}},
    "skyline": {"foreground": {"landscape": {"skyline": ["forest"]}}, "attitude__altitude_deg": 30},
    "colour": {"sensor__colour": {"pattern": "RGGB"}},
}


@pytest.mark.parametrize("kind", KINDS)
def test_parts_are_the_whole_where_light_does_not_change(kind: str) -> None:
    """Without air and sky, image and truth are those of one rendering."""
    plan = exposed(EVENING, 600.0, **(CONSTANT | KINDS[kind]))
    parts, whole = render_expected(plan), render_under_one_sky(plan)
    scale = whole.electrons.max()
    assert np.abs(parts.electrons - whole.electrons).max() < 0.02 * scale
    assert parts.electrons.sum(dtype=float) == pytest.approx(whole.electrons.sum(dtype=float), rel=5e-4)
    inside = (whole.fraction_in_frame > 0.999) & (whole.hidden_fraction < 0.99)
    assert inside.sum() > 40
    # Branches hide a star at more moments of the parts than of the whole.
    clear = inside & (whole.hidden_fraction < 1e-3) & (parts.hidden_fraction < 1e-3)
    assert clear.sum() > 3
    for name in ("u_px", "v_px", "centroid_px", "light_px", "start_px", "end_px"):
        np.testing.assert_allclose(getattr(parts, name)[clear], getattr(whole, name)[clear], atol=0.02, err_msg=name)
    np.testing.assert_allclose(parts.star_electrons[clear], whole.star_electrons[clear], rtol=0.02)
    assert np.abs(parts.hidden_fraction - whole.hidden_fraction)[inside].mean() < 0.01
    for name in ("low_px", "high_px"):
        np.testing.assert_allclose(getattr(parts, name)[clear], getattr(whole, name)[clear], atol=0.2, err_msg=name)
    for field in fields(StarTruth):
        np.testing.assert_array_equal(getattr(parts.objects, field.name), getattr(whole.objects, field.name))
    if whole.cover is not None and parts.cover is not None:
        np.testing.assert_allclose(parts.cover, whole.cover, atol=1e-6)


def test_a_star_that_fills_pixels_in_a_later_part_is_saturated() -> None:
    """A camera that turns by 30 deg: stars that enter the frame after the first of five parts, and fill pixels then."""
    turning = {"motion": {"rate_deg_s": [0.0, 0.05, 0.0], "samples": 61}, "sensor": {"full_well_e": 2000}}
    plan = exposed(EVENING, 600.0, **(CONSTANT | turning))
    parts, whole = render_expected(plan), render_under_one_sky(plan)
    by_parts, at_once = star_table(plan, parts), star_table(plan, whole)
    assert by_parts["star_id"].equals(at_once["star_id"])
    saturated, wanted = (table["saturated"].to_numpy() for table in (by_parts, at_once))
    start_u = by_parts["start_u_px"].to_numpy()
    late = wanted & ((start_u < -20) | (start_u > 180))
    assert late.sum() > 5
    assert saturated[late].all()
    assert (saturated == wanted).mean() > 0.97
