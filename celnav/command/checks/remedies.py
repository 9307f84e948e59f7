"""Remedies for input that cannot be used: pictures of other formats or sizes, and attitudes that are no file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from celnav.camera import Camera
from celnav.errors import AttitudeError, CameraError, ImageError

OTHER_FORMAT = "is not a PNG, JPEG, TIFF or HEIF image"
"""End of the message of `celnav.read_image` about a file of another format."""
CONVERT = "convert a picture of another format to PNG or TIFF, without changing its size (FITS is read too)"
ATTITUDE_NAMES = ("unknown", "zenith", "zenith-north-up", "exif")
ATTITUDE_KEYS = ("azimuth", "altitude", "roll", "tilt_sigma", "heading_sigma")
_OF_OTHER_SIZE = (
    "a camera file is for pictures of its own size: calibrate again for cropped or binned ones, or give --camera unknown, "
    "which finds field and lens from the stars"
)
_TURNED = (
    "turn the picture back by a quarter turn, to how the camera stores it, or give --camera unknown, which finds field and "
    "lens from the stars"
)


@contextmanager
def naming_formats() -> Iterator[None]:
    """Add to the message about a file of another format what to do with it."""
    try:
        yield
    except ImageError as error:
        if not str(error).endswith(OTHER_FORMAT):
            raise
        raise ImageError(f"{error}: {CONVERT}") from None


@contextmanager
def naming_attitudes(text: str) -> Iterator[None]:
    """Add to the message about a file that does not exist what the option ``--attitude`` may be; `text` is its value."""
    try:
        yield
    except AttitudeError as error:
        if not str(error).startswith("cannot read attitude file") or os.path.exists(text):
            raise
        keys = ", ".join(f"{key}=" for key in ATTITUDE_KEYS)
        raise AttitudeError(
            f"{error}; --attitude is a name ({', '.join(ATTITUDE_NAMES)}), angles in degrees ({keys}) or a JSON file with "
            "R_cam"
        ) from None


def check_size(camera: Camera, shape: tuple[int, ...]) -> None:
    """Check that a picture has the size of the camera's pictures.

    Parameters
    ----------
    camera : Camera
        The camera.
    shape : tuple of int
        Shape of the picture: height, width, and colours if there are any.

    Raises
    ------
    CameraError
        When the sizes differ, with a remedy for pictures turned by a quarter turn and one for all others.
    """
    height, width = shape[:2]
    if (width, height) == (camera.width, camera.height):
        return
    remedy = _TURNED if (height, width) == (camera.width, camera.height) else _OF_OTHER_SIZE
    raise CameraError(
        f"the camera is {camera.width} x {camera.height} pixels, but the image {width} x {height}: {remedy}"
    )
