"""Errors of the generator. The type says what the user can change: scenario, data files, time or installation."""

from __future__ import annotations


class GeneratorError(Exception):
    """Base of the generator's errors. The message is one line, or a short list, and names the remedy."""


class ScenarioError(GeneratorError):
    """A scenario file is not acceptable; the message names the file, the key, what was found and what is allowed."""


class DataFileError(GeneratorError):
    """A data file of the generator is missing, truncated or in another format."""


class TimeRangeError(GeneratorError):
    """A time is outside the Earth orientation table."""


class RuntimeUnavailableError(GeneratorError):
    """Mitsuba cannot run here; the message says what is missing and how to get it."""
