"""`celnav.find_camera`: field, lens and orientation of one picture whose lens, place and pointing are all unknown.

It runs the blind start of a calibration (`celnav.calibrating.blind_start`) on the stars of the whole sky, without air.
Refraction cannot be known without a place, so it becomes part of the lens. `celnav.solve` treats the camera as
uncalibrated.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.calibrating.beside_axis import follows, lens_outwards, scatter_px
from celnav.calibrating.blind_start import PASSES, Pass, find_start, is_mirrored, is_narrow
from celnav.calibrating.frames import DEEP_MAG, FAINTEST_MAG, CalibrationFrame, Site, Sky
from celnav.calibrating.growth import grow
from celnav.calibrating.joint_fit import NothingNamedError
from celnav.camera import Camera
from celnav.detection import DetectionConfig, detect
from celnav.detections import Detections
from celnav.errors import CalibrationError
from celnav.position import Weather
from celnav.sky.astrometry import celestial_to_terrestrial, terrestrial_stars
from celnav.sky.catalog import load_catalog
from celnav.sky.earth_rotation import EarthOrientation
from celnav.sky.utc import Utc, parse_utc

F8 = NDArray[np.float64]

WIDER_SIGMAS_PX = (1.6, 3.0)
"""Standard deviations of star images to try if the usual detection leads to no solution. In a picture that was interpolated
from a colour mosaic, or smoothed, hot pixels are as wide as sharp stars; where they outnumber the stars, the usual detection
measures their width."""
_NO_AIR = Site(0.0, 0.0, Weather(0.0, 0.0))


@dataclass(frozen=True, eq=False)
class FoundCamera:
    """A camera determined from identified stars.

    Attributes
    ----------
    camera : Camera
        A Kannala-Brandt fisheye lens with four terms, which can follow any lens as far out as stars are identified. It is
        decentred if a plain lens leaves a pattern larger than the scatter, and its axis is off-centre if the picture was
        cut from one side of a larger one.
    R_icrs_to_camera : ndarray, shape (3, 3)
        Orientation.
    detections : Detections
        Detections in the picture.
    stars : int
        Number of identified stars.
    scatter_px : float
        Scatter of their positions along an axis, pixels.
    """

    camera: Camera
    R_icrs_to_camera: F8
    detections: Detections
    stars: int
    scatter_px: float


def find_camera(image: ArrayLike, utc: str | datetime | Utc, mask: ArrayLike | None = None) -> FoundCamera:
    """Determine field, lens and orientation of one picture of the sky with a field of 5 to 180 deg.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        The picture, as for `celnav.detect`.
    utc : str, datetime or Utc
        When it was taken; an error of one day changes the result by 1 arcsec (aberration).
    mask : array_like of bool, shape (height, width), optional
        True where the picture is **not** to be used.

    Raises
    ------
    CalibrationError
        When no stars can be identified, or the picture shows the sky mirrored.
    """
    moment = parse_utc(utc)
    sky = whole_sky(moment)
    frames: list[CalibrationFrame] = []
    for sigma_px in (None, *WIDER_SIGMAS_PX):
        frames.append(_frame(image, moment, mask, sigma_px))
        if (found := _found(frames[-1], sky, PASSES[:2])) is not None:
            return found
    if (found := _found(frames[0], sky, PASSES[2:])) is not None:
        return found
    if any(is_mirrored(frame, sky) for frame in frames[:2]):
        raise CalibrationError("the picture shows the sky mirrored: turn its rows over")
    raise NothingNamedError(
        "no field, lens and orientation explain the lights of the picture better than chance: give a clearer picture, a mask "
        "of what is not sky, or a camera"
    )


def whole_sky(utc: Utc, faintest_mag: float = FAINTEST_MAG) -> Sky:
    """Return the stars of the whole sky as seen from the Earth without air, in the catalogue's axes.

    The Earth's rotation cancels in these axes, so that no table needs to contain the time.
    """
    catalog = load_catalog()
    catalog = catalog.take(slice(int(np.searchsorted(catalog.v_mag, faintest_mag))))
    orientation = EarthOrientation(0.0)
    to_terrestrial = celestial_to_terrestrial(utc, orientation)
    dirs = terrestrial_stars(catalog, utc, orientation, to_terrestrial).dirs @ to_terrestrial
    return Sky(dirs, catalog.v_mag, catalog.star_id, np.eye(3), _NO_AIR, utc)


def _frame(image: ArrayLike, utc: Utc, mask: ArrayLike | None, sigma_px: float | None) -> CalibrationFrame:
    """Detect stars in the image; `sigma_px`, if given, is their width."""
    detections = detect(image, mask, DetectionConfig(psf_sigma_px=sigma_px))
    assert detections.shape is not None
    return CalibrationFrame(detections, utc, detections.shape[::-1])


def _found(frame: CalibrationFrame, sky: Sky, passes: tuple[Pass, ...]) -> FoundCamera | None:
    """Identify the middle of the frame and extend the lens outwards; None if that fails."""
    start = find_start(frame, sky, passes)
    if start is None:
        return None
    if is_narrow(start.camera):
        sky = whole_sky(frame.utc, DEEP_MAG)
    fit, _ = lens_outwards(frame, sky, start, grow(frame, sky, start))
    if fit is None:
        return None
    scatter = scatter_px(fit)
    if not follows(fit, frame):
        raise NothingNamedError(
            f"{len(fit.seen)} stars are identified near the middle, but no lens follows them outwards "
            f"({scatter:.1f} px): is the picture cut from one side of a larger one, put together of several, or of pixels "
            "that are not square?"
        )
    camera = fit.bundle.form.camera(fit.bundle.values, frame.size)
    return FoundCamera(camera, fit.bundle.rotations[0], frame.detections, len(fit.seen), scatter)
