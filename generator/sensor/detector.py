"""Conversion of expected electrons to DN: the sensor's effects in order (:mod:`generator.sensor`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from generator.scenario.sensor_spec import SensorSpec
from generator.sensor.charge import CosmicRays, FullWell, PhotonNoise, PhotoResponse
from generator.sensor.dark import BlinkingPixels, DarkCurrent, HotPixels
from generator.sensor.effect import Effect, Exposure, NoiseStream
from generator.sensor.readout import (
    Converter,
    FixedLines,
    FixedOffset,
    Interference,
    LineNoise,
    ReadNoise,
    TelegraphNoise,
)
from generator.sensor.sunburn import TrappedCharge


def effects(sensor: SensorSpec, burnt: TrappedCharge | None = None) -> list[Effect]:
    """The sensor's effects in the order in which they act; effects of zero strength are left out.

    Source of the model: EMVA Standard 1288, release 4.0, section 2 (linear camera model).
    """
    on = sensor.noise
    chain: list[Effect] = []
    if on and (sensor.prnu or sensor.dead_pixel_fraction):
        chain.append(PhotoResponse(sensor.prnu, sensor.dead_pixel_fraction))
    chain.append(PhotonNoise(on))
    defects = defect_pixels(sensor)
    if sensor.mean_dark_e_s or defects:
        chain.append(DarkCurrent(sensor.mean_dark_e_s, defects, on))
    rays = cosmic_rays(sensor)
    if rays is not None:
        chain.append(rays)
    chain.append(FullWell(sensor.full_well_e, sensor.blooming))
    if burnt is not None:
        chain.append(burnt)
    if on and sensor.dsnu_e:
        chain.append(FixedOffset(sensor.dsnu_e))
    if on and (sensor.dsnu_row_e or sensor.dsnu_column_e):
        chain.append(FixedLines(sensor.dsnu_row_e, sensor.dsnu_column_e))
    if on and sensor.read_noise_e:
        chain.append(ReadNoise(sensor.read_noise_e))
    if on and sensor.telegraph is not None:
        chain.append(TelegraphNoise(sensor.telegraph.fraction, sensor.telegraph.amplitude_e))
    if on and (sensor.row_noise_e or sensor.column_noise_e):
        chain.append(LineNoise(sensor.row_noise_e, sensor.column_noise_e))
    if on:
        chain += [
            Interference(wave.cycles_per_column, wave.cycles_per_row, wave.amplitude_e, number)
            for number, wave in enumerate(sensor.interference)
        ]
    chain.append(Converter(sensor.gain_e_per_dn, sensor.black_level_dn, sensor.bits))
    return chain


def defect_pixels(sensor: SensorSpec) -> tuple[HotPixels | BlinkingPixels, ...]:
    """The sensor's hot and blinking pixels at its temperature; empty without noise."""
    if not sensor.noise:
        return ()
    defects: list[HotPixels | BlinkingPixels] = []
    if sensor.hot_pixel_fraction:
        mean_e_s = sensor.hot_pixel_e_s * sensor.hot_factor
        defects.append(HotPixels(sensor.hot_pixel_fraction, mean_e_s, sensor.hot_pixel_log_sigma))
    blinking = sensor.blinking_pixels
    if blinking is not None:
        amplitude_e_s = blinking.amplitude_e_s * sensor.hot_factor
        defects.append(BlinkingPixels(blinking.fraction, amplitude_e_s, *blinking.time_constant_s))
    return tuple(defects)


def cosmic_rays(sensor: SensorSpec) -> CosmicRays | None:
    """The sensor's cosmic rays, or None if it has none."""
    rays = sensor.cosmic_rays
    if not sensor.noise or rays is None:
        return None
    return CosmicRays(rays.rate_s, rays.charge_e_px, rays.length_px)


def expose(
    electrons: NDArray[np.float32],
    exposure_s: float,
    sensor: SensorSpec,
    stream: NoiseStream,
    unit: NoiseStream | None = None,
    start_s: float = 0.0,
    burnt: TrappedCharge | None = None,
) -> NDArray[np.uint16]:
    """Read out a sensor.

    Parameters
    ----------
    electrons : (..., height, width) array
        Expected electrons from light.
    exposure_s : float
    sensor : SensorSpec
    stream : callable
        Returns the random generator of a named stream of this frame.
    unit : callable, optional
        Returns the random generator of a named stream of this particular sensor, the same in all its frames; by default
        `stream`.
    start_s : float
        Start of the exposure, seconds from any fixed moment.
    burnt : TrappedCharge, optional
        Pixels burnt by the Sun (:func:`generator.sensor.sunburn.burnt_pixels`).

    Returns
    -------
    (..., height, width) uint16 array
        DN, 0 to 2^bits - 1.
    """
    exposure = Exposure(exposure_s, stream, unit or stream, start_s)
    signal = np.asarray(electrons, dtype=np.float32)
    for effect in effects(sensor, burnt):
        signal = effect.apply(signal, exposure)
    return signal.astype(np.uint16)


def saturation_e(sensor: SensorSpec, exposure_s: float) -> float:
    """Electrons of an exposure at which a pixel reaches full well or the largest value, whichever comes first.

    For a video, those of all its frames.
    """
    largest_dn = 2**sensor.bits - 1
    if sensor.video is not None:
        largest_dn = min(largest_dn, largest_dn / sensor.video.exposure)
    one = min(sensor.full_well_e, (largest_dn - sensor.black_level_dn) * sensor.gain_e_per_dn)
    return one * sensor.exposures(exposure_s)


def matched_filter_snr(
    star_e: NDArray[np.float64],
    sky_e_px: NDArray[np.float64],
    psf_sigma_px: float,
    exposure_s: float,
    sensor: SensorSpec,
    area_px: NDArray[np.float64] | None = None,
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
    area_px : (n,) array, optional
        Noise-equivalent areas of extended sources (:func:`streak_area_px`).

    Returns
    -------
    (n,) array
    """
    area = 4 * np.pi * (psf_sigma_px**2 + 1 / 12) if area_px is None else area_px
    exposures = sensor.exposures(exposure_s)
    lines = sensor.row_noise_e**2 + sensor.column_noise_e**2 + sum(w.amplitude_e**2 / 2 for w in sensor.interference)
    fixed = sensor.dsnu_e**2 + sensor.dsnu_row_e**2 + sensor.dsnu_column_e**2
    # A fixed pattern adds up linearly over the frames of a video, noise with the square root of their number.
    readout = sensor.read_noise_e**2 + lines + exposures * fixed + sensor.gain_e_per_dn**2 / 12
    per_pixel = sky_e_px + sensor.mean_dark_e_s * exposure_s + exposures * readout
    return star_e / np.sqrt(star_e + area * per_pixel)


def streak_area_px(length_px: NDArray[np.float64], psf_sigma_px: float) -> NDArray[np.float64]:
    """Noise-equivalent area, px, of evenly lit straight streaks under a Gaussian point spread function.

    It is the inverse of the integral of the squared profile, as King's (1983): 4 pi sigma^2 for a point, approaching 2
    sqrt(pi) sigma L for a streak much longer than wide. sigma includes the pixel's own width.
    """
    sigma = np.sqrt(psf_sigma_px**2 + 1 / 12)
    length = np.maximum(length_px, 1e-3 * sigma)
    along = erf(length / (2 * sigma)) / length
    along -= 2 * sigma / (np.sqrt(np.pi) * length**2) * -np.expm1(-(length**2) / (4 * sigma**2))
    return 2 * np.sqrt(np.pi) * sigma / along
