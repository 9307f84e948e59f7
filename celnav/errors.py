"""Errors that celnav raises for input that it cannot use.

A frame without a solution is not an error: the solver returns a `Fix` with ``ok=False`` and a reason. An error means that the
input itself is malformed; its message is one line that says what is wrong and what to do.
"""


class CelnavError(ValueError):
    """Base class of every error that celnav raises deliberately."""


class CameraError(CelnavError):
    """The camera description is malformed, or does not fit the detections or the image."""


class AttitudeError(CelnavError):
    """The attitude is not a rotation, or its uncertainties are invalid."""


class TimeError(CelnavError):
    """The time is not an unambiguous UTC time."""


class EarthRotationError(CelnavError):
    """The Earth's orientation is not known for the requested time."""


class DetectionError(CelnavError):
    """Detections (positions, fluxes) are malformed."""


class ImageError(CelnavError):
    """The image is missing, truncated, too large, or of a type that celnav does not read."""


class CatalogError(CelnavError):
    """The star catalogue cannot be read, or a requested star is not in it."""


class ConfigError(CelnavError):
    """The solver does not exist, or an option has a value out of range."""


class CalibrationError(CelnavError):
    """The frames do not determine the camera, or a calibration read from a file is invalid."""
