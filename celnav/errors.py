"""Errors that celnav raises for input it cannot work with.

A frame that holds no answer is not an error: the solver returns a `Fix` with ``ok=False`` and a reason. An error means
that the question itself is malformed; its message is one line that names what is wrong and what to do.
"""


class CelnavError(ValueError):
    """Base of every error that celnav raises on purpose."""


class CameraError(CelnavError):
    """The camera description is malformed, or does not fit the detections or the image."""


class AttitudeError(CelnavError):
    """The attitude is not a rotation, or its uncertainties make no sense."""


class TimeError(CelnavError):
    """The time is not an unambiguous UTC."""


class EarthRotationError(CelnavError):
    """The Earth's orientation is not known for the time asked for."""


class DetectionError(CelnavError):
    """Detections (positions, fluxes) are malformed."""


class ImageError(CelnavError):
    """The image is missing, truncated, too large, or of a kind that celnav does not read."""


class CatalogError(CelnavError):
    """The star catalogue cannot be read, or a star that was asked for is not in it."""


class ConfigError(CelnavError):
    """A solver that does not exist, or an option with a value out of range."""


class CalibrationError(CelnavError):
    """The frames do not determine the camera, or a calibration that is read makes no sense."""
