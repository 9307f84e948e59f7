"""The noise of an image, pixel by pixel: values of tiles, interpolated on demand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.strips import strips
from celnav.detecting.tiles import TileMap

F4 = NDArray[np.float32]

# Rounding error of interpolation in single precision, relative.
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class NoiseMap:
    """Standard deviation of each pixel.

    Attributes
    ----------
    white : TileMap
        Noise from the differences of neighbours.
    least : float
        Lower limit of the noise.
    ratio : TileMap or None
        Factor by which the image scatters more under a filter than white noise would; None stands for 1.
    """

    white: TileMap
    least: float
    ratio: TileMap | None = None

    def strip(self, top: int, bottom: int) -> F4:
        """Values of the rows from `top` to `bottom`, shape (bottom - top, width)."""
        noise = self.white.strip(top, bottom)
        np.maximum(noise, np.float32(self.least), out=noise)
        if self.ratio is not None:
            noise *= self.ratio.strip(top, bottom)
        return noise

    def exceeding(
        self, values: F4, times: float, zones: F4 | None = None, either_sign: bool = False
    ) -> tuple[NDArray[np.intp], F4]:
        """Find the pixels that exceed a number of standard deviations.

        Parameters
        ----------
        values : ndarray, shape (height, width)
            Values of the pixels.
        times : float
            Threshold in standard deviations.
        zones : ndarray, shape (height, width), optional
            Factor on the standard deviation of each pixel.
        either_sign : bool
            Whether to compare absolute values, so that pixels below zero count too.

        Returns
        -------
        at : ndarray of int, shape (n,)
            Flat indices of the pixels, in ascending order.
        limit : ndarray, shape (n,)
            The threshold that each pixel exceeds.
        """
        height, width = values.shape
        found = []
        pieces = list(strips(height, width))
        for (top, bottom), bound in zip(pieces, self._bounds(pieces) * np.float32(times), strict=True):
            strip, least = values[top:bottom], bound if zones is None else bound * zones[top:bottom]
            above = strip > least
            if either_sign:
                above |= strip < -least
            found.append(above.ravel().nonzero()[0] + top * width)
        at = np.concatenate(found)
        value, rows = values.ravel().take(at), at // width
        limit = self.at(rows, at - rows * width)
        limit *= np.float32(times)
        if zones is not None:
            limit *= zones.ravel().take(at)
        standing = ((np.abs(value) if either_sign else value) > limit).nonzero()[0]
        return at.take(standing), limit.take(standing)

    def _bounds(self, pieces: list[tuple[int, int]]) -> F4:
        """Return a lower bound of the values for each strip of rows and each column, shape (strips, width)."""
        bounds = np.maximum(self.white.least(pieces), np.float32(self.least))
        if self.ratio is not None:
            bounds *= self.ratio.least(pieces)
        bounds *= np.float32(1 - _ROUNDING)
        return bounds

    def at(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> F4:
        """Values of single pixels, shape (n,)."""
        noise = np.maximum(self.white.at(rows, columns), np.float32(self.least))
        return noise if self.ratio is None else np.asarray(noise * self.ratio.at(rows, columns))

    def mesh(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> F4:
        """Values where rows and columns cross, shape (rows, columns)."""
        noise = np.maximum(self.white.mesh(rows, columns), np.float32(self.least))
        return noise if self.ratio is None else np.asarray(noise * self.ratio.mesh(rows, columns))
