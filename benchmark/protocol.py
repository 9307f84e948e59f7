"""What a solver under test receives and what it returns.

This module separates solvers from the truth: an `Observation` holds everything that a solver may know about a frame, and
nothing of the truth.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

SIGMAS = (
    "utc_sigma_s",
    "focal_sigma",
    "principal_point_sigma_px",
    "distortion_sigma",
    "pressure_sigma_hpa",
    "temperature_sigma_c",
)
"""Standard deviations of the supplied quantities, other than those of the attitude."""


@dataclass(frozen=True)
class CameraRecord:
    """The `camera` object of a frame record (docs/dataset_format.md); lengths in px, centres at integers."""

    model: str
    width: int
    height: int
    f_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k: tuple[float, ...] = ()
    p: tuple[float, ...] = ()
    s: tuple[float, ...] = ()
    tilt_rad: tuple[float, ...] = ()

    def as_given(self) -> dict[str, Any]:
        """The camera as solvers receive it; thin prism and tilt only for a lens that has them, as in the frame record."""
        fields = dataclasses.asdict(self)
        return {name: value for name, value in fields.items() if value or name not in ("s", "tilt_rad")}


@dataclass(frozen=True)
class SequencePlace:
    """Place of a frame in a sequence: frames of one camera at one place, which solvers receive in order.

    The supplied lens, air and clock have the same errors in all of its frames; the error of the vertical is partly the same.

    Attributes
    ----------
    sequence_id : str
    index : int
        Counted from 0. A program may use what it learned from the frames before.
    length : int
        Number of frames in the sequence.
    tilt_bias_sigma_deg : float
        Standard deviation, about each of the camera's axes across its line of sight, of the part of the error of the vertical
        that is constant in the camera throughout the sequence. It is included in `Observation.tilt_sigma_deg`; the rest of
        the error is new in each frame.
    """

    sequence_id: str
    index: int
    length: int
    tilt_bias_sigma_deg: float

    def as_given(self) -> dict[str, Any]:
        """The place in the sequence as solvers receive it."""
        fields = dataclasses.asdict(self)
        return {"id": fields.pop("sequence_id"), **fields}


@dataclass(frozen=True)
class Observation:
    """What is known about a frame besides its image.

    Attributes
    ----------
    camera : CameraRecord
        The camera model.
    utc : str
        Mid-exposure, ISO 8601 with a trailing Z.
    R_cam : ndarray, shape (3, 3)
        Rotation from ENU to camera at mid-exposure, as far as it is known.
    tilt_sigma_deg : float
        Standard deviation of its vertical about each horizontal axis.
    heading_sigma_deg : float
        Standard deviation of its heading; infinite where the heading is not known.
    pressure_hpa, temperature_c : float
        Air at the observer, as measured by a barometer and a thermometer on board; pressure 0 means no refraction.
    utc_sigma_s : float
        Standard deviation of the time.
    focal_sigma : float
        Standard deviation of the focal length, relative.
    principal_point_sigma_px : float
        Standard deviation of each coordinate of the principal point.
    distortion_sigma : float
        Standard deviation of the lens's k1, where its distortion is not supplied.
    pressure_sigma_hpa, temperature_sigma_c : float
        Standard deviations of the air's pressure and temperature. All sigmas are 0 where the supplied value is exact.
    sequence : SequencePlace or None
        None for a frame that is not part of a sequence.
    """

    camera: CameraRecord
    utc: str
    R_cam: NDArray[np.float64]
    tilt_sigma_deg: float = 0.0
    heading_sigma_deg: float = 0.0
    pressure_hpa: float = 1010.0
    temperature_c: float = 10.0
    utc_sigma_s: float = 0.0
    focal_sigma: float = 0.0
    principal_point_sigma_px: float = 0.0
    distortion_sigma: float = 0.0
    pressure_sigma_hpa: float = 0.0
    temperature_sigma_c: float = 0.0
    sequence: SequencePlace | None = None


class Detections(Protocol):
    """Light sources found in one image, as an interface that the type returned by any detector can meet."""

    @property
    def uv(self) -> NDArray[np.float64]:
        """Positions, shape (n, 2), px."""

    @property
    def flux(self) -> NDArray[np.float64] | None:
        """Brightness, shape (n,), in any unit proportional to DN; None where the detector does not measure it."""


@dataclass(frozen=True)
class Answer:
    """A position, or a refusal with its reason.

    Attributes
    ----------
    ok : bool
        Whether a position is claimed.
    reason : str
        Short code that says why there is no position; empty when `ok`.
    lat_deg, lon_deg : float or None
        WGS84 geodetic, east positive; None when refused.
    cov_km2 : ndarray, shape (2, 2), or None
        East-north covariance of the position, km^2.
    confidence : float or None
        0 to 1.
    matches : ndarray of int64, shape (m, 2)
        Detection index (into the detections passed to the solver) and star id.
    time_ms : mapping of str to float
        Duration of the solver's stages, as it reports them.
    """

    ok: bool
    reason: str = ""
    lat_deg: float | None = None
    lon_deg: float | None = None
    cov_km2: NDArray[np.float64] | None = None
    confidence: float | None = None
    matches: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    time_ms: Mapping[str, float] = field(default_factory=dict)


class SolverUnderTest(Protocol):
    """Interface of a solver that takes part in the benchmark.

    It keeps nothing from one frame to the next that depends on a frame: every call is answered as if it were the first,
    except within a sequence (`SequencePlace`), whose frames come in order. With more than one process, instances are sent to
    the workers and must therefore be picklable.
    """

    @property
    def name(self) -> str:
        """Name in tables and file names: letters, digits and ``. _ @ + -``."""

    @property
    def version(self) -> str:
        """Version of the program that solves."""

    @property
    def detector(self) -> str:
        """Name of the detector and its settings; solvers that return the same name share one run of `detect`."""

    def detect(self, image: NDArray[np.uint16]) -> Detections:
        """Find light sources in an image of DN, shape (height, width)."""

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        """Answer one frame, using detections that `detect` of the same detector returned."""
