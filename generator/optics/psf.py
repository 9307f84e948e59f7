"""Point spread functions of a camera, integrated over pixels, on a grid of field positions and wavelength bands.

Parts of a point spread function convolve, so their transfer functions multiply:

- Gaussian: exp(-2 pi^2 sigma^2 f^2);
- defocus disk of diameter d: 2 J1(pi d f) / (pi d f);
- a Gaussian with widths along and across the field's radius, by the angle off axis: exp(-2 pi^2 (sr^2 fr^2 + st^2 ft^2));
- diffraction: that of a pupil with aberrations over the field (:mod:`generator.optics.pupil`);
- Moffat's profile (Moffat 1969, A&A 3, 455), transformed numerically;
- a user's stack, transformed numerically;
- the pixel itself: sinc(w f_u) sinc(h f_v), w and h the sides of its sensitive area (1 unless given), times the Gaussian
  of the charge's diffusion. It is normalised to a mean of 1 over all places of a star within a pixel (the quantum
  efficiency already accounts for the insensitive part), so that electrons depend on the place of a star within a pixel if
  w or h is below 1.

Light beyond the support is not drawn, and the rest is not renormalised: the table's sum is the energy encircled by the
support.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special

from generator.identity.kept import kept
from generator.light.photometry import GRID_START_NM, GRID_STOP_NM
from generator.optics.pupil import REFERENCE_NM, pupil_transfer
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.lens.psf_spec import FieldGaussianSpec, MoffatSpec, PixelSpec, PsfSpec, PsfStackSpec
from generator.scenario.lens.psf_stack import read_stack

Floats = NDArray[np.float64]

FINE_PER_PX = 8
"""Samples of a stamp per pixel."""
FIELD_NODES = 5
"""Computed nodes of the field grid along each axis, if the point spread function varies."""
FINE_FIELD_NODES = 9
"""Nodes if it depends on the field only by Gaussians: then one band is enough, and the table stays small."""
BAND_COUNT = 4
"""Number of wavelength bands, if it depends on wavelength."""
CHROMATIC_SPAN_NM = 200.0
"""Span from 450 to 650 nm, over which the lateral chromatic shift is stated."""
MARGIN_PX = 4
FARTHEST_PX = 160
"""Limit of half the transform's period, for its memory: 5e-4 of a Moffat profile of beta 1.5 and 3 px returns there."""
PSF_REACH_SIGMAS = 6.0
"""Equivalent standard deviations from a star within which its light counts."""


@dataclass(frozen=True)
class PsfTable:
    """Point spread functions on a grid of field positions, for a few wavelength bands.

    Attributes
    ----------
    stamps : (bands, rows, columns, n, n) array
        Fraction of the light that a pixel receives, by its distance from the star, every 1/FINE_PER_PX px from -radius -
        0.5 to radius + 0.5; n = (2 radius + 1) FINE_PER_PX + 1.
    shift : (bands,) array
        Lateral chromatic shift of equal bands of the spectral range at the frame's corner, px.
    """

    stamps: NDArray[np.float32]
    shift: Floats

    @functools.cached_property
    def cumulated(self) -> Floats:
        """Cumulative light on fine samples before each row and column, (bands, rows, columns, n + 1, n + 1) array.

        Fine samples integrate to the light: each represents 1/FINE_PER_PX^2 of it, and those on the rim half as much.
        """
        size = self.stamps.shape[-1]
        result = np.zeros((*self.stamps.shape[:3], size + 1, size + 1))
        result[..., 1:, 1:] = self.stamps
        result[..., [1, -1], :] *= 0.5
        result[..., [1, -1]] *= 0.5
        result /= FINE_PER_PX**2
        np.cumsum(result, axis=-1, out=result)
        return np.cumsum(result, axis=-2, out=result)

    @functools.cached_property
    def light(self) -> tuple[Floats, Floats]:
        """Sum of the light, (bands, rows, columns), and its normalised first moment, px (u, v), (bands, rows, columns, 2).

        The moment is relative to the place of the star plus the band's lateral chromatic shift; samples on the rim count
        half.
        """
        axis = (np.arange(self.stamps.shape[-1]) - self.stamps.shape[-1] // 2) / FINE_PER_PX
        weight = np.where(np.arange(len(axis)) % (len(axis) - 1) == 0, 0.5, 1.0) / FINE_PER_PX
        by_row = self.stamps @ weight
        total = by_row @ weight
        along = np.stack(
            [np.einsum("...rc,c,r->...", self.stamps, weight * axis, weight), by_row @ (weight * axis)], axis=-1
        )
        return total, along / total[..., None]

    @property
    def by_phase(self) -> NDArray[np.float32]:
        """The stamps' samples, ordered by their place within a pixel: see :class:`generator.plugins.psf_atlas.PsfAtlas`."""
        *nodes, size, _ = self.stamps.shape
        side = size // FINE_PER_PX + 1
        spare = side * FINE_PER_PX - size
        padded = np.pad(self.stamps, [(0, 0)] * 3 + [(0, spare)] * 2)
        return padded.reshape(*nodes, side, FINE_PER_PX, side, FINE_PER_PX).transpose(0, 1, 2, 4, 6, 3, 5)

    @functools.cached_property
    def inside(self) -> Floats:
        """Light within squares of 1, 3, 5 … px around a star, (radius + 1, bands, rows, columns) array."""
        middle = self.stamps.shape[-1] // 2

        def square(half: int) -> Floats:
            first, stop = middle - half, middle + half + 1
            corners = self.cumulated
            return (
                corners[..., stop, stop] - corners[..., first, stop] - corners[..., stop, first]
                + corners[..., first, first]
            )  # fmt: skip

        halves = np.arange(FINE_PER_PX // 2, middle + 1, FINE_PER_PX)
        # The rim of a square counts half.
        return np.array([(square(h) + square(h - 1)) / 2 if h < middle else square(h) for h in halves])

    @functools.cached_property
    def beyond(self) -> Floats:
        """Largest fraction in a pixel outside those squares, anywhere in the field and in any band, (radius + 1,) array."""
        largest = self.stamps.max(axis=(0, 1, 2))
        from_middle = np.abs(np.arange(len(largest)) - len(largest) // 2)
        distance = np.maximum(from_middle[:, None], from_middle)
        halves = np.arange(FINE_PER_PX // 2, len(largest) // 2, FINE_PER_PX)
        return np.array([*(largest[distance >= half].max() for half in halves), 0.0])


def psf_table(camera: CameraSpec) -> PsfTable:
    """Point spread function of a camera, which must have a `psf` section; for a drifting camera, that without drift."""
    return _tabulated(camera.resting)


@functools.lru_cache(maxsize=2)
def _tabulated(camera: CameraSpec) -> PsfTable:
    psf = camera.psf
    if psf is None:
        raise ValueError("the camera has no psf section")
    arrays = kept("psf", (camera,), lambda: _computed(camera, psf))
    stamps = np.asarray(arrays["stamps"], dtype=np.float32)
    if stamps.shape[1] > 1:
        # Stars use the nearest node, so there are enough nodes for the steps between them to be small.
        stamps = _between_nodes(_between_nodes(stamps, 1), 2)
    return PsfTable(stamps, np.asarray(arrays["shift"], dtype=np.float64))


def _computed(camera: CameraSpec, psf: PsfSpec) -> dict[str, Floats | NDArray[np.float32]]:
    """Stamps of a camera's nodes, and the shift, as in a :class:`PsfTable`."""
    bands = BAND_COUNT if psf.diffraction is not None or psf.lateral_chromatic_px else 1
    edges = np.linspace(GRID_START_NM, GRID_STOP_NM, bands + 1)
    middles = (edges[1:] + edges[:-1]) / 2
    by_gaussians = psf.field_gaussian is not None and bands == 1 and psf.stack is None
    nodes = (FINE_FIELD_NODES if by_gaussians else FIELD_NODES) if psf.varies else 1
    projection, corner = camera.projection, camera.corner_px
    u = np.linspace(-0.5, camera.width - 0.5, nodes) if nodes > 1 else np.array([projection.cx_px])
    v = np.linspace(-0.5, camera.height - 0.5, nodes) if nodes > 1 else np.array([projection.cy_px])
    size = (2 * psf.support_px + 1) * FINE_PER_PX + 1
    stamps = np.zeros((bands, nodes, nodes, size, size), np.float32)
    for band, wavelength in enumerate(middles):
        for row in range(nodes):
            for column in range(nodes):
                field = complex(u[column] - projection.cx_px, v[row] - projection.cy_px) / corner
                off_axis_deg = 0.0
                if psf.field_gaussian is not None:
                    off_axis_deg = projection.axis_angle_deg(corner * abs(field) / projection.f_px)
                stamps[band, row, column] = pixel_psf(psf, wavelength, field, camera.pixel_pitch_um, off_axis_deg)
    return {"stamps": stamps, "shift": psf.lateral_chromatic_px * (middles - REFERENCE_NM) / CHROMATIC_SPAN_NM}


def _between_nodes(stamps: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Insert the mean of every two neighbours along an axis."""
    lower, upper = (np.take(stamps, range(first, first + stamps.shape[axis] - 1), axis) for first in (0, 1))
    shape = list(stamps.shape)
    shape[axis] = 2 * shape[axis] - 1
    result = np.empty(shape, np.float32)
    known, between = [slice(None)] * axis + [slice(0, None, 2)], [slice(None)] * axis + [slice(1, None, 2)]
    result[tuple(known)], result[tuple(between)] = stamps, 0.5 * (lower + upper)
    return result


def equivalent_sigma_px(camera: CameraSpec) -> float:
    """Standard deviation, px, of the Gaussian with the noise-equivalent area of the point spread function, on axis.

    The noise-equivalent area 1 / sum(p^2) of a Gaussian is 4 pi (sigma^2 + 1/12), the pixel included (King 1983, PASP 95,
    163).
    """
    return camera.psf_sigma_px if camera.psf is None else _equivalent_sigma_px(camera.resting)


@functools.lru_cache(maxsize=64)
def _equivalent_sigma_px(camera: CameraSpec) -> float:
    table = psf_table(camera)
    nodes = table.stamps.shape[1]
    stamp = table.stamps[len(table.stamps) // 2, nodes // 2, nodes // 2].astype(np.float64)
    area = stamp.sum() ** 2 / (stamp**2).sum() / FINE_PER_PX**2
    return float(np.sqrt(max(area / (4 * np.pi) - 1 / 12, 0.04)))


def pixel_psf(
    psf: PsfSpec, wavelength_nm: float, field: complex, pixel_pitch_um: float | None, off_axis_deg: float = 0.0
) -> Floats:
    """Pixel-integrated point spread function.

    Parameters
    ----------
    psf : PsfSpec
    wavelength_nm : float
    field : complex
        Field position: u + iv from the principal point, divided by the corner's distance.
    pixel_pitch_um : float or None
        Pixel pitch, required for diffraction.
    off_axis_deg : float
        Angle from the axis, for a Gaussian that depends on it.

    Returns
    -------
    (n, n) array
        Fraction of the light on a pixel whose centre is (column, row) / FINE_PER_PX - support_px - 0.5 px from the star.
    """
    size_px = _period_px(psf)
    frequency: Floats = np.fft.fftfreq(size_px * FINE_PER_PX, 1 / FINE_PER_PX).astype(np.float64)
    fu, fv = np.meshgrid(frequency, frequency)
    f = np.hypot(fu, fv)
    transfer = _pixel_transfer(psf.pixel, fu, fv) * np.exp(-2 * (np.pi * psf.gaussian_sigma_px * f) ** 2) + 0j
    if psf.field_gaussian is not None:
        transfer *= _field_gaussian_transfer(psf.field_gaussian, off_axis_deg, field, fu, fv)
    if psf.defocus_disk_px:
        argument = np.pi * psf.defocus_disk_px * f
        transfer *= np.where(argument > 1e-9, 2 * special.j1(argument) / np.maximum(argument, 1e-9), 1)
    if psf.moffat is not None:
        transfer *= _moffat_transfer(psf.moffat, f)
    if psf.diffraction is not None and pixel_pitch_um is not None:
        transfer *= pupil_transfer(psf.diffraction, wavelength_nm, field, pixel_pitch_um, frequency)
    if psf.stack is not None:
        transfer *= _stack_transfer(psf.stack, field, frequency)
    image = np.fft.fftshift(np.fft.ifft2(transfer).real) * FINE_PER_PX**2
    middle = len(frequency) // 2
    half = psf.support_px * FINE_PER_PX + FINE_PER_PX // 2
    # Ringing due to the band limit may leave values slightly below zero; a pixel receives no negative light.
    return np.maximum(image[middle - half : middle + half + 1, middle - half : middle + half + 1], 0)


def _period_px(psf: PsfSpec) -> int:
    """Period of the transform: light beyond half of it returns, which Moffat's wings of small beta need room for."""
    half = psf.support_px + MARGIN_PX + 1
    if psf.moffat is not None:
        core = psf.moffat.core_radius_px
        # The light beyond, spread evenly over the period, as far as it falls on the support.
        while (1 + (half / core) ** 2) ** (1 - psf.moffat.beta) * (psf.support_px / half) ** 2 > 1e-3:
            if 2 * half > FARTHEST_PX:
                break
            half *= 2
    return 2 * half


def _pixel_transfer(pixel: PixelSpec | None, fu: Floats, fv: Floats) -> Floats:
    """Transfer function of a pixel's response."""
    if pixel is None:
        return np.sinc(fu) * np.sinc(fv)
    blur = np.exp(-2 * (np.pi * pixel.diffusion_sigma_px) ** 2 * (fu**2 + fv**2))
    return np.sinc(pixel.sensitive_width * fu) * np.sinc(pixel.sensitive_height * fv) * blur


def _field_gaussian_transfer(
    gaussian: FieldGaussianSpec, off_axis_deg: float, field: complex, fu: Floats, fv: Floats
) -> Floats:
    """Transfer function of a Gaussian with its own widths along and across the direction of the field's radius."""
    radial, tangential = gaussian.sigmas_px(off_axis_deg)
    outward = field / abs(field) if abs(field) > 1e-9 else 1.0 + 0j
    along, across = fu * outward.real + fv * outward.imag, fv * outward.real - fu * outward.imag
    return np.exp(-2 * np.pi**2 * ((radial * along) ** 2 + (tangential * across) ** 2))


def _moffat_transfer(moffat: MoffatSpec, f: Floats) -> Floats:
    """Moffat's transfer function: 2/Gamma(b-1) (pi a f)^(b-1) K_(b-1)(2 pi a f), its Hankel transform in closed form.

    Gradshteyn & Ryzhik, 6.565.4.
    """
    x = 2 * np.pi * moffat.core_radius_px * np.maximum(f, 1e-6)
    order = moffat.beta - 1
    value = 2 / special.gamma(order) * (x / 2) ** order * special.kv(order, x)
    return np.where(f > 1e-6, value, 1.0)


def _stack_transfer(stack: PsfStackSpec, field: complex, frequency: Floats) -> NDArray[np.complex128]:
    """Transfer function of a user's stack at a field position: interpolated between neighbours and rotated with the field."""
    images = read_stack(stack.file, stack.oversampling)
    place = min(abs(field), 1.0) * (len(images) - 1)
    lower = min(int(place), max(len(images) - 2, 0))
    upper = min(lower + 1, len(images) - 1)
    image = (1 - (place - lower)) * images[lower] + (place - lower) * images[upper]
    # Rotated so that the stack's +u axis points away from the principal point.
    angle = float(np.angle(field))
    middle = (np.array(image.shape) - 1) / 2
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if abs(field) > 1e-6 and len(images) > 1:
        image = ndimage.affine_transform(image, turn, middle - turn @ middle, order=3)
    image = np.maximum(image, 0)
    image = image / image.sum()
    rows = (np.arange(image.shape[0]) - middle[0]) / stack.oversampling
    columns = (np.arange(image.shape[1]) - middle[1]) / stack.oversampling
    down = np.exp(-2j * np.pi * np.outer(frequency, rows))
    across = np.exp(-2j * np.pi * np.outer(columns, frequency))
    # Samples represent the band-limited function through them: their spectrum repeats beyond this frequency.
    beyond = np.abs(frequency) >= stack.oversampling / 2
    down[beyond], across[:, beyond] = 0, 0
    return down @ image @ across
