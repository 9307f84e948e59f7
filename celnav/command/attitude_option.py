"""The option ``--attitude``: a name, angles, or a file."""

from __future__ import annotations

import re

from celnav.attitude import Attitude
from celnav.command.checks.remedies import ATTITUDE_KEYS
from celnav.command.pointing import Pointing
from celnav.errors import AttitudeError
from celnav.sky.utc import parse_utc

# The accelerometers in eight published photographs have an rms error of 10 thousandths of g along each axis.
GRAVITY_SIGMA_DEG = 0.6
_GRAVITY = re.compile(r"\s*exif\s*(?:,\s*tilt_sigma\s*=\s*(?P<sigma>[^,]+))?")
_NAMED_WITH_MORE = re.compile(r"\s*zenith(-north-up)?\s*,")
_ANGLES = re.compile(r"\s*(" + "|".join(ATTITUDE_KEYS) + r")\s*=")


def read_attitude(text: str, up: tuple[float, float, float] | None = None, utc: str | None = None) -> Attitude | None:
    """Read the option's value.

    Parameters
    ----------
    text : str
        ``unknown``; ``zenith-north-up``; ``zenith``; ``exif``, the vertical of the image's maker note, with ``,tilt_sigma=``
        if it is not GRAVITY_SIGMA_DEG; angles in degrees such as ``azimuth=120,altitude=45,roll=3``, with ``tilt_sigma``
        and ``heading_sigma`` if they are uncertain; or the name of a JSON file with `R_cam`. Without an azimuth, the heading
        is unknown.
    up : tuple of float, optional
        Direction of the zenith in the camera frame, from the image's tags.
    utc : str, optional
        Middle of the exposure, the time for which the attitude of a calibration is predicted.

    Returns
    -------
    Attitude or None
        The attitude; None if nothing is known.

    Raises
    ------
    AttitudeError
        When the value has none of these forms, an angle is out of range, or the tags have no vertical.
    """
    if text == "unknown":
        return None
    if text == "zenith-north-up":
        return Attitude.zenith_north_up()
    if text == "zenith":
        return Attitude.up([0.0, 0.0, 1.0])
    gravity = _GRAVITY.fullmatch(text)
    if gravity is not None:
        if up is None:
            raise AttitudeError(
                "--attitude exif: the image has no maker note with an accelerometer at rest (Apple's AccelerationVector, of "
                "the rear camera, in a file as the telephone wrote it): give --attitude altitude=45,roll=0"
            )
        return Attitude.up(
            up, GRAVITY_SIGMA_DEG if gravity["sigma"] is None else _degrees(text, "tilt_sigma", gravity["sigma"])
        )
    if _NAMED_WITH_MORE.match(text) is not None:
        raise AttitudeError(
            f"--attitude {text}: a name takes no sigmas; write angles, such as altitude=90,tilt_sigma=1 for zenith and "
            "azimuth=180,altitude=90,tilt_sigma=1,heading_sigma=1 for zenith-north-up"
        )
    if _ANGLES.match(text) is None:
        try:
            if utc is None:
                return Attitude.from_json(text)
            from celnav.calibrating.mount_times import read_attitude_at

            return read_attitude_at(text, parse_utc(utc))
        except RecursionError:
            raise AttitudeError(f"attitude file {text} is nested too deep") from None
        except AttitudeError as error:
            if isinstance(error.__context__, RecursionError):
                raise AttitudeError(f"attitude file {text} is nested too deep") from None
            named = str(error) if text in str(error) else f"attitude file {text}: {error}"
            raise AttitudeError(named) from None
    angles = _angles(text)
    if "altitude" not in angles:
        raise AttitudeError(f"--attitude {text}: the altitude of the boresight is missing, such as altitude=45")
    pointing = Pointing(angles.get("azimuth", 0.0), angles["altitude"], angles.get("roll", 0.0))
    tilt = angles.get("tilt_sigma", 0.0)
    if "azimuth" not in angles:
        if "heading_sigma" in angles:
            raise AttitudeError(f"--attitude {text}: heading_sigma needs an azimuth")
        return Attitude.up(pointing.R_cam[:, 2], tilt)
    if tilt > 0 and "heading_sigma" not in angles:
        raise AttitudeError(
            f"--attitude {text}: a tilt_sigma beside an azimuth needs a heading_sigma too, or the heading would count as "
            "exact; where it is not known leave the azimuth out"
        )
    return Attitude.with_sigma(pointing.R_cam, tilt_deg=tilt, heading_deg=angles.get("heading_sigma", 0.0))


def is_of_gravity(text: str) -> bool:
    """Return whether the option's value asks for the vertical of a telephone's accelerometer."""
    return _GRAVITY.fullmatch(text) is not None


def _angles(text: str) -> dict[str, float]:
    angles: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = (piece.strip() for piece in part.partition("="))
        if name not in ATTITUDE_KEYS or name in angles:
            raise AttitudeError(
                f"--attitude {text}: {name!r} must be one of {', '.join(ATTITUDE_KEYS)}, each at most once"
            )
        angles[name] = _degrees(text, name, value)
    return angles


def _degrees(text: str, name: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise AttitudeError(f"--attitude {text}: {name} = {value!r} must be a number of degrees") from None
