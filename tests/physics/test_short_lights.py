"""Lights that shine for a part of the exposure: place, length and flux are theirs, however long the exposure is."""

import copy

import numpy as np
import pytest
from small_scenes import small_scenario

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.flying.orbits import spans_s
from generator.frame.plan import plan_frame

CAMERA = {
    "width": 400, "height": 400, "hfov_deg": 40, "aperture_mm": 10, "bloom": {"share": 0}, "veiling_glare": 0,
}  # fmt: skip
DARK = {
    "camera": CAMERA, "attitude": {"azimuth_deg": 180.0, "altitude_deg": 45.0},
    "sky": None, "stars": {"limiting_magnitude": -2.0, "planets": False},
}  # fmt: skip
F_PX = 200 / np.tan(np.radians(20))
ACROSS = {
    "kind": "satellite", "start": {"azimuth_deg": 175.0, "altitude_deg": 45.0},
    "end": {"azimuth_deg": 185.0, "altitude_deg": 45.0}, "start_s": 0.2, "end_s": 0.7, "v_mag": -2.0,
}  # fmt: skip
# 5 deg of azimuth from the boresight at its altitude: the middle of a great circle of the pinhole's line.
HALF_PX = F_PX * np.cos(np.radians(45)) * np.sin(np.radians(5)) / (0.5 + 0.5 * np.cos(np.radians(5)))
UPWARD = ACROSS | {
    "start": {"azimuth_deg": 180.0, "altitude_deg": 39.0},
    "end": {"azimuth_deg": 180.0, "altitude_deg": 51.0},
}
EXPOSURES_S = (1.0, 30.0, 60.0, 600.0)
SHELL = {"shells": [{}]}


def rendered(trail, exposure_s, **overrides):
    trails = {"trails": [copy.deepcopy(trail)]}
    plan = plan_frame(small_scenario(**(DARK | overrides), time__exposure_s=exposure_s, foreground=trails), 0)
    return plan, render_expected(plan)


def planned(exposure_s, *trails):
    """Objects of some trails."""
    tree = {"trails": [copy.deepcopy(trail) for trail in trails]}
    return plan_frame(small_scenario(time__exposure_s=exposure_s, foreground=tree), 0).objects


def lit_columns(electrons):
    """First and last column with a hundredth of the brightest's light."""
    by_column = electrons.astype(float).sum(axis=0)
    return np.flatnonzero(by_column > 0.01 * by_column.max())[[0, -1]]


@pytest.mark.parametrize(("kind", "share"), [("satellite", 1.0), ("aircraft", 1.0), ("meteor", 2 / 3)])
def test_a_short_trail_is_the_same_in_every_exposure(kind, share) -> None:
    """Columns by the great circle and the pinhole; light that of the trail over its own exposure, 2/3 under a parabola."""
    _, own = rendered(ACROSS | {"start_s": 0.0, "end_s": 0.5}, 0.5)
    for exposure_s in EXPOSURES_S:
        _, frame = rendered(ACROSS | {"kind": kind}, exposure_s)
        assert frame.objects.start_px[0, 0] == pytest.approx(199.5 - HALF_PX, abs=0.01)
        assert frame.objects.end_px[0, 0] == pytest.approx(199.5 + HALF_PX, abs=0.01)
        assert lit_columns(frame.electrons) == pytest.approx([199.5 - HALF_PX, 199.5 + HALF_PX], abs=2.5)
        light = float(frame.electrons.astype(float).sum())
        assert light == pytest.approx(share * own.objects.electrons[0], rel=0.005)
        assert light == pytest.approx(frame.objects.electrons[0], rel=1e-3)


@pytest.mark.parametrize("exposure_s", [1.0, 600.0])
def test_readout_meets_a_short_trail_where_both_are(exposure_s) -> None:
    """Rows start 1 ms after each other, the light climbs from row 257: it is seen from where the readout has come by."""
    shutter = {"sensor": {"rolling_shutter": {"line_time_us": 1000.0}}}
    _, whole = rendered(UPWARD, exposure_s)
    _, frame = rendered(UPWARD, exposure_s, **shutter)
    times = np.linspace(0.2, 0.7, 500_001)
    rows = 199.5 - F_PX * np.tan(np.radians(12 * (times - 0.2) / 0.5 - 6))
    meets = np.argmin(np.abs(times - 1e-3 * rows))
    assert frame.objects.start_px[0, 1] == pytest.approx(rows[meets], abs=0.05)
    assert frame.objects.end_px[0, 1] == pytest.approx(rows[-1], abs=0.05)
    # Light of a constant source by the cosine of its angle from the axis, of the pupil.
    steady = np.cos(np.radians(12 * (times - 0.2) / 0.5 - 6))
    assert frame.objects.electrons[0] / whole.objects.electrons[0] == pytest.approx(
        steady[meets:].sum() / steady.sum(), rel=0.002
    )
    _, level = rendered(ACROSS, exposure_s, **shutter)
    _, still = rendered(ACROSS, exposure_s)
    assert level.objects.electrons[0] == pytest.approx(still.objects.electrons[0], rel=1e-3)


def test_a_turning_camera_sees_a_short_trail_from_where_it_looks_then() -> None:
    """At 0.02 deg/s to the right, 14.8 s and 14.3 s before the middle of the exposure."""
    _, frame = rendered(ACROSS | {"kind": "meteor"}, 30.0, motion={"rate_deg_s": [0.0, 0.02, 0.0]})
    for place, time_s, side in ((frame.objects.start_px, 0.2, -1), (frame.objects.end_px, 0.7, 1)):
        angle = np.arctan(side * HALF_PX / F_PX) - np.radians(0.02 * (time_s - 15.0))
        assert place[0, 0] == pytest.approx(199.5 + F_PX * np.tan(angle), abs=0.02)


@pytest.mark.parametrize("exposure_s", [30.0, 600.0])
def test_flashes_are_resolved_in_every_exposure(exposure_s) -> None:
    """47 flashes of 10 ms within 12 s: their light, the places of the first and the last, and as many spots."""
    strobe = {"period_s": 0.25, "flash_s": 0.01, "first_s": 0.12}
    trail = ACROSS | {"start_s": 0.0, "end_s": 11.75}
    wide = {"start": {"azimuth_deg": 165.0, "altitude_deg": 45.0}, "end": {"azimuth_deg": 195.0, "altitude_deg": 45.0}}
    _, steady = rendered(trail | wide, exposure_s)
    _, frame = rendered(trail | wide | {"kind": "aircraft", "strobe": strobe}, exposure_s)
    assert frame.objects.electrons[0] / steady.objects.electrons[0] == pytest.approx(47 * 0.01 / 11.75, rel=0.005)
    way = steady.objects.end_px[0, 0] - steady.objects.start_px[0, 0]
    assert frame.objects.start_px[0, 0] - steady.objects.start_px[0, 0] == pytest.approx(0.12 / 11.75 * way, abs=0.4)
    assert steady.objects.end_px[0, 0] - frame.objects.end_px[0, 0] == pytest.approx(0.12 / 11.75 * way, abs=0.4)
    by_column = frame.electrons.astype(float).sum(axis=0)
    peaks = (by_column[1:-1] > by_column[:-2]) & (by_column[1:-1] >= by_column[2:])
    assert (peaks & (by_column[1:-1] > 0.3 * by_column.max())).sum() == 47


def test_flashes_that_cannot_be_resolved_are_refused() -> None:
    trail = ACROSS | {"kind": "aircraft", "end_s": 600.0, "strobe": {"flash_s": 0.005}}
    with pytest.raises(ScenarioError, match=r"foreground.trails.0.strobe.flash_s: .* several trails"):
        planned(600.0, trail)


def test_a_trail_is_lit_between_its_horizons() -> None:
    """From 20 deg below the horizon to 20 deg above it in 20 s, half of them dark; another stays below it."""
    rising = ACROSS | {
        "start": {"azimuth_deg": 180.0, "altitude_deg": -20.0}, "end": {"azimuth_deg": 180.0, "altitude_deg": 20.0},
        "start_s": 5.0, "end_s": 25.0,
    }  # fmt: skip
    never = rising | {"end": {"azimuth_deg": 170.0, "altitude_deg": -5.0}}
    objects = planned(50.0, rising, never)
    assert objects.lit[0] == pytest.approx([15 / 50, 25 / 50])
    assert objects.shining.tolist() == [True, False]
    assert np.isfinite(objects.directions).all()
    with pytest.raises(
        ScenarioError, match=r"foreground.trails.0.start_s: 70 s is not before the end of the exposure, 50 s"
    ):
        planned(50.0, rising | {"start_s": 70.0, "end_s": None})


def test_a_train_crosses_the_sky_once() -> None:
    """At half a degree a second from 60 deg up over the zenith: 240 s to the other horizon, each 4 s after the one before."""
    train = {
        "start": {"azimuth_deg": 90.0, "altitude_deg": 60.0}, "end": {"azimuth_deg": 90.0, "altitude_deg": 70.0},
        "end_s": 20.0, "count": 5, "gap_s": 4.0, "v_mag": 3.0,
    }  # fmt: skip
    objects = plan_frame(small_scenario(foreground={"trains": [train]}, time__exposure_s=3600.0), 0).objects
    assert objects.lit[:, 0].tolist() == [0.0] * 5
    assert objects.lit[:, 1] * 3600 == pytest.approx(240 + 4 * np.arange(5))
    assert objects.directions[:, -1, 2] == pytest.approx(0, abs=1e-9)
    steps = np.arccos((objects.directions[:, 1:] * objects.directions[:, :-1]).sum(axis=2))
    assert np.degrees(steps) == pytest.approx(np.repeat((120 + 2 * np.arange(5)) / 64, 64).reshape(5, 64))


def test_spans_are_found_between_keyframes() -> None:
    """Seen within a half-width of a middle, by three satellites: throughout, in part, and from the start."""
    middle, half, time_s = np.array([5.0, 4.321, 0.1]), np.array([9.0, 1.234, 2.6]), np.linspace(0, 10, 21)

    def seen_at(rows, when):
        return np.abs(when - middle[rows][:, None]) <= half[rows][:, None]

    found = spans_s(seen_at(np.arange(3), np.tile(time_s, (3, 1))), time_s, seen_at)
    np.testing.assert_allclose(found, [[0, 10], [4.321 - 1.234, 4.321 + 1.234], [0, 2.7]], atol=1e-6)


def test_a_shell_s_satellites_come_and_go_at_the_same_time_in_every_exposure() -> None:
    """Those that rise, set or meet the shadow within a minute, by exposures of one and of ten minutes.

    Within 0.15 s: the Sun is that of mid-exposure, and moves by 0.003 deg from one to the other.
    """
    spans = []
    for exposure_s in (60.0, 600.0):
        scenario = small_scenario(foreground=SHELL, time__utc_start="2020-01-15T17:30:00Z", time__exposure_s=exposure_s)
        objects = plan_frame(scenario, 0).objects
        assert (objects.directions[:, [0, -1], 2] > -1e-6).all()
        assert not objects.dark_ends.any()
        spans.append(dict(zip(objects.number.tolist(), (objects.lit * exposure_s).tolist(), strict=True)))
    short, long = spans
    both = [(short[number], long[number]) for number in short.keys() & long.keys()]
    came = [(one[0], other[0]) for one, other in both if one[0] > 0]
    went = [(one[1], other[1]) for one, other in both if one[1] < 60]
    assert min(len(came), len(went)) > 3
    np.testing.assert_allclose(*np.transpose(came + went), atol=0.15)


def test_parts_of_an_exposure_share_out_each_light() -> None:
    """Light and place of a strobe and a meteor over eight parts of the exposure."""
    objects = planned(
        8.0,
        ACROSS | {"kind": "aircraft", "end_s": 7.7, "strobe": {"period_s": 0.9, "flash_s": 0.05}},
        ACROSS | {"kind": "meteor", "start_s": 2.2, "end_s": 2.9},
    )

    def light_s(some, exposure_s):
        means = np.array([curve.mean() for curve in np.split(some.light_curve, some.first_part[1:])])
        return means * np.diff(some.lit)[:, 0] * exposure_s

    assert light_s(objects, 8.0) == pytest.approx([8 * 0.05, 2 / 3 * 0.7], rel=1e-9)
    parts = [objects.within(k / 8, (k + 1) / 8) for k in range(8)]
    assert sum(light_s(part, 1.0) for part in parts) == pytest.approx(light_s(objects, 8.0), rel=1e-9)
    assert [part.shining.tolist()[1] for part in parts] == [False, False, True, *[False] * 5]
    np.testing.assert_allclose(parts[2].lit[1], [0.2, 0.9])
    np.testing.assert_allclose(parts[2].directions[1], objects.directions[1], atol=1e-12)
    np.testing.assert_allclose(parts[3].directions[0, -1], parts[4].directions[0, 0], atol=1e-12)
