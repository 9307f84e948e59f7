"""Preview of one frame in numbers, for its author before a dataset is rendered, and warnings of likely mistakes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow.compute as pc
from sgp4.api import Satrec

from generator.frame.record import VISIBLE_SNR, pointing_object, visible_stars
from generator.frame.render import RenderedFrame
from generator.places.times import Instant
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.contradictions import contradictions
from generator.scenario.foreground_spec import TleSpec
from generator.scenario.model import FrameSpec
from generator.scenario.sensor_spec import SensorSpec

STALE_ELEMENTS_DAYS = 14.0
"""SGP4 with two-line elements deviates by 1 to 3 km per day. Source: Vallado et al. 2006, AIAA 2006-6753, section VI."""
LEAST_F_NUMBER = 1.0
LEAST_RANGE = 0.5
"""Fraction of the full well below which the converter's range wastes the sensor."""
LIKE_RECIPROCAL = 1.5
"""A gain is suspected to be its reciprocal if the reciprocal fits the full well to within this factor."""


@dataclass(frozen=True)
class Outlook:
    """A frame in numbers.

    Attributes
    ----------
    hfov_deg, vfov_deg : float
        Angle between the left and right, and the top and bottom, edges on the axis.
    azimuth_deg, altitude_deg, roll_deg : float
        Pointing of the boresight at mid-exposure.
    f_number : float or None
        Focal ratio; None if the pixel's size is not given.
    sky_e, dark_e : float
        Median of the sky, and mean of the dark current, electrons per pixel.
    full_well_e : float
    range_e : float
        Electrons at which the converter's range ends.
    visible_stars, saturated_stars : int
        Stars in the frame with a matched-filter SNR of VISIBLE_SNR or more, and those that saturate a pixel.
    saturated_share : float
        Fraction of pixels whose expected signal reaches the full well or the end of the converter's range.
    sun_altitude_deg, moon_altitude_deg : float
    satellites_stale : tuple of int
        Satellites, by their index in the scenario, whose elements are more than STALE_ELEMENTS_DAYS from the exposure.
    """

    hfov_deg: float
    vfov_deg: float
    azimuth_deg: float
    altitude_deg: float
    roll_deg: float
    f_number: float | None
    sky_e: float
    dark_e: float
    full_well_e: float
    range_e: float
    visible_stars: int
    saturated_stars: int
    saturated_share: float
    sun_altitude_deg: float
    moon_altitude_deg: float
    satellites_stale: tuple[int, ...]


def field_of_view_deg(camera: CameraSpec) -> tuple[float, float]:
    """Horizontal and vertical field of view, deg, through the principal point; within the image circle if there is one.

    Tangential distortion is left out.
    """
    lens = camera.projection
    reach_px = math.inf if camera.image_circle_px is None else camera.image_circle_px

    def across(centre_px: float, size: int, focal_px: float) -> float:
        edges_px = (centre_px + 0.5, size - 0.5 - centre_px)
        return sum(lens.axis_angle_deg(min(max(edge, 0.0), reach_px) / focal_px) for edge in edges_px)

    return across(lens.cx_px, camera.width, lens.f_px), across(lens.cy_px, camera.height, lens.fy_px)


def f_number(camera: CameraSpec) -> float | None:
    """Focal length over the aperture; None if the focal length is known only in pixels."""
    if camera.focal_length_mm is not None:
        return camera.focal_length_mm / camera.aperture_mm
    if camera.pixel_pitch_um is None:
        return None
    return camera.f_px * camera.pixel_pitch_um / 1000 / camera.aperture_mm


def outlook(frame: RenderedFrame) -> Outlook:
    """Return the numbers of a rendered frame."""
    spec = frame.plan.spec
    camera, sensor = spec.camera, spec.sensor
    exposures = sensor.exposures(spec.time.exposure_s)
    dark_e = sensor.mean_dark_e_s * spec.time.exposure_s
    range_e = converter_range_e(sensor)
    stars = frame.stars.filter(pc.greater(frame.stars["fraction_in_frame"], 0))
    full = (frame.expected.electrons + dark_e) / exposures >= min(sensor.full_well_e, range_e)
    hfov_deg, vfov_deg = field_of_view_deg(camera)
    return Outlook(
        hfov_deg=hfov_deg,
        vfov_deg=vfov_deg,
        **pointing_object(frame.plan.motion.R_mid),
        f_number=f_number(camera),
        sky_e=float(np.median(frame.expected.sky_electrons)),
        dark_e=dark_e,
        full_well_e=sensor.full_well_e,
        range_e=range_e,
        visible_stars=visible_stars(frame.stars),
        saturated_stars=int(pc.sum(stars["saturated"]).as_py() or 0),
        saturated_share=float(np.mean(full)),
        sun_altitude_deg=frame.plan.sky.sun_altitude_deg,
        moon_altitude_deg=frame.plan.sky.moon_altitude_deg,
        satellites_stale=stale_satellites(spec.foreground.satellites, frame.plan.utc_mid),
    )


def converter_range_e(sensor: SensorSpec) -> float:
    """Electrons at which the analogue-to-digital converter's range ends."""
    return (2**sensor.bits - 1 - sensor.black_level_dn) * sensor.gain_e_per_dn


def stale_satellites(satellites: Sequence[TleSpec], when: Instant) -> tuple[int, ...]:
    """Indices of the satellites whose elements are too old, or too new, for their positions at a time to be trusted."""
    stale = []
    for place, satellite in enumerate(satellites):
        orbit = Satrec.twoline2rv(satellite.line1, satellite.line2)
        age_days = (when.utc1 - orbit.jdsatepoch) + (when.utc2 - orbit.jdsatepochF)
        if abs(age_days) > STALE_ELEMENTS_DAYS:
            stale.append(place)
    return tuple(stale)


def warnings_of(spec: FrameSpec, found: Outlook) -> tuple[str, ...]:
    """Warnings about values of a frame that look like mistakes; each is a sentence that begins with the key."""
    sensor = spec.sensor
    said = []
    steps = 2**sensor.bits - 1 - sensor.black_level_dn
    swapped_e = steps / sensor.gain_e_per_dn
    fits = max(swapped_e / sensor.full_well_e, sensor.full_well_e / swapped_e) <= LIKE_RECIPROCAL
    if found.range_e < LEAST_RANGE * sensor.full_well_e or found.range_e * LEAST_RANGE > sensor.full_well_e:
        cause = (
            f"it looks like DN per electron; {1 / sensor.gain_e_per_dn:.3g} electrons per DN would fit"
            if fits
            else f"{sensor.full_well_e / steps:.3g} electrons per DN would use the whole range"
        )
        said.append(
            f"sensor.gain_e_per_dn: {sensor.gain_e_per_dn:g} ends the {sensor.bits}-bit converter's range at "
            f"{found.range_e:.3g} electrons, the full well is {sensor.full_well_e:g}: {cause}"
        )
    if found.f_number is not None and found.f_number < LEAST_F_NUMBER:
        said.append(
            f"camera.aperture_mm: {spec.camera.aperture_mm:g} is wider than the focal length "
            f"({found.f_number * spec.camera.aperture_mm:.3g} mm): f/{found.f_number:.2g}"
        )
    said += contradictions(spec)
    if found.saturated_share > 0.01:
        said.append(f"time.exposure_s: {found.saturated_share:.0%} of the pixels saturate")
    if found.visible_stars == 0:
        said.append(f"camera: no star of the frame reaches an SNR of {VISIBLE_SNR:g}")
    said += [
        f"foreground.satellites.{place}: its elements are more than {STALE_ELEMENTS_DAYS:g} days from the exposure; "
        "take elements of that week"
        for place in found.satellites_stale
    ]
    return tuple(said)
