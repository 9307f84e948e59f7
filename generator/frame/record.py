"""The frame record and the table of stars, in the format of docs/dataset_format.md."""

from __future__ import annotations

import functools
import json
import math
from importlib.metadata import version
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from generator import __version__
from generator.frame.plan import FramePlan
from generator.frame.scene import ExpectedFrame
from generator.frame.star_truth import LitMoments
from generator.identity.revision import GENERATOR_REVISION, generator_revision
from generator.mitsuba_runtime import choose_variant
from generator.optics.motion import Motion
from generator.optics.psf import PSF_REACH_SIGMAS, equivalent_sigma_px
from generator.places.ephemeris import PLANET_ID_BASE
from generator.reading.record import FORMAT
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.model import pointing_of
from generator.scenario.sensor_spec import SensorSpec
from generator.scenario.sequences.sequence import Passage
from generator.sensor.detector import matched_filter_snr, saturation_e

LARGEST_8_BIT = 255
VISIBLE_SNR = 5.0
"""Any detector finds a star with this signal-to-noise ratio."""
CORNERS_PER_PX = 16
"""Steps per pixel of the least and greatest places of a star's light, which compress well in the table."""
LEAST_LIGHT_E = 5.0
"""Electrons on the sensor from which a star is listed whose place at mid-exposure is far outside the frame."""

STAR_COLUMNS: tuple[tuple[str, pa.DataType, str], ...] = (
    ("index", pa.int32(), ""),
    ("frame_id", pa.string(), ""),
    ("star_id", pa.int32(), ""),
    ("hip", pa.int32(), ""),
    ("hr", pa.int32(), ""),
    ("kind", pa.string(), ""),
    ("ra_deg", pa.float64(), "deg"),
    ("dec_deg", pa.float64(), "deg"),
    ("v_mag", pa.float32(), "mag"),
    ("bv_mag", pa.float32(), "mag"),
    ("azimuth_deg", pa.float64(), "deg"),
    ("altitude_deg", pa.float64(), "deg"),
    ("airmass", pa.float32(), "1"),
    ("u_px", pa.float64(), "px"),
    ("v_px", pa.float64(), "px"),
    ("centroid_u_px", pa.float64(), "px"),
    ("centroid_v_px", pa.float64(), "px"),
    ("light_u_px", pa.float64(), "px"),
    ("light_v_px", pa.float64(), "px"),
    ("start_u_px", pa.float64(), "px"),
    ("start_v_px", pa.float64(), "px"),
    ("end_u_px", pa.float64(), "px"),
    ("end_v_px", pa.float64(), "px"),
    ("low_u_px", pa.float32(), "px"),
    ("low_v_px", pa.float32(), "px"),
    ("high_u_px", pa.float32(), "px"),
    ("high_v_px", pa.float32(), "px"),
    ("electrons_e", pa.float32(), "e"),
    ("fraction_in_frame", pa.float32(), "1"),
    ("snr", pa.float32(), "1"),
    ("saturated", pa.bool_(), ""),
    ("occluded", pa.bool_(), ""),
    ("hidden_fraction", pa.float32(), "1"),
    ("cloud_optical_depth", pa.float32(), "1"),
    ("cloud_transmission", pa.float32(), "1"),
    ("scintillation", pa.float32(), "1"),
)
LATER_STAR_COLUMNS = frozenset({"low_u_px", "low_v_px", "high_u_px", "high_v_px"})
"""Columns that tables of before lack."""
STAR_SCHEMA = pa.schema(
    [pa.field(name, kind, nullable=False, metadata={"unit": unit}) for name, kind, unit in STAR_COLUMNS],
    metadata={"format": "skybench-stars/1"},
)


def visible_stars(stars: pa.Table) -> int:
    """Number of visible stars in a table (STAR_SCHEMA): SNR of VISIBLE_SNR or more, and at least half in the frame."""
    bright = pc.greater_equal(stars["snr"], VISIBLE_SNR)
    return pc.sum(pc.and_(bright, pc.greater_equal(stars["fraction_in_frame"], 0.5))).as_py() or 0


def frame_record(plan: FramePlan, expected: ExpectedFrame, stars: pa.Table) -> dict[str, Any]:
    """Return the frame record as JSON-ready data; nothing in it depends on the machine or the clock."""
    spec = plan.spec
    camera, sensor, air = spec.camera, spec.sensor, spec.atmosphere
    return {
        "format": FORMAT,
        "frame_id": plan.frame_id,
        "index": plan.index,
        "scenario": {"name": plan.scenario.name, "sha256": plan.scenario.sha256, "seed": plan.scenario.seed},
        "site": spec.site.model_dump() | {"ground_height_m": spec.site.horizon_ground_m},
        "time": {
            "utc_start": plan.utc_start.isoformat(),
            "utc_mid": plan.utc_mid.isoformat(),
            "exposure_s": spec.time.exposure_s,
            "ut1_utc_s": plan.orientation.ut1_utc_s,
            "polar_motion_x_arcsec": plan.orientation.polar_motion_x_arcsec,
            "polar_motion_y_arcsec": plan.orientation.polar_motion_y_arcsec,
        },
        "camera": camera_object(camera),
        "attitude": attitude_object(plan.motion),
        **drift_objects(plan),
        **({} if plan.passage is None else {"sequence": sequence_object(plan.passage)}),
        "optics": {
            "aperture_mm": camera.aperture_mm,
            "transmission": camera.transmission,
            "psf_sigma_px": equivalent_sigma_px(camera),
            "pupil": camera.pupil_law,
            "vignetting": list(camera.vignetting),
            "image_circle_px": camera.image_circle_px,
        },
        "sensor": sensor_object(sensor, spec.time.exposure_s),
        "atmosphere": air.model_dump(),
        "sky": {
            "bortle": spec.sky.bortle,
            "zenith_mag_arcsec2": expected.zenith_mag_arcsec2,
            "components": list(spec.sky.active_components),
            "horizon_altitude_deg": plan.horizon.altitude_deg,
            "clouds": clouds_object(plan),
            "sun_altitude_deg": plan.sky.sun_altitude_deg,
            "moon_altitude_deg": plan.sky.moon_altitude_deg,
            "moon_phase_angle_deg": plan.sky.moon.phase_angle_deg,
        },
        "stars": {
            "n_in_field": stars.num_rows,
            "n_visible": visible_stars(stars),
            "limiting_magnitude": spec.stars.limiting_magnitude,
            **({} if (listed := spec.stars.listed_magnitude) is None else {"listed_magnitude": listed}),
            "catalogue": spec.stars.catalogue,
        },
        "provenance": {
            "skybench": __version__,
            GENERATOR_REVISION: generator_revision(),
            **_versions(),
            "variant": choose_variant(),
        },
    }


@functools.cache
def _versions() -> dict[str, str]:
    """Versions of the packages that a frame's bytes depend on (looking them up takes some milliseconds)."""
    return {name: version(name) for name in ("mitsuba", "drjit", "numpy")}


def camera_object(camera: CameraSpec) -> dict[str, Any]:
    """Description of the camera for solvers, as in a file camera.json."""
    projection = camera.projection
    return {
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "f_px": projection.f_px,
        "fy_px": projection.fy_px,
        "cx_px": projection.cx_px,
        "cy_px": projection.cy_px,
        "k": list(projection.full_k),
        "p": list(projection.full_p),
        **({"s": list(projection.full_s)} if any(projection.s) else {}),
        **({"tilt_rad": list(projection.full_tilt_rad)} if any(projection.tilt_rad) else {}),
    }


def sensor_object(sensor: SensorSpec, exposure_s: float) -> dict[str, Any]:
    """The sensor's part of a record. For a video, it applies to the mean of its frames, in electrons of all of them.

    For a colour video they are electrons of the green pixels, to which white balance scales the others.
    """
    video, frames = sensor.video, sensor.exposures(exposure_s)
    photo = None if sensor.develop is None else sensor.develop.photo
    # From DN to the image's values.
    scale = 1.0 if video is None else LARGEST_8_BIT * video.exposure / (2**sensor.bits - 1)
    return {
        "bits": sensor.bits if video is None else 8,
        "gain_e_per_dn": frames * sensor.gain_e_per_dn / scale,
        "black_level_dn": round(sensor.black_level_dn * scale),
        "full_well_e": frames * sensor.full_well_e,
        "read_noise_e": math.sqrt(frames) * sensor.read_noise_e,
        "dark_current_e_s": sensor.mean_dark_e_s,
        "quantum_efficiency": [
            {"channel": name, "curve": [list(point) for point in curve]} for name, curve in sensor.channels.items()
        ],
        "bayer_pattern": None if sensor.colour is None or video is not None else sensor.colour.pattern,
        "line_time_s": 0.0 if sensor.rolling_shutter is None else sensor.rolling_shutter.line_time_us * 1e-6,
        "readout_direction": None if sensor.rolling_shutter is None else sensor.rolling_shutter.direction,
        **({} if video is None else {"video": {"frames": frames} | video.model_dump()}),
        **({} if photo is None else {"photo": photo.model_dump()}),
    }


def drift_objects(plan: FramePlan) -> dict[str, Any]:
    """The drift of lens and mount, and the values that a solver receives instead; empty without drift."""
    spec, drift, camera, motion = plan.spec.drift, plan.drift, plan.told_camera, plan.told_motion
    if spec is None or drift is None or camera is None or motion is None:
        return {}
    return {
        "drift": {
            "focal_ppm": drift.focal_ppm,
            "principal_point_px": list(drift.principal_point_px),
            "mount_deg": list(drift.mount_deg),
        },
        "told": {
            "camera": camera_object(camera),
            "attitude": attitude_object(motion) | {
                "tilt_sigma_deg": spec.mount_deg,
                "heading_sigma_deg": spec.mount_deg,
            },
        },
    }  # fmt: skip


def pointing_object(R_cam: NDArray[np.float64]) -> dict[str, float]:
    """Azimuth, altitude and roll of a rotation ENU to camera (3, 3), to 4 microarcseconds, the limit of rounding."""
    angles = pointing_of(R_cam).model_dump()
    rounded = {name: round(angle, 9) + 0.0 for name, angle in angles.items()}
    return rounded | {"azimuth_deg": rounded["azimuth_deg"] % 360.0}


def attitude_object(motion: Motion) -> dict[str, Any]:
    """Attitude at mid-exposure, its samples over the shutter's time, and the gyroscope's reading."""
    imu = motion.imu
    return {
        "R_cam": (np.round(motion.R_mid, 15) + 0.0).tolist(),
        **pointing_object(motion.R_mid),
        "sample_time_s": motion.time_s.tolist(),
        "sample_R_cam": (np.round(motion.R_cam, 15) + 0.0).tolist(),
        "imu_time_s": [] if imu is None else imu.time_s.tolist(),
        "imu_rate_deg_s": [] if imu is None else imu.rate_deg_s.tolist(),
        "imu_bias_deg_s": [0.0, 0.0, 0.0] if imu is None else imu.bias_deg_s.tolist(),
    }


def sequence_object(passage: Passage) -> dict[str, Any]:
    """Position of a frame in its sequence, and its velocity over ground."""
    return {
        "index": passage.sequence,
        "step": passage.step,
        "start_s": passage.start_s,
        "velocity_enu_m_s": (np.round(passage.velocity_enu_m_s, 9) + 0.0).tolist(),
    }


def clouds_object(plan: FramePlan) -> dict[str, Any] | None:
    """The cloud layer above a frame, with the depth drawn for its night; None without cloud."""
    spec, clouds = plan.spec.sky.clouds, plan.sky.clouds
    if spec is None or clouds is None:
        return None
    return {
        "kind": spec.kind,
        "altitude_km": spec.altitude_km,
        "coverage": spec.coverage,
        "mean_optical_depth": clouds.pattern.mean_depth,
        "point_share": clouds.point_share,
    }


def record_bytes(record: dict[str, Any]) -> bytes:
    """Serialise a frame record: UTF-8 JSON without NaN or infinity, with one section per line."""
    # Indentation at every level would make json use its Python encoder, which takes ten times as long as that in C.
    lines = (f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in record.items())
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def star_table(plan: FramePlan, expected: ExpectedFrame) -> pa.Table:
    """Return the truth of a frame's stars, one row per star in or near the field (schema: STAR_SCHEMA)."""
    spec = plan.spec
    camera, sensor = spec.camera, spec.sensor
    sigma = equivalent_sigma_px(camera)
    reach = PSF_REACH_SIGMAS * sigma
    with np.errstate(invalid="ignore"):
        seen = (
            (expected.u_px > -0.5 - reach)
            & (expected.u_px < camera.width - 0.5 + reach)
            & (expected.v_px > -0.5 - reach)
            & (expected.v_px < camera.height - 0.5 + reach)
        )
    # A star that trails, or whose wings are wide, may send light into the frame from outside.
    arriving_e = expected.star_electrons * expected.fraction_in_frame
    seen |= (arriving_e >= LEAST_LIGHT_E) & np.isfinite(expected.u_px)
    star_id = plan.stars.star_id
    rows = np.flatnonzero(seen)
    # The catalogue is sorted by magnitude already, which speeds up a stable sort.
    order = np.argsort(_brightness_order(plan.stars.v_mag[rows], star_id[rows]), kind="stable")
    rows = rows[order]
    u_px, v_px = expected.u_px[rows], expected.v_px[rows]
    column = np.clip(np.rint(u_px), 0, camera.width - 1).astype(np.intp)
    row = np.clip(np.rint(v_px), 0, camera.height - 1).astype(np.intp)
    pixel = row * camera.width + column
    sky = expected.sky_electrons.take(pixel).astype(np.float64)
    electrons = expected.star_electrons[rows]
    # If a star sends no light at one of these moments (because it is occluded, or outside the lens' range), its
    # mid-exposure position is used.
    centroid, light, start, end, low, high = (
        [
            np.where(np.isfinite(place), place, middle)
            for place, middle in zip(places.T[:, rows], (u_px, v_px), strict=True)
        ]
        for places in (
            expected.centroid_px, expected.light_px, expected.start_px, expected.end_px, expected.low_px, expected.high_px
        )
    )  # fmt: skip
    # Rounded outwards, so that the range still contains all places.
    low = [np.floor(place * CORNERS_PER_PX) / CORNERS_PER_PX for place in low]
    high = [np.ceil(place * CORNERS_PER_PX) / CORNERS_PER_PX for place in high]
    saturating_e = saturation_e(sensor, spec.time.exposure_s) - sensor.mean_dark_e_s * spec.time.exposure_s
    places = plan.middle[rows]
    columns = {
        "index": np.full(len(rows), plan.index),
        "frame_id": pa.repeat(plan.frame_id, len(rows)),
        "star_id": star_id[rows],
        "hip": plan.stars.hip[rows],
        "hr": plan.stars.hr[rows],
        "kind": pa.array(["star", "planet"]).take(pa.array((star_id[rows] > PLANET_ID_BASE).astype(np.int8))),
        "ra_deg": plan.ra_deg[rows],
        "dec_deg": plan.dec_deg[rows],
        "v_mag": plan.stars.v_mag[rows],
        "bv_mag": plan.stars.bv_mag[rows],
        "azimuth_deg": places.azimuth_deg,
        "altitude_deg": places.altitude_deg,
        "airmass": plan.airmass[rows],
        "u_px": u_px,
        "v_px": v_px,
        "centroid_u_px": centroid[0],
        "centroid_v_px": centroid[1],
        "light_u_px": light[0],
        "light_v_px": light[1],
        "start_u_px": start[0],
        "start_v_px": start[1],
        "end_u_px": end[0],
        "end_v_px": end[1],
        "low_u_px": low[0],
        "low_v_px": low[1],
        "high_u_px": high[0],
        "high_v_px": high[1],
        "electrons_e": electrons,
        "fraction_in_frame": expected.fraction_in_frame[rows],
        "snr": matched_filter_snr(camera.direct_share * electrons, sky, sigma, spec.time.exposure_s, sensor),
        "saturated": _touching(expected.electrons >= saturating_e, expected.lit, len(star_id))[rows],
        "occluded": expected.occluded[rows],
        "hidden_fraction": expected.hidden_fraction[rows],
        "cloud_optical_depth": plan.cloud_optical_depth[rows],
        "cloud_transmission": plan.cloud_transmission[rows],
        "scintillation": plan.scintillation[rows],
    }
    arrays = [_column(columns[field.name], field.type) for field in STAR_SCHEMA]
    return pa.Table.from_arrays(arrays, schema=STAR_SCHEMA)


def _column(values: Any, kind: pa.DataType) -> pa.Array:
    """A column of the table."""
    return values if isinstance(values, pa.Array) else pa.array(values.astype(kind.to_pandas_dtype(), copy=False))


def _brightness_order(v_mag: NDArray[np.float64], star_id: NDArray[np.int32]) -> NDArray[np.int64]:
    """Sort keys of the stars by V in single precision, then by id."""
    bits = v_mag.astype(np.float32).view(np.int32).astype(np.int64)
    # For negative numbers, the bits rise as the number falls.
    magnitude = np.where(bits < 0, -(bits & 0x7FFFFFFF), bits)
    return (magnitude << 32) + star_id


def _touching(full: NDArray[np.bool_], lit: LitMoments, count: int) -> NDArray[np.bool_]:
    """Whether one of the 3 x 3 pixels around a place from which its light arrives is full, for each of `count` stars."""
    if not full.any():
        return np.zeros(count, dtype=bool)
    height, width = full.shape
    # One pixel of margin, so that places beside the frame touch its edge.
    near = _around(np.pad(full, 1))
    column, row = np.rint(lit.u) + 1, np.rint(lit.v) + 1
    beside = np.flatnonzero((column >= 0) & (column <= width + 1) & (row >= 0) & (row <= height + 1))
    touched = near[row[beside].astype(np.intp), column[beside].astype(np.intp)]
    return np.bincount(lit.star[beside], touched, count) > 0


def _around(marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether any of the 3 x 3 pixels around each pixel is marked."""
    tall = marked.copy()
    tall[1:] |= marked[:-1]
    tall[:-1] |= marked[1:]
    result = tall.copy()
    result[:, 1:] |= tall[:, :-1]
    result[:, :-1] |= tall[:, 1:]
    return result
