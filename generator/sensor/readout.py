"""What happens between charge and DN: offsets, read noise and its tail, row and column noise, quantisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from generator.sensor.draws import standard_normal
from generator.sensor.effect import Exposure, Floats


@dataclass(frozen=True)
class FixedOffset:
    """Fixed offset of every pixel (EMVA 1288's DSNU), normal."""

    sigma_e: float

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add the offsets."""
        return signal + self.sigma_e * standard_normal(signal.shape, exposure.unit("dsnu"))


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

    A pixel with a trap reads -a, 0 or +a with probabilities 1/4, 1/2, 1/4 (Wang et al. 2006, IEDM, "Random telegraph signal
    in CMOS image sensor pixels": three peaks); which pixels have one, and their exponentially distributed a, is fixed.
    """

    fraction: float
    amplitude_e: float

    def apply(self, signal: Floats, exposure: Exposure) -> Floats:
        """Add the jumps."""
        unit = exposure.unit("telegraph")
        trapped = unit.random(signal.shape) < self.fraction
        amplitude = unit.standard_exponential(signal.shape) * self.amplitude_e
        jump = exposure.frame("telegraph").integers(0, 2, (2, *signal.shape)).sum(axis=0) - 1
        return signal + (trapped * amplitude * jump).astype(np.float32)


@dataclass(frozen=True)
class LineNoise:
    """An offset shared by a row, and one shared by a column, new in every frame (EMVA 1288 release 4.0, section 8.1)."""

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
        """Return DN, whole numbers from 0 to 2^bits - 1."""
        del exposure
        dn = signal * np.float32(1 / self.gain_e_per_dn)
        dn += np.float32(self.black_level_dn)
        return np.clip(np.rint(dn, out=dn), 0, 2**self.bits - 1, out=dn)
