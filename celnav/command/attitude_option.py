"""The option ``--attitude``: a name, angles, or a file."""

from __future__ import annotations

import re

from celnav.attitude import Attitude
from celnav.command.pointing import Pointing
from celnav.errors import AttitudeError

_KEYS = ("azimuth", "altitude", "roll", "tilt_sigma", "heading_sigma")
_ANGLES = re.compile(r"\s*(" + "|".join(_KEYS) + r")\s*=")


def read_attitude(text: str) -> Attitude | None:
    """Read the option's value.

    Parameters
    ----------
    text : str
        ``unknown``; ``zenith-north-up``; ``zenith``; angles in degrees such as ``azimuth=120,altitude=45,roll=3``, with
        ``tilt_sigma`` and ``heading_sigma`` where they are uncertain; or the name of a JSON file with `R_cam`. Without an
        azimuth the heading is unknown.

    Returns
    -------
    Attitude or None
        None where nothing is known.

    Raises
    ------
    AttitudeError
        When the value is none of these, or an angle is out of range.
    """
    if text == "unknown":
        return None
    if text == "zenith-north-up":
        return Attitude.zenith_north_up()
    if text == "zenith":
        return Attitude.up([0.0, 0.0, 1.0])
    if _ANGLES.match(text) is None:
        return Attitude.from_json(text)
    angles = _angles(text)
    if "altitude" not in angles:
        raise AttitudeError(f"--attitude {text}: the altitude of the boresight is missing, such as altitude=45")
    pointing = Pointing(angles.get("azimuth", 0.0), angles["altitude"], angles.get("roll", 0.0))
    tilt = angles.get("tilt_sigma", 0.0)
    if "azimuth" not in angles:
        if "heading_sigma" in angles:
            raise AttitudeError(f"--attitude {text}: heading_sigma needs an azimuth")
        return Attitude.up(pointing.R_cam[:, 2], tilt)
    return Attitude.with_sigma(pointing.R_cam, tilt_deg=tilt, heading_deg=angles.get("heading_sigma", 0.0))


def _angles(text: str) -> dict[str, float]:
    angles: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = (piece.strip() for piece in part.partition("="))
        if name not in _KEYS or name in angles:
            raise AttitudeError(f"--attitude {text}: {name!r} must be one of {', '.join(_KEYS)}, each at most once")
        try:
            angles[name] = float(value)
        except ValueError:
            raise AttitudeError(f"--attitude {text}: {name} = {value!r} must be a number of degrees") from None
    return angles
