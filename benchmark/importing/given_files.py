"""Files that the options of `skybench import` name: regular ones of a limited size, before they are read."""

from __future__ import annotations

from pathlib import Path

from benchmark.errors import PhotographError
from benchmark.importing.photographs import LARGEST_TABLE_BYTES, read_times
from benchmark.importing.told import ToldCamera, read_told
from celnav.command.checks.input_files import check_attitude_file, check_camera_file, check_file
from celnav.errors import CelnavError, TimeError


def read_given_camera(camera_file: Path, attitude: str | None = None) -> ToldCamera:
    """Read ``--camera`` and ``--attitude`` as `read_told` does. Raises PhotographError, also for a pipe or a device."""
    try:
        check_camera_file(camera_file)
        if attitude is not None:
            check_attitude_file(attitude)
    except CelnavError as error:
        raise PhotographError(str(error)) from error
    return read_told(camera_file, attitude)


def read_given_times(path: Path) -> dict[str, tuple[str, float]]:
    """Read ``--times`` as `read_times` does. Raises PhotographError, also for a pipe or a device."""
    try:
        check_file(path, f"table of times {path}", TimeError, LARGEST_TABLE_BYTES)
    except CelnavError as error:
        raise PhotographError(str(error)) from error
    return read_times(path)
