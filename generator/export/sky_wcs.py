"""A frame's world coordinate system in FITS' terms: the lens' own projection, with SIP polynomials for the residuals.

FITS projections: Calabretta & Greisen 2002, A&A 395, 1077. SIP: Shupe et al. 2005, ASP Conf. Ser. 347, 491.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from astropy.io import fits
from astropy.wcs import WCS
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Floats = NDArray[np.float64]
Coefficients = dict[tuple[int, int], Floats]
Directions = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Function from places in a frame to ICRS unit vectors and apparent altitudes, deg; NaN if there is no direction."""

PROJECTIONS = {
    "pinhole": "TAN",
    "brown_conrady": "TAN",
    "kannala_brandt": "ARC",
    "equidistant": "ARC",
    "equisolid": "ZEA",
    "stereographic": "STG",
    "orthographic": "SIN",
}
"""FITS' name of each lens model's projection without distortion."""
LARGEST_RESIDUAL_PX = 0.06
WANTED_RESIDUAL_PX = 0.02
"""Residual below which no higher order is tried."""
ORDERS = (1, 3, 5, 7, 9)
"""Orders of the polynomials: 1 means no SIP, 9 is the highest that SIP allows."""
LOWEST_ALTITUDES_DEG = (0.0, 5.0, 10.0, 15.0)
"""Lower limits of the altitude. Polynomials cannot follow refraction at the horizon; the first limit above which they can is
used."""
NODES = (44, 32)
"""Numbers of fitted places along u and v."""
CHECKS = (61, 45)
"""Numbers of places along u and v, different from the nodes, with which the fit is compared."""
FEWEST_PLACES = 200
CENTRE_ROUNDS = 3
"""Number of fits that bring the reference direction to the principal point."""


@dataclass(frozen=True)
class SkyFit:
    """A world coordinate system and its residual.

    Attributes
    ----------
    code : str
        FITS' name of the projection.
    order : int
        Order of the polynomials; 1 if there are none.
    residual_px : float
        Largest distance between the system and the directions of pixels, either way, over the sky in the frame above
        `lowest_altitude_deg`.
    lowest_altitude_deg : float
    centre_px : (2,) array
        The principal point.
    crval_deg : (2,) array
        Right ascension and declination there.
    linear_deg_px : (2, 2) array
        Matrix from pixels to the projection's plane.
    ahead, behind : dict of (p, q) to (2,) array
        Coefficients of u^p v^q, px, u and v from the principal point: to the input of the linear part, and back.
    """

    code: str
    order: int
    residual_px: float
    lowest_altitude_deg: float
    centre_px: Floats
    crval_deg: Floats
    linear_deg_px: Floats
    ahead: Coefficients
    behind: Coefficients

    def header(self) -> fits.Header:
        """Cards of the system."""
        header = fits.Header()
        suffix = "-SIP" if self.order > 1 else ""
        header["CTYPE1"], header["CTYPE2"] = f"RA---{self.code}{suffix}", f"DEC--{self.code}{suffix}"
        header["CUNIT1"] = header["CUNIT2"] = "deg"
        for axis in (0, 1):
            # FITS numbers the first pixel 1.
            header[f"CRPIX{axis + 1}"] = float(self.centre_px[axis]) + 1
            header[f"CRVAL{axis + 1}"] = float(self.crval_deg[axis])
            for along in (0, 1):
                header[f"CD{axis + 1}_{along + 1}"] = float(self.linear_deg_px[axis, along])
        header["LONPOLE"], header["LATPOLE"] = 180.0, float(self.crval_deg[1])
        header["RADESYS"] = "ICRS"
        if self.order > 1:
            for axis, names in enumerate((("A", "AP"), ("B", "BP"))):
                for name, coefficients in zip(names, (self.ahead, self.behind), strict=True):
                    header[f"{name}_ORDER"] = self.order
                    for (p, q), coefficient in coefficients.items():
                        header[f"{name}_{p}_{q}"] = float(coefficient[axis])
        return header


@dataclass(frozen=True)
class Grid:
    """Places of a frame that show sky: (n, 2) px, right ascension and declination (n, 2) deg, altitude (n,) deg."""

    px: Floats
    world_deg: Floats
    altitude_deg: Floats

    def above(self, altitude_deg: float) -> Grid:
        """The places above an altitude."""
        rows = self.altitude_deg > altitude_deg
        return Grid(self.px[rows], self.world_deg[rows], self.altitude_deg[rows])


def fit_sky(
    directions: Directions, model: str, width: int, height: int, centre_px: tuple[float, float]
) -> SkyFit | None:
    """Fit polynomials of the lowest sufficient order, down to the lowest altitude at which any order is sufficient.

    Returns None if hardly any sky is in the frame; if no order is sufficient, the best one above 15 deg.

    Parameters
    ----------
    directions : callable
    model : str
        Lens model, one of PROJECTIONS.
    width, height : int
    centre_px : (u, v)
        The principal point.
    """
    # Chebyshev's nodes, so that the largest error is small rather than the mean one.
    across = [
        (size - 1) / 2 - size / 2 * np.cos((np.arange(count) + 0.5) / count * np.pi)
        for size, count in zip((width, height), NODES, strict=True)
    ]
    evenly = [np.linspace(-0.5, size - 0.5, count) for size, count in zip((width, height), CHECKS, strict=True)]
    fitted, checked = _grid(directions, *across), _grid(directions, *evenly)
    (reference,), _ = directions(*np.array(centre_px).reshape(2, 1))
    best: SkyFit | None = None
    for lowest in LOWEST_ALTITUDES_DEG:
        if min(len(fitted.above(lowest).px), len(checked.above(lowest).px)) < FEWEST_PLACES:
            break
        best = None
        for order in ORDERS:
            found = _fit(order, PROJECTIONS[model], reference, np.array(centre_px), fitted, checked, lowest)
            if found is not None and (best is None or found.residual_px < best.residual_px):
                best = found
            if best is not None and best.residual_px < WANTED_RESIDUAL_PX:
                return best
        if best is not None and best.residual_px < LARGEST_RESIDUAL_PX:
            return best
    return best


def _grid(directions: Directions, u: Floats, v: Floats) -> Grid:
    """The places of a grid that show sky."""
    grid_v, grid_u = (axis.ravel() for axis in np.meshgrid(v, u, indexing="ij"))
    icrs, altitude_deg = directions(grid_u, grid_v)
    return Grid(np.stack([grid_u, grid_v], axis=1), equatorial_deg(icrs), altitude_deg).above(0.0)


def equatorial_deg(icrs: Floats) -> Floats:
    """Right ascension (0 to 360) and declination, deg, (n, 2), of unit vectors."""
    ra_deg = np.degrees(np.arctan2(icrs[:, 1], icrs[:, 0])) % 360
    return np.stack([ra_deg, np.degrees(np.arctan2(icrs[:, 2], np.hypot(icrs[:, 0], icrs[:, 1])))], axis=1)


def _fit(
    order: int,
    code: str,
    reference: Floats,
    centre_px: Floats,
    fitted: Grid,
    checked: Grid,
    lowest_altitude_deg: float,
) -> SkyFit | None:
    """Fit one order; None if the projection cannot show the whole field."""
    fitted, checked = fitted.above(lowest_altitude_deg), checked.above(lowest_altitude_deg)
    crval = equatorial_deg(reference[None])[0]
    scale = np.abs(fitted.px - centre_px).max()
    near = (fitted.px - centre_px) / scale
    powers = [(p, degree - p) for degree in range(order + 1) for p in range(degree, -1, -1)]
    solve = _solver(_monomials(near, powers))
    for _ in range(CENTRE_ROUNDS):
        plane_of = _plane(code, crval)
        plane = plane_of.wcs_world2pix(fitted.world_deg, 0)
        if not np.isfinite(plane).all():
            return None
        terms = solve(plane)
        crval = plane_of.wcs_pix2world(terms[:1], 0)[0]
    linear = terms[1:3].T / scale
    to_px = np.linalg.inv(linear)
    higher = {power: to_px @ term / scale ** sum(power) for power, term in zip(powers[3:], terms[3:], strict=True)}
    # The inverse, from the plane's linear pixels to the frame's.
    flat = plane @ to_px.T / scale
    back_powers = powers[1:]
    back = _solver(_monomials(flat, back_powers))(near - flat)

    away = checked.px - centre_px
    plane = plane_of.wcs_world2pix(checked.world_deg, 0)
    if not np.isfinite(plane).all():
        return None
    flat = plane @ to_px.T
    ahead = away + sum((coefficient * _monomials(away, [power]) for power, coefficient in higher.items()), np.zeros(2))
    behind = flat + scale * _monomials(flat / scale, back_powers) @ back
    residual = max(float(np.hypot(*(got - want).T).max()) for got, want in ((ahead, flat), (behind, away)))

    inverse = {power: term * scale ** (1 - sum(power)) for power, term in zip(back_powers, back, strict=True)}
    return SkyFit(code, order, residual, lowest_altitude_deg, centre_px, crval, linear, ahead=higher, behind=inverse)


def _solver(matrix: Floats) -> Callable[[Floats], Floats]:
    """Least squares with one matrix and several right sides."""
    q, r = np.linalg.qr(matrix)
    return lambda right: solve_triangular(r, q.T @ right)


def _plane(code: str, crval: Floats) -> WCS:
    """The projection alone: world coordinates to degrees in its plane."""
    system = WCS(naxis=2)
    system.wcs.ctype = [f"RA---{code}", f"DEC--{code}"]
    system.wcs.crval = crval
    system.wcs.crpix = [1.0, 1.0]
    system.wcs.cdelt = [1.0, 1.0]
    system.wcs.lonpole = 180.0
    system.wcs.set()
    return system


def _monomials(places: Floats, powers: list[tuple[int, int]]) -> Floats:
    """u^p v^q of places (n, 2), (n, number of powers) array."""
    highest = max(max(power) for power in powers)
    raised = np.ones((highest + 1, *places.shape))
    for power in range(1, highest + 1):
        raised[power] = raised[power - 1] * places
    return np.stack([raised[p, :, 0] * raised[q, :, 1] for p, q in powers], axis=1)
