"""The solver `learned`: patterns, its network in NumPy against PyTorch, what it names in exact and in random fields."""

from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from unit.benchmark.exact_fields import FISHEYE, PINHOLE, PLACE, stars_in, told

from benchmark.judge.geodesy import geodesic_km
from benchmark.solvers.detected_points import Points
from benchmark.solvers.learned.adapter import Learned
from benchmark.solvers.learned.network import WEIGHTS, Network, read_network, trained_network, write_network
from benchmark.solvers.learned.patterns import BINS, FARTHEST_DEG, KINDS, NEAREST_DEG, PATTERN_SIZE, patterns_of
from celnav.sky.catalog import load_catalog

ROOT = Path(__file__).parents[3]
RANDOM = np.random.default_rng(4)


def rays(n):
    xy = RANDOM.uniform(-0.5, 0.5, (n, 2))
    found = np.column_stack((xy, np.ones(n)))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def trainer():
    spec = importlib.util.spec_from_file_location("train_learned", ROOT / "tools" / "train_learned.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_patterns_do_not_depend_on_the_attitude_nor_on_the_zero_point():
    seen, magnitudes = rays(40), RANDOM.uniform(0.0, 5.0, 40)
    turned = seen @ Rotation.from_euler("xyz", [0.3, -1.2, 2.5]).as_matrix().T
    expected = patterns_of(seen, magnitudes)
    np.testing.assert_allclose(patterns_of(turned, magnitudes + 7.0), expected, atol=1e-5)
    shuffled = RANDOM.permutation(40)
    np.testing.assert_allclose(patterns_of(seen[shuffled], magnitudes[shuffled]), expected[shuffled], atol=1e-5)


def test_a_pattern_counts_the_neighbours_at_their_distances():
    away_deg = np.array([0.0, 0.5 * NEAREST_DEG, 10.0, FARTHEST_DEG + 1.0])
    seen = np.column_stack((np.sin(np.radians(away_deg)), np.zeros(4), np.cos(np.radians(away_deg))))
    first = patterns_of(seen, np.array([3.0, 3.0, -2.0, 3.0]))[0].reshape(KINDS, BINS)
    # One of them is neither too near nor too far: at 10 deg, 100 ln 2 = 69.3 bins on, and brighter by more than a step.
    assert first.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(first[0, 69:71], [0.685, 0.315], atol=1e-3)


def test_weights_are_small_and_nothing_in_their_file_is_run(tmp_path):
    assert WEIGHTS.stat().st_size < 2_000_000
    network = trained_network()
    assert network.layers[0][0].shape[0] == PATTERN_SIZE
    assert set(network.star_ids) <= set(load_catalog().star_id)
    probabilities = network.probabilities(patterns_of(rays(20), np.zeros(20)))
    np.testing.assert_allclose(probabilities.sum(axis=1), 1.0, atol=1e-4)
    write_network(tmp_path / "again.npz", network)
    # Not the files' bytes: the headers of zip members differ between patch releases of Python.
    with np.load(tmp_path / "again.npz") as again, np.load(WEIGHTS) as stored:
        assert again.files == stored.files
        assert all(
            np.array_equal(again[name], stored[name]) and again[name].dtype == stored[name].dtype for name in stored
        )
    with (tmp_path / "object.npz").open("wb") as file:
        np.savez(file, bias0=np.array([object()], dtype=object), weights0=np.zeros((1, 1)), star_ids=np.zeros(1))
    with pytest.raises(ValueError, match="allow_pickle"):
        read_network(tmp_path / "object.npz")


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
def test_exact_positions_of_stars_give_the_place_and_their_names(camera):
    observation = told(camera)
    ids, uv, flux = stars_in(observation)
    answer = Learned().solve(Points(uv, flux), observation)
    assert answer.ok, answer.reason
    assert geodesic_km(*PLACE, answer.lat_deg, answer.lon_deg) < (0.2 if camera is PINHOLE else 1.0)
    assert len(answer.matches) >= 30
    assert (ids[answer.matches[:, 0]] == answer.matches[:, 1]).mean() > 0.95
    assert answer.confidence > 0.999999


def test_any_roll_and_missing_and_false_stars():
    plain = told(PINHOLE)
    turned = dataclasses.replace(plain, R_cam=Rotation.from_euler("z", 130, degrees=True).as_matrix() @ plain.R_cam)
    ids, uv, flux = stars_in(turned)
    kept = RANDOM.random(len(ids)) > 0.3
    false = RANDOM.uniform([0, 0], [639, 479], (8, 2))
    uv = np.vstack((uv[kept] + RANDOM.normal(0.0, 0.3, (kept.sum(), 2)), false))
    flux = np.concatenate((flux[kept], RANDOM.choice(flux, 8)))
    answer = Learned().solve(Points(uv, flux), turned)
    assert answer.ok, answer.reason
    assert geodesic_km(*PLACE, answer.lat_deg, answer.lon_deg) < 5.0


def test_random_points_are_no_stars():
    """30 fields of 20 to 60 points: a false answer has a probability below 30 times 12 sets times 1e-6."""
    for n in RANDOM.integers(20, 61, 30):
        answer = Learned().solve(Points(RANDOM.uniform([0, 0], [639, 479], (n, 2)), RANDOM.random(n)), told(PINHOLE))
        assert not answer.ok
        assert answer.reason == "no names that agree with enough stars"
    assert Learned().solve(Points(np.array([[5.0, 5.0]]), None), told(PINHOLE)).reason == "fewer than 4 detections"


def test_fields_for_the_training_show_stars_of_the_catalogue():
    stars = load_catalog()
    star_ids = stars.star_id[stars.v_mag < 5.5].astype(np.int64)
    fields = trainer().Fields(star_ids, 5)
    named = 0
    for _ in range(20):
        seen, magnitudes, classes = fields.draw()
        np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 1.0)
        assert (np.diff(magnitudes) >= 0.0).all()
        known = classes >= 0
        named += known.sum()
        # Angles to the brightest of the named stars are those of the catalogue, but for noise and the focal length.
        rows = stars.rows_of(star_ids[classes[known]])
        angles = [np.arccos(np.clip(each[:1] @ each.T, -1.0, 1.0)) for each in (seen[known], stars.vectors[rows])]
        assert np.median(np.abs(np.degrees(angles[0] - angles[1]))) < 1.0
    assert named > 200


def test_the_network_in_numpy_is_that_of_pytorch():
    torch = pytest.importorskip("torch", reason="torch is not installed: pip install 'skybench[learned]'")
    module = trainer()
    model = module.model_of(50)
    with torch.no_grad():
        for layer in model:
            if isinstance(layer, torch.nn.BatchNorm1d):
                layer.running_mean.uniform_(-1.0, 1.0)
                layer.running_var.uniform_(0.5, 2.0)
    model.eval()
    seen = patterns_of(rays(30), RANDOM.uniform(0.0, 5.0, 30))
    network: Network = module.network_of(model, np.arange(50))
    with torch.no_grad():
        expected = torch.softmax(model(torch.from_numpy(seen)), dim=1).numpy()
    np.testing.assert_allclose(network.probabilities(seen), expected, atol=1e-5)
