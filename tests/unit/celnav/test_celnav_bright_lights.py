"""Bright lights that are no stars: recognised by their number, and passed over by the search."""

import numpy as np
import pytest

import celnav
from benchmark.fields.solver_bars import attitude_of, camera_of, measure
from benchmark.fields.solver_fields import Condition, make_field
from celnav.identification.bright_lights import bright_lights

FIELDS = 12


def magnitudes(rng: np.random.Generator, n: int) -> np.ndarray:
    """Magnitudes of stars to V 6: their number grows tenfold in two magnitudes."""
    return 6 + 2 * np.log10(rng.random(n))


@pytest.mark.parametrize("n", [20, 60, 200, 1000])
def test_stars_are_rarely_taken_for_lights(n: int) -> None:
    """The bound is 3 standard deviations: 400 skies have 0.5 in the mean by the normal law, Poisson's law some more."""
    rng = np.random.default_rng(n)
    assert sum(bright_lights(magnitudes(rng, n)) for _ in range(400)) <= 12


@pytest.mark.parametrize(("n_lights", "brightest"), [(30, 0.0), (60, 0.0), (200, 0.0), (25, -2.0), (150, -2.0)])
def test_lights_are_told_by_their_number(n_lights: int, brightest: float) -> None:
    """Sixty stars, and lights that are as often bright as faint, or all brighter: even if they are the majority."""
    rng = np.random.default_rng(n_lights)
    lights = rng.uniform(brightest, brightest + (6.0 if brightest == 0 else 1.0), n_lights)
    mag = np.concatenate((magnitudes(rng, 60), lights))
    assert bright_lights(mag)
    assert bright_lights(np.concatenate((mag, np.full(9, np.nan))))


def test_no_flux_tells_nothing() -> None:
    assert not bright_lights(None)
    assert not bright_lights(np.full(5, np.nan))


@pytest.mark.parametrize(
    "condition",
    [
        Condition("attitude known", 60, 5.5, noise_px=0.3, bright_false=150, exact_attitude=True),
        Condition("vertical known", 60, 5.5, noise_px=0.3, bright_false=60),
        Condition("wide", 120, 5.0, noise_px=0.3, bright_false=80),
    ],
    ids=lambda condition: condition.name,
)
def test_stars_are_named_among_lights_that_are_brighter_than_all(condition: Condition) -> None:
    found = measure(condition, FIELDS, 3)
    assert (int(np.sum(found.error_km <= 10)), found.wrong) == (FIELDS, 0)


def test_without_fluxes_nothing_is_passed_over() -> None:
    condition = Condition("plain", 60, 5.5, noise_px=0.3)
    field = make_field(condition, 3, 0)
    fix = celnav.solve(field.uv, camera_of(condition), field.utc, attitude_of(condition, field))
    assert fix.ok
