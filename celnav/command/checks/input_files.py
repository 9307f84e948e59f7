"""Files that a command's arguments name: regular ones of a limited size, before anything opens them.

Reading never begins from a pipe without a writer, and never ends from a device such as /dev/zero.
"""

from __future__ import annotations

import argparse
import stat
from pathlib import Path

from celnav.command.checks.remedies import ATTITUDE_NAMES
from celnav.command.checks.rms_file import check_rms_file
from celnav.errors import AttitudeError, CalibrationError, CameraError, CelnavError, ImageError

LARGEST_RECORD_BYTES = 200_000_000
"""Largest frame record next to an image, or file of RMS' platepars."""
LARGEST_IMAGE_BYTES = 2_000_000_000
"""Largest image: a hundred million pixels of 16 bits in three colours, three times."""
LARGEST_SETTINGS_BYTES = 16_000_000
"""Largest file of a camera or an attitude."""
_UNKNOWN = "unknown"


def check_input_files(arguments: argparse.Namespace) -> None:
    """Check the files that ``celnav solve`` or ``celnav calibrate`` is going to read.

    Raises
    ------
    CelnavError
        One is not a regular file, or is too large for what it should contain. A missing file passes, since whatever reads it
        says what it wanted.
    """
    for path in [arguments.image] if arguments.command == "solve" else arguments.frames:
        if arguments.command == "calibrate" and Path(path).suffix.lower() == ".json":
            check_file(path, f"file of centroids {path}", CalibrationError, LARGEST_RECORD_BYTES)
            check_rms_file(path)
            continue
        check_file(path, f"image {path}", ImageError, LARGEST_IMAGE_BYTES)
        if arguments.command == "calibrate":
            record = Path(path).with_suffix(".json")
            check_file(record, f"frame record {record}", ImageError, LARGEST_RECORD_BYTES)
    if arguments.mask is not None:
        check_file(arguments.mask, f"mask {arguments.mask}", ImageError, LARGEST_IMAGE_BYTES)
    if arguments.camera not in (None, _UNKNOWN):
        check_camera_file(arguments.camera)
    if arguments.command == "solve":
        check_attitude_file(arguments.attitude)


def check_camera_file(path: str | Path) -> None:
    """Raise `CameraError` for what `read_camera_file` could not read to the end, as `check_file` does."""
    check_file(path, f"camera file {path}", CameraError, LARGEST_SETTINGS_BYTES)


def check_attitude_file(text: str) -> None:
    """Raise `AttitudeError`, as `check_file` does, if the option ``--attitude`` names a file; angles are no file's name."""
    if text not in ATTITUDE_NAMES:
        check_file(text, f"attitude file {text}", AttitudeError, LARGEST_SETTINGS_BYTES)


def check_file(path: str | Path, what: str, error: type[CelnavError], most_bytes: int) -> None:
    """Refuse what is there and is no regular file, or has more than `most_bytes`; `what` names it in the message."""
    try:
        found = Path(path).stat()
    except (OSError, ValueError):  # a path with a zero byte is a ValueError
        return
    if stat.S_ISDIR(found.st_mode):
        return
    if not stat.S_ISREG(found.st_mode):
        raise error(f"{what} is a pipe or a device, not a regular file: save its content as a file first")
    if found.st_size > most_bytes:
        raise error(f"{what} is larger than {most_bytes // 1_000_000} MB, far more than it needs: is it the right one?")
