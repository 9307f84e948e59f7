"""The track of a vehicle with a tilted mount: bias found, misidentifications kept out, covariance honest."""

import dataclasses
import math

import numpy as np
import pytest

import celnav
from celnav.horizon import place_from_rotation
from celnav.identification.verification import rotation_of
from celnav.sequences.track import KM_PER_DEG, Track, TrackConfig, moved, offset_km
from celnav.sky.astrometry import enu_rotation

SIGMA_KM, BIAS_DEG = 0.3, np.array([0.06, -0.04])


def orbit(rng, n=60, seconds=30.0, turns=2.0, lat=48.0, lon=11.0, bias=BIAS_DEG, wrong=()):
    """Fixes (biased, noisy) of a vehicle that drifts with white-noise acceleration and turns about its vertical."""
    q = 3e-4
    step = q * np.linalg.cholesky([[seconds**3 / 3, seconds**2 / 2], [seconds**2 / 2, seconds]])
    velocity = 0.05 * rng.standard_normal(2)
    for k in range(n):
        heading = 360.0 * turns * k / n
        jump, change = step @ rng.standard_normal((2, 2))
        lat, lon = moved(lat, lon, *(velocity * seconds + jump))
        velocity = velocity + change
        s, c = math.sin(math.radians(heading)), math.cos(math.radians(heading))
        offset = KM_PER_DEG * np.array([[s, c], [c, -s]]) @ bias + SIGMA_KM * rng.standard_normal(2)
        if k in wrong:
            offset += [800.0, -300.0]
        seen = moved(lat, lon, *offset)
        fix = celnav.Fix(True, celnav.Reason.OK, "", *seen, cov_km2=np.eye(2) * SIGMA_KM**2)
        second = 3600 + k * seconds
        yield (
            fix,
            f"2024-03-01T{int(second // 3600):02d}:{int(second // 60 % 60):02d}:{second % 60:06.3f}Z",
            heading,
            (lat, lon),
        )


def run(rng, config=None, **kwargs):
    track = Track(config or TrackConfig(acceleration_km_s2=3e-4))
    truth = []
    for fix, utc, heading, place in orbit(rng, **kwargs):
        assert track.update(fix, utc, heading) is not None
        truth.append(place)
    return track, truth


def errors_km(points, truth):
    return np.array([offset_km(p.lat_deg, p.lon_deg, *place) for p, place in zip(points, truth, strict=True)])


def test_an_orbit_finds_the_bias_of_the_mount():
    track, truth = run(np.random.default_rng(1))
    last = track.points[-1]
    sigma = np.sqrt(np.diag(last.cov)[4:6])
    assert (sigma < 0.01).all()
    np.testing.assert_allclose(last.tilt_bias_deg, BIAS_DEG, atol=4 * sigma.max())
    # A single fix is off by the bias, 8 km; the smoother by a fraction of it.
    assert np.median(np.linalg.norm(errors_km(track.smoothed(), truth), axis=1)) < 1.0


def test_misidentifications_do_not_pass_the_gate():
    track, truth = run(np.random.default_rng(2), wrong=(20, 21, 40))
    assert [k for k, point in enumerate(track.points) if not point.used] == [20, 21, 40]
    assert np.linalg.norm(errors_km(track.smoothed(), truth), axis=1).max() < 3.0


def test_a_wrong_first_fix_does_not_keep_the_right_ones_out():
    track, truth = run(np.random.default_rng(10), n=200, wrong=(0,))
    assert [point.used for point in track.points] == [True] * 199
    off = np.linalg.norm(errors_km(track.smoothed(), truth[1:]), axis=1)
    assert off.max() < 3.0


def test_the_track_is_the_one_with_most_fixes_and_of_several_the_oldest():
    track, leaders = Track(TrackConfig(acceleration_km_s2=3e-4)), []
    for fix, utc, heading, _ in orbit(np.random.default_rng(11), n=8, wrong=(1, 2, 4)):
        point = track.update(fix, utc, heading)
        leaders.append((len(track.points), point.used))
    # Fixes 0, 3, 5, 6 and 7 are right. After the third, the two wrong ones that agree are the track; with 3 both have two.
    assert leaders == [(1, True), (2, False), (2, True), (4, True), (4, True), (6, True), (7, True), (8, True)]
    assert [point.used for point in track.points] == [True, False, False, True, False, True, True, True]


def test_a_jump_of_the_vehicle_is_followed_after_eleven_fixes_and_scattered_fixes_never():
    rng = np.random.default_rng(12)
    jump = range(40, 60)
    track, truth = run(rng, wrong=jump)
    assert [point.used for point in track.points] == [True] * 20
    assert track.points[0].time_s == 40 * 30.0
    off = errors_km(track.points, truth[40:])
    assert np.linalg.norm(off - [800.0, -300.0], axis=1).max() < 15.0
    until = Track(TrackConfig(acceleration_km_s2=3e-4))
    for count, (fix, utc, heading, _) in enumerate(orbit(np.random.default_rng(12), wrong=jump), start=-39):
        if until.update(fix, utc, heading).used and count > 0:
            break
    assert count == 11
    scattered = Track(TrackConfig(acceleration_km_s2=3e-4))
    for k, (fix, utc, heading, _) in enumerate(orbit(rng, n=60)):
        there = moved(fix.lat_deg, fix.lon_deg, *(rng.choice([-1, 1], 2) * rng.uniform(500, 2000, 2)))
        wrong = dataclasses.replace(fix, lat_deg=there[0], lon_deg=there[1])
        scattered.update(wrong if k % 3 else fix, utc, heading)
    assert [k for k, point in enumerate(scattered.points) if point.used] == list(range(0, 60, 3))


def test_covariance_of_filter_and_smoother_is_honest():
    """Mean normalised squared error over 60 runs with random biases, two degrees of freedom: 4-sigma band of 2."""
    filtered, smoothed = [], []
    rng = np.random.default_rng(3)
    config = TrackConfig(acceleration_km_s2=3e-4, tilt_bias_sigma_deg=0.05)
    for _ in range(60):
        track, truth = run(rng, config, n=40, turns=1.3, bias=0.05 * rng.standard_normal(2))
        for points, into in ((track.points, filtered), (track.smoothed(), smoothed)):
            k = -10
            error = errors_km(points, truth[-len(points) :])[k]  # a good fix in a thousand may start the track anew
            into.append(error @ np.linalg.solve(points[k].cov_km2, error))
    band = 4 * 2 / math.sqrt(60)
    assert 2 - band < np.mean(filtered) < 2 + band
    assert 2 - band < np.mean(smoothed) < 2 + band


def test_smoother_is_better_than_the_filter_in_the_middle():
    track, truth = run(np.random.default_rng(4))
    middle = slice(5, 40)
    smoothed = np.linalg.norm(errors_km(track.smoothed(), truth)[middle], axis=1)
    assert smoothed.mean() < np.linalg.norm(errors_km(track.points, truth)[middle], axis=1).mean()


def test_refusals_are_passed_over_and_order_is_kept():
    track = Track()
    assert track.update(celnav.Fix.refusal(celnav.Reason.NO_HYPOTHESIS, "x"), "2024-03-01T00:00:00Z", 0.0) is None
    assert track.smoothed() == ()
    fix, utc, heading, _ = next(orbit(np.random.default_rng(5)))
    track.update(fix, utc, heading)
    with pytest.raises(celnav.CelnavError, match="order"):
        track.update(fix, "2024-02-01T00:00:00Z", heading)
    with pytest.raises(celnav.CelnavError, match="heading"):
        track.update(fix, utc, math.nan)
    with pytest.raises(celnav.CelnavError, match="gate"):
        TrackConfig(gate=0)


def test_heading_bias_is_learnt_from_what_the_stars_say():
    track = Track()
    for fix, utc, heading, _ in orbit(np.random.default_rng(6), n=20):
        track.update(dataclasses.replace(fix, heading_off_deg=0.7), utc, heading)
    assert track.points[-1].heading_bias_deg == pytest.approx(0.7, abs=0.02)


@pytest.mark.parametrize("none", ["tilt_bias_sigma_deg", "heading_bias_sigma_deg", "speed_sigma_km_s"])
def test_what_is_known_exactly_is_smoothed_too(none):
    config = TrackConfig(bias_walk_deg=0.0, acceleration_km_s2=0.0, **{none: 0.0})
    track, _ = run(np.random.default_rng(8), config, n=4, bias=np.zeros(2))
    assert np.isfinite([point.lat_deg for point in track.smoothed()]).all()
    place = track.smoothed()[-1]
    np.testing.assert_allclose(place.cov, track.points[-1].cov)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"cov_km2": np.full((2, 2), math.nan)}, "cov_km2"),
        ({"cov_km2": -np.eye(2)}, "cov_km2"),
        ({"cov_km2": np.eye(3)}, "cov_km2"),
        ({"lat_deg": math.nan}, "lat_deg"),
    ],
)
def test_a_fix_without_numbers_is_refused_and_leaves_the_track_as_it_was(changed, words):
    track = Track()
    fix, utc, heading, _ = next(orbit(np.random.default_rng(5)))
    with pytest.raises(celnav.CelnavError, match=words):
        track.update(dataclasses.replace(fix, **changed), utc, heading)
    assert track.points == ()


def test_the_bias_of_the_heading_is_honest_beside_a_tilt():
    """200 straight runs at 60 N, whose tilts turn the meridian by 0.17 deg: 4-sigma band of the mean square."""
    rng = np.random.default_rng(9)
    level = np.diag([-1.0, -1.0, 1.0])
    squares = []
    for _ in range(200):
        tilt = rotation_of(np.radians([*(0.1 * rng.standard_normal(2)), 0.0]))
        bias, heading = rng.standard_normal(), rng.uniform(0, 360)
        track = Track()
        for minute in range(10):
            R_cam, true = (level @ rotation_of(np.radians([0.0, 0.0, h])) for h in (heading, heading + bias))
            noise = rotation_of(np.radians([*(0.003 * rng.standard_normal(2)), 0.02 * rng.standard_normal()]))
            seen = place_from_rotation(
                noise @ tilt @ true @ enu_rotation(60.0, 10.0),
                np.diag(np.radians([0.003, 0.003, 0.02]) ** 2),
                celnav.Attitude.with_sigma(R_cam, tilt_deg=0.0, heading_deg=1.0),
            )
            fix = celnav.Fix(
                True,
                celnav.Reason.OK,
                "",
                seen.lat_deg,
                seen.lon_deg,
                seen.cov_km2,
                heading_off_deg=seen.heading_off_deg,
            )
            point = track.update(fix, f"2024-03-01T00:{minute:02d}:00Z", heading)
        squares.append((point.heading_bias_deg - bias) ** 2 / point.cov[6, 6])
    assert 1 - 4 * math.sqrt(2 / 200) < np.mean(squares) < 1 + 4 * math.sqrt(2 / 200)


def crossing(rng, lat_sign, beside_km):
    """A track from longitude 0 to 180 at 0.2 km/s, over a pole or past it, and the places of the vehicle."""
    track, truth = Track(TrackConfig(speed_sigma_km_s=0.3)), []
    for k in range(50):
        x = 5 - 0.2 * k + 1e-9
        lat, lon = lat_sign * (90 - math.hypot(x, beside_km) / 111.694), math.degrees(math.atan2(beside_km, x))
        seen = moved(lat, lon, *rng.normal(0, 0.1, 2))
        fix = celnav.Fix(True, celnav.Reason.OK, "", *seen, cov_km2=np.eye(2) * 0.01)
        # Azimuth of one direction, which turns with the meridian, and of a vehicle that turns besides.
        track.update(fix, f"2024-03-01T21:00:{k:02d}Z", 7.0 * k - lat_sign * lon)
        truth.append((lat, lon))
    return track, truth


@pytest.mark.parametrize(("lat_sign", "beside_km"), [(1, 0.0), (1, 0.7), (-1, 0.0)])
def test_a_track_crosses_the_pole(lat_sign, beside_km):
    """Squared errors are as large as at the equator (2.0 filtered, 2.3 smoothed); the gate drops one fix in a thousand."""
    rng = np.random.default_rng(6)
    squares, dropped = [], 0
    for _ in range(8):
        track, truth = crossing(rng, lat_sign, beside_km)
        dropped += sum(not point.used for point in track.points)
        for points in (track.points, track.smoothed()):
            off = errors_km(points, truth)
            squares += [e @ np.linalg.solve(p.cov_km2, e) for p, e in zip(points, off, strict=True)]
        last = track.points[-1]
        assert (np.abs(errors_km([last], truth[-1:])[0]) < 3 * np.sqrt(np.diag(last.cov_km2))).all()
        # Away from the pole, which lies behind: south in the north.
        away = offset_km(*truth[-1], *truth[-2])
        np.testing.assert_allclose(last.velocity_km_s, away, atol=4 * math.sqrt(last.cov[3, 3]))
        assert -lat_sign * away[1] == pytest.approx(0.2, abs=0.01)
    assert np.mean(squares) < 3.0
    assert dropped <= 2  # of 400


def test_offsets_are_the_way_there_and_back():
    rng = np.random.default_rng(7)
    for lat, lon in ((0, 0), (48, 179.99), (-89.99, 20), (90, 0), (89.9, -180)):
        for east, north in rng.uniform(-30, 30, (20, 2)):
            np.testing.assert_allclose(offset_km(*moved(lat, lon, east, north), lat, lon), (east, north), atol=1e-9)
    assert moved(89.99, 10.0, 0.0, 2 * 0.01 * 111.694)[1] == pytest.approx(-170, abs=1e-6)
    assert moved(12.0, 34.0, 0.0, 0.0) == (12.0, 34.0)
    np.testing.assert_allclose(offset_km(12.0, 34.0, 12.0, 34.0), 0, atol=1e-9)
