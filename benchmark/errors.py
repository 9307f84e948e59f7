"""Errors of the benchmark that its user can correct.

Every error says which file or name is meant and what to do about it. The command line prints it on one line and exits with
status 2.
"""


class BenchmarkError(Exception):
    """Base class of all errors that the user can correct."""


class DatasetError(BenchmarkError):
    """The dataset folder is missing, unfinished, damaged or contradicts itself."""


class UnknownSolverError(BenchmarkError):
    """No solver of that name is registered."""


class ResultsError(BenchmarkError):
    """The results folder is empty, damaged, or holds results that do not belong together."""


class TaskError(BenchmarkError):
    """A task does not exist, or its files or frames are invalid."""


class SolverError(BenchmarkError):
    """A solver cannot be started here: its folder, its extra or its environment is missing."""


class PhotographError(BenchmarkError):
    """A photograph cannot be read, or its twin cannot be made."""


class RoundError(BenchmarkError):
    """A round's secret, rules, commitment or frames are missing, wrong or do not belong together."""
