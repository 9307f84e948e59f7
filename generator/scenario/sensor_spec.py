"""The scenario's ``sensor`` section: conversion of photons into DN."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from generator.scenario.processing.develop_spec import DevelopSpec
from generator.scenario.processing.video_spec import VideoSpec
from generator.scenario.quantum_efficiency import QE_CURVES
from generator.scenario.strict import Curve, Fraction, Strict, listed
from generator.scenario.sunburn_spec import SunburnSpec

COLOURS = ("blue", "green", "red")
"""Channels of a colour sensor in the alphabetical order in which a ``specfilm`` holds them."""
MOST_DARK_E_S = 1e12
"""Largest dark current: it fills any pixel in a microsecond, and the longest exposure's electrons are a finite number."""

MOST_TRACK_PX = 1e7
"""Largest mean length of all tracks of cosmic rays in an exposure: 3 GB of memory."""


class ColourSpec(Strict):
    """A Bayer filter array."""

    pattern: Literal["RGGB", "BGGR", "GRBG", "GBRG"] = "RGGB"
    """Colours of the first 2 x 2 pixels, row by row."""
    red: Curve = QE_CURVES["cmos-red"]
    green: Curve = QE_CURVES["cmos-green"]
    blue: Curve = QE_CURVES["cmos-blue"]


class ShutterSpec(Strict):
    """A rolling shutter: rows start and end their exposures one after the other."""

    line_time_us: Annotated[float, Field(gt=0, le=1e6)]
    """Time between one row and the next, microseconds."""
    direction: Literal["down", "up"] = "down"
    """``down`` reads the first row (v = 0) first."""


class TelegraphSpec(Strict):
    """Random telegraph noise, the tail of the read noise."""

    fraction: Fraction
    """Fraction of pixels with telegraph noise."""
    amplitude_e: Annotated[float, Field(gt=0, le=1000)]
    """Mean of the exponentially distributed amplitudes, electrons."""


def _rising(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[1] < limits[0]:
        raise ValueError(f"found {list(limits)}, expected the shortest and the longest")
    return limits


class BlinkingSpec(Strict):
    """Pixels whose dark current jumps between two levels: random telegraph signal."""

    fraction: Fraction
    """Fraction of pixels that blink."""
    amplitude_e_s: Annotated[float, Field(gt=0, le=1e6)]
    """Mean of the exponentially distributed upper levels at `dark_reference_c`, e/s."""
    time_constant_s: Annotated[
        tuple[Annotated[float, Field(ge=1e-3, le=1e6)], Annotated[float, Field(ge=1e-3, le=1e6)]],
        BeforeValidator(listed),
        AfterValidator(_rising),
    ] = (1.0, 3600.0)
    """Shortest and longest time constant of the jumps' correlation, s; evenly distributed in the logarithm in between."""


class InterferenceSpec(Strict):
    """A sinusoidal disturbance of the readout."""

    cycles_per_column: Annotated[float, Field(ge=-0.5, le=0.5)]
    """Cycles from one pixel to the next along a row."""
    cycles_per_row: Annotated[float, Field(ge=-0.5, le=0.5)]
    """Cycles from one row to the next, without whole cycles."""
    amplitude_e: Annotated[float, Field(gt=0, le=1e5)]
    """Amplitude of the disturbance, electrons."""


class CosmicRaySpec(Strict):
    """Charged particles that cross the silicon."""

    rate_s: Annotated[float, Field(ge=0, le=1e6)]
    """Particles per second over the whole sensor."""
    charge_e_px: Annotated[float, Field(gt=0, le=1e6)] = 200.0
    """Mean charge deposited per pixel of track, electrons."""
    length_px: Annotated[float, Field(gt=0, le=1000)] = 4.0
    """Mean length of a track, px."""


class SensorSpec(Strict):
    """Conversion of photons into DN."""

    quantum_efficiency: Curve = QE_CURVES["cmos-mono"]
    """A named curve, a list of [nm, 0-1], or a CSV file (wavelength_nm, quantum_efficiency), linear in between, zero
    outside. A colour sensor uses three curves of its own."""
    colour: ColourSpec | None = None
    """Bayer filter array; a monochrome sensor unless given."""
    rolling_shutter: ShutterSpec | None = None
    """Rolling shutter; a global shutter unless given."""
    full_well_e: Annotated[float, Field(gt=0, le=1e7)] = 15000.0
    """Electrons at which a pixel saturates."""
    blooming: bool = False
    """Whether charge above the full well spreads along the column."""
    read_noise_e: Annotated[float, Field(ge=0, le=1000)] = 2.5
    """Rms read noise, electrons."""
    telegraph: TelegraphSpec | None = None
    row_noise_e: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """Rms of an offset per row that differs in every frame, electrons."""
    column_noise_e: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """Rms of an offset per column that differs in every frame, electrons."""
    dsnu_e: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """Rms of a fixed offset per pixel (EMVA 1288's DSNU), electrons."""
    # These keys are left out of the scenario's hash unless given, as if they did not exist.
    dsnu_row_e: Annotated[float, Field(ge=0, le=1000)] = Field(default=0.0, exclude_if=lambda rms: not rms)
    """Rms of a fixed offset per row, electrons."""
    dsnu_column_e: Annotated[float, Field(ge=0, le=1000)] = Field(default=0.0, exclude_if=lambda rms: not rms)
    """Rms of a fixed offset per column, electrons."""
    interference: Annotated[tuple[InterferenceSpec, ...], Field(max_length=16), BeforeValidator(listed)] = Field(
        default=(), exclude_if=lambda waves: not waves
    )
    """Periodic disturbances of the readout."""
    prnu: Annotated[float, Field(ge=0, le=0.3)] = 0.0
    """Rms of a fixed relative response per pixel (EMVA 1288's PRNU)."""
    dark_current_e_s: Annotated[float, Field(ge=0, le=1e5)] = 0.5
    """Dark current per pixel at `dark_reference_c`, electrons per second."""
    temperature_c: Annotated[float, Field(ge=-100, le=100)] = 20.0
    """Temperature of the sensor, deg C."""
    dark_reference_c: Annotated[float, Field(ge=-100, le=100)] = 20.0
    """Temperature at which the dark current is stated, deg C."""
    dark_doubling_c: Annotated[float, Field(gt=1, le=50)] = 6.0
    """Rise of the temperature that doubles the dark current, deg C."""
    hot_pixel_fraction: Fraction = 0.0
    """Fraction of pixels that are hot."""
    hot_pixel_e_s: Annotated[float, Field(ge=0, le=1e6)] = 100.0
    """Mean of the hot pixels' extra dark current at `dark_reference_c`, e/s."""
    hot_pixel_log_sigma: Annotated[float, Field(ge=0, le=3)] = Field(default=1.4, exclude_if=lambda sigma: sigma == 1.4)
    """Standard deviation of the natural logarithm of their extra dark current, which is log-normal."""
    hot_pixel_doubling_c: Annotated[float, Field(gt=1, le=50)] = Field(default=8.5, exclude_if=lambda rise: rise == 8.5)
    """Rise of the temperature that doubles the extra dark current of hot and blinking pixels, deg C."""
    blinking_pixels: BlinkingSpec | None = Field(default=None, exclude_if=lambda blinking: blinking is None)
    dead_pixel_fraction: Fraction = 0.0
    """Fraction of pixels without response."""
    sunburn: SunburnSpec | None = Field(default=None, exclude_if=lambda burn: burn is None)
    """Pixels that retain charge because the Sun's image burnt them."""
    cosmic_rays: CosmicRaySpec | None = None
    gain_e_per_dn: Annotated[float, Field(gt=0, le=1e4)] = 4.0
    """Electrons per DN."""
    black_level_dn: Annotated[int, Field(ge=0, le=32768)] = 64
    """Output without signal, DN."""
    bits: Annotated[int, Field(ge=8, le=16)] = 12
    """Bits of the analogue-to-digital converter."""
    unit: Annotated[int, Field(ge=0, le=2**63)] | None = Field(default=None, exclude_if=lambda unit: unit is None)
    """Number of this particular sensor, which determines all fixed properties of its pixels; unless given, the scenario's
    seed does."""
    noise: bool = True
    """Whether there are random effects; without, the image is the expected signal, quantised."""
    develop: DevelopSpec | None = None
    """Also write an 8-bit developed picture."""
    hud: bool = False
    """Draw a head-up display over the picture, and write its mask."""
    video: VideoSpec | None = Field(default=None, exclude_if=lambda video: video is None)
    """Record a video during the exposure; the image is the mean of its frames."""

    @model_validator(mode="after")
    def _black_level_fits(self) -> SensorSpec:
        if self.black_level_dn >= 2**self.bits - 1:
            raise ValueError(f"black_level_dn {self.black_level_dn} leaves no range below {2**self.bits - 1} DN")
        return self

    @model_validator(mode="after")
    def _dark_current_is_possible(self) -> SensorSpec:
        hot_e_s = self.hot_pixel_e_s if self.hot_pixel_fraction else 0.0
        blinking_e_s = 0.0 if self.blinking_pixels is None else self.blinking_pixels.amplitude_e_s
        for key, mean_e_s, factor, doubling in (
            ("dark_current_e_s", self.dark_current_e_s, self.dark_factor, "dark_doubling_c"),
            ("hot_pixel_e_s", hot_e_s, self.hot_factor, "hot_pixel_doubling_c"),
            ("blinking_pixels.amplitude_e_s", blinking_e_s, self.hot_factor, "hot_pixel_doubling_c"),
        ):
            if not mean_e_s * factor <= MOST_DARK_E_S:
                raise ValueError(
                    f"{key}: {mean_e_s:g} e/s at {self.dark_reference_c:g} deg C become {mean_e_s * factor:.2g} e/s at "
                    f"temperature_c {self.temperature_c:g}, expected at most {MOST_DARK_E_S:g}; lower temperature_c, or "
                    f"raise {doubling} or dark_reference_c"
                )
        return self

    @model_validator(mode="after")
    def _video_by_itself(self) -> SensorSpec:
        beside = {"rolling_shutter": self.rolling_shutter, "develop": self.develop}
        given = [name for name, value in (beside | {"hud": self.hud or None}).items() if value is not None]
        if self.video is not None and given:
            raise ValueError(f"video and {given[0]} exclude each other; leave one of them out")
        if self.video is not None and self.video.white_balance is not None and self.colour is None:
            raise ValueError("video.white_balance is of colour sensors; give colour, or leave it out")
        return self

    def check_exposure(self, exposure_s: float) -> None:
        """Refuse more cosmic rays in an exposure than memory holds. Raises ValueError."""
        rays = self.cosmic_rays
        if rays is not None and rays.rate_s * exposure_s * max(rays.length_px, 1.0) > MOST_TRACK_PX:
            raise ValueError(
                f"sensor.cosmic_rays.rate_s: {rays.rate_s:g} tracks per second of {rays.length_px:g} px over "
                f"{exposure_s:g} s are more than {MOST_TRACK_PX:g} px; lower rate_s, length_px or the exposure"
            )

    def exposures(self, exposure_s: float) -> int:
        """Number of exposures that make up an image: the frames of its video, or 1."""
        return 1 if self.video is None else self.video.count(exposure_s)

    @property
    def channels(self) -> dict[str, tuple[tuple[float, float], ...]]:
        """Quantum efficiency curves by the film's channel names, in their order."""
        if self.colour is None:
            return {"electrons": self.quantum_efficiency}
        return {name: getattr(self.colour, name) for name in COLOURS}

    @property
    def dark_factor(self) -> float:
        """Dark current at the sensor's temperature over that at the reference."""
        return 2.0 ** ((self.temperature_c - self.dark_reference_c) / self.dark_doubling_c)

    @property
    def hot_factor(self) -> float:
        """Extra dark current of hot pixels at the sensor's temperature over that at the reference."""
        return 2.0 ** ((self.temperature_c - self.dark_reference_c) / self.hot_pixel_doubling_c)

    @property
    def mean_dark_e_s(self) -> float:
        """Dark current of a normal pixel at the sensor's temperature, e/s."""
        return self.dark_current_e_s * self.dark_factor

    def read_out_s(self, height: int) -> float:
        """Time between the exposures' starts of the first and the last row, s."""
        return 0.0 if self.rolling_shutter is None else self.rolling_shutter.line_time_us * 1e-6 * (height - 1)
