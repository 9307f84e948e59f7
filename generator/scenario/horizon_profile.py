"""Horizon profiles: CSV files of azimuth and elevation."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.csv_table import CsvError, read_csv
from generator.scenario.strict import InputFile

PROFILE_COLUMNS = ("azimuth_deg", "elevation_deg")
LARGEST_ROWS = 100_000
"""One every 0.0036 deg, 13 arcsec."""


class ProfileError(ValueError):
    """The file is not a horizon profile."""


@functools.lru_cache(maxsize=8)
def read_profile(file: InputFile) -> NDArray[np.float64]:
    """Read a profile: (n, 2) azimuth (0 to 360, increasing) and elevation, deg.

    Raises
    ------
    ProfileError
        Another header, a value out of range, or azimuths that do not increase.
    """
    try:
        table = read_csv(
            Path(file.location), file.path, PROFILE_COLUMNS, least_rows=1, most_rows=LARGEST_ROWS, increasing=True
        )
    except CsvError as error:
        raise ProfileError(str(error)) from error
    azimuth, elevation = table.values.T
    if azimuth[0] < 0 or azimuth[-1] > 360:
        raise ProfileError(
            f"'{file.path}': found azimuths from {azimuth[0]:g} to {azimuth[-1]:g} deg, expected 0 to 360"
        )
    if (np.abs(elevation) >= 90).any():
        raise ProfileError(
            f"'{file.path}': found elevations that reach the zenith or the nadir, expected -90 to 90 deg"
        )
    return table.values


def elevation_deg(profile: NDArray[np.float64], azimuth_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Elevation of the profile at azimuths, deg; linear in between, closed around the circle."""
    return np.interp(azimuth_deg, profile[:, 0], profile[:, 1], period=360)
