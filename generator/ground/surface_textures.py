"""Maps of a landscape that do not depend on the light: computed once for a camera, kept on the device for all frames."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator import mitsuba_runtime
from generator.device_arrays import aligned_zeros
from generator.ground.lamp import KINDS, Lamp, spectrum
from generator.ground.lighting import lamp_illuminance, transmission
from generator.ground.panorama import Layers, Panorama, fitted_shape, reduced
from generator.ground.reflectance import primaries
from generator.ground.surface import REFLECTING, covered_cells, surface_maps
from generator.light.lamps import luminous

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Place = tuple[int, int, int, int]

TEXELS_PER_PX = 2.0
"""Resolution of the maps, along each axis, at the centre of the frame: two samples and a texel's own width make a pixel."""
MOST_TEXELS = 2**23
"""Largest landscape whose maps are kept for frames with other pointings, 270 MB; of larger ones only the part in view is
kept."""
SURROUNDINGS_DEG = 1.0
"""Step of the maps of the whole circle, for light from outside the frame."""
WINDOW_LIGHT = "LED"
"""Spectrum of a landscape's own glow, coloured by its picture."""


@dataclass(frozen=True)
class Ground:
    """Quantities on which the maps of a landscape depend.

    Attributes
    ----------
    panorama : Panorama
    texel_deg : float
        Step of the maps; the panorama's own if that is coarser.
    extinction_per_km : float
        Extinction of the air in front of it.
    lamps : tuple of Lamp
        Lamps that shine on it.
    plain : (eye height, distance)
        As for :func:`generator.ground.lighting.lamp_illuminance`.
    """

    panorama: Panorama
    texel_deg: float
    extinction_per_km: float
    lamps: tuple[Lamp, ...]
    plain: tuple[float, float]

    @property
    def is_large(self) -> bool:
        """Whether the maps of the whole circle take too much memory."""
        return math.prod(fitted_shape(self.panorama, self.texel_deg)) > MOST_TEXELS

    def layers(self, part: Place | None = None) -> Layers:
        """The panorama on the maps' grid, or a part of it."""
        whole = _fitted(self.panorama, self.texel_deg)
        return whole if part is None else whole.window(whole.part(part))


@functools.lru_cache(maxsize=2)
def _fitted(panorama: Panorama, texel_deg: float) -> Layers:
    return reduced(panorama, texel_deg)


@dataclass(frozen=True)
class Response:
    """A camera's response by channel at GRID_NM, as a key.

    Attributes
    ----------
    channels : int
    values : bytes
        Values in double precision.
    """

    channels: int
    values: bytes

    @classmethod
    def of(cls, response: Floats) -> Response:
        """Convert from a (channels, n) array."""
        return cls(len(response), np.ascontiguousarray(response, dtype=np.float64).tobytes())

    @property
    def array(self) -> Floats:
        """Convert to a (channels, n) array."""
        return np.frombuffer(self.values).reshape(self.channels, -1)


@dataclass(frozen=True, eq=False)
class Surface:
    """Maps on the device: texels with a margin of one around them, by row and column, with the planes of a texel adjacent.

    A texel is either upright or level, so one set of colours is enough. Its planes are alpha, negative (or -0) for level
    ones, red, green, blue, air, and its own light by channel.

    Attributes
    ----------
    values : TensorXf
        Values with one axis.
    cells : TensorXf
        Cells with one axis: :func:`generator.ground.surface.covered_cells` of alpha.
    planes : int
        Number of planes of a texel, a power of two.
    shines : bool
        Whether it emits any light.
    rows, columns : int
        Numbers of rows and columns without the margin.
    top_deg, bottom_deg : float
    first_column, whole_columns : int
        As for :class:`generator.ground.panorama.Layers`.
    """

    values: Any
    cells: Any
    planes: int
    shines: bool
    rows: int
    columns: int
    top_deg: float
    bottom_deg: float
    first_column: int
    whole_columns: int

    def at(self, altitude_deg: float, azimuth_deg: float) -> Singles:
        """Alpha, SURFACES, and own light of the texel around a direction."""
        row = int((self.top_deg - altitude_deg) / (self.top_deg - self.bottom_deg) * self.rows)
        whole = self.whole_columns or self.columns
        column = (int(azimuth_deg % 360 / 360 * whole) - self.first_column) % whole
        texels = np.array(self.values).reshape(self.rows + 2, self.columns + 2, self.planes)
        alpha, *colours, air = texels[row + 1, column + 1, :REFLECTING]
        upright, level = (colours, (0, 0, 0)) if not np.signbit(alpha) else ((0, 0, 0), colours)
        return np.array([abs(alpha), *upright, *level, air, *texels[row + 1, column + 1, REFLECTING:]], np.float32)


@functools.lru_cache(maxsize=2)
def surface(ground: Ground, part: Place | None, response: Response) -> Surface:
    """Maps of reflecting surfaces (:func:`generator.ground.surface.surface_maps`) and of emitted light, for a part or all."""
    layers = ground.layers(part)
    maps = surface_maps(layers, ground.extinction_per_km)
    shines = layers.glow is not None or bool(ground.lamps)
    planes = 1 << (REFLECTING + shines * response.channels - 1).bit_length()
    rows, columns = layers.alpha.shape
    texels = aligned_zeros((rows + 2, columns + 2, planes), np.float32)
    inner = np.moveaxis(texels[1:-1, 1:-1], -1, 0)
    inner[0] = np.where(layers.level, -maps[0], maps[0])
    inner[1:4] = np.where(layers.level, maps[4:7], maps[1:4])
    inner[4] = maps[7]
    if shines:
        passed = transmission(layers, ground.extinction_per_km)
        signal = own_light(layers, ground, response.array)
        inner[REFLECTING : REFLECTING + response.channels] = signal if passed is None else signal * passed
    # At the zenith and the nadir the grid ends, but not the landscape.
    if layers.top_deg >= 90:
        texels[0] = texels[1]
    if layers.bottom_deg <= -90:
        texels[-1] = texels[-2]
    before, after = (1, -2) if layers.whole_columns else (-2, 1)
    texels[:, 0], texels[:, -1] = texels[:, before], texels[:, after]
    place = (layers.top_deg, layers.bottom_deg, layers.first_column, layers.whole_columns)
    cells = covered_cells(layers.alpha, layers)
    tensor = mitsuba_runtime.start().TensorXf
    return Surface(
        tensor(texels.reshape(-1)),
        tensor(cells.reshape(-1).astype(np.float32)),
        planes,
        shines,
        rows,
        columns,
        *place,
    )


def own_light(layers: Layers, ground: Ground, response: Floats) -> Singles:
    """Light of windows and of lamps on a landscape, through the camera's response, (channels, ny, nx) array."""
    total = np.zeros((len(response), *layers.alpha.shape), np.float32)
    if layers.glow is not None:
        # cd/m^2 is lm m^-2 sr^-1, and the spectrum has a V-band mean of 1.
        white = spectrum(WINDOW_LIGHT) * ground.panorama.glow_cd_m2 / luminous(spectrum(WINDOW_LIGHT))
        total += _by_channel(layers.glow, white, response)
    for kind in KINDS:
        lamps = tuple(lamp for lamp in ground.lamps if lamp.kind == kind)
        if lamps:
            light = _by_channel(layers.reflectance, spectrum(kind) / (np.pi * luminous(spectrum(kind))), response)
            total += light * lamp_illuminance(layers, lamps, ground.plain)
    return total


def _by_channel(colours: Singles, white: Floats, response: Floats) -> Singles:
    """Signal of linear colours (ny, nx, 3) whose white has a spectrum, (channels, ny, nx) array."""
    terms = (response @ (primaries() * white).T).astype(np.float32)
    return np.moveaxis(colours @ terms.T, -1, 0)
