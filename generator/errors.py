"""What can go wrong in the generator, as types that say whose move it is."""

from __future__ import annotations


class GeneratorError(Exception):
    """Base of the generator's errors. The message is one line (or a short list) for a person to act upon."""


class ScenarioError(GeneratorError):
    """A scenario file is not acceptable: names the file, the key, what was found and what is allowed."""


class DataFileError(GeneratorError):
    """A data file that the generator needs is missing, truncated or of another kind."""


class TimeRangeError(GeneratorError):
    """A time lies outside the Earth orientation table."""


class RuntimeUnavailableError(GeneratorError):
    """Mitsuba cannot run here; the message says what is missing and how to get it."""
