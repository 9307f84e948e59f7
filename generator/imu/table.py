"""The table of a sequence's inertial unit: its readings, the truth behind them, and their errors.

A strapdown inertial unit integrates: each reading is the mean of the angular rate, or of the specific force, along the
camera's rotating axes over the interval since the previous one.
"""

from __future__ import annotations

from pathlib import Path

import erfa
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from generator.files import atomic_path
from generator.imu.noise import ErrorModel, drifting_bias, white_noise
from generator.places.times import SECONDS_PER_DAY, Instant
from generator.places.trajectory import Trajectory
from generator.scenario.file import Scenario
from generator.scenario.sequences.path_spec import AccelerometerSpec, GyroSpec
from generator.scenario.sequences.sequence import trajectory_of
from generator.seeds import random_stream

Floats = NDArray[np.float64]

STANDARD_GRAVITY_M_S2 = 9.80665
SECONDS_PER_HOUR = 3600.0
GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Quadrature that is exact for rates up to the fifth power of time within an interval."""
READINGS_AT_ONCE = 20_000


def _names(quantity: str) -> list[str]:
    """Columns of a vector along the camera's axes."""
    unit = "rad_s" if quantity.startswith("gyro") else "m_s2"
    return [f"{quantity}_{axis}_{unit}" for axis in "xyz"]


def _triple(quantity: str) -> list[tuple[str, pa.DataType, str]]:
    unit = "rad/s" if quantity.startswith("gyro") else "m/s^2"
    return [(name, pa.float64(), unit) for name in _names(quantity)]


IMU_COLUMNS: tuple[tuple[str, pa.DataType, str], ...] = (
    ("sequence", pa.int32(), ""),
    ("t_s", pa.float64(), "s"),
    ("utc", pa.string(), ""),
    *_triple("gyro"),
    *_triple("accelerometer"),
    *_triple("gyro_true"),
    *_triple("accelerometer_true"),
    *_triple("gyro_bias"),
    *_triple("accelerometer_bias"),
    ("latitude_deg", pa.float64(), "deg"),
    ("longitude_deg", pa.float64(), "deg"),
    ("height_m", pa.float64(), "m"),
    ("velocity_east_m_s", pa.float64(), "m/s"),
    ("velocity_north_m_s", pa.float64(), "m/s"),
    ("velocity_up_m_s", pa.float64(), "m/s"),
    ("qx", pa.float64(), ""),
    ("qy", pa.float64(), ""),
    ("qz", pa.float64(), ""),
    ("qw", pa.float64(), ""),
)
IMU_SCHEMA = pa.schema(
    [pa.field(name, kind, nullable=False, metadata={"unit": unit}) for name, kind, unit in IMU_COLUMNS],
    metadata={"format": "skybench-imu/1"},
)


def imu_table(scenario: Scenario, sequence: int) -> pa.Table:
    """Readings and truth of a sequence's inertial unit (schema: IMU_SCHEMA); no rows if it has none.

    The table depends only on the scenario and the sequence. Rows run from the end of the first interval after the start
    of the first exposure to the end of the last exposure.
    """
    spec = scenario.sequence(sequence)
    if spec.imu is None:
        return IMU_SCHEMA.empty_table()
    rate_hz, trajectory = spec.imu.rate_hz, trajectory_of(spec)
    count = int(spec.length_s * rate_hz + 1e-9)
    ends = np.arange(1, count + 1) / rate_hz
    columns: dict[str, object] = {
        "sequence": np.full(count, sequence),
        "t_s": ends,
        "utc": _utc(Instant.parse(spec.time.utc_start), ends),
    }
    true = dict(zip(("gyro", "accelerometer"), mean_readings(trajectory, ends, 1 / rate_hz), strict=True))
    for sensor, model in (
        ("gyro", gyro_errors(spec.imu.gyro)),
        ("accelerometer", force_errors(spec.imu.accelerometer)),
    ):

        def stream(name: str, sensor: str = sensor) -> np.random.Generator:
            return random_stream(scenario.seed, f"imu.{sensor}.{name}", sequence)

        bias = drifting_bias(model, count, 1 / rate_hz, stream)
        measured = true[sensor] + bias + white_noise(model, count, 1 / rate_hz, stream)
        for name, values in ((sensor, measured), (f"{sensor}_true", true[sensor]), (f"{sensor}_bias", bias)):
            columns |= dict(zip(_names(name), values.T, strict=True))
    columns |= dict(zip(("latitude_deg", "longitude_deg", "height_m"), trajectory.position(ends), strict=True))
    velocity = trajectory.velocity_enu_m_s(ends).T
    columns |= dict(zip(("velocity_east_m_s", "velocity_north_m_s", "velocity_up_m_s"), velocity, strict=True))
    columns |= dict(zip(("qx", "qy", "qz", "qw"), trajectory.R_cam(ends).as_quat(canonical=True).T, strict=True))
    return pa.table([pa.array(columns[field.name], field.type) for field in IMU_SCHEMA], schema=IMU_SCHEMA)


def mean_readings(trajectory: Trajectory, ends_s: Floats, interval_s: float) -> tuple[Floats, Floats]:
    """Mean angular rate, rad/s, and specific force, m/s^2, over intervals that end at times (n): two (n, 3) arrays."""
    moments = ends_s[:, None] + interval_s / 2 * (GAUSS_NODES - 1)
    rate, force = np.empty((2, len(ends_s), 3))
    for start in range(0, len(ends_s), READINGS_AT_ONCE):
        rows = slice(start, start + READINGS_AT_ONCE)
        times = moments[rows].ravel()
        for result, values in ((rate, trajectory.rate_rad_s(times)), (force, trajectory.specific_force_m_s2(times))):
            result[rows] = np.einsum("k,nki->ni", GAUSS_WEIGHTS / 2, values.reshape(-1, len(GAUSS_NODES), 3))
    return rate, force


def gyro_errors(spec: GyroSpec) -> ErrorModel:
    """A gyroscope's errors, converted to rad and s."""
    per_s, root_h = np.radians(1 / SECONDS_PER_HOUR), np.sqrt(SECONDS_PER_HOUR)
    return ErrorModel(
        bias=np.array(spec.bias_deg_h) * per_s,
        bias_sigma=spec.bias_sigma_deg_h * per_s,
        white=np.radians(spec.angle_random_walk_deg_sqrt_h) / root_h,
        instability=spec.bias_instability_deg_h * per_s,
        random_walk=spec.rate_random_walk_deg_h_sqrt_h * per_s / root_h,
    )


def force_errors(spec: AccelerometerSpec) -> ErrorModel:
    """An accelerometer's errors, converted to m and s."""
    ug, root_h = STANDARD_GRAVITY_M_S2 * 1e-6, np.sqrt(SECONDS_PER_HOUR)
    return ErrorModel(
        bias=np.array(spec.bias_ug) * ug,
        bias_sigma=spec.bias_sigma_ug * ug,
        white=spec.velocity_random_walk_m_s_sqrt_h / root_h,
        instability=spec.bias_instability_ug * ug,
        random_walk=spec.acceleration_random_walk_ug_sqrt_h * ug / root_h,
    )


def _utc(start: Instant, after_s: Floats) -> list[str]:
    """Times after an instant, ISO 8601 to the microsecond."""
    tai1, tai2 = erfa.utctai(start.utc1, start.utc2)
    utc1, utc2 = erfa.taiutc(tai1, tai2 + after_s / SECONDS_PER_DAY)
    year, month, day, clock = erfa.d2dtf("UTC", 6, utc1, utc2)
    return [
        f"{y:04d}-{m:02d}-{d:02d}T{c['h']:02d}:{c['m']:02d}:{c['s']:02d}.{c['f']:06d}Z"
        for y, m, d, c in zip(year, month, day, clock, strict=True)
    ]


def write_imu_table(path: Path, scenario: Scenario, sequences: range) -> None:
    """Write the tables of sequences as one Parquet file, with one row group per sequence."""
    floats = [field.name for field in IMU_SCHEMA if pa.types.is_floating(field.type)]
    with (
        atomic_path(path) as temporary,
        pq.ParquetWriter(
            temporary, IMU_SCHEMA, compression="zstd", use_dictionary=["sequence"], use_byte_stream_split=floats
        ) as writer,
    ):
        for sequence in sequences:
            table = imu_table(scenario, sequence)
            writer.write_table(table, row_group_size=max(1, table.num_rows))
