"""Record of a solver's judged answer to one frame."""

from collections.abc import Mapping
from dataclasses import dataclass

from benchmark.frames.conditions import FrameConditions
from benchmark.frames.identity import UNKNOWN, FrameIdentity
from benchmark.stats.metrics import FrameScore


@dataclass(frozen=True)
class DetectionRow:
    """One detection in one frame; `flux` is None where unknown, `star_id` and `correct` where it is not identified."""

    frame_id: str
    detection: int
    u_px: float
    v_px: float
    flux: float | None
    star_id: int | None
    correct: bool | None


@dataclass(frozen=True)
class FrameDetails:
    """What is recorded about a frame besides its score.

    Attributes
    ----------
    cov_km2 : (float, float, float) or None
        Claimed covariance: east-east, east-north, north-north.
    confidence : float or None
        As claimed by the solver.
    detect_ms, solve_ms : float
    stage_ms : mapping of str to float
        Duration of the solver's stages, as it reports them.
    utc : str
        Mid-exposure.
    conditions : FrameConditions
    site : str
        Name of the place and the night; frames of one site are not independent.
    error_east_km, error_north_km : float or None
        Components of the error; None without a fix.
    crlb_km : float or None
        Root of the trace of the Cramér-Rao bound on the position's covariance; None where there is no bound.
    peak_memory_mib : float or None
        Peak memory of the solving process during the request.
    identity : FrameIdentity
        Hashes of the frame's image and truth.
    """

    cov_km2: tuple[float, float, float] | None
    confidence: float | None
    detect_ms: float
    solve_ms: float
    stage_ms: Mapping[str, float]
    utc: str
    conditions: FrameConditions
    site: str = ""
    error_east_km: float | None = None
    error_north_km: float | None = None
    crlb_km: float | None = None
    peak_memory_mib: float | None = None
    identity: FrameIdentity = UNKNOWN


@dataclass(frozen=True)
class SolverOutcome:
    """One solver's judged answer to one frame, with what the results record besides the score."""

    score: FrameScore
    details: FrameDetails
    detections: tuple[DetectionRow, ...]
