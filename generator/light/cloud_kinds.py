"""Kinds of cloud: height, cover, optical depth, texture and particles of each, from published measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import j0, j1, ndtr, ndtri

WAVELENGTH_UM = 0.55


@dataclass(frozen=True)
class CloudKind:
    """A kind of cloud.

    Attributes
    ----------
    altitude_km : float
        Height above the site.
    coverage : float
    median_depth, spread, least_depth, most_depth : float
        Distribution over nights of the optical depth within the cloud: lognormal with this standard deviation of its
        logarithm, truncated.
    outer_scale_km : float
        Scale above which the power spectrum is flat.
    stretch : float
        Length of its waves along the wind relative to that across: 1 for isotropic cloud, more for bands.
    cell_km : float
        Distance between its cells; 0 for none.
    particle_um : float
        Effective diameter of its droplets or crystals.
    wind_m_s : float
    """

    altitude_km: float
    coverage: float
    median_depth: float
    spread: float
    least_depth: float
    most_depth: float
    outer_scale_km: float
    stretch: float
    cell_km: float
    particle_um: float
    wind_m_s: float

    def drawn_depth(self, random: np.random.Generator) -> float:
        """Optical depth within the cloud on one night."""
        low, high = (
            float(np.log(limit / self.median_depth)) / self.spread for limit in (self.least_depth, self.most_depth)
        )
        part = ndtr(low) + random.random() * (ndtr(high) - ndtr(low))
        return float(self.median_depth * np.exp(self.spread * ndtri(part)))


CLOUD_KINDS = {
    "cirrus": CloudKind(10.0, 0.6, 0.61, 0.64, 0.03, 3.6, 25.0, 4.0, 0.0, 60.0, 25.0),
    "altocumulus": CloudKind(4.0, 0.6, 2.0, 0.5, 0.5, 3.6, 10.0, 1.5, 1.0, 16.0, 12.0),
    "stratocumulus": CloudKind(1.3, 0.85, 9.1, 0.45, 3.6, 23.0, 8.0, 1.3, 2.5, 20.0, 8.0),
    "cumulus": CloudKind(1.3, 0.3, 6.8, 0.4, 1.0, 23.0, 2.0, 1.0, 0.0, 20.0, 6.0),
    "fog": CloudKind(0.2, 1.0, 5.0, 0.5, 1.0, 23.0, 1.0, 1.0, 0.0, 16.0, 1.0),
}
"""Sources. Cirrus: base 8.8 and top 11.2 km over Salt Lake City (Sassen & Campbell 2001, J. Atmos. Sci. 58, 481), visible
depth 0.75 (mean) and 0.61 (median), visible from 0.03 (Sassen & Comstock 2001, J. Atmos. Sci. 58, 2113). Limits at 3.6 and
23: the definition of types by the International Satellite Cloud Climatology Project (Rossow & Schiffer 1999, Bull. Am.
Meteorol. Soc. 80, 2261); stratocumulus has its median in the middle of its limits. Cumulus: 5.8 to 8.0 in one cloud (Barker &
Liu 1995, J. Climate 8, 2620). Droplets of 20 um (Luo et al. 1994, J. Geophys. Res. 99, 3685: radius 9.3 to 10.2 um). Covers,
spreads of droplet clouds, cells, the stretch of bands, fog and winds are skybench's choice of an ordinary case. The numbers
from Sassen's papers and the limits of the types are quoted from memory and have not been checked against the papers."""

ICE_FROM_KM = 6.0
"""Cloud without a kind consists of ice from this height on."""


def usual_particle_um(altitude_km: float) -> float:
    """Diameter of the particles of a layer of unknown kind: crystals of cirrus above ICE_FROM_KM, droplets below."""
    return CLOUD_KINDS["cirrus" if altitude_km >= ICE_FROM_KM else "stratocumulus"].particle_um


def of_ice(kind: str | None, altitude_km: float) -> bool:
    """Whether a layer consists of crystals: cirrus, or cloud without a kind from ICE_FROM_KM on."""
    return altitude_km >= ICE_FROM_KM if kind is None else kind == "cirrus"


def point_share(particle_um: float, capture_rad: float) -> float:
    """Fraction of a cloud's optical depth that removes light from a star's image.

    Half of the light that large particles extinguish is diffracted by their shadows (Babinet's principle), into a pattern
    as wide as wavelength over diameter. Light within the image is not lost: the fraction 1 - J0(x)^2 - J1(x)^2 of a
    disk's diffraction pattern is within an angle t, x = pi D t / wavelength (Born & Wolf, "Principles of Optics", 8.5.2).
    This is the delta scaling of Joseph et al. 1976, J. Atmos. Sci. 33, 2452, with the forward peak of the particle's own
    size. Through cirrus a Sun photometer of 2.4 deg sees half of the optical depth (Shiobara & Asano 1994, J. Appl.
    Meteorol. 33, 672).

    Parameters
    ----------
    particle_um : float
        Effective diameter; 0 means that all extinguished light is lost.
    capture_rad : float
        Angular radius of the star's image.
    """
    x = np.pi * particle_um / WAVELENGTH_UM * np.sin(min(capture_rad, np.pi / 2))
    return float(1 - 0.5 * (1 - j0(x) ** 2 - j1(x) ** 2))
