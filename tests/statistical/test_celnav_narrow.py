"""Fields of 5 to 20 deg, as a star tracker has them: lost in space, and with the vertical alone."""

import numpy as np
import pytest

import celnav
from benchmark.fields.solver_bars import attitude_of, camera_of, measure
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition, make_field
from celnav.identification.sky_index import load_deep_sky_index, load_sky_index

SEED, FIELDS = 37, 12
USUAL = {"noise_px": 0.5, "missing": 0.2, "false": 0.2, "tilt_deg": 50.0}
SPOILT = {"noise_px": 0.5, "missing": 0.5, "false": 1.0, "tilt_deg": 50.0}


@pytest.mark.parametrize(
    ("hfov_deg", "v_max", "spoilt", "least"),
    [
        pytest.param(20, 8.0, USUAL, 0.99, marks=pytest.mark.journey),
        pytest.param(12, 8.0, USUAL, 0.99, marks=pytest.mark.journey),
        pytest.param(8, 8.0, USUAL, 0.97, marks=pytest.mark.journey),
        (5, 8.0, USUAL, 0.80),
        pytest.param(20, 6.0, SPOILT, 0.70, marks=pytest.mark.journey),
        (12, 8.0, SPOILT, 0.65),
        (8, 8.0, SPOILT, 0.45),
    ],
)
def test_narrow_fields(hfov_deg, v_max, spoilt, least):
    """As many as a solver of that rate has with probability 0.999, and no wrong position."""
    found = measure(Condition("narrow", hfov_deg, v_max, **spoilt), FIELDS, SEED)
    allowed = 3.1 * np.sqrt(FIELDS * least * (1 - least)) + 0.5
    assert np.sum(found.error_km <= 10) >= FIELDS * least - allowed
    assert found.wrong == 0


@pytest.mark.parametrize("hfov_deg", [5, 8, 12, 20])
def test_clutter_in_a_narrow_field_is_no_star_field(hfov_deg):
    """5 frames of noise each, up to 300 detections: refused within the work allowed; the bound is 1e-6 a frame."""
    camera = celnav.Camera.pinhole(WIDTH, HEIGHT, hfov_deg)
    for number in range(5):
        rng = np.random.default_rng([SEED, number])
        n = int(rng.integers(6, 300))
        uv = rng.uniform([0, 0], [WIDTH - 1, HEIGHT - 1], (n, 2))
        fix = celnav.solve(uv, camera, "2024-03-01T22:00:00Z", celnav.Attitude.up([0, 0, 1]), flux=rng.random(n))
        assert not fix.ok
        assert fix.R_icrs_to_camera is None
        assert fix.work <= celnav.SkybenchConfig().max_work


def test_deep_tables_continue_the_others():
    """The stars of both are the same as far as both go, so that levels of the one serve with the stars of the other."""
    usual, deep = load_sky_index(), load_deep_sky_index()
    assert np.array_equal(usual.xyz, deep.xyz[: len(usual.xyz)])
    assert [level.n for level in deep.levels] == sorted(level.n for level in deep.levels)
    deepest = deep.levels[-1]
    assert deepest.n == len(deep.xyz) == 102_400
    rows = np.random.default_rng(1).integers(len(deepest.first), size=200)
    chord = np.linalg.norm(deep.xyz[deepest.first[rows]] - deep.xyz[deepest.second[rows]], axis=1)
    assert 2 * np.arcsin(chord / 2) == pytest.approx(deepest.separation_rad[rows], abs=2e-7)


def test_a_detection_has_one_name_and_a_star_one_detection():
    """Noise of three pixels mixes the stars of doubles."""
    condition, named = Condition("noisy", 15, 6.0, noise_px=3.0), 0
    for number in range(20):
        field = make_field(condition, SEED, number)
        fix = celnav.solve(field.uv, camera_of(condition), field.utc, attitude_of(condition, field), flux=field.flux)
        for column in fix.matches.T:
            assert len(np.unique(column)) == len(column)
        named += len(fix.matches)
    assert named > 170
