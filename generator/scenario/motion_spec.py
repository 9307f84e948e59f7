"""The scenario's ``motion`` section: how the camera turns while the shutter is open."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from generator.scenario.strict import File, Numbers, Strict, listed

AXES = ("x", "y", "z")
LARGEST_RATE_DEG_S = 720.0
Rate = Annotated[float, Field(ge=-LARGEST_RATE_DEG_S, le=LARGEST_RATE_DEG_S)]
Triple = Annotated[tuple[Rate, Rate, Rate], BeforeValidator(listed)]
Spectrum = Annotated[
    tuple[tuple[Annotated[float, Field(gt=0, le=1e4)], Annotated[float, Field(ge=0, le=1e3)]], ...],
    Field(min_length=2, max_length=1000),
    BeforeValidator(listed),
]


class VibrationSpec(Strict):
    """Vibration about one camera axis, by its one-sided power spectral density."""

    axis: Literal["x", "y", "z"]
    """Camera axis: x right, y down, z along the boresight."""
    psd_deg2_hz: Spectrum
    """Points [Hz, deg^2/Hz], linear in between, zero outside."""

    @model_validator(mode="after")
    def _frequencies_increase(self) -> VibrationSpec:
        frequencies = [point[0] for point in self.psd_deg2_hz]
        if sorted(set(frequencies)) != frequencies:
            raise ValueError("psd_deg2_hz: frequencies must increase")
        return self


class GimbalSpec(Strict):
    """A gimbal's pointing jitter: an Ornstein-Uhlenbeck process about each axis."""

    sigma_deg: Annotated[float, Field(ge=0, le=10)]
    """Standard deviation about each axis, deg."""
    correlation_s: Annotated[float, Field(gt=0, le=1000)] = 0.1
    """Time after which the correlation has fallen to 1/e, s."""


class ImuSpec(Strict):
    """The gyroscope whose reading goes into the frame record, against east-north-up: without the Earth's rotation."""

    rate_hz: Annotated[float, Field(gt=0, le=1e4)] = 200.0
    """Readings per second."""
    noise_deg_s_rthz: Annotated[float, Field(ge=0, le=10)] = 0.01
    """White noise, deg/s per square root of Hz (angle random walk)."""
    bias_deg_s: Triple = (0.0, 0.0, 0.0)
    """Constant bias about x, y, z, deg/s."""
    bias_sigma_deg_s: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Spread of a further bias, drawn once per frame, deg/s."""


class MotionSpec(Strict):
    """Rotation of the camera during the exposure, about its own axes; the parts act together.

    Rates, polynomial and gyro log leave the attitude at mid-exposure as stated in the scenario; vibration and jitter
    change it.
    """

    rate_deg_s: Triple = (0.0, 0.0, 0.0)
    """Constant rates about x, y, z, deg/s."""
    polynomial_deg: Annotated[tuple[Numbers, Numbers, Numbers], BeforeValidator(listed)] = ((), (), ())
    """Per axis, coefficients of t, t^2, … of a rotation vector, deg, t in s from mid-exposure."""
    vibration: Annotated[tuple[VibrationSpec, ...], Field(max_length=30), BeforeValidator(listed)] = ()
    gimbal: GimbalSpec | None = None
    gyro_log: File | None = None
    """CSV with the columns t (s from the start of the exposure), wx, wy, wz (deg/s), against east-north-up: a real log
    contains the Earth's rotation, which must be subtracted."""
    samples: Annotated[int, Field(ge=2, le=4096)] = 32
    """Number of attitude samples, evenly spaced over the exposure."""
    imu: ImuSpec | None = None

    @property
    def still(self) -> bool:
        """Whether the camera stands still."""
        return not (any(self.rate_deg_s) or any(self.polynomial_deg) or self.vibration or self.gimbal or self.gyro_log)
