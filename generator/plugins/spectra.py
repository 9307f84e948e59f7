"""Tabulated spectra in Dr.Jit: linear interpolation on the generator's wavelength grid."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.light.photometry import GRID_NM, GRID_START_NM, GRID_STEP_NM, GRID_STOP_NM

SPECTRAL_RANGE_NM = GRID_STOP_NM - GRID_START_NM


class SpectralTable:
    """One or more spectra on GRID_NM; a fractional row interpolates between two neighbouring spectra.

    Parameters
    ----------
    table : TensorXf
        Shape (rows, len(GRID_NM)).
    """

    def __init__(self, table: Any) -> None:
        if len(table.shape) != 2 or table.shape[1] != len(GRID_NM):
            raise ValueError(f"a spectral table must have shape (rows, {len(GRID_NM)}), not {tuple(table.shape)}")
        self.rows = table.shape[0]
        self.values = mi.Float(table.array)

    def host(self) -> NDArray[np.float64]:
        """The table as a NumPy array."""
        return np.array(self.values, dtype=np.float64).reshape(self.rows, len(GRID_NM))

    def eval(self, row: Any, wavelengths: Any) -> Any:
        """Value of (fractional) row `row` (Float) at `wavelengths` (Spectrum, nm), zero outside the grid."""
        lower_row = dr.minimum(mi.UInt32(row), max(self.rows - 2, 0))
        upper_row = dr.minimum(lower_row + 1, self.rows - 1)
        row_weight = row - mi.Float(lower_row)
        position = (wavelengths - GRID_START_NM) / GRID_STEP_NM
        inside = (position >= 0) & (position <= len(GRID_NM) - 1)
        result = mi.Spectrum(0)
        for k in range(len(wavelengths)):
            lower = dr.clip(mi.UInt32(dr.maximum(position[k], 0)), 0, len(GRID_NM) - 2)
            weight = position[k] - mi.Float(lower)

            def blend(row: Any, lower: Any = lower, weight: Any = weight) -> Any:
                index = row * len(GRID_NM) + lower
                before, after = dr.gather(mi.Float, self.values, index), dr.gather(mi.Float, self.values, index + 1)
                return dr.lerp(before, after, weight)

            result[k] = dr.select(inside[k], dr.lerp(blend(lower_row), blend(upper_row), row_weight), 0)
        return result

    def spectrum(self, wavelengths: Any) -> Any:
        """Value of the first row at `wavelengths` (Spectrum, nm)."""
        return self.eval(mi.Float(0), wavelengths)


class ColourTable:
    """Spectra on GRID_NM over two colours; fractional rows and columns interpolate between four neighbouring spectra.

    Parameters
    ----------
    table : TensorXf
        Shape (rows, columns, len(GRID_NM)).
    """

    def __init__(self, table: Any) -> None:
        if len(table.shape) != 3 or min(table.shape[:2]) < 2:
            raise ValueError(
                f"a table of colours must have shape (rows, columns, {len(GRID_NM)}), not {tuple(table.shape)}"
            )
        self.rows, self.columns = table.shape[:2]
        self.spectra = SpectralTable(mi.TensorXf(table.array, (self.rows * self.columns, table.shape[2])))

    def host(self) -> NDArray[np.float64]:
        """The table as a NumPy array."""
        return self.spectra.host().reshape(self.rows, self.columns, len(GRID_NM))

    def eval(self, row: Any, column: Any, wavelengths: Any) -> Any:
        """Value at fractional row and column (Float) and `wavelengths` (Spectrum, nm), zero outside the grid."""
        upper = dr.minimum(mi.UInt32(row), self.rows - 2)
        left = dr.minimum(mi.UInt32(column), self.columns - 2)
        across = column - mi.Float(left)
        first, second = (
            self.spectra.eval(mi.Float((upper + below) * self.columns + left) + across, wavelengths) for below in (0, 1)
        )
        return dr.lerp(first, second, row - mi.Float(upper))


def stratified_wavelengths(sample: Any) -> Any:
    """Wavelengths (Spectrum, nm) over the whole range from one uniform sample (Float); their density is 1/range."""
    return GRID_START_NM + SPECTRAL_RANGE_NM * mi.sample_shifted(mi.Float(sample))
