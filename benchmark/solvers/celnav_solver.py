"""Adapter for celnav's own solvers."""

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.protocol import Answer, Detections, Observation
from benchmark.provenance import distribution_version
from benchmark.solvers.sequence_track import SequenceTrack, without_bias
from celnav.sky.planets import FIRST_PLANET_ID, planet_ids

_DETECTION = celnav.DetectionConfig(faint_stars=celnav.FAINT_STARS)


@dataclass(frozen=True)
class CelnavSolver:
    """One of celnav's solvers, with its default settings and celnav's default detector.

    Attributes
    ----------
    name : str
        celnav's name of the solver.
    """

    name: str
    _track: SequenceTrack = field(default_factory=SequenceTrack, repr=False, compare=False)

    @property
    def version(self) -> str:
        """Version of the skybench distribution, which contains celnav."""
        return distribution_version()

    @property
    def detector(self) -> str:
        """All of celnav's solvers share its default detector."""
        return "celnav"

    def detect(self, image: NDArray[np.uint16]) -> Detections:
        """Run celnav's detector; for the default solver, faint sources follow where few stars stand out."""
        found: Detections = celnav.detect(image, config=_DETECTION if self.name == "skybench" else None)
        return found

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        """Solve each frame on its own; only the frames of a sequence are tracked, by the default solver."""
        if observation.sequence is None or self.name != "skybench":
            return answer_of(self._fix(detections, observation))
        fix = self._fix(detections, without_bias(observation))
        return self._track.answer(answer_of(fix), fix, observation)

    def _fix(self, detections: Detections, observation: Observation) -> celnav.Fix:
        camera = celnav.Camera.from_dict(dataclasses.asdict(observation.camera))
        if not isinstance(detections, celnav.Detections):
            detections = celnav.Detections(detections.uv, detections.flux, (camera.height, camera.width))
        return celnav.solve(
            detections,
            camera,
            utc=observation.utc,
            attitude=self._attitude(observation),
            solver=self.name,
            history=None,
            pressure_hpa=observation.pressure_hpa,
            temperature_c=observation.temperature_c,
            sigmas=celnav.ToldSigmas(
                observation.utc_sigma_s,
                observation.focal_sigma,
                observation.principal_point_sigma_px,
                observation.pressure_sigma_hpa,
                observation.temperature_sigma_c,
                observation.distortion_sigma,
            ),
        )

    def _attitude(self, observation: Observation) -> celnav.Attitude:
        """What is known about the attitude; the thesis' solvers require a complete attitude, however uncertain."""
        tilt, heading = observation.tilt_sigma_deg, observation.heading_sigma_deg
        if (tilt == 0.0 and heading == 0.0) or self.name != "skybench":
            return celnav.Attitude.exact(observation.R_cam)
        if math.isinf(heading):
            return celnav.Attitude.up(observation.R_cam[:, 2], tilt_deg=tilt)
        return celnav.Attitude.with_sigma(observation.R_cam, tilt_deg=tilt, heading_deg=heading)


def answer_of(fix: celnav.Fix) -> Answer:
    """Convert celnav's fix to the benchmark's terms."""
    return Answer(
        ok=bool(fix.ok),
        reason="" if fix.ok else str(fix.reason),
        lat_deg=float(fix.lat_deg) if fix.ok else None,
        lon_deg=float(fix.lon_deg) if fix.ok else None,
        cov_km2=None if fix.cov_km2 is None else np.asarray(fix.cov_km2, dtype=np.float64),
        confidence=_finite_or_none(fix.confidence),
        matches=_with_dataset_ids(np.asarray(fix.matches, dtype=np.int64).reshape(-1, 2)),
        time_ms={str(stage): float(ms) for stage, ms in fix.time_ms.items()},
    )


def _with_dataset_ids(matches: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number planets as docs/dataset_format.md does: 900,000,000 plus the NAIF number, which is 100 k + 99 for planet k."""
    named = matches.copy()

    rows = np.isin(named[:, 1], planet_ids())
    named[rows, 1] = 900_000_099 + 100 * (-named[rows, 1] - FIRST_PLANET_ID)
    return named


def _finite_or_none(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
