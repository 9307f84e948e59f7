"""The option ``--sigma``: standard deviations of time, lens and air."""

from __future__ import annotations

from celnav.checking import shown
from celnav.errors import ConfigError
from celnav.problem import ToldSigmas

_FIELDS = {
    "time": "utc_s",
    "focal": "focal",
    "centre": "centre_px",
    "pressure": "pressure_hpa",
    "temperature": "temperature_c",
    "distortion": "distortion",
}


def read_sigmas(text: str | None) -> ToldSigmas:
    """Read the option's value, such as ``time=0.5,focal=0.001,centre=1,pressure=2,temperature=2,distortion=0.01``.

    The units are seconds, a fraction of the focal length, pixels, hPa, K, and k1. Values that are not named are 0; None names
    nothing.

    Raises
    ------
    ConfigError
        When a name is unknown or repeated, or a value is not a number or out of range.
    """
    values: dict[str, float] = {}
    for part in text.split(",") if text is not None else ():
        name, _, value = (piece.strip() for piece in part.partition("="))
        if name not in _FIELDS or _FIELDS[name] in values:
            raise ConfigError(f"--sigma {shown(text)}: {name!r} must be one of {', '.join(_FIELDS)}, each at most once")
        try:
            values[_FIELDS[name]] = float(value)
            ToldSigmas(**{_FIELDS[name]: values[_FIELDS[name]]})
        except ConfigError as error:
            reason = str(error).partition(f"{_FIELDS[name]} = ")[2]
            raise ConfigError(f"--sigma {shown(text)}: {name} = {reason}") from None
        except ValueError:
            raise ConfigError(f"--sigma {shown(text)}: {name} = {value!r} must be a number") from None
    return ToldSigmas(**values)
