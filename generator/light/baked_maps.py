"""Read, check and interpolate the maps of ``skybench bake``."""

from __future__ import annotations

import functools
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, RegularGridInterpolator

from generator.errors import DataFileError
from generator.light.atmosphere import Atmosphere, aerosol_optical_depth, rayleigh_optical_depth
from generator.light.bake_grids import WAVELENGTHS_NM, BakedAir, CityGrid, GroundGrid, MoonGrid, content_hash
from generator.light.single_scattering import moon_single

Floats = NDArray[np.float64]
FOLDER = Path(__file__).parents[1] / "data" / "baked"
MOON_FILE, CITY_FILE, GROUND_FILE = (FOLDER / f"{name}.npz" for name in ("moonlight", "city_kernel", "ground"))

_SEARCHED_NM: Floats = np.geomspace(1000.0, 340.0, 500)


def read(path: Path, key: str, part: str = "values") -> Floats:
    """Read an array of a map ('values', 'relative_error', 'walked'), and refuse a map computed from other inputs.

    Raises
    ------
    DataFileError
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            found, values = str(stored["key"]), stored[part]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as problem:
        raise DataFileError(f"{path}: not a baked map ({problem}); run `skybench bake`") from problem
    if found != key:
        raise DataFileError(f"{path}: baked from other inputs (key {found[:12]}, not {key[:12]}); run `skybench bake`")
    return values.astype(np.float64)


def moon_map(part: str = "values") -> Floats:
    """All moonlight divided by closed-form single scattering; axes aerosol, wavelength, view, Moon, azimuth of MoonGrid.

    The part 'relative_error' is the Monte Carlo standard error of the light; 'walked' is the result of the random walks.
    """
    return read(MOON_FILE, content_hash(BakedAir(), MoonGrid()), part)


def city_map(part: str = "values") -> Floats:
    """Multiply scattered light of a lamp, km^-2 sr^-1 per unit output.

    Axes: pattern, and aerosol, wavelength, view, edges of the rings and of their parts of CityGrid. The part
    'relative_error' is the Monte Carlo standard error of these values after the fit; 'walked' and 'walked_error' are the
    random walks' means over the cells and their errors.
    """
    return read(CITY_FILE, content_hash(BakedAir(), CityGrid()), part)


def ground_map(part: str = "values") -> Floats:
    """Light that the ground reflects once, for a ground that absorbs nothing.

    The part 'values' is the light of a lamp at the edges of CityGrid's rings, mean over azimuth, km^-2 sr^-1 per unit
    output; axes pattern, aerosol, wavelength, view, ring. 'glow' is the radiance above an infinite ground that emits
    light of 1, sr^-1; axes aerosol, wavelength, view. 'walked' and 'walked_error' are the results of the random walks.
    """
    return read(GROUND_FILE, content_hash(BakedAir(), GroundGrid()), part)


@functools.cache
def _log_moon() -> tuple[RegularGridInterpolator, CubicSpline]:
    """Interpolator of the logarithm of multiply scattered moonlight divided by the measure of :func:`moon_multiple`.

    It is interpolated in the logarithms of aerosol depth and wavelength, and as a cubic in the Moon's altitude: returns a
    function of the first two with the values at the Moon's altitudes, and the cubic's weights.
    """
    grid, air = MoonGrid(), BakedAir()
    wavelength = np.array(grid.wavelength_nm)
    rayleigh = rayleigh_optical_depth(wavelength, air.pressure_hpa)[:, None, None]
    aerosol = np.array([aerosol_optical_depth(wavelength, tau, air.angstrom_exponent) for tau in grid.aerosol_tau_550])
    to_moon, view = (1 / np.sin(np.radians(at)) for at in (grid.moon_altitude_deg, grid.view_altitude_deg))
    measure = moon_single(rayleigh, aerosol[..., None, None], to_moon, view[:, None], 0.0, air)
    light = np.log(moon_map("walked") / measure[..., None])
    by_air = RegularGridInterpolator((np.log(grid.aerosol_tau_550), np.log(wavelength)), light)
    moon = np.log(grid.moon_altitude_deg)
    return by_air, CubicSpline(moon, np.eye(len(moon)), bc_type="natural")


@functools.cache
def _log_city() -> CubicSpline:
    return CubicSpline(np.log(WAVELENGTHS_NM), np.log(np.moveaxis(city_map(), (2, 1), (0, 1))), axis=0)


def baked_equivalent(wavelength_nm: Floats, atmosphere: Atmosphere) -> tuple[Floats, Floats]:
    """Wavelength and aerosol depth at 550 nm at which the bake's air scatters as another air at `wavelength_nm`.

    At one wavelength, only optical depths matter, so thinner air is equivalent to a longer wavelength.

    Returns
    -------
    wavelength_nm, aerosol_tau_550 : (n,) arrays
    """
    air = BakedAir()
    wanted = rayleigh_optical_depth(wavelength_nm, max(atmosphere.pressure_hpa, 1.0))
    baked = rayleigh_optical_depth(_SEARCHED_NM, air.pressure_hpa)
    same = np.exp(np.interp(np.log(wanted), np.log(baked), np.log(_SEARCHED_NM)))
    aerosol = aerosol_optical_depth(wavelength_nm, atmosphere.aerosol_tau_550, atmosphere.angstrom_exponent)
    return same, aerosol / aerosol_optical_depth(same, 1.0, air.angstrom_exponent)


def moon_multiple(
    atmosphere: Atmosphere, moon_altitude_deg: float, altitude_deg: Floats, azimuth_deg: Floats
) -> Floats:
    """Multiply scattered moonlight, (w, m, k) array for wavelengths x view altitudes x azimuths from the Moon.

    Its unit is closed-form single scattering at right angles (:func:`generator.light.single_scattering.moon_single`).
    Without single scattering, whose aureole is narrower than the grid, it is smooth: its logarithm is a cubic between the
    grid's altitudes and azimuths. Outside the grid the nearest value is used (aerosol depths beyond 0.03 to 0.3, Moon
    below 3 deg, lines of sight below 2 deg).
    """
    grid = MoonGrid()
    wavelength, tau = baked_equivalent(np.array(WAVELENGTHS_NM), atmosphere)
    wavelength = np.clip(wavelength, grid.wavelength_nm[0], grid.wavelength_nm[-1])
    tau = np.clip(tau, grid.aerosol_tau_550[0], grid.aerosol_tau_550[-1])
    by_air, by_moon = _log_moon()
    moon = by_moon(np.log(np.clip(moon_altitude_deg, grid.moon_altitude_deg[0], grid.moon_altitude_deg[-1])))
    light = np.einsum("wvma,m->wva", by_air(np.stack([np.log(tau), np.log(wavelength)], axis=-1)), moon)
    view = np.log(np.clip(altitude_deg, grid.view_altitude_deg[0], 90.0))
    relative = np.abs((azimuth_deg + 180) % 360 - 180)
    down = CubicSpline(np.log(grid.view_altitude_deg), light, axis=1, bc_type="natural")(view)
    # The light is the same on both sides of the Moon.
    return np.exp(CubicSpline(grid.relative_azimuth_deg, down, axis=2, bc_type="clamped")(relative))


def city_kernel(atmosphere: Atmosphere) -> Floats:
    """Logarithm of the lamp's kernel (see :func:`city_map`) in an air, (pattern, wavelength, view, ring, part) array.

    It is a cubic in the logarithm of wavelength and a parabola in that of aerosol depth; aerosol depths beyond 0.03 to
    0.3 take the nearest value.
    """
    grid = CityGrid()
    node = np.log(grid.aerosol_tau_550)
    wavelength, tau = baked_equivalent(np.array(WAVELENGTHS_NM), atmosphere)
    at = np.clip(np.log(np.maximum(tau, 1e-9)), node[0], node[-1])
    parabola = np.array(
        [np.prod([(at - other) / (own - other) for other in node if other != own], axis=0) for own in node]
    )
    table = _log_city()(np.log(wavelength))
    return np.einsum("tw,wt...->w...", parabola, table).swapaxes(0, 1)


def city_multiple(kernel: Floats, distance_km: Floats, relative_azimuth_deg: Floats) -> Floats:
    """Multiply scattered light of lamps, km^-2 sr^-1 per unit output: linear between the kernel's nodes.

    Parameters
    ----------
    kernel : (patterns, w, views, rings, parts) array
        Kernel from :func:`city_kernel`.
    distance_km, relative_azimuth_deg : (m,) arrays
        Places of the lamps; the azimuth is relative to the line of sight.

    Returns
    -------
    (patterns, w, views, m) array
    """
    grid = CityGrid()
    along = grid.scale(np.minimum(distance_km, grid.farthest_km)) / grid.scale(grid.farthest_km) * grid.distances
    across = np.sqrt(np.abs((relative_azimuth_deg + 180) % 360 - 180) / 180) * grid.azimuths
    ring, part = (
        np.minimum(at.astype(np.intp), last - 1) for at, last in ((along, grid.distances), (across, grid.azimuths))
    )
    a, b = along - ring, across - part
    near = kernel[..., ring, part] * (1 - b) + kernel[..., ring, part + 1] * b
    far = kernel[..., ring + 1, part] * (1 - b) + kernel[..., ring + 1, part + 1] * b
    return np.exp(near * (1 - a) + far * a)
