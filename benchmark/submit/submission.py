"""Answers of a solver that ran elsewhere: one file, CSV or Parquet, checked line by line before use.

A submission is untrusted. It is read as data only. Size, number of lines, and length of lines and cells are limited. Of its
content only identifiers and numbers of the expected form are printed or stored. docs/submissions.md documents the format.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmark.judge.answers import FARTHEST_PX, LARGEST_COVARIANCE_KM2, is_covariance
from benchmark.stats.metrics import ERROR, FIX, REFUSED
from benchmark.submit.cells import Cell, CellTable, read_cells, shown

LARGEST_FRAMES = 200_000
LARGEST_STAR_ROWS = 1_000_000
LARGEST_DETECTIONS_OF_A_FRAME = 100_000
LONGEST_TIME_MS = 1e9
MAX_PROBLEMS = 1000

FRAME_COLUMNS = ("frame_id", "status", "lat_deg", "lon_deg", "cov_ee", "cov_en", "cov_nn", "confidence", "time_ms")
REQUIRED_FRAME_COLUMNS = ("frame_id", "status", "lat_deg", "lon_deg")
STAR_COLUMNS = ("frame_id", "u_px", "v_px", "star_id")
STATUSES = (FIX, REFUSED, ERROR)

_FRAME_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_NUMBER = re.compile(r"[+-]?(?:[0-9]{1,30}(?:\.[0-9]{0,60})?|\.[0-9]{1,60})(?:[eE][+-]?[0-9]{1,3})?")
_INTEGER = re.compile(r"[+-]?[0-9]{1,10}(?:\.0{0,30})?")


@dataclass(frozen=True)
class Problem:
    """A fault of a submission.

    Attributes
    ----------
    line : int
        Line of a CSV file, where the header is line 1; row of a Parquet file, from 1; 0 for the file as a whole.
    column : str
        Empty where the whole line is meant.
    reason : str
        The fault and the expected form; printable characters only.
    """

    line: int
    column: str
    reason: str

    def __str__(self) -> str:
        """Format the problem as a compiler would: line, column, reason."""
        where = ": ".join(part for part in (f"line {self.line}" if self.line else "", self.column) if part)
        return f"{where}: {self.reason}" if where else self.reason


@dataclass(frozen=True)
class FrameAnswer:
    """A submission's answer to one frame; None where a cell is empty. Units as in docs/submissions.md."""

    frame_id: str
    status: str
    lat_deg: float | None
    lon_deg: float | None
    cov_km2: tuple[float, float, float] | None
    confidence: float | None
    time_ms: float | None


@dataclass(frozen=True)
class StarRow:
    """One detection in a frame and the star as which it is identified; `star_id` is None where it is not identified."""

    frame_id: str
    u_px: float
    v_px: float
    star_id: int | None


@dataclass(frozen=True)
class Checked:
    """The readable part of a submission.

    Attributes
    ----------
    answers : tuple of FrameAnswer
        Answers of the lines without a problem.
    stars : mapping of str to tuple of StarRow
        By frame; empty without a star table.
    problems : tuple of Problem
        Empty where the submission is valid.
    """

    answers: tuple[FrameAnswer, ...]
    stars: Mapping[str, tuple[StarRow, ...]]
    problems: tuple[Problem, ...]


class Notes:
    """Problems in the order in which they are found, up to a limit."""

    def __init__(self) -> None:
        self.found: list[Problem] = []
        self.left_out = 0

    def add(self, line: int, column: str, reason: str) -> None:
        """Add a problem."""
        if len(self.found) < MAX_PROBLEMS:
            self.found.append(Problem(line, column, reason))
        else:
            self.left_out += 1

    def all(self) -> tuple[Problem, ...]:
        """Return the problems in the order of the lines, those of the file first."""
        ordered = sorted(self.found, key=lambda problem: problem.line)
        if self.left_out:
            ordered.append(Problem(0, "", f"and {self.left_out} more problems"))
        return tuple(ordered)


def check_answers(path: Path, frame_ids: Collection[str] | None = None) -> Checked:
    """Read and check the file of answers.

    Parameters
    ----------
    path : Path
        CSV or Parquet, distinguished by its first bytes.
    frame_ids : collection of str, optional
        The frames that must be answered, each once; without them only the form of ids is checked.
    """
    notes = Notes()
    answers: dict[str, FrameAnswer] = {}
    first_line: dict[str, int] = {}
    table = _table(path, FRAME_COLUMNS, REQUIRED_FRAME_COLUMNS, LARGEST_FRAMES, notes)
    for line, row in table.rows if table else ():
        before = len(notes.found) + notes.left_out
        frame_id = _identifier(row, line, notes, frame_ids)
        if frame_id is not None and frame_id in first_line:
            notes.add(
                line, "frame_id", f"{frame_id} was answered on line {first_line[frame_id]}; answer each frame once"
            )
        elif frame_id is not None:
            first_line[frame_id] = line
        answer = _answer(row, line, notes)
        if answer is not None and frame_id is not None and len(notes.found) + notes.left_out == before:
            answers[frame_id] = FrameAnswer(frame_id, *answer)
    if frame_ids is not None and table is not None:
        missing = sorted(set(frame_ids) - set(first_line))
        for frame_id in missing[:20]:
            notes.add(0, "frame_id", f"{frame_id} is missing; give it the status {REFUSED} where there is no answer")
        if len(missing) > 20:
            notes.add(0, "frame_id", f"and {len(missing) - 20} more frames are missing")
    return Checked(tuple(answers.values()), {}, notes.all())


def check_stars(path: Path, frame_ids: Collection[str] | None = None) -> Checked:
    """Read and check a star table: detections, and the stars that they are identified as.

    Parameters
    ----------
    path : Path
    frame_ids : collection of str, optional
        The frames that exist.
    """
    notes = Notes()
    stars: dict[str, list[StarRow]] = {}
    table = _table(path, STAR_COLUMNS, STAR_COLUMNS, LARGEST_STAR_ROWS, notes)
    for line, row in table.rows if table else ():
        frame_id = _identifier(row, line, notes, frame_ids)
        places = [_number(row, name, line, notes, -FARTHEST_PX, FARTHEST_PX, needed=True) for name in ("u_px", "v_px")]
        star_id = _integer(row, "star_id", line, notes)
        if frame_id is None or places[0] is None or places[1] is None:
            continue
        of_frame = stars.setdefault(frame_id, [])
        if len(of_frame) >= LARGEST_DETECTIONS_OF_A_FRAME:
            notes.add(line, "", f"{frame_id} has more than {LARGEST_DETECTIONS_OF_A_FRAME} detections")
            continue
        of_frame.append(StarRow(frame_id, places[0], places[1], star_id))
    return Checked((), {frame_id: tuple(rows) for frame_id, rows in stars.items()}, notes.all())


def _table(
    path: Path, columns: tuple[str, ...], required: Iterable[str], max_rows: int, notes: Notes
) -> CellTable | None:
    table = read_cells(path, columns, max_rows, notes.add)
    if table is None:
        return None
    absent = [name for name in required if name not in table.columns]
    for name in absent:
        notes.add(1, name, f"column is missing; expected {', '.join(columns)}")
    return None if absent else table


def _identifier(row: Mapping[str, Cell], line: int, notes: Notes, frame_ids: Collection[str] | None) -> str | None:
    text = row.get("frame_id")
    if not isinstance(text, str) or not _FRAME_ID.fullmatch(text):
        notes.add(line, "frame_id", f"found {shown(text)}, expected letters, digits and . _ - only, at most 100")
        return None
    if frame_ids is not None and text not in frame_ids:
        notes.add(line, "frame_id", f"{text} is not a frame of this set")
        return None
    return text


_Answer = tuple[str, float | None, float | None, tuple[float, float, float] | None, float | None, float | None]


def _answer(row: Mapping[str, Cell], line: int, notes: Notes) -> _Answer | None:
    status = row.get("status")
    if status not in STATUSES:
        notes.add(line, "status", f"found {shown(status)}, expected {', '.join(STATUSES)}")
        return None
    assert isinstance(status, str)
    fix = status == FIX
    lat = _number(row, "lat_deg", line, notes, -90.0, 90.0, needed=fix)
    lon = _number(row, "lon_deg", line, notes, -360.0, 360.0, needed=fix)
    limit = LARGEST_COVARIANCE_KM2
    ee = _number(row, "cov_ee", line, notes, 0.0, limit)
    en = _number(row, "cov_en", line, notes, -limit, limit)
    nn = _number(row, "cov_nn", line, notes, 0.0, limit)
    confidence = _number(row, "confidence", line, notes, 0.0, 1.0)
    time_ms = _time(row, line, notes)
    covariance = None
    given = [row.get(name) not in (None, "") for name in ("cov_ee", "cov_en", "cov_nn")]
    if any(given) and not all(given):
        notes.add(line, "cov_ee", "give cov_ee, cov_en and cov_nn together, or none of them")
    elif ee is not None and en is not None and nn is not None:
        if not is_covariance(ee, en, nn):
            notes.add(line, "cov_en", "no covariance has cov_en^2 above cov_ee cov_nn")
        covariance = (ee, en, nn)
    if not fix:
        said = [name for name in ("lat_deg", "lon_deg") if row.get(name) not in (None, "")]
        if said:
            notes.add(line, said[0], f"a frame of status {status} has no position; leave it empty")
        return status, None, None, None, confidence, time_ms
    return status, lat, lon, covariance, confidence, time_ms


def _number(
    row: Mapping[str, Cell], column: str, line: int, notes: Notes, low: float, high: float, needed: bool = False
) -> float | None:
    value = _parsed(row.get(column), _NUMBER, float)
    if value is None:
        if needed:
            notes.add(line, column, "is empty, expected a number")
        return None
    if isinstance(value, str) or not math.isfinite(value):
        notes.add(line, column, f"found {shown(row.get(column))}, expected a finite decimal number")
        return None
    if not low <= value <= high:
        notes.add(line, column, f"found {value:.6g}, expected {low:g} to {high:g}")
        return None
    return float(value)


def _time(row: Mapping[str, Cell], line: int, notes: Notes) -> float | None:
    """Time of an answer, ms; a claimed 0 is no measurement, and would rank before every solver that was timed."""
    value = _number(row, "time_ms", line, notes, -math.inf, math.inf)
    if value is not None and not 0.0 < value <= LONGEST_TIME_MS:
        expected = f"above 0, at most {LONGEST_TIME_MS:g}, or nothing where the time was not measured"
        notes.add(line, "time_ms", f"found {value:.6g}, expected {expected}")
        return None
    return value


def _integer(row: Mapping[str, Cell], column: str, line: int, notes: Notes) -> int | None:
    value = _parsed(row.get(column), _INTEGER, float)
    if value is None:
        return None
    if isinstance(value, str) or value != int(value) or not -(2**31) <= value < 2**31:
        notes.add(line, column, f"found {shown(row.get(column))}, expected an integer of 32 bits, or nothing")
        return None
    return int(value)


def _parsed(cell: Cell, form: re.Pattern[str], convert: Callable[[str], float]) -> float | str | None:
    """Parse the number in a cell; None where it is empty; its text, or NaN, where it is not a number."""
    if cell is None:
        return None
    if isinstance(cell, str):
        text = cell.strip(" ")
        if not text:
            return None
        return convert(text) if form.fullmatch(text) else text
    return math.nan if isinstance(cell, float) and not math.isfinite(cell) else cell
