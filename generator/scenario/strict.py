"""Types shared by all parts of a scenario: the strict base model, fractions, curves, and files next to the scenario."""

from __future__ import annotations

import hashlib
import itertools
import stat
from pathlib import Path
from typing import Annotated

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
)

from generator.csv_table import read_csv
from generator.scenario.quantum_efficiency import QE_CURVES

LARGEST_INPUT_BYTES = 200_000_000


class Strict(BaseModel):
    """Base of all parts: frozen, no unknown keys, no conversion of types except integer to float."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


Fraction = Annotated[float, Field(ge=0, le=1)]


def listed(value: object) -> object:
    """Convert YAML's lists into tuples, which frozen models need."""
    return tuple(listed(item) for item in value) if isinstance(value, list) else value


Numbers = Annotated[tuple[float, ...], Field(max_length=32), BeforeValidator(listed)]
"""A short list of numbers."""


class InputFile(Strict):
    """A file that a scenario names: its path relative to the scenario's folder, and the hash of its bytes."""

    path: str
    """Path relative to the scenario's folder, which it may not leave."""
    sha256: str
    """Hash of the file's bytes; part of the scenario's own hash."""
    location: Annotated[str, Field(exclude=True)]
    """Path on this machine."""

    def __hash__(self) -> int:
        return hash((self.path, self.sha256))


def _opened(value: object, info: ValidationInfo) -> object:
    if not isinstance(value, str):
        return value
    context = info.context or {}
    try:
        folder = Path(context.get("folder", ".")).resolve()
        location = (folder / value).resolve()
    except (OSError, RuntimeError) as error:  # Python up to 3.12 raises RuntimeError for circular links
        raise ValueError(f"found {value!r}, which cannot be read (a link that leads nowhere)") from error
    if Path(value).is_absolute() or not location.is_relative_to(folder):
        raise ValueError(f"found {value!r}, which leaves the scenario's folder")
    try:
        state = location.stat()
        size = state.st_size
        if not stat.S_ISREG(state.st_mode):
            raise ValueError(f"found {value!r}, which cannot be read (not a regular file)")
        if size > LARGEST_INPUT_BYTES:
            raise ValueError(f"found {value!r}, {size} bytes; at most {LARGEST_INPUT_BYTES} are read")
        digest = hashlib.sha256(location.read_bytes()).hexdigest()
    except OSError as error:
        raise ValueError(f"found {value!r}, which cannot be read ({error.strerror})") from error
    file = InputFile(path=value, sha256=digest, location=str(location))
    if "files" in context:
        context["files"].append(file)
    return file


File = Annotated[InputFile, BeforeValidator(_opened)]
"""A file name in a scenario. Validation looks for it in the context's ``folder`` and adds it to the context's ``files``."""

CURVE_COLUMNS = ("wavelength_nm", "quantum_efficiency")
MOST_CURVE_POINTS = 2000
"""Enough for one point every 1.5 nm over the widest range."""


def _named_curve(value: object, info: ValidationInfo) -> object:
    if not isinstance(value, str):
        return listed(value)
    if value in QE_CURVES:
        return QE_CURVES[value]
    if value.endswith(".csv"):
        return _curve_from_file(value, info)
    raise ValueError(
        f"{value!r} is not one of the named curves {sorted(QE_CURVES)}, a .csv file, nor a list of [nm, 0-1]"
    )


def _curve_from_file(name: str, info: ValidationInfo) -> tuple[tuple[float, ...], ...]:
    """Read the points of a curve from a CSV file with the columns CURVE_COLUMNS."""
    file = _opened(name, info)
    assert isinstance(file, InputFile)
    table = read_csv(Path(file.location), name, CURVE_COLUMNS, least_rows=2, most_rows=MOST_CURVE_POINTS)
    return tuple(tuple(row) for row in table.values.tolist())


def increasing(curve: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """Check that the first numbers of a curve's points increase."""
    if any(after[0] <= before[0] for before, after in itertools.pairwise(curve)):
        raise ValueError("wavelengths must increase")
    return curve


Curve = Annotated[
    tuple[tuple[Annotated[float, Field(ge=100, le=3000)], Fraction], ...],
    Field(min_length=2, max_length=MOST_CURVE_POINTS),
    AfterValidator(increasing),
    BeforeValidator(_named_curve),
]
