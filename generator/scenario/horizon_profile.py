"""Horizon profiles: CSV files of azimuth and elevation."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.scenario.strict import InputFile

LARGEST_ROWS = 100_000


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
    lines = Path(file.location).read_text(encoding="utf-8", errors="replace").splitlines()
    header = [name.strip() for name in lines[0].split(",")] if lines else []
    if header != ["azimuth_deg", "elevation_deg"] or not 2 <= len(lines) <= LARGEST_ROWS:
        raise ProfileError(
            f"found '{file.path}' with the columns {header}, expected azimuth_deg, elevation_deg and some rows"
        )
    try:
        rows = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:] if line.strip()])
    except ValueError as error:
        raise ProfileError(f"found '{file.path}', which holds something that is not a number ({error})") from error
    if rows.ndim != 2 or rows.shape[1] != 2 or not np.isfinite(rows).all():
        raise ProfileError(f"found '{file.path}', which needs two finite numbers per row")
    if (np.diff(rows[:, 0]) <= 0).any() or rows[0, 0] < 0 or rows[-1, 0] > 360:
        raise ProfileError(f"found '{file.path}', whose azimuths do not increase from 0 to 360")
    if (np.abs(rows[:, 1]) >= 90).any():
        raise ProfileError(f"found '{file.path}', whose elevations leave -90 to 90 deg")
    return rows


def elevation_deg(profile: NDArray[np.float64], azimuth_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Elevation of the profile at azimuths, deg; linear in between, closed around the circle."""
    return np.interp(azimuth_deg, profile[:, 0], profile[:, 1], period=360)
