"""The sensor measured by the reference analyser of EMVA 1288 (PyPI package `emva1288`): what goes in comes out."""

import logging

import numpy as np
import pytest
from scipy import stats

from generator.scenario.sensor_spec import SensorSpec
from generator.seeds import random_stream
from generator.sensor.detector import expose

SHAPE = (240, 250)
QUANTUM_EFFICIENCY = 0.6
SENSOR = SensorSpec(
    full_well_e=50000.0,
    read_noise_e=5.0,
    dark_current_e_s=0.0,
    dsnu_e=4.0,
    prnu=0.004,
    gain_e_per_dn=0.9,
    black_level_dn=500,
    bits=16,
)
SPATIAL_PHOTONS = 40000.0


def frame(photons: float, number: int) -> np.ndarray:
    expected = np.full(SHAPE, QUANTUM_EFFICIENCY * photons, np.float32)
    return expose(
        expected,
        1.0,
        SENSOR,
        lambda name: random_stream(1, name, number),
        lambda name: random_stream(1, f"unit.{name}", 0),
    )


@pytest.fixture(scope="module")
def analysis():
    patch = pytest.MonkeyPatch()
    # The package still calls a function that NumPy 2 has dropped.
    patch.setattr(np, "asfarray", lambda values: np.asarray(values, float), raising=False)
    from emva1288.process.data import Data1288
    from emva1288.process.results import Results1288
    from emva1288.process.routines import get_int_imgs

    saturation = SENSOR.full_well_e / QUANTUM_EFFICIENCY
    levels = [0.0, *(saturation * np.concatenate([np.geomspace(1e-4, 0.9, 28), np.arange(0.92, 1.001, 0.005)]))]
    temporal = {}
    for number, photons in enumerate(levels):
        pair = get_int_imgs([frame(photons, 2 * number), frame(photons, 2 * number + 1)])
        temporal[float(photons)] = {"sum": pair["sum"].sum(), "pvar": pair["pvar"].sum(), "dmean": pair["dmean"]}
    spatial = {
        photons: get_int_imgs([frame(photons, 1000 + 100 * row + number) for number in range(24)])
        for row, photons in enumerate((0.0, SPATIAL_PHOTONS))
    }
    data = {"temporal": {1.0: temporal}, "spatial": {1.0: spatial}, "height": SHAPE[0], "width": SHAPE[1]}
    results = Results1288(Data1288(data, loglevel=logging.WARNING).data, loglevel=logging.WARNING)
    yield results
    patch.undo()


def test_system_gain_within_one_percent(analysis) -> None:
    assert pytest.approx(1 / SENSOR.gain_e_per_dn, rel=0.01) == analysis.K


def test_quantum_efficiency_within_one_percent(analysis) -> None:
    assert pytest.approx(100 * QUANTUM_EFFICIENCY, rel=0.01) == analysis.QE


def test_dark_noise_within_three_percent(analysis) -> None:
    assert analysis.sigma_d == pytest.approx(SENSOR.read_noise_e, rel=0.03)


def test_full_well_within_two_percent(analysis) -> None:
    """The standard's saturation is where the temporal variance peaks, which full well and the pixels' spread say."""
    levels = SENSOR.full_well_e * np.arange(0.9, 1.0, 5e-4)
    spread = np.linspace(-5, 5, 201)
    mean = levels[:, None] * (1 + SENSOR.prnu * spread)
    sigma = np.sqrt(mean)
    room = (SENSOR.full_well_e - mean) / sigma
    below, density = stats.norm.cdf(room), stats.norm.pdf(room)
    first = -room * below - density
    second = (1 + room**2) * below + room * density
    variance = np.average(sigma**2 * (second - first**2), axis=1, weights=stats.norm.pdf(spread))
    assert analysis.u_e_sat == pytest.approx(levels[variance.argmax()], rel=0.02)
    assert levels[variance.argmax()] == pytest.approx(SENSOR.full_well_e, rel=0.02)


def test_dsnu_and_prnu_within_five_percent(analysis) -> None:
    assert pytest.approx(SENSOR.dsnu_e, rel=0.05) == analysis.DSNU1288
    assert pytest.approx(100 * SENSOR.prnu, rel=0.05) == analysis.PRNU1288


def test_signal_to_noise_over_four_decades(analysis) -> None:
    """SNR = eta mu_p / sqrt(sigma_d^2 + sigma_q^2/K^2 + eta mu_p) (EMVA 1288 release 4.0, equation 25), within 3 %."""
    temporal = analysis.temporal
    electrons = QUANTUM_EFFICIENCY * temporal["u_p"]
    used = electrons < 0.95 * SENSOR.full_well_e
    measured = (temporal["u_y"] - temporal["u_ydark"]) / np.sqrt(temporal["s2_y"])
    noise = SENSOR.read_noise_e**2 + SENSOR.gain_e_per_dn**2 / 12 + electrons
    np.testing.assert_allclose(measured[used], (electrons / np.sqrt(noise))[used], rtol=0.03)
    assert electrons[used].max() / electrons[used].min() > 0.9e4
