"""Stars below the threshold: they follow where few stand out, and a solver uses them only where it refuses the others."""

import dataclasses
import json

import numpy as np
import pytest
from calibration_sky import LAT_DEG, LON_DEG, apparent_stars, perspective_positions
from PIL import Image
from star_images import add_star

import celnav
from celnav.__main__ import main
from celnav.command.pointing import Pointing
from celnav.errors import ConfigError, DetectionError

UTC = "2021-08-05T05:30:00+00:00"
CAMERA = celnav.Camera("pinhole", width=640, height=480, f_px=554.3, cx_px=319.5, cy_px=239.5)
R_CAM = Pointing(130, 60, 5).R_cam
ATTITUDE = celnav.Attitude.exact(R_CAM)
FAINT = celnav.DetectionConfig(faint_stars=celnav.FAINT_STARS)
NOISE = 20.0


def noise(rng):
    """A sky of 1,000 with white noise."""
    return 1000 + rng.normal(0, NOISE, (CAMERA.height, CAMERA.width))


def faint_sky(rng, snr=3.9, number=24):
    """The brightest stars of a field, all of that signal-to-noise ratio under the matched filter, and their positions."""
    enu, v_mag = apparent_stars(UTC, 6.5)
    enu = enu[np.argsort(v_mag)]
    enu = enu[(R_CAM @ enu.T)[2] > 0.5]
    uv = perspective_positions(enu, R_CAM, (CAMERA.f_px, CAMERA.cx_px, CAMERA.cy_px))
    inside = ((uv > 12) & (uv < np.array([CAMERA.width, CAMERA.height]) - 13)).all(axis=1)
    image = noise(rng)
    # The standard deviation of a Gaussian star's fitted light is 2 sqrt(pi) times its width times the noise of a pixel.
    for u, v in (uv := uv[inside][:number]):
        add_star(image, u, v, snr * NOISE * 2 * np.sqrt(np.pi))
    return np.rint(image).astype(np.uint16), uv


def test_a_sky_without_stars_has_as_many_faint_detections_as_wanted_and_no_more_stars():
    image = np.rint(noise(np.random.default_rng(1))).astype(np.uint16)
    usual, more = celnav.detect(image), celnav.detect(image, config=FAINT)
    assert usual.n_faint == 0
    assert len(usual) <= 4
    assert len(more) == celnav.FAINT_STARS
    assert more.n_faint == len(more) - len(usual)
    assert (more.without_faint().uv == usual.uv).all()
    assert (np.diff(more.flux[len(usual) :]) <= 0).all()
    apart = np.linalg.norm(more.uv[:, None] - more.uv[None], axis=2)[np.triu_indices(len(more), 1)]
    assert apart.min() > 1


def test_a_frame_with_enough_stars_has_none():
    rng = np.random.default_rng(2)
    image, _ = faint_sky(rng, snr=40, number=70)
    usual, more = celnav.detect(image), celnav.detect(image, config=FAINT)
    assert len(usual) >= celnav.FAINT_STARS
    assert more.n_faint == 0
    assert (more.uv == usual.uv).all()
    assert (more.sigma_px == usual.sigma_px).all()


def test_stars_that_do_not_stand_out_are_identified_among_noise():
    """Of ten frames whose 24 stars have a signal-to-noise ratio of 3.9 most are solved, none wrong; before, next to none."""
    usual, more = [], []
    for seed in range(10):
        image, uv = faint_sky(np.random.default_rng([3, seed]))
        usual.append(celnav.solve(celnav.detect(image), CAMERA, UTC, ATTITUDE))
        found = celnav.detect(image, config=FAINT)
        fix = celnav.solve(found, CAMERA, UTC, ATTITUDE)
        more.append(fix)
        if fix.ok:
            distance = np.linalg.norm(found.uv[fix.matches[:, 0]][:, None] - uv[None], axis=2).min(axis=1)
            assert np.mean(distance < 3) > 0.75
            assert abs(fix.lat_deg - LAT_DEG) < 0.3
            assert abs(fix.lon_deg - LON_DEG) < 0.3
    assert sum(fix.ok for fix in more) >= 8 > 4 >= sum(fix.ok for fix in usual)


@pytest.mark.parametrize("attitude", [ATTITUDE, celnav.Attitude.up(R_CAM[:, 2], tilt_deg=0.1)])
def test_faint_detections_of_noise_are_no_fix(attitude):
    """`tests/statistical/test_celnav_noise_images.py` judges more of them."""
    for seed in range(6):
        image = np.rint(noise(np.random.default_rng([4, seed]))).astype(np.uint16)
        found = celnav.detect(image, config=FAINT)
        assert found.n_faint > 50
        assert not celnav.solve(found, CAMERA, UTC, attitude).ok


def test_a_frame_that_is_solved_without_them_is_solved_without_them():
    image, _ = faint_sky(np.random.default_rng(5), snr=30, number=30)
    usual, more = celnav.detect(image), celnav.detect(image, config=FAINT)
    assert more.n_faint > 0
    first, second = (celnav.solve(found, CAMERA, UTC, ATTITUDE) for found in (usual, more))
    assert first.ok
    assert (second.lat_deg, second.lon_deg) == (first.lat_deg, first.lon_deg)
    assert second.matches.tolist() == first.matches.tolist()


def test_the_command_line_uses_them_and_counts_them_apart(tmp_path, capsys):
    image, _ = faint_sky(np.random.default_rng([3, 0]))
    found = celnav.detect(image, config=FAINT)
    Image.fromarray(image).save(tmp_path / "faint.png")
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA.to_dict()))
    told = ["solve", str(tmp_path / "faint.png"), "--camera", str(tmp_path / "camera.json"), "--utc", UTC]
    told += ["--attitude", "azimuth=130,altitude=60,roll=5"]
    assert main(told) == 0
    n = len(found) - found.n_faint
    assert f"identified of {n} detected and {found.n_faint} fainter than the threshold" in capsys.readouterr().out
    assert main([*told, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["n_detections"], answer["n_faint_detections"]) == (len(found), found.n_faint)


def test_the_time_limit_holds_for_both_searches():
    """Where the first search has used the time, its refusal is the answer."""
    image, _ = faint_sky(np.random.default_rng([3, 0]))
    found = celnav.detect(image, config=FAINT)
    assert celnav.solve(found, CAMERA, UTC, ATTITUDE).ok
    assert not celnav.solve(found, CAMERA, UTC, ATTITUDE, time_limit_s=1e-9).ok


def test_the_second_search_has_an_eighth_of_the_effort():
    seen = []

    def refuses(problem, history, clock):
        seen.append((len(problem.observation.uv), problem.effort))
        return celnav.Fix.refusal(celnav.Reason.NO_HYPOTHESIS, "none")

    image, _ = faint_sky(np.random.default_rng([3, 0]))
    found = celnav.detect(image, config=FAINT)
    assert not celnav.solve(found, CAMERA, UTC, ATTITUDE, solver=refuses).ok
    assert seen == [(len(found) - found.n_faint, 1.0), (len(found), 0.125)]


def test_streaks_and_points_are_joined():
    """Where only the faint ones have streaks, the others have streaks of no length and their own standard deviation."""
    stars = celnav.Detections(np.array([[10.0, 10.0]]), np.array([9.0]), (50, 50), np.array([0.1]))
    fainter = celnav.Detections(
        np.array([[11.0, 11.0], [30.0, 30.0]]), np.array([2.0, 1.0]), (50, 50), np.array([0.4, 0.5]),
        np.array([[3.0, 0.0], [4.0, 0.0]]), np.array([0.2, 0.3]),
    )  # fmt: skip
    joined = stars.followed_by(fainter, 5)
    assert joined.uv.tolist() == [[10, 10], [30, 30]]
    assert joined.n_faint == 1
    assert joined.streak_px.tolist() == [[0, 0], [4, 0]]
    assert joined.sigma_across_px.tolist() == [0.1, 0.3]
    assert joined.sigma_px.tolist() == [0.1, 0.5]
    assert len(stars.followed_by(fainter, 1)) == 1


def test_malformed_numbers_are_refused():
    with pytest.raises(ConfigError, match="faint_stars"):
        celnav.DetectionConfig(faint_stars=-1)
    found = celnav.Detections(np.array([[10.0, 10.0]]), None)
    with pytest.raises(DetectionError, match="n_faint = 2"):
        celnav.solve(dataclasses.replace(found, n_faint=2), CAMERA, UTC, ATTITUDE)
