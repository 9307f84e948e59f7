"""The ``drift`` section: how lens and mount deviate from their known calibration."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from generator.scenario.strict import Strict


class DriftSpec(Strict):
    """Differences between the camera that takes the frames and the calibration that solvers receive.

    Solvers receive the scenario's camera and attitude. Each quantity wanders as a stationary Gaussian process in time
    whose correlation falls as exp(-|t| / time constant); the scenario's seed determines the same process for all its
    frames. Temperature changes the lens in proportion.
    """

    time_constant_h: Annotated[float, Field(ge=0.02, le=100_000)] = 24.0
    """Correlation time of all drifts, hours: with 24, nights differ, and hours within a night are nearly the same."""
    focal_ppm: Annotated[float, Field(ge=0, le=100_000)] = 0.0
    """Standard deviation of the focal length, parts per million."""
    principal_point_px: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """Standard deviation of the principal point along u and along v, px."""
    mount_deg: Annotated[float, Field(ge=0, le=30)] = 0.0
    """Standard deviation of the mount's rotation about each axis of the camera, deg."""
    focal_ppm_per_c: Annotated[float, Field(ge=-10_000, le=10_000)] = 0.0
    """Change of the focal length with the air's temperature, parts per million per deg C."""
    principal_u_px_per_c: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """Change of the principal point along u, px per deg C."""
    principal_v_px_per_c: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """Change of the principal point along v, px per deg C."""
    reference_temperature_c: Annotated[float, Field(ge=-90, le=60)] = 10.0
    """Temperature at which the camera was calibrated, deg C."""
