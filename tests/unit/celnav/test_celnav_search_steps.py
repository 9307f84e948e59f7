"""Steps of the identification that work on many hypotheses at once, against the same done one by one."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import celnav
from celnav.identification.frame_grid import frame_grid
from celnav.identification.search import View, pair_hypotheses, triads, turns
from celnav.identification.sky_index import load_sky_index

ALLSKY = Path(__file__).parents[3] / "benchmark/real_tasks/allsky-real.camera.json"


def test_frames_of_pairs_are_orthonormal_and_turned_into_each_other():
    rng = np.random.default_rng(1)
    a, b = (Rotation.random(40, rng=rng).apply([0, 0, 1]).T for _ in range(2))
    frames = triads(a, b)
    np.testing.assert_allclose(
        np.einsum("ikn,jkn->nij", frames, frames), np.broadcast_to(np.eye(3), (40, 3, 3)), atol=1e-12
    )
    middle = (a + b) / np.linalg.norm(a + b, axis=0)
    np.testing.assert_allclose(frames[0], middle, atol=1e-12)
    turn = Rotation.random(rng=rng)
    to = turns(turn.apply(a.T).T, turn.apply(b.T).T, frames)
    np.testing.assert_allclose(to, np.broadcast_to(turn.as_matrix(), (40, 3, 3)), atol=1e-12)


def test_the_true_rotation_is_among_those_of_a_pair_and_each_pair_comes_either_way_round():
    index = load_sky_index()
    level = index.levels[1]
    first, second = index.xyz[[11, 47]]
    sky_from_camera = Rotation.random(rng=np.random.default_rng(2)).as_matrix()
    rays = (np.stack((first, second)) @ sky_from_camera).astype(np.float32)
    view = View(rays, np.full(2, 1e-3, dtype=np.float32))
    pairs = np.array([[0, 1]])
    every = np.concatenate(
        [found for found, _ in pair_hypotheses(view, pairs, level, index.axes, 0.5, (0.0, 0.0), 10**6)]
    )
    assert np.abs(every - sky_from_camera).max(axis=(1, 2)).min() < 1e-5
    forth, back = np.array_split(every, 2)
    middle = (rays[0] + rays[1]) / np.linalg.norm(rays[0] + rays[1])
    np.testing.assert_allclose(forth @ middle, back @ middle, atol=1e-5)
    assert np.abs(np.linalg.det(every) - 1).max() < 1e-5

    allowed = np.zeros((2, level.n), dtype=bool)
    allowed[0, 47] = allowed[1, 11] = True
    [(found, skipped)] = pair_hypotheses(view, pairs, level, index.axes, 0.5, (0.0, 0.0), 10**6, allowed)
    assert len(found) == 1
    assert skipped == len(every) - 1
    np.testing.assert_allclose(found[0] @ (rays[0] - rays[1]), second - first, atol=1e-3)


@pytest.mark.parametrize("f_px", [200.0, 900.0])
def test_the_solid_angle_of_a_pinhole_camera_is_that_of_its_pyramid(f_px):
    camera = celnav.Camera("pinhole", 640, 480, f_px)
    grid = frame_grid(camera)
    assert grid.solid_angle_sr == pytest.approx(camera.solid_angle_sr, rel=2e-3)
    assert grid.seen_part == 1.0


def test_an_image_circle_shows_half_of_the_sky():
    """Of an equidistant lens with 90 deg at 300 px, in a frame of 600 px: 2 pi sr, pi / 4 of the frame."""
    given = {"model": "equidistant", "width": 600, "height": 600, "f_px": 300 / (math.pi / 2)}
    whole = celnav.Camera(**given)
    half = np.arccos(frame_grid(whole).rays[:, 2]) < math.pi / 2
    assert frame_grid(whole).solid_angles_sr[half].sum() == pytest.approx(2 * math.pi, rel=0.01)
    assert half.mean() * frame_grid(whole).seen_part == pytest.approx(math.pi / 4, rel=0.01)


def test_the_grid_of_a_real_lens_agrees_with_a_finer_one():
    camera = celnav.Camera.from_json(ALLSKY)
    assert frame_grid(camera).solid_angle_sr == pytest.approx(camera.solid_angle_sr, rel=0.01)
    assert frame_grid(camera).seen_part == pytest.approx(0.673, rel=0.01)
