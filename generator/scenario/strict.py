"""Types shared by all parts of a scenario: the strict base model, fractions, curves, and files beside the scenario."""

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

QE_CURVES: dict[str, tuple[tuple[float, float], ...]] = {
    "cmos-mono": (
        (350, 0.30), (400, 0.58), (450, 0.74), (500, 0.81), (550, 0.80), (600, 0.74), (650, 0.65), (700, 0.54),
        (750, 0.43), (800, 0.33), (850, 0.24), (900, 0.16), (950, 0.09), (1000, 0.04),
    ),
    "cmos-red": (
        (350, 0.02), (400, 0.03), (450, 0.02), (500, 0.03), (550, 0.05), (575, 0.16), (590, 0.52), (600, 0.60),
        (625, 0.58), (650, 0.53), (675, 0.45), (690, 0.22), (700, 0.08), (710, 0.02), (720, 0),
    ),
    "cmos-green": (
        (350, 0.02), (400, 0.03), (450, 0.08), (475, 0.24), (500, 0.50), (525, 0.65), (540, 0.66), (550, 0.63),
        (575, 0.44), (600, 0.17), (625, 0.07), (650, 0.06), (675, 0.08), (690, 0.05), (700, 0.02), (720, 0),
    ),
    "cmos-blue": (
        (350, 0.05), (390, 0.20), (400, 0.32), (425, 0.50), (450, 0.58), (475, 0.50), (500, 0.26), (525, 0.10),
        (550, 0.04), (600, 0.02), (650, 0.02), (690, 0.02), (720, 0),
    ),
}  # fmt: skip
"""Named quantum efficiencies, skybench's own: ``cmos-mono`` a generic back-illuminated monochrome CMOS, the others its
Bayer filters behind an infrared cut-off at 700 nm."""


class InputFile(Strict):
    """A file that a scenario names: its path relative to the scenario's folder, and the hash of its bytes."""

    path: str
    """Relative to the scenario's folder, which it may not leave."""
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
    folder = Path(context.get("folder", ".")).resolve()
    location = (folder / value).resolve()
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
"""One every 1.5 nm over the widest range."""


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
    """Points of a curve in a CSV file with the columns CURVE_COLUMNS."""
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
