"""The scenario's ``sensor.video`` section: an exposure as a stack of video frames."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from generator.scenario.strict import Strict, listed

FEWEST_FRAMES, MOST_FRAMES = 3, 256
"""Number of frames in a stack; its frame numbers have 8 bits."""


Factor = Annotated[float, Field(gt=0, le=16)]


class H264Spec(Strict):
    """Coding by H.264."""

    bitrate_kbit_s: Annotated[float, Field(ge=50, le=200000)] | None = None
    """Constant bit rate, kbit/s; a constant quality unless given."""
    crf: Annotated[int, Field(ge=0, le=51)] = 23
    """Constant quality by x264's rate factor, where no bit rate is given: 0 is lossless, larger is coarser."""
    keyframe_every: Annotated[int, Field(ge=1, le=1000)] = 50
    """Frames from one key frame, which can be decoded by itself, to the next."""


class SharpenSpec(Strict):
    """Unsharp masking."""

    amount: Annotated[float, Field(gt=0, le=5)] = 0.5
    """Factor with which the difference to the blurred picture is added."""
    sigma_px: Annotated[float, Field(ge=0.3, le=20)] = 1.0
    """Standard deviation of the blur, px."""


class DenoiseSpec(Strict):
    """Smoothing of small differences from the surroundings: a sigma filter with a Gaussian core."""

    sigma_px: Annotated[float, Field(ge=0.3, le=20)] = 1.0
    """Standard deviation of the smoothing, px."""
    strength: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Fraction of a small difference from the smoothed picture that is removed."""
    threshold: Annotated[float, Field(gt=0, le=1)] | None = None
    """Difference, as a fraction of white, at which only half of that fraction is removed; unless given, everything is
    smoothed alike."""


class VideoDenoiseSpec(DenoiseSpec):
    """Noise reduction of a video, which can also average with earlier frames."""

    temporal: Annotated[float, Field(ge=0, le=0.95)] = 0.0
    """Weight of the previous frame in each frame, where the two differ by less than the threshold."""


class VideoSpec(Strict):
    """Frames of a video within the exposure, and their stack, which replaces a single raw image."""

    frames_per_s: Annotated[float, Field(ge=0.1, le=240)] = 25.0
    """Frames per second; `time.exposure_s` times this is the number of frames, 3 to 256."""
    exposure: Annotated[float, Field(gt=0, le=1e4)] = 1.0
    """Factor before the 8-bit values; 1 maps the largest DN to 255."""
    gamma: Annotated[float, Field(ge=1, le=4)] = 1.0
    """Transfer curve: the 8-bit value is the light to the power of 1 / gamma."""
    # Left out of the scenario's hash unless given, as if the key did not exist.
    white_balance: Annotated[tuple[Factor, Factor, Factor], BeforeValidator(listed)] | None = Field(
        default=None, exclude_if=lambda factors: factors is None
    )
    """For a colour sensor, factors on red, green, blue; unless given, those that make the sky grey."""
    denoise: VideoDenoiseSpec | None = None
    """The camera's noise reduction and scaling, before conversion to 8-bit values."""
    sharpen: SharpenSpec | None = None
    """Sharpening after the noise reduction."""
    codec: Literal["h264", "none"] = "h264"
    """Whether the stack is made from decoded frames, or (``none``) from frames that were never coded."""
    h264: H264Spec = H264Spec()
    keep: bool = False
    """Whether the video is kept in addition to the stack."""

    def count(self, exposure_s: float) -> int:
        """Number of frames in an exposure.

        Raises
        ------
        ValueError
            The number is not whole, or outside its limits.
        """
        frames = exposure_s * self.frames_per_s
        whole = round(frames)
        if abs(frames - whole) > 1e-6 * frames or not FEWEST_FRAMES <= whole <= MOST_FRAMES:
            raise ValueError(
                f"sensor.video: time.exposure_s {exposure_s:g} times frames_per_s {self.frames_per_s:g} is {frames:g}, "
                f"expected a whole number of frames from {FEWEST_FRAMES} to {MOST_FRAMES}"
            )
        return whole
