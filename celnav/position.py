"""Position from identified stars: a coarse grid, then Levenberg-Marquardt with a robust loss.

The observed rays are converted to geometric ENU directions once (attitude, then Bennett's refraction, which needs the
apparent altitude that the camera measures). After that, the position enters through a rotation alone. Latitude and
longitude turn that rotation about two axes that are perpendicular everywhere, so the problem is well posed at the poles too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.attitude import Attitude, as_attitude
from celnav.camera import Camera
from celnav.checking import bounded, check_fields, finite_number
from celnav.detections import as_positions
from celnav.errors import AttitudeError, ConfigError, DetectionError
from celnav.fix import Fix, Reason
from celnav.sky.astrometry import TerrestrialStars, terrestrial_stars
from celnav.sky.catalog import load_catalog
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.planets import planet_ids
from celnav.sky.ray_integral import standard_pressure_hpa
from celnav.sky.refraction import unrefract
from celnav.sky.utc import Utc, parse_utc
from celnav.sky.wgs84 import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS_KM

F8 = NDArray[np.float64]


@dataclass(frozen=True)
class Weather:
    """Air at the observer, for refraction: pressure (hPa; 0: no refraction) and temperature (deg C)."""

    pressure_hpa: float = bounded(1010.0, 0, 1200)
    temperature_c: float = bounded(10.0, -100, 80)

    def __post_init__(self) -> None:
        check_fields(self)


def usual_weather(height_m: float, pressure_hpa: float | None = None, temperature_c: float | None = None) -> Weather:
    """Return the air at a height above sea level, m; values not given follow the standard atmosphere.

    They start from the 1010 hPa and 10 deg C of a default `Weather` at sea level; the temperature falls by 6.5 K/km up to
    11 km (U.S. Standard Atmosphere 1976).
    """
    height_m = finite_number(height_m, "height_m", ConfigError, -1000, 30000)
    sea = Weather()
    usual_hpa = sea.pressure_hpa * standard_pressure_hpa(height_m / 1000) / standard_pressure_hpa(0.0)
    usual_c = sea.temperature_c - 6.5e-3 * min(height_m, 11000.0)
    return Weather(
        usual_hpa if pressure_hpa is None else pressure_hpa, usual_c if temperature_c is None else temperature_c
    )


def refracting(weather: Weather, more: float) -> Weather:
    """Return air whose refraction differs by the fraction `more`: colder air if it is positive, thinner air if negative."""
    kelvin = (weather.temperature_c + 273.15) / (1 + max(more, 0.0))
    return Weather(weather.pressure_hpa * (1 + min(more, 0.0)), max(kelvin - 273.15, -100.0))


@dataclass(frozen=True)
class PositionConfig:
    """Configuration of the position estimate (the thesis, section 4.v and equation 3.10).

    Attributes
    ----------
    grid_step_deg : float
        Step of the coarse grid in latitude and longitude.
    grid_stars : int
        The grid search uses at most this many stars, chosen evenly.
    loss : str
        ``soft-l1``, ``huber``, ``cauchy`` or ``squares``. The thesis does not specify its robust loss.
    loss_scale_deg : float
        Error from which the loss grows more slowly than the square.
    weights : str
        ``angle``: the angular errors of all stars count alike, as in equation 3.10; ``pixel``: errors are measured in
        pixels, in which centroid noise is uniform.
    clip_sigma, clip_floor_px : float
        After a first estimate, stars that are off by more than this many robust standard deviations (and by more than the
        floor) are dropped, and the estimate is repeated; 0 keeps all.
    centroid_sigma_px : float or None
        Standard deviation of a centroid along each axis, for the covariance; None estimates it from the residuals.
    min_sigma_px : float
        Floor of that estimate, since a few stars can agree by chance.
    max_iterations : int
        Largest number of Levenberg-Marquardt iterations.
    """

    grid_step_deg: float = bounded(5.0, 0.5, 45)
    grid_stars: int = bounded(24, 1, 1000)
    loss: Literal["soft-l1", "huber", "cauchy", "squares"] = "soft-l1"
    loss_scale_deg: float = bounded(0.1, 1e-9, 180)
    weights: Literal["angle", "pixel"] = "angle"
    clip_sigma: float = bounded(5.0, 0)
    clip_floor_px: float = bounded(1.0, 0)
    centroid_sigma_px: float | None = bounded(None, 1e-6)
    min_sigma_px: float = bounded(0.01, 1e-6)
    max_iterations: int = bounded(50, 1, 10_000)

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class _Observed:
    """Observed stars: geometric ENU directions (n, 3), two tangents of each (n, 2, 3), and radians per pixel (n, 2, 2).

    `radians_per_px` maps a displacement in pixels onto the two tangents.
    """

    dirs: F8
    tangents: F8
    radians_per_px: F8


def fix_position(
    uv: ArrayLike,
    star_ids: ArrayLike,
    camera: Camera,
    utc: str | datetime | Utc,
    attitude: Attitude | ArrayLike,
    *,
    config: PositionConfig | None = None,
    weather: Weather | None = None,
    dut1_s: float | None = None,
) -> Fix:
    """Determine the position from identified stars.

    Parameters
    ----------
    uv : array_like, shape (n, 2)
        Pixel positions. Two or more stars give a unique position; a single star leaves two solutions, of which one is
        returned.
    star_ids : array_like of int, shape (n,)
        Hipparcos numbers, or minus the HR numbers of stars without one. The planets of `Fix.matches` are left out, because
        their directions are too coarse for a position.
    camera : Camera
        The camera.
    utc : str, datetime or Utc
        Time of mid-exposure.
    attitude : Attitude or 3x3 array_like
        Attitude with a heading (`Attitude.exact` or `Attitude.with_sigma`).
    config, weather : optional
        Configuration of the estimate, and the air for refraction.
    dut1_s : float, optional
        UT1-UTC in seconds; taken from the IERS table unless given.

    Returns
    -------
    Fix
        The position; `matches` holds the stars that were used.

    Raises
    ------
    CelnavError
        For malformed input or a star id that is not in the catalogue.
    """
    config = PositionConfig() if config is None else config
    weather = Weather() if weather is None else weather
    positions = as_positions(uv)
    camera.check_positions(positions)
    ids = _whole_numbers(star_ids, len(positions))
    stellar = np.flatnonzero(~np.isin(ids, planet_ids()))
    positions, ids = positions[stellar], ids[stellar]
    if len(positions) == 0:
        return Fix.refusal(Reason.TOO_FEW_DETECTIONS, "no star")
    known = as_attitude(attitude)
    if known is None or known.kind != "rotation":
        raise AttitudeError("a position needs the whole attitude: give R_cam")
    instant = parse_utc(utc)
    catalog = load_catalog()
    stars = terrestrial_stars(catalog.take(catalog.rows_of(ids)), instant, earth_orientation(instant, dut1_s))
    observed = _observe(positions, camera, known, weather)

    keep = np.arange(len(positions))
    solution = _solve(observed, stars, config)
    if config.clip_sigma > 0 and len(positions) > 2 and solution is not None:
        error_px = _errors_px(solution, observed, stars)
        limit = max(config.clip_floor_px, config.clip_sigma * 1.4826 * float(np.median(error_px)) / 1.1774)
        keep = np.flatnonzero(error_px <= limit)
        if len(keep) < len(positions):
            observed, stars = _take(observed, keep), TerrestrialStars(stars.dirs[keep])
            solution = _solve(observed, stars, config, start=solution)
    if solution is None:
        return Fix.refusal(Reason.NOT_CONVERGED, "the position estimate did not converge")
    lat_deg, lon_deg = solution
    error_px = _errors_px(solution, observed, stars)
    return Fix(
        ok=True,
        reason=Reason.OK,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        cov_km2=_covariance(solution, observed, stars, known, config),
        confidence=1.0,
        matches=np.column_stack((stellar[keep], ids[keep])).astype(np.int64),
        residual_rms_px=float(np.sqrt(np.mean(error_px**2))),
    )


def _whole_numbers(star_ids: ArrayLike, n: int) -> NDArray[np.int64]:
    try:
        ids = np.asarray(star_ids)
    except ValueError:  # rows of different lengths
        ids = np.empty(0)
    if ids.shape != (n,) or (n and not np.issubdtype(ids.dtype, np.integer)):
        raise DetectionError(f"star_ids must be {n} whole numbers, one per position")
    return ids.astype(np.int64)


def _observe(positions: F8, camera: Camera, attitude: Attitude, weather: Weather) -> _Observed:
    """Convert pixel positions to geometric ENU directions, with the local plate scale of the camera."""
    R_cam = attitude.R_cam
    rays = camera.to_rays(positions)
    dirs = unrefract(rays @ R_cam, weather.pressure_hpa, weather.temperature_c)
    # Tangents along which the ray moves with u and v; the compression by refraction (below 1 %) is neglected.
    step = np.stack(
        [camera.to_rays(positions + 0.5 * axis) - camera.to_rays(positions - 0.5 * axis) for axis in np.eye(2)]
    )
    moves = np.swapaxes(step @ R_cam, 0, 1)
    first = moves[:, 0] - np.sum(moves[:, 0] * dirs, axis=1, keepdims=True) * dirs
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    tangents = np.stack((first, np.cross(dirs, first)), axis=1)
    return _Observed(dirs, tangents, np.einsum("nij,nkj->nik", tangents, moves))


def _take(observed: _Observed, rows: NDArray[np.intp]) -> _Observed:
    return _Observed(observed.dirs[rows], observed.tangents[rows], observed.radians_per_px[rows])


def _errors_px(solution: tuple[float, float], observed: _Observed, stars: TerrestrialStars) -> F8:
    """Distances between observed and predicted stars, pixels, shape (n,)."""
    along = np.einsum("nij,nj->ni", observed.tangents, stars.enu(*solution) - observed.dirs)
    return np.asarray(np.linalg.norm(np.linalg.solve(observed.radians_per_px, along[:, :, None])[:, :, 0], axis=1))


def _residuals(
    solution: tuple[float, float], observed: _Observed, stars: TerrestrialStars, config: PositionConfig
) -> tuple[F8, F8]:
    """Residuals, shape (n, 2), and their derivatives by latitude and longitude in radians, shape (n, 2, 2)."""
    predicted = stars.enu(*solution)
    lat = math.radians(solution[0])
    # Moving north rotates the sky about the east axis; moving east rotates it about the Earth's axis.
    d_lat = np.column_stack((np.zeros(len(predicted)), -predicted[:, 2], predicted[:, 1]))
    axis = np.array([0.0, math.cos(lat), math.sin(lat)])
    d_lon = np.cross(predicted, axis)
    residual = np.einsum("nij,nj->ni", observed.tangents, predicted - observed.dirs)
    # For far-off predictions the projected chord is short by cos(angle); there only its direction matters.
    jacobian = np.stack(
        [np.einsum("nij,nj->ni", observed.tangents, derivative) for derivative in (d_lat, d_lon)], axis=2
    )
    if config.weights == "pixel":
        to_px = np.linalg.inv(observed.radians_per_px)
        # Scaled back to radians at the centre of the field, so that the loss scale keeps its meaning.
        scale = 1.0 / np.abs(np.linalg.det(to_px)).min() ** 0.5
        residual = np.einsum("nij,nj->ni", to_px, residual) * scale
        jacobian = to_px @ jacobian * scale
    return residual, jacobian


def robust_loss(squares: F8, config: PositionConfig) -> tuple[F8, F8]:
    """Loss of squared residuals, and its derivative by the square, which is the weight of iterative reweighting.

    Parameters
    ----------
    squares : ndarray, shape (n,)
        Squared residuals, rad^2.
    config : PositionConfig
        Selects the loss and its scale.

    References
    ----------
    B. Triggs et al., "Bundle Adjustment - A Modern Synthesis", 2000, section 3.3; the names follow SciPy's
    ``least_squares``.
    """
    scale = math.radians(config.loss_scale_deg) ** 2
    z = squares / scale
    if config.loss == "squares":
        return squares, np.ones_like(squares)
    if config.loss == "cauchy":
        return scale * np.log1p(z), 1.0 / (1.0 + z)
    if config.loss == "huber":
        root = np.sqrt(np.maximum(z, 1.0))
        return scale * np.where(z <= 1, z, 2 * root - 1), 1.0 / root
    root = np.sqrt(1.0 + z)
    return 2 * scale * (root - 1.0), 1.0 / root


def _solve(
    observed: _Observed, stars: TerrestrialStars, config: PositionConfig, start: tuple[float, float] | None = None
) -> tuple[float, float] | None:
    """Return the latitude and longitude, degrees, that minimise the mean robust loss; None without convergence."""
    lat, lon = _grid_minimum(observed, stars, config) if start is None else start

    def loss(residual: F8) -> F8:
        return robust_loss(np.sum(residual**2, axis=1), config)[0]

    damping = 1e-3
    residual, jacobian = _residuals((lat, lon), observed, stars, config)
    cost = float(loss(residual).sum())
    for _ in range(config.max_iterations):
        weight = robust_loss(np.sum(residual**2, axis=1), config)[1]
        normal = np.einsum("n,nij,nik->jk", weight, jacobian, jacobian)
        gradient = np.einsum("n,nij,ni->j", weight, jacobian, residual)
        try:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -gradient)
        except np.linalg.LinAlgError:
            return None
        trial = _normalise(lat + math.degrees(step[0]), lon + math.degrees(step[1]))
        trial_residual, trial_jacobian = _residuals(trial, observed, stars, config)
        trial_cost = float(loss(trial_residual).sum())
        if trial_cost <= cost:
            (lat, lon), residual, jacobian, cost = trial, trial_residual, trial_jacobian, trial_cost
            damping = max(damping / 10, 1e-12)
        else:
            damping *= 10
        if float(np.abs(step).max()) < 1e-11:  # 0.06 mm on the ground
            return lat, lon
    # Steps that shrink to rounding errors while the damping grows also mean convergence; a large last step does not.
    return (lat, lon) if float(np.abs(step).max()) < 1e-8 else None


def _normalise(lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """Bring a position that went over a pole or around the Earth back into the usual ranges."""
    lat = math.remainder(lat_deg, 360.0)
    if abs(lat) > 90:
        lat, lon_deg = math.copysign(180.0, lat) - lat, lon_deg + 180.0
    return lat, math.remainder(lon_deg, 360.0)


def _grid_minimum(observed: _Observed, stars: TerrestrialStars, config: PositionConfig) -> tuple[float, float]:
    """Return the node of the coarse grid with the smallest mean robust angular error."""
    n = len(observed.dirs)
    rows = np.unique(np.linspace(0, n - 1, min(n, config.grid_stars)).astype(np.intp))
    lat = np.radians(np.arange(-90 + config.grid_step_deg / 2, 90, config.grid_step_deg))[:, None, None]
    lon = np.radians(np.arange(-180 + config.grid_step_deg / 2, 180, config.grid_step_deg))[None, :, None]
    x, y, z = stars.dirs[rows].T
    e, u_, v = observed.dirs[rows].T
    toward = np.cos(lon) * x + np.sin(lon) * y  # component along the meridian's direction in the equator's plane
    east = np.cos(lon) * y - np.sin(lon) * x
    north = np.cos(lat) * z - np.sin(lat) * toward
    up = np.cos(lat) * toward + np.sin(lat) * z
    cosine = np.clip(east * e + north * u_ + up * v, -1, 1)
    # For the grid the loss is the angle itself, which is the soft-L1 loss far beyond its scale.
    mean_angle = np.arccos(cosine).mean(axis=2)
    i, j = np.unravel_index(int(np.argmin(mean_angle)), mean_angle.shape)
    return float(np.degrees(lat[i, 0, 0])), float(np.degrees(lon[0, j, 0]))


def _covariance(
    solution: tuple[float, float],
    observed: _Observed,
    stars: TerrestrialStars,
    attitude: Attitude,
    config: PositionConfig,
) -> F8 | None:
    """Covariance of the position, east-north, km^2; None if a single star leaves no residual to estimate it from."""
    n = len(observed.dirs)
    if config.centroid_sigma_px is not None:
        sigma_px = config.centroid_sigma_px
    elif n < 2:
        return None
    else:
        squares = float(np.sum(_errors_px(solution, observed, stars) ** 2))
        sigma_px = max(math.sqrt(squares / (2 * n - 2)), config.min_sigma_px)
    residual, jacobian = _residuals(solution, observed, stars, config)
    weight = robust_loss(np.sum(residual**2, axis=1), config)[1]
    try:
        bread = np.linalg.inv(np.einsum("n,nij,nik->jk", weight, jacobian, jacobian))
    except np.linalg.LinAlgError:
        return None
    # The noise in pixels propagates through the weights that were used: the sandwich J+ S J+^T.
    to_residual = observed.radians_per_px
    if config.weights == "pixel":
        to_px = np.linalg.inv(observed.radians_per_px)
        to_residual = np.broadcast_to(np.eye(2), to_px.shape) / np.abs(np.linalg.det(to_px)).min() ** 0.5
    gain = np.einsum("jk,n,nik->nji", bread, weight, jacobian)  # (n, 2, 2): residual -> latitude, longitude
    influence = gain @ to_residual
    covariance = sigma_px**2 * np.einsum("nij,nkj->ik", influence, influence)
    # An attitude error rotates all observed directions together, about east, north (tilt) and up (heading).
    sigmas = np.radians([attitude.tilt_deg, attitude.tilt_deg, attitude.heading_deg])
    if sigmas.any():
        turns = np.stack([np.cross(axis, observed.dirs) for axis in np.eye(3)])
        in_residual = np.einsum("nij,anj->nia", observed.tangents, turns)
        if config.weights == "pixel":
            in_residual = to_residual @ np.linalg.solve(observed.radians_per_px, in_residual)
        systematic = np.einsum("nji,nia->ja", gain, in_residual)
        covariance = covariance + (systematic * sigmas**2) @ systematic.T
    lat = math.radians(solution[0])
    curvature = 1 - ECCENTRICITY_SQUARED * math.sin(lat) ** 2
    north_km = SEMI_MAJOR_AXIS_KM * (1 - ECCENTRICITY_SQUARED) / curvature**1.5
    east_km = SEMI_MAJOR_AXIS_KM / math.sqrt(curvature) * math.cos(lat)
    to_km = np.array([[0.0, east_km], [north_km, 0.0]])
    return np.asarray(to_km @ covariance @ to_km.T)
