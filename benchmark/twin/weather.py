"""The weather of a twin: at most four numbers, fitted to the light of the sky and to the stars of the photograph.

The positions of gaps in a cloud are random. Of many patterns of one cloud, the one that best dims the individual stars as in
the photograph is chosen. Depth and cover are then fitted to the light of the cells at each altitude and to the dimming of
stars, both after sorting by size.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import expit

from benchmark.photographed.view import View

Floats = NDArray[np.float64]

RING_EDGES_DEG = (10, 14, 18, 24, 32, 42, 54, 70, 90)
SECTORS = 12
LEAST_PX = 60
"""Least number of sky pixels in a cell of altitude and azimuth that counts."""
SKY_SCATTER, STAR_SCATTER, ORDER_SCATTER = 0.10, 0.20, 0.05
"""Relative scatter of a cell and of a star about a correct twin (gradients of the night, variable stars, scintillation), and
of stars sorted by their light, whichever stars they are."""
MOST_EVALUATIONS = 15
STEP, OFFSET = 0.05, 10.0
"""Step of the derivatives, in the logarithm of a number, and offset of the logarithms, because SciPy's steps are relative."""
LIMITS = {
    "airglow_factor": (0.2, 3.0),
    "aerosol_tau_550": (0.01, 1.5),
    "cloud_tau": (0.005, 20.0),
    "cloud_cover": (0.3, 0.999),
    "city_factor": (0.3, 3.0),
}
START = {
    "airglow_factor": 0.8,
    "aerosol_tau_550": 0.06,
    "cloud_tau": 1.5,
    "cloud_cover": 0.8,
    "city_factor": 1.0,
}
CLOUDLESS = ("airglow_factor", "aerosol_tau_550", "city_factor")
CLOUDED = ("airglow_factor", "cloud_tau", "cloud_cover")
"""Numbers of a cloudy sky, in addition to the draw of its pattern; air and cities are the scene's."""
VEIL = {
    "altitude_km": 9.0,
    "outer_scale_km": 50.0,
    "spectral_slope": -11 / 3,
    "wind_m_s": 25.0,
    "star_aureoles": True,
}
"""A veil of high cloud. Its slope is that of columns through turbulence in three dimensions, whose power falls as k^(-11/3)
(Obukhov 1949, Corrsin 1951; Tatarski 1961, "Wave Propagation in a Turbulent Medium"), below the thickness of cirrus, 2.4 km
(Sassen & Campbell 2001, J. Atmos. Sci. 58, 481)."""
DECK = {"kind": "altocumulus", "thickness_km": 0.25, "star_aureoles": True}
"""A deck of droplets that hides every star; its texture ends at its thickness."""
CLOUDS = VEIL, DECK
DRAWS = 64
"""Number of patterns of each cloud that are tried: six bits, and so a number of the weather like depth and cover."""
MOST_HAZE = 0.4
"""Aerosol depth above which a cloudy sky is tried: except for dust storms and smoke, more is cloud."""
CLOUDY_MISFIT = 0.15
"""Typical deviation of a cell's logarithm without cloud, and half that of a star's, from which a cloudy sky is tried."""


@dataclass(frozen=True)
class Weather:
    """Values fitted to a photograph; None for a number that does not apply to the frame.

    Attributes
    ----------
    airglow_factor : float or None
        Airglow relative to its mean.
    aerosol_tau_550 : float or None
        Optical depth of aerosol.
    cloud_tau, cloud_cover : float or None
        For a layer of cloud: mean optical depth over the whole sky, and the fraction of the sky that it covers.
    cloud_draw : int or None
        Index of the pattern of `CLOUDS`, from 0 (:mod:`benchmark.twin.cloud_draw`).
    city_factor : float or None
        Light of the scene's cities relative to what the scene states.
    focus_factor : float or None
        Width of stars relative to that of the scene's camera (:mod:`benchmark.twin.focus`).
    """

    airglow_factor: float | None = None
    aerosol_tau_550: float | None = None
    cloud_tau: float | None = None
    cloud_cover: float | None = None
    cloud_draw: int | None = None
    city_factor: float | None = None
    focus_factor: float | None = None

    @property
    def cloudless(self) -> Weather:
        """The same weather without cloud."""
        return dataclasses.replace(self, cloud_tau=None, cloud_cover=None, cloud_draw=None)

    def over(self, tree: dict[str, Any]) -> dict[str, Any]:
        """A scenario's tree with this weather."""
        sky, air = dict(tree.get("sky") or {}), dict(tree.get("atmosphere") or {})
        if self.airglow_factor is not None:
            sky["airglow_factor"] = round(self.airglow_factor, 4)
        if self.aerosol_tau_550 is not None:
            air["aerosol_tau_550"] = round(self.aerosol_tau_550, 4)
        if self.cloud_tau is not None:
            kind, draw = divmod(self.cloud_draw or 0, DRAWS)
            sky["clouds"] = CLOUDS[kind] | {"mean_optical_depth": round(self.cloud_tau, 4), "draw": draw}
            if self.cloud_cover is not None:
                sky["clouds"]["coverage"] = round(self.cloud_cover, 4)
        if self.city_factor is not None and sky.get("cities"):
            sky["cities"] = [
                city | {"upward_mlm": round(city.get("upward_mlm", 100.0) * self.city_factor, 4)}
                for city in sky["cities"]
            ]
        return tree | {"sky": sky, "atmosphere": air}


@dataclass(frozen=True, eq=False)
class Seen:
    """What a frame provides to the fit: medians of the sky in cells, and light of stars; NaN where unknown."""

    cells: Floats
    stars: Floats

    def in_order(self, known: Seen) -> Seen:
        """Sort the cells of each altitude, and the stars, by size, using those that are known in another frame."""
        return Seen(
            np.sort(np.where(np.isfinite(known.cells), self.cells, np.nan), axis=1),
            np.sort(np.where(np.isfinite(known.stars), self.stars, np.nan)),
        )


def sky_cells(light: NDArray[np.floating], view: View, sky: NDArray[np.bool_], least_px: int = LEAST_PX) -> Floats:
    """Medians of the light above the dark level in cells of altitude and azimuth, (8, 12); NaN without enough sky."""
    ring = np.digitize(view.altitude_deg, RING_EDGES_DEG) - 1
    sector = np.nan_to_num(view.azimuth_deg / 360 * SECTORS).astype(int) % SECTORS
    counted = sky & (ring >= 0) & (ring < len(RING_EDGES_DEG) - 1)
    cells = np.full((len(RING_EDGES_DEG) - 1, SECTORS), np.nan)
    number = ring[counted] * SECTORS + sector[counted]
    order = np.argsort(number, kind="stable")
    sorted_number, sorted_light = number[order], light[counted][order]
    for cell, part in zip(
        np.unique(sorted_number),
        np.split(sorted_light, np.flatnonzero(np.diff(sorted_number)) + 1),
        strict=True,
    ):
        if len(part) >= least_px:
            cells[divmod(int(cell), SECTORS)] = np.median(part)
    return cells


@dataclass(frozen=True)
class Fit:
    """A fitted weather.

    Attributes
    ----------
    weather : Weather
    typical_miss, star_miss : float
        Medians of the absolute deviations of the cells and of the stars, in the logarithm.
    misfit : float
        Combined mean of both; single stars vary twice as much as cells. Most stars of a clouded sky are seen neither in the
        photograph nor in the twin, so medians do not distinguish two skies.
    """

    weather: Weather
    typical_miss: float
    star_miss: float
    misfit: float

    @property
    def clouded(self) -> bool:
        """Whether no cloudless air fits the photograph."""
        haze = self.weather.aerosol_tau_550
        return max(self.typical_miss, self.star_miss / 2) > CLOUDY_MISFIT or (haze is not None and haze > MOST_HAZE)


def first_guess(names: tuple[str, ...]) -> Weather:
    """The weather with which a fit of these numbers starts."""
    given: dict[str, Any] = {name: START[name] for name in names}
    return Weather(**given)


def fit_weather(
    real: Seen, names: tuple[str, ...], twin: Callable[[Weather], Seen], known_before: Weather = Weather()
) -> Fit:
    """Find the weather whose twin has the photograph's sky and stars.

    Parameters
    ----------
    real : Seen
        What the photograph shows; in a fit with cloud, stars are relative to those of a sky without cloud.
    names : tuple of str
        Fields of `Weather` to fit, at most four.
    twin : function
        Maps a weather to what its twin shows, in the same cells and for the same stars.
    known_before : Weather
        Numbers that are not fitted here, and the starting values of the fit.
    """
    known_values = dataclasses.asdict(known_before)
    start = np.array([known_values[name] or START[name] for name in names])
    star_scatter = STAR_SCATTER
    if "cloud_cover" in names:
        star_scatter = ORDER_SCATTER
        known, shown = real, twin
        real = real.in_order(known)

        def twin(weather: Weather) -> Seen:
            return shown(weather).in_order(known)

    covers = np.array([name == "cloud_cover" for name in names])
    origin = _on_line(start, covers) - OFFSET
    low, high = (_on_line(np.array([LIMITS[name][side] for name in names]), covers) - origin for side in (0, 1))

    def weather_at(point: Floats) -> Weather:
        values = _off_line(np.clip(point, low, high) + origin, covers)
        return dataclasses.replace(known_before, **dict(zip(names, values.tolist(), strict=True)))

    def misses(point: Floats) -> Floats:
        made = twin(weather_at(point))
        parts = []
        for ours, theirs, scatter in (
            (made.cells, real.cells, SKY_SCATTER * np.sqrt(np.isfinite(real.cells).sum() / 20)),
            (made.stars, real.stars, star_scatter * np.sqrt(max(_seen(real.stars) / 20, 1))),
        ):
            miss = np.log(np.maximum(ours, 1e-3) / np.where(theirs > 0, theirs, np.nan)) / scatter
            parts.append(np.nan_to_num(miss.ravel()))
        return np.concatenate(parts)

    found = least_squares(
        misses,
        np.full(len(names), OFFSET),
        bounds=(low, high),
        loss="soft_l1",
        diff_step=np.full(len(names), STEP / OFFSET),
        ftol=1e-3,
        xtol=1e-4,
        max_nfev=MOST_EVALUATIONS,
    )
    weather = weather_at(found.x)
    made = twin(weather)
    cells, stars = _misses(made.cells, real.cells), _misses(made.stars, real.stars)
    return Fit(
        weather,
        float(np.median(np.abs(cells))),
        float(np.median(np.abs(stars))),
        float(np.mean(np.abs(cells)) + np.mean(np.abs(stars)) / 2),
    )


def _on_line(values: Floats, parts: NDArray[np.bool_]) -> Floats:
    """Logarithms; for fractions of a whole, those of their odds, since 0.98 and 0.995 are far apart."""
    return np.asarray(np.log(values) - np.log(np.where(parts, 1 - values, 1.0)))


def _off_line(places: Floats, parts: NDArray[np.bool_]) -> Floats:
    return np.asarray(np.where(parts, expit(places), np.exp(places)))


def _seen(stars: Floats) -> int:
    """Number of stars above the lowest value, which is that of stars that are not seen."""
    known = stars[np.isfinite(stars)]
    return int((known > known.min()).sum()) if len(known) else 0


def _misses(made: Floats, real: Floats) -> Floats:
    """Deviations of the logarithms where both are known; a single 0 where nothing is."""
    both = np.isfinite(made) & np.isfinite(real) & (made > 0) & (real > 0)
    return np.asarray(np.log(made[both] / real[both])) if both.any() else np.zeros(1)
