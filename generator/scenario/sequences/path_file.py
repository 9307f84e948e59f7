"""Read paths: waypoints of a scenario, or CSV files with one row per moment."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.csv_table import CsvError, read_csv
from generator.places.times import Instant
from generator.places.trajectory import Knots
from generator.scenario.model import Pointing, SiteSpec, pointing_matrix
from generator.scenario.sequences.path_spec import ATTITUDE, HIGHEST_LATITUDE_DEG, LEAST_STEP_S, POSITION, PathSpec
from generator.scenario.strict import InputFile

Floats = NDArray[np.float64]
Columns = dict[str, Floats]

TIME = "t_s"
UTC = "utc"
QUATERNION = ("qx", "qy", "qz", "qw")
LAYOUTS = tuple(
    (time, *position, *attitude)
    for time in (TIME, UTC)
    for position, attitude in (
        (POSITION, ATTITUDE), (POSITION, QUATERNION), (POSITION, ()), ((), ATTITUDE), ((), QUATERNION),
    )
)  # fmt: skip
"""Columns that a path file may have."""
LARGEST_PATH_ROWS = 200_000
"""Enough for half an hour at 100 Hz, for which a spline takes three seconds to compute."""
LONGEST_TIME_S = 366 * 86400.0
RANGES = {
    TIME: (-LONGEST_TIME_S, LONGEST_TIME_S),
    "latitude_deg": (-HIGHEST_LATITUDE_DEG, HIGHEST_LATITUDE_DEG), "longitude_deg": (-180, 360), "height_m": (-500, 20000),
    "azimuth_deg": (-360, 360), "altitude_deg": (-90, 90), "roll_deg": (-360, 360),
}  # fmt: skip
UNIT_TOLERANCE = 1e-3
"""Deviation of a quaternion's length from 1 that rounding explains."""


class PathError(ValueError):
    """The path cannot be used; the message starts with the key."""


def path_columns(path: PathSpec, utc_start: str) -> Columns:
    """Return the path's numbers by column, (k,) each, with times TIME after a start. Raises PathError."""
    if path.file is not None:
        origin, columns = read_path(path.file)
        after_s = 0.0 if origin is None else origin.since(Instant.parse(utc_start))
        return columns | {TIME: columns[TIME] + after_s}
    waypoints = path.waypoints or ()
    names = [name for name in (TIME, *POSITION, *ATTITUDE) if getattr(waypoints[0], name) is not None]
    return {name: np.array([getattr(waypoint, name) for waypoint in waypoints]) for name in names}


@functools.lru_cache(maxsize=4)
def read_path(file: InputFile) -> tuple[Instant | None, Columns]:
    """Read a path: CSV with a header of one of LAYOUTS.

    Returns
    -------
    origin : Instant or None
        Instant of the first row, from which times count; None if the file counts from the start of the sequence.
    columns : dict of (k,) arrays

    Raises
    ------
    PathError
    """
    clock = _Clock()
    try:
        table = read_csv(
            Path(file.location),
            file.path,
            least_rows=2,
            most_rows=LARGEST_PATH_ROWS,
            increasing=True,
            first_column={UTC: clock.seconds},
        )
    except CsvError as error:
        raise PathError(f"path.file: {error}") from error
    if table.columns not in LAYOUTS:
        expected = " or ".join(", ".join(layout) for layout in LAYOUTS[:2])
        raise PathError(
            f"path.file: '{file.path}': found the columns {', '.join(table.columns)}, expected {expected}, "
            "without the position or without the attitude where the scenario gives it"
        )
    columns = dict(zip((TIME, *table.columns[1:]), table.values.T, strict=True))
    step_s = np.diff(columns[TIME])
    if step_s.min() < LEAST_STEP_S:
        row = int(np.argmin(step_s))
        raise PathError(
            f"path.file: '{file.path}', column {table.columns[0]}: found {step_s[row]:g} s between rows {row + 1} and "
            f"{row + 2}, expected at least {LEAST_STEP_S:g} s; leave one of them out"
        )
    for name, (low, high) in RANGES.items():
        if name in columns and not ((columns[name] >= low) & (columns[name] <= high)).all():
            row = int(np.flatnonzero((columns[name] < low) | (columns[name] > high))[0])
            raise PathError(
                f"path.file: '{file.path}', column {name}: found {columns[name][row]:g} at t_s {columns[TIME][row]:g}, "
                f"expected {low:g} to {high:g}"
            )
    if QUATERNION[0] in columns:
        length = np.linalg.norm([columns[name] for name in QUATERNION], axis=0)
        if np.abs(length - 1).max() > UNIT_TOLERANCE:
            row = int(np.argmax(np.abs(length - 1)))
            raise PathError(
                f"path.file: '{file.path}', columns qx to qw: found a length of {length[row]:g} at t_s "
                f"{columns[TIME][row]:g}, expected unit quaternions"
            )
    return clock.origin, columns


class _Clock:
    """Converts UTC times to seconds after the first row."""

    def __init__(self) -> None:
        self.origin: Instant | None = None

    def seconds(self, cell: str) -> float:
        """Seconds of a cell. Raises ValueError."""
        instant = Instant.parse(cell.strip())
        self.origin = self.origin or instant
        return instant.since(self.origin)


def knots_of(columns: Columns, site: SiteSpec | None, attitude: Pointing) -> Knots:
    """Return the knots of a path; position or attitude are constant if the columns leave them out."""
    time = columns.get(TIME, np.zeros(1))
    if POSITION[0] in columns:
        latitude, longitude, height = (columns[name] for name in POSITION)
    else:
        assert site is not None  # as SequenceSpec ensures
        latitude, longitude, height = (np.array([getattr(site, name)]) for name in POSITION)
    return Knots(time, latitude, longitude, height, _attitudes(columns, attitude))


def _attitudes(columns: Columns, attitude: Pointing) -> Rotation:
    if QUATERNION[0] in columns:
        return Rotation.from_quat(np.stack([columns[name] for name in QUATERNION], axis=-1))
    if ATTITUDE[0] not in columns:
        return Rotation.from_matrix(pointing_matrix(attitude)[None])
    # As in pointing_matrix: about the vertical, then about the camera's horizontal axis, then about the boresight.
    azimuth, altitude, roll = (columns[name] for name in ATTITUDE)
    level_north = Rotation.from_matrix(pointing_matrix(Pointing(azimuth_deg=0.0, altitude_deg=0.0)))
    return _turn("z", -roll) * _turn("x", -altitude) * level_north * _turn("z", azimuth)


def _turn(axis: str, angle_deg: Floats) -> Rotation:
    """Rotations of vectors about a coordinate axis."""
    return Rotation.from_rotvec(np.outer(angle_deg, np.eye(3)["xyz".index(axis)]), degrees=True)
