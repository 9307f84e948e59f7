"""Transfer function of a circular pupil with aberrations that change over the field.

The image of a point is |transform of the pupil|^2, the pupil a unit disk with a phase of Noll's Zernike polynomials (Noll
1976, JOSA 66, 207), here in Noll's normalisation (rms 1 over the disk) and numbering: Airy's pattern without aberrations
(Goodman, Introduction to Fourier Optics, sections 4.4 and 6.4). Coefficients are polynomials of the field position, as in
nodal aberration theory for lenses with displaced or tilted parts (Thompson 2005, JOSA A 22, 1389): coma that vanishes at
a displaced node is a term linear in the field and a constant one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from generator.scenario.lens.psf_spec import DiffractionSpec

Floats = NDArray[np.float64]

REFERENCE_NM = 550.0
"""Wavelength of the waves of aberrations, and the one without lateral chromatic shift."""
FEWEST_SAMPLES, MOST_SAMPLES = 192, 768
"""Limits of the number of samples across four pupil radii."""
SAMPLES_PER_SLOPE = 12.0
"""Samples per wave and radius of the steepest wavefront: a third of a wave between neighbours."""


def noll_degrees(number: int) -> tuple[int, int]:
    """Degree n and order m of Noll's polynomial; m > 0 for cosines, m < 0 for sines."""
    n = int((math.sqrt(8 * number - 7) - 1) / 2)
    rest = number - n * (n + 1) // 2 - 1
    m = n % 2 + 2 * ((rest + (n + 1) % 2) // 2)
    return n, m if number % 2 == 0 else -m


def zernike(number: int, rho: Floats, theta: Floats) -> Floats:
    """Noll's polynomial at polar coordinates in the unit disk; its root mean square over the disk is 1."""
    n, order = noll_degrees(number)
    m = abs(order)
    radial = np.zeros_like(rho)
    for k in range((n - m) // 2 + 1):
        factor = (-1) ** k * math.factorial(n - k)
        factor //= math.factorial(k) * math.factorial((n + m) // 2 - k) * math.factorial((n - m) // 2 - k)
        radial = radial + factor * rho ** (n - 2 * k)
    if m == 0:
        return math.sqrt(n + 1) * radial
    return math.sqrt(2 * (n + 1)) * radial * (np.cos(m * theta) if order > 0 else np.sin(m * theta))


def wavefront_terms(diffraction: DiffractionSpec, field: complex) -> dict[int, float]:
    """Coefficients in waves at REFERENCE_NM by Noll's number, at a field position (u + iv) over the corner's distance."""
    radius, angle = abs(field), float(np.angle(field))
    coma, astigmatism = diffraction.coma_waves * radius, diffraction.astigmatism_waves * radius**2
    terms = {
        4: diffraction.defocus_waves,
        5: astigmatism * math.sin(2 * angle),
        6: astigmatism * math.cos(2 * angle),
        7: coma * math.sin(angle),
        8: coma * math.cos(angle),
    }
    for term in diffraction.zernike:
        here = term.waves * field.real**term.u_power * field.imag**term.v_power
        terms[term.noll] = terms.get(term.noll, 0.0) + here
    return {number: value for number, value in terms.items() if value}


def pupil_transfer(
    diffraction: DiffractionSpec, wavelength_nm: float, field: complex, pixel_pitch_um: float, frequency: Floats
) -> NDArray[np.complex128]:
    """Transfer function at frequencies (cycles per px, along both axes), (n, n) array.

    Without aberrations it has a closed form; with them it is the autocorrelation of the pupil, sampled so finely that the
    wavefront changes by a third of a wave between samples.
    """
    cutoff = 1000 * pixel_pitch_um / (wavelength_nm * diffraction.f_number)
    terms = wavefront_terms(diffraction, field)
    fu, fv = np.meshgrid(frequency, frequency)
    if not terms:
        s = np.minimum(np.hypot(fu, fv) / cutoff, 1)
        return (2 / np.pi) * (np.arccos(s) - s * np.sqrt(1 - s * s)) + 0j
    waves = REFERENCE_NM / wavelength_nm
    samples = _samples_for(terms, waves)
    x, y, step = _pupil_grid(samples)
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    inside = np.clip(0.5 + (1 - rho) / step, 0, 1)
    pupil = inside * np.exp(2j * np.pi * waves * _wavefront(terms, rho, theta))
    padded = np.zeros((2 * samples, 2 * samples), complex)
    padded[:samples, :samples] = pupil
    correlation = np.fft.fftshift(np.fft.ifft2(np.abs(np.fft.fft2(padded)) ** 2))
    correlation = correlation / correlation[samples, samples].real
    # A shift of two pupil radii is the cut-off frequency.
    passed = np.hypot(fu, fv) < cutoff
    places = [samples + 2 * f[passed] / cutoff / step for f in (fv, fu)]
    transfer = np.zeros(fu.shape, complex)
    transfer.real[passed] = ndimage.map_coordinates(correlation.real, places, order=3)
    transfer.imag[passed] = ndimage.map_coordinates(correlation.imag, places, order=3)
    return transfer


def _pupil_grid(samples: int) -> tuple[Floats, Floats, float]:
    """Coordinates x and y over four pupil radii, and their step."""
    step = 4.0 / samples
    axis = (np.arange(samples) - samples // 2) * step
    x, y = np.meshgrid(axis, axis)
    return x, y, step


def _wavefront(terms: dict[int, float], rho: Floats, theta: Floats) -> Floats:
    """Wavefront in waves; beyond the rim, the value on the rim."""
    within = np.minimum(rho, 1.0)
    return sum((value * zernike(number, within, theta) for number, value in terms.items()), np.zeros_like(rho))


def _samples_for(terms: dict[int, float], waves: float) -> int:
    """Samples across four pupil radii for a wavefront, a multiple of 64."""
    x, y, step = _pupil_grid(FEWEST_SAMPLES)
    rho = np.hypot(x, y)
    front = _wavefront(terms, rho, np.arctan2(y, x)) * waves
    slopes = np.hypot(*np.gradient(front, step))
    wanted = SAMPLES_PER_SLOPE * float(slopes[rho < 1 - step].max())
    return int(np.clip(64 * math.ceil(wanted / 64), FEWEST_SAMPLES, MOST_SAMPLES))
