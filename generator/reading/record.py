"""The schema of the frame record (docs/dataset_format.md): the keys that readers use, and their allowed values.

Keys that only some readers use may be missing, because records of earlier versions and of other generators lack them; if
present, they must have the right type. Other keys are ignored.
"""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from generator.errors import GeneratorError
from generator.reading.json_text import strict_json

FORMAT = "skybench-frame/1"
LARGEST_RECORD_BYTES = 8_000_000
"""Limit of a record; one with thousands of attitude samples and measured curves of its sensor is below 2 MB."""
LARGEST_SIDE_PX = 16384
"""Largest side of an image; a scenario's camera has no more (generator/scenario/camera_spec.py)."""
_UTC = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}(\.[0-9]{1,12})?Z")


def _utc(text: str) -> str:
    if not _UTC.fullmatch(text):
        raise ValueError("must be UTC with a trailing Z")
    return text


def _matrix(rows: list[list[float]]) -> list[list[float]]:
    if len(rows) != 3 or any(len(row) != 3 for row in rows):
        raise ValueError("must be 3 rows of 3 numbers")
    return rows


Text = Annotated[str, Field(min_length=1, max_length=1000)]
Utc = Annotated[Text, AfterValidator(_utc)]
Matrix = Annotated[list[list[float]], AfterValidator(_matrix)]
Coefficients = Annotated[list[float], Field(max_length=32)]
Count = Annotated[int, Field(ge=0, le=2**31 - 1)]
Side = Annotated[int, Field(ge=1, le=LARGEST_SIDE_PX)]


class Section(BaseModel):
    """A part of a record: numbers must be finite, nothing is converted, and unknown keys are ignored."""

    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False)


class ScenarioSection(Section):
    """``scenario``."""

    name: Text
    sha256: Text


class SiteSection(Section):
    """``site``."""

    latitude_deg: float
    longitude_deg: float
    height_m: float | None = None
    ground_height_m: float | None = None


class TimeSection(Section):
    """``time``."""

    utc_mid: Utc
    utc_start: Utc | None = None
    exposure_s: float
    ut1_utc_s: float | None = None
    polar_motion_x_arcsec: float | None = None
    polar_motion_y_arcsec: float | None = None


class CameraSection(Section):
    """``camera``."""

    model: Text
    width: Side
    height: Side
    f_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k: Coefficients
    p: Coefficients
    s: Coefficients | None = None
    tilt_rad: Coefficients | None = None


class AttitudeSection(Section):
    """``attitude``."""

    R_cam: Matrix
    azimuth_deg: float | None = None
    altitude_deg: float | None = None
    roll_deg: float | None = None
    sample_time_s: list[float] | None = None
    sample_matrices: list[Matrix] | None = Field(default=None, alias="sample_R_cam")
    tilt_sigma_deg: float | None = None
    heading_sigma_deg: float | None = None


class ToldSection(Section):
    """``told``."""

    camera: CameraSection
    attitude: AttitudeSection


class SequenceSection(Section):
    """``sequence``."""

    index: Count | None = None
    step: Count | None = None


class OpticsSection(Section):
    """``optics``."""

    psf_sigma_px: float | None = None


class SensorSection(Section):
    """``sensor``."""

    bits: Annotated[int, Field(ge=1, le=16)] | None = None
    gain_e_per_dn: float | None = None
    black_level_dn: float | None = None
    bayer_pattern: Text | None = None


class AtmosphereSection(Section):
    """``atmosphere``."""

    pressure_hpa: float | None = None
    temperature_c: float | None = None
    relative_humidity: float | None = None
    aerosol_tau_550: float | None = None
    refraction: bool | None = None


class SkySection(Section):
    """``sky``."""

    bortle: Count | None = None
    horizon_altitude_deg: float | None = None
    zenith_mag_arcsec2: float | None = None
    sun_altitude_deg: float | None = None
    moon_altitude_deg: float | None = None
    moon_phase_angle_deg: float | None = None


class StarsSection(Section):
    """``stars``."""

    n_in_field: Count
    n_visible: Count | None = None
    limiting_magnitude: float | None = None


class FrameRecord(Section):
    """A frame record."""

    frame_id: Annotated[str, Field(pattern=r"^frame-[0-9]{5,8}$")]
    index: Count
    scenario: ScenarioSection
    site: SiteSection
    time: TimeSection
    camera: CameraSection
    attitude: AttitudeSection
    told: ToldSection | None = None
    sequence: SequenceSection | None = None
    optics: OpticsSection | None = None
    sensor: SensorSection | None = None
    atmosphere: AtmosphereSection
    sky: SkySection
    stars: StarsSection
    provenance: dict[str, Any] | None = None


_WANTED = {
    "bool_type": "true or false",
    "dict_type": "an object",
    "finite_number": "a finite number",
    "float_type": "a finite number",
    "int_type": "an integer",
    "list_type": "a list of finite numbers",
    "model_type": "an object",
    "string_too_short": "a text",
    "string_type": "a text",
}


def read_record(data: bytes | str, name: str, frame_id: str = "") -> dict[str, Any]:
    """Parse and check a frame record.

    Parameters
    ----------
    data : bytes or str
        JSON.
    name : str
        Name of the file, and of the frame in it, for messages.
    frame_id : str
        Frame to which the record belongs according to its file name; empty accepts any frame.

    Returns
    -------
    dict
        Record as stored.

    Raises
    ------
    GeneratorError
        The data are not a frame record; the message names the key.
    """
    found = strict_json(data, name, LARGEST_RECORD_BYTES)
    if not isinstance(found, dict):
        raise GeneratorError(f"{name}: expected one JSON object, found a {type(found).__name__}")
    if found.get("format") != FORMAT:
        raise GeneratorError(f"{name}: format is {str(found.get('format'))[:100]!r}, this version reads {FORMAT!r}")
    try:
        FrameRecord.model_validate(found)
    except ValidationError as error:
        raise GeneratorError(f"{name}: {_problem(error)} (docs/dataset_format.md)") from error
    if frame_id and found["frame_id"] != frame_id:
        raise GeneratorError(f"{name}: frame_id is {found['frame_id']!r}, its name says {frame_id!r}")
    return found


def image_shape(record: dict[str, Any]) -> tuple[int, int]:
    """Height and width (px) of a checked record's image."""
    return record["camera"]["height"], record["camera"]["width"]


def _problem(error: ValidationError) -> str:
    """The first finding, with its key."""
    first = error.errors(include_url=False)[0]
    key, kind, found = ".".join(str(part) for part in first["loc"]), first["type"], repr(first["input"])[:100]
    if kind == "missing":
        return f"key {key} is missing"
    if kind == "value_error":
        return f"{key} {first['ctx']['error']}, found {found}"
    if kind == "greater_than_equal":
        return f"{key} must be at least {first['ctx']['ge']}, found {found}"
    if kind == "less_than_equal":
        return f"{key} must be at most {first['ctx']['le']}, found {found}"
    if kind in _WANTED:
        return f"{key} must be {_WANTED[kind]}, found {found}"
    return f"{key}: {first['msg'][0].lower()}{first['msg'][1:]}, found {found}"
