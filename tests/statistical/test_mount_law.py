"""Laws of a mount's wander, judged on nights that were drawn: the right law's claims hold, a narrow law's do not."""

import importlib.util
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.special import bdtr, chdtri

from celnav.calibrating.mount import USUAL_WANDER_DEG, turned
from celnav.calibrating.mount_times import MEMORY_H
from celnav.identification.verification import rotation_of

SITE = (51.9, -1.3)
MOUNT = rotation_of(np.array([0.6, -0.4, 1.1]))
NIGHTS = 200


@pytest.fixture(scope="module")
def law():
    path = Path(__file__).parents[2] / "tools" / "mount_law.py"
    spec = importlib.util.spec_from_file_location("mount_law", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def drawn(law, rng, lag_h):
    """Two frames of each of many nights, a lag apart, about a mount that wanders as celnav says."""
    variance = 2 * USUAL_WANDER_DEG**2 * (1 - math.exp(-lag_h / MEMORY_H))
    turns = rng.normal(0, math.sqrt(variance), (NIGHTS, 3))
    true = np.stack([turned(MOUNT, turn) for turn in turns])
    told = np.broadcast_to(MOUNT, true.shape)
    return law.Pairs("night", np.ones(3), 0.0, np.full(NIGHTS, lag_h), told, true, 1e-5), np.full(NIGHTS, variance)


@pytest.mark.parametrize("lag_h", [0.1, 3.0])
def test_the_right_law_claims_what_holds(law, lag_h):
    """Squares over covariances are chi-squared of two a night, and 95 % lie within; each but for one run in a thousand."""
    pairs, variance = drawn(law, np.random.default_rng(16), lag_h)
    _, square, _ = law.judged(pairs, variance, SITE, doubt=False)
    least, most = chdtri(2 * NIGHTS, [1 - 0.0005, 0.0005])
    assert least < square.sum() < most
    assert bdtr(int((square < law.WITHIN_95).sum()), NIGHTS, 0.95) > 0.001


def test_a_narrow_law_scores_worse(law):
    """A tenth of the variance: densities tell it by 5 standard errors and more."""
    pairs, variance = drawn(law, np.random.default_rng(17), 2.0)
    right, narrow = (law.judged(pairs, part * variance, SITE, doubt=False)[2] for part in (1.0, 0.1))
    assert (narrow - right).mean() > 5 * (narrow - right).std() / math.sqrt(NIGHTS)


def test_turns_about_the_unfelt_axis_leave_the_position(law):
    pairs, variance = drawn(law, np.random.default_rng(18), 2.0)
    true = np.stack([turned(MOUNT, angle * law.unfelt_axis(SITE[0])) for angle in (0.01, 0.05)])
    moved = law.Pairs("night", np.ones(3), 0.0, np.full(2, 2.0), pairs.told[:2], true, 1e-5)
    error, _, _ = law.judged(moved, variance[:2], SITE, doubt=False)
    assert error.max() < 0.01  # 0.05 deg of tilt are 5.6 km


def test_nights_are_read(law, tmp_path):
    """Three frames: two of one moment, from which the noise is known, and one an hour on."""
    rows = [(0.0, 0.0), (0.001, 0.002), (1.2, 0.1)]
    frames = [{"utc_mjd": 6e4 + hour / 24, "R_cam": turned(MOUNT, np.array([turn, 0.0, 0.0])).tolist(),
               "tilt_sigma_deg": 0.001, "heading_sigma_deg": 0.001} for hour, turn in rows]  # fmt: skip
    path = tmp_path / "night.json"
    path.write_text(json.dumps({"R_cam": MOUNT.tolist(), "calibration": {"frames": frames}}))
    pairs = law.Pairs.of(path)
    assert len(pairs.lag_h) == 4
    assert pairs.lag_h == pytest.approx(1.2, abs=0.01)
    assert pairs.noise_deg == pytest.approx(0.002 / math.sqrt(6), rel=1e-3)
    assert abs(pairs.axis) == pytest.approx([1.0, 0.0, 0.0], abs=1e-4)
    assert np.isnan(law.by_lag(pairs, np.ones(4))).sum() == 4
