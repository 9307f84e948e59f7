"""A photograph's twin: the fitted values, the two images, and the measurements on both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.photographed.alignment import Alignment
from benchmark.twin.comparison import Measured
from benchmark.twin.photograph import Photograph
from benchmark.twin.weather import Weather
from generator.frame.render import RenderedFrame

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class VideoWeather:
    """The three fitted numbers of a stack.

    Attributes
    ----------
    zenith_mag_arcsec2 : float
        Brightness of the sky without Moon and twilight.
    gain_factor : float
        Grey values per electron relative to the scene's camera.
    black_level_dn : int
        DN of the sensor without light.
    gain_e_per_dn : float
        Gain of the scene's camera.
    """

    zenith_mag_arcsec2: float
    gain_factor: float
    black_level_dn: int
    gain_e_per_dn: float

    def over(self, tree: dict[str, Any]) -> dict[str, Any]:
        """A scenario's tree with these numbers."""
        sky = {key: value for key, value in (tree.get("sky") or {}).items() if key != "bortle"}
        sky["zenith_mag_arcsec2"] = round(self.zenith_mag_arcsec2, 4)
        gain = round(self.gain_e_per_dn / self.gain_factor, 6)
        sensor = {"gain_e_per_dn": gain, "black_level_dn": self.black_level_dn}
        return tree | {"sky": sky, "sensor": (tree.get("sensor") or {}) | sensor}


@dataclass(frozen=True, eq=False)
class StackRange:
    """What a stack contains besides its mean.

    Attributes
    ----------
    deviation : (3,) array
        10, 50 and 90 % quantiles of STDPIXEL over the sky, DN.
    above_mean : (3,) array
        The same quantiles of MAXPIXEL minus AVEPIXEL.
    """

    deviation: Floats
    above_mean: Floats


@dataclass(frozen=True, eq=False)
class Twin:
    """A photograph and its twin.

    Attributes
    ----------
    photograph : Photograph
    path : Path
        Path of the twin's scenario.
    alignment : Alignment
    weather : Weather or VideoWeather
    frame : RenderedFrame
        The twin with its truth.
    sky : (height, width) bool array
        Pixels that are compared.
    real, made : Measured
    moon_altitude_deg, sun_altitude_deg : float
    ranges : (StackRange, StackRange) or None
        For a stack of video: what else the photograph's and the twin's stacks contain.
    """

    photograph: Photograph
    path: Path
    alignment: Alignment
    weather: Weather | VideoWeather
    frame: RenderedFrame
    sky: NDArray[np.bool_]
    real: Measured
    made: Measured
    moon_altitude_deg: float
    sun_altitude_deg: float
    ranges: tuple[StackRange, StackRange] | None = None

    @property
    def pixels(self) -> NDArray[np.uint16]:
        """The twin, (height, width) DN."""
        return self.frame.dn
