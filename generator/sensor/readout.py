"""Effects between charge and DN: offsets, read noise and its tail, row and column noise, quantisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from generator.sensor.draws import fixed_normal, standard_normal
from generator.sensor.effect import Exposure, Floats
from generator.sensor.sparse import rare_pixels


@dataclass(frozen=True)
class FixedOffset:
    """Fixed offset of every pixel (EMVA 1288's DSNU), normal."""

    sigma_e: float

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add the offsets."""
        return signal + self.sigma_e * fixed_normal(signal.shape, exposure.unit("dsnu"))


@dataclass(frozen=True)
class FixedLines:
    """Fixed offsets shared by a row, and by a column: parts of DSNU as separated by EMVA 1288 release 4.0."""

    row_e: float
    column_e: float

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add the offsets."""
        height, width = signal.shape[-2:]
        if self.row_e:
            signal = signal + self.row_e * fixed_normal((height, 1), exposure.unit("dsnu.row"))
        if self.column_e:
            signal = signal + self.column_e * fixed_normal((1, width), exposure.unit("dsnu.column"))
        return signal


@dataclass(frozen=True)
class Interference:
    """A sinusoidal voltage picked up by the readout, with a different phase in every frame.

    With readout row by row at a constant rate, a sine in time is a plane wave over the frame: a pair of peaks in its
    spectrum, which EMVA 1288 searches for in the spectrogram of dark frames.

    Attributes
    ----------
    cycles_per_column, cycles_per_row : float
        Cycles from one pixel to the next along u, and from one row to the next: the frequency divided by the pixel rate,
        and the frequency times the line time without whole cycles.
    amplitude_e : float
    number : int
        Index in the scenario's list.
    """

    cycles_per_column: float
    cycles_per_row: float
    amplitude_e: float
    number: int

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add the wave."""
        height, width = signal.shape[-2:]
        start = exposure.frame(f"interference.{self.number}").uniform(0, 2 * np.pi)
        along = 2 * np.pi * self.cycles_per_column * np.arange(width)
        down = 2 * np.pi * self.cycles_per_row * np.arange(height)[:, None] + start
        # cos(a + b) from sines and cosines of only rows and columns.
        cosine, sine = (self.amplitude_e * turn(down).astype(np.float32) for turn in (np.cos, np.sin))
        return signal + cosine * np.cos(along).astype(np.float32) - sine * np.sin(along).astype(np.float32)


@dataclass(frozen=True)
class ReadNoise:
    """Normal noise of the pixel amplifiers (EMVA 1288 release 4.0, section 2.3)."""

    sigma_e: float

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add the noise."""
        return signal + self.sigma_e * standard_normal(signal.shape, exposure.frame("read"))


@dataclass(frozen=True)
class TelegraphNoise:
    """Random telegraph noise, the read noise's tail: correlated double sampling sees a trap empty, fill, or neither.

    A pixel with a trap reads -a, 0 or +a with probabilities 1/4, 1/2, 1/4 (Wang et al. 2006, IEDM, "Random telegraph
    signal in CMOS image sensor pixels": three peaks). The pixels with traps, and their exponentially distributed a, are
    fixed.
    """

    fraction: float
    amplitude_e: float

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add the jumps."""
        unit = exposure.unit("telegraph")
        places = rare_pixels(unit, signal.size, self.fraction)
        amplitude = unit.standard_exponential(len(places)) * self.amplitude_e
        jump = exposure.frame("telegraph").integers(0, 2, (2, len(places))).sum(axis=0) - 1
        result = signal.copy()
        result.reshape(-1)[places] += (amplitude * jump).astype(np.float32)
        return result


@dataclass(frozen=True)
class LineNoise:
    """An offset shared by a row, and one by a column, different in every frame (EMVA 1288 release 4.0, section 8.1)."""

    row_e: float
    column_e: float

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add the offsets."""
        shape = signal.shape
        if self.row_e:
            signal = signal + self.row_e * standard_normal((*shape[:-1], 1), exposure.frame("row"))
        if self.column_e:
            signal = signal + self.column_e * standard_normal((*shape[:-2], 1, shape[-1]), exposure.frame("column"))
        return signal


@dataclass(frozen=True)
class Converter:
    """Conversion gain, black level and a quantiser that rounds and clips (EMVA 1288 release 4.0, section 2.4)."""

    gain_e_per_dn: float
    black_level_dn: int
    bits: int

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Return DN, integers from 0 to 2^bits - 1."""
        del exposure
        dn = signal * np.float32(1 / self.gain_e_per_dn)
        dn += np.float32(self.black_level_dn)
        return np.clip(np.rint(dn, out=dn), 0, 2**self.bits - 1, out=dn)
