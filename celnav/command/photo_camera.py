"""A camera from a photograph's tags, for use without a calibration: a pinhole with the focal length of the tags."""

from __future__ import annotations

import math
from dataclasses import dataclass

from celnav.camera import Camera
from celnav.command.exif import PhotoTags
from celnav.errors import CameraError

# Diagonal of 36 mm x 24 mm, to which CIPA DCG-001 refers the equivalent focal length.
DIAGONAL_35MM = math.hypot(36.0, 24.0)
# Wider lenses are seldom close to a pinhole: fisheyes, and wide lenses with a per cent and more of distortion.
WIDE_DEG = 75.0
# If the sensor's pixel pitch and the equivalent focal length disagree by more, the picture was resized or cropped.
_AGREEMENT = 0.1


@dataclass(frozen=True)
class PhotoCamera:
    """A camera from tags.

    Attributes
    ----------
    camera : Camera
        A pinhole camera.
    assumed, warnings : tuple of str
        Assumptions, and reasons to doubt them; a sentence each.
    """

    camera: Camera
    assumed: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def photo_camera(
    tags: PhotoTags, focal_length_mm: float | None = None, sensor_width_mm: float | None = None
) -> PhotoCamera:
    """Make a camera from a photograph's tags.

    Parameters
    ----------
    tags : PhotoTags
        Tags of the photograph.
    focal_length_mm, sensor_width_mm : float, optional
        Focal length of the lens, and width of the part of the sensor that the rows of the stored picture show; each
        replaces the value of the tags.

    Raises
    ------
    CameraError
        When neither tags nor options give a focal length in pixels.
    """
    for name, value in (("--focal-length-mm", focal_length_mm), ("--sensor-width-mm", sensor_width_mm)):
        if value is not None and not 0 < value < 1e5:
            raise CameraError(f"{name} {value:g} must be a positive number of millimetres")
    f_px, source = _focal_length(tags, focal_length_mm, sensor_width_mm)
    camera = Camera("pinhole", tags.width, tags.height, f_px)
    across = math.degrees(2 * math.atan(tags.width / 2 / f_px))
    taken_by = ", ".join(name for name in (tags.camera, tags.lens) if name)
    assumed = (
        f"camera{f' ({taken_by})' if taken_by else ''}: {source}: {f_px:.0f} px, {across:.1f} deg wide",
        "a pinhole with square pixels and its principal point in the middle",
    )
    warnings = []
    if across > WIDE_DEG or "fisheye" in tags.lens.lower():
        what = "is a fisheye" if "fisheye" in tags.lens.lower() else f"is wide ({across:.0f} deg)"
        warnings.append(
            f"the lens {what}, and such lenses are seldom close to a pinhole: give --camera a calibration, or a file with "
            "the model equidistant and hfov_deg"
        )
    return PhotoCamera(camera, assumed, tuple(warnings))


def _focal_length(tags: PhotoTags, focal_length_mm: float | None, sensor_width_mm: float | None) -> tuple[float, str]:
    """Return the focal length in pixels, and its source."""
    f_mm = focal_length_mm if focal_length_mm is not None else tags.focal_length_mm
    given = f"{f_mm:g} mm" if f_mm is not None else ""
    given += " (EXIF)" if focal_length_mm is None else ""
    if sensor_width_mm is not None:
        if f_mm is None:
            raise CameraError(
                "the image does not say its focal length: give --focal-length-mm, or a file with --camera"
            )
        return f_mm / sensor_width_mm * tags.width, f"focal length {given}, sensor {sensor_width_mm:g} mm wide"
    equivalent = None
    if tags.focal_length_35mm is not None and focal_length_mm is None:
        equivalent = tags.focal_length_35mm / DIAGONAL_35MM * math.hypot(tags.width, tags.height)
    if tags.focal_plane_px_mm is not None and f_mm is not None:
        written = tags.tagged_width_px or tags.width
        if tags.height == written != tags.width:  # rotated by a program that kept the tags
            written = tags.width
        pitch = tags.focal_plane_px_mm * tags.width / written
        if equivalent is None or abs(math.log(f_mm * pitch / equivalent)) < _AGREEMENT:
            return f_mm * pitch, f"focal length {given}, {1000 / pitch:.2f} µm to a pixel (EXIF)"
    if equivalent is not None:
        return equivalent, f"focal length equivalent to {tags.focal_length_35mm:g} mm on 35 mm film (EXIF)"
    if f_mm is not None:
        raise CameraError(
            f"the focal length is {given}, but the image does not say how large its sensor is: give --sensor-width-mm, a "
            "file with --camera, or --camera unknown, which finds field and lens from the stars"
        )
    raise CameraError(
        "the image does not say its focal length: give --camera FILE, --focal-length-mm and --sensor-width-mm, or --camera "
        "unknown, which finds field and lens from the stars"
    )
