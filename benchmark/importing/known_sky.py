"""The sky over a known place at a known time, by the generator's astrometry, which no solver shares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import PhotographError
from benchmark.place import Place
from generator.errors import TimeRangeError
from generator.light.atmosphere import airmass
from generator.places.astrometry import (
    ApparentPlaces,
    Site,
    intermediate_places,
    observed_places,
    places_of_date,
    stars_within,
)
from generator.places.catalogue import StarCatalogue, load_catalogue
from generator.places.ephemeris import planets
from generator.places.times import EarthOrientation, Instant, earth_orientation
from generator.sky.state import SkyState, sky_state

Floats = NDArray[np.float64]

FAINTEST_MAG = 7.0
"""Magnitude limit of the listed stars."""


@dataclass(frozen=True, eq=False)
class KnownSky:
    """Stars and planets above the horizon, brightest first, and Sun and Moon.

    Attributes
    ----------
    stars : StarCatalogue
        The n stars, to `FAINTEST_MAG`.
    ra_deg, dec_deg : (n,) arrays
        ICRS, proper motion applied.
    start, middle, end : ApparentPlaces
        Apparent places at the start, middle and end of the exposure.
    airmass : (n,) array
    utc_start, utc_mid : Instant
    orientation : EarthOrientation
    state : SkyState
    """

    stars: StarCatalogue
    ra_deg: Floats
    dec_deg: Floats
    start: ApparentPlaces
    middle: ApparentPlaces
    end: ApparentPlaces
    airmass: Floats
    utc_start: Instant
    utc_mid: Instant
    orientation: EarthOrientation
    state: SkyState


def known_sky(place: Place, utc_mid: str, exposure_s: float) -> KnownSky:
    """Compute the sky at the middle of an exposure.

    Raises
    ------
    PhotographError
        The time is invalid, or the Earth's rotation is not known for it.
    """
    try:
        middle = Instant.parse(utc_mid)
        orientation = earth_orientation(middle)
    except (ValueError, TimeRangeError) as error:
        raise PhotographError(f"time {utc_mid}: {error}") from error
    site, air = Site(place.latitude_deg, place.longitude_deg, place.height_m), place.air
    state = sky_state(site, middle, orientation, air, None, 0)
    zenith = state.icrs_from_enu[:, 2]
    parts = [part[(part.v_mag <= FAINTEST_MAG) & stars_within(part, zenith, 91.0)]
             for part in (load_catalogue(), planets(site, middle, orientation))]  # fmt: skip
    stars = parts[0].joined(parts[1])
    intermediate = intermediate_places(stars, site, middle, orientation)
    moments = [middle.plus(after) for after in (-exposure_s / 2, 0.0, exposure_s / 2)]
    path = [observed_places(intermediate, site, moment, orientation, air) for moment in moments]
    up = np.flatnonzero(path[1].enu[:, 2] > 0)
    up = up[np.lexsort((stars.star_id[up], stars.v_mag[up]))]
    stars = stars[up]
    start, mid, end = (places[up] for places in path)
    ra_deg, dec_deg = places_of_date(stars, middle)
    return KnownSky(
        stars=stars,
        ra_deg=ra_deg,
        dec_deg=dec_deg,
        start=start,
        middle=mid,
        end=end,
        airmass=airmass(mid.altitude_deg),
        utc_start=moments[0],
        utc_mid=middle,
        orientation=orientation,
        state=state,
    )
