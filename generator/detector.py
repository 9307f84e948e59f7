"""From expected electrons to DN: shot noise, dark current, saturation, read noise, gain, black level, quantisation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from generator.scenario import SensorSpec

NoiseStream = Callable[[str], np.random.Generator]


def expose(
    electrons: NDArray[np.float32], exposure_s: float, sensor: SensorSpec, stream: NoiseStream
) -> NDArray[np.uint16]:
    """Read out a sensor.

    Source of the model: EMVA Standard 1288, release 4.0, section 2 (linear camera model): Poisson electrons from light and
    dark current, Gaussian read noise, a uniform quantiser.

    Parameters
    ----------
    electrons : (height, width) array
        Expected electrons from light.
    exposure_s : float
    sensor : SensorSpec
    stream : callable
        Gives the random generator of a named stream (``shot``, ``read``).

    Returns
    -------
    (height, width) uint16 array
        DN, 0 to 2^bits - 1.
    """
    expected = np.asarray(electrons, dtype=np.float64) + sensor.dark_current_e_s * exposure_s
    signal = stream("shot").poisson(expected).astype(np.float64) if sensor.noise else expected
    signal = np.minimum(signal, sensor.full_well_e)
    if sensor.noise:
        signal = signal + stream("read").normal(0.0, sensor.read_noise_e, signal.shape)
    dn = np.rint(signal / sensor.gain_e_per_dn + sensor.black_level_dn)
    return np.clip(dn, 0, 2**sensor.bits - 1).astype(np.uint16)


def saturation_e(sensor: SensorSpec) -> float:
    """Electrons at which a pixel reaches full well or the largest DN, whichever comes first."""
    return min(sensor.full_well_e, (2**sensor.bits - 1 - sensor.black_level_dn) * sensor.gain_e_per_dn)


def matched_filter_snr(
    star_e: NDArray[np.float64],
    sky_e_px: NDArray[np.float64],
    psf_sigma_px: float,
    exposure_s: float,
    sensor: SensorSpec,
) -> NDArray[np.float64]:
    """Signal-to-noise ratio of stars under a matched filter to a Gaussian point spread function.

    The filter's noise-equivalent area is 4 pi sigma^2, sigma including the pixel's own width (King 1983, PASP 95, 163).

    Parameters
    ----------
    star_e : (n,) array
        Expected electrons of each star.
    sky_e_px : (n,) array
        Expected electrons of the sky in a pixel at each star.
    psf_sigma_px, exposure_s : float
    sensor : SensorSpec

    Returns
    -------
    (n,) array
    """
    area_px = 4 * np.pi * (psf_sigma_px**2 + 1 / 12)
    per_pixel = sky_e_px + sensor.dark_current_e_s * exposure_s + sensor.read_noise_e**2 + sensor.gain_e_per_dn**2 / 12
    return star_e / np.sqrt(star_e + area_px * per_pixel)
