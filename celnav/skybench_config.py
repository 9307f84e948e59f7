"""Configuration of the solver ``skybench``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from celnav.adjustment import CameraPriors
from celnav.attitude import Attitude
from celnav.camera import Camera
from celnav.checking import bounded, check_fields
from celnav.errors import ConfigError
from celnav.identification.search_config import SearchConfig
from celnav.problem import ToldSigmas, check_time_limit

# Largest fraction of the effort that all other focal lengths may use together.
MOST_FOCAL_EFFORT = 0.9


@dataclass(frozen=True)
class SkybenchConfig:
    """Configuration of the solver.

    Attributes
    ----------
    search : SearchConfig
        Configuration of the identification.
    calibrate : str
        ``auto``: also fit the focal length where the frame shows clearly that it is off; ``none``: trust the camera;
        ``full``: fit the parameters that `priors` leave free.
    priors : CameraPriors
        Standard deviations for ``full``.
    focal_factors : tuple of float
        Factors on the focal length, tried in turn where no identification fits the camera as given; not used with
        ``none``. Each factor covers 6 % to both sides.
    focal_effort : float
        Fraction of `max_work` for each factor. An eighth is 2.5 million look-ups; 2 million suffice to identify 95 in 100
        fields whose focal length is off by 7 to 15 %.
    max_work : int
        Bound on the work of the identification, in look-ups. One look-up projects one detection onto the star map under
        one hypothesis; other steps count as many look-ups as take the same time (`celnav.identification.effort`).
        Unlike a time limit, it makes the answer independent of the machine. With the default, refusing any
        input takes about 0.2 s on one idle core, and the solver meets the targets of docs/solver.md, which shows what
        more work finds.
    time_limit_s : float or None
        Wall-clock time after which the identification gives up, checked between batches of some milliseconds. Off by
        default, because under a time limit an answer may differ from machine to machine and from run to run. The
        caller's ``celnav.solve(..., time_limit_s=)`` counts too; the shorter of the two applies.
    max_detections : int
        Largest number of detections used; fainter ones are left out, because the work after identification grows with
        their number.
    single_star_sigma_deg : float
        If heading and tilt are known better than this, hypotheses come from single stars.
    min_stars : int
        Least number of matched stars for a fix.
    max_sigma_px : float
        A frame whose residuals scatter by more than this is refused.
    max_heading_off_deg : float
        A frame whose stars contradict the supplied heading by more than this (plus five standard deviations) is refused,
        unless errors of the stated size explain it. Beyond 60 deg of latitude, part of the discrepancy is disregarded
        (`celnav.horizon.heading_contradicts`).
    max_moved_deg : float
        Where the vertical comes with a standard deviation, a heading that is off by at most this much is taken for a
        mount that has moved. The position is then as uncertain as the heading has proved to be.
    readout_sigma : float
        For a camera that turns during the exposure: standard deviation of the time from reading the first row of its
        rolling shutter to reading the last, divided by the exposure time. The readout time is fitted where stars are
        streaks. 0 stands for a global shutter.
    """

    search: SearchConfig = field(default_factory=SearchConfig)
    calibrate: Literal["auto", "none", "full"] = "auto"
    priors: CameraPriors = field(default_factory=lambda: CameraPriors(focal=0.03, centre_px=3.0, distortion=0.02))
    focal_factors: tuple[float, ...] = bounded((0.88, 1.13), 0.2, 5)
    focal_effort: float = bounded(0.125, 0, 1)
    max_work: int = bounded(20_000_000, 1)
    time_limit_s: float | None = None
    max_detections: int = bounded(20_000, 1, 1_000_000)
    single_star_sigma_deg: float = bounded(0.3, 0)
    min_stars: int = bounded(4, 1)
    max_sigma_px: float = bounded(8.0, 0)
    max_heading_off_deg: float = bounded(1.0, 0)
    max_moved_deg: float = bounded(5.0, 0)
    readout_sigma: float = bounded(0.04, 0, 1)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.max_detections < self.min_stars:
            raise ConfigError(f"max_detections = {self.max_detections} must be at least min_stars = {self.min_stars}")
        if not 0 <= self.focal_effort * len(self.focal_factors) <= MOST_FOCAL_EFFORT:
            raise ConfigError(
                f"focal_effort = {self.focal_effort} for each of {len(self.focal_factors)} focal_factors leaves nothing "
                "for the camera as it is given"
            )
        if self.time_limit_s is not None:
            check_time_limit(self.time_limit_s)

    def heading_limit_deg(self, attitude: Attitude, sigmas: ToldSigmas, camera: Camera) -> float:
        """Return the heading error, degrees, that is accepted whatever the uncertainty of the position."""
        limit = self.max_heading_off_deg + 5 * sigmas.loosened(attitude, camera).heading_deg
        return max(limit, self.max_moved_deg) if attitude.tilt_deg else limit
