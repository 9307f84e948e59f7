"""A tree of results in the documented layout, made of random numbers with a known law, and pictures to go with it."""

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmark.preview import preview_webp

ROOT_SEED = 20260808
WIDTH, HEIGHT = 480, 320


@dataclass(frozen=True)
class FakeTask:
    name: str
    title: str
    condition: str
    unit: str
    levels: tuple[float, ...]
    larger_is_harder: bool = True


@dataclass(frozen=True)
class FakeSolver:
    """`strength` moves the level (in steps along the condition) at which half the frames are solved."""

    name: str
    family: str
    strength: float
    time_ms: float
    wrong: float = 0.15


TASKS = (
    FakeTask("bortle", "From a dark site to a city", "Bortle class", "", tuple(float(n) for n in range(1, 10))),
    FakeTask("motion", "A camera that turns", "rate", "deg/s", (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)),
    FakeTask("thesis-mag", "Fewer and fewer stars", "limiting magnitude", "mag", (3.0, 4.0, 5.0, 6.0, 7.0), False),
)
SOLVERS = (
    FakeSolver("skybench", "celnav", 2.2, 45.0, 0.02),
    FakeSolver("tetra3rs", "peers", 1.4, 21.0, 0.05),
    FakeSolver("ruststartracker", "peers", 1.2, 64.0, 0.08),
    FakeSolver("thesis-adaptive", "thesis", -0.2, 420.0, 0.3),
    FakeSolver("brightest-n", "celnav", -1.0, 12.0, 0.4),
    FakeSolver("never<i>", "submission", -50.0, 3.0, 0.0),
)


def write_results(
    root: Path,
    tasks: tuple[FakeTask, ...] = TASKS,
    solvers: tuple[FakeSolver, ...] = SOLVERS,
    frames_per_level: int = 20,
    modes: tuple[str, ...] = ("own", "shared"),
) -> Path:
    """Write ``root/<task>@1/dev/<mode>/<solver>-<key>/`` for all, and previews beside them."""
    for place, task in enumerate(tasks):
        split = root / f"{task.name}@1" / "dev"
        for mode in modes:
            for number, solver in enumerate(solvers):
                rng = np.random.default_rng(np.random.SeedSequence(ROOT_SEED, spawn_key=(place, number, len(mode))))
                _write_one(split, task, solver, mode, frames_per_level, rng)
        _write_previews(split / "previews", len(task.levels) * frames_per_level, place)
    return root


def _write_one(
    split: Path, task: FakeTask, solver: FakeSolver, mode: str, per_level: int, rng: np.random.Generator
) -> None:
    n = per_level * len(task.levels)
    order = np.arange(n) // per_level
    difficulty = order if task.larger_is_harder else len(task.levels) - 1 - order
    middle = (len(task.levels) - 1) / 2.0 + solver.strength
    chance = 1.0 / (1.0 + np.exp(1.7 * (difficulty - middle)))
    right = rng.uniform(size=n) < chance
    wrong = ~right & (rng.uniform(size=n) < solver.wrong)
    fix = right | wrong
    bound = 0.05 * 1.35**difficulty
    error = np.where(right, np.minimum(bound * 10.0 ** rng.normal(0.25, 0.3, n), 9.0), 10.0 ** rng.uniform(1.2, 3.9, n))
    angle = rng.uniform(0.0, 2.0 * math.pi, n)
    nothing = np.full(n, None)
    found = rng.integers(8, 40, n)
    matched = np.where(fix, (found * rng.uniform(0.5, 0.95, n)).astype(int), 0)
    time_ms = solver.time_ms * np.exp(rng.normal(0.0, 0.35, n))

    def where_fixed(values: np.ndarray) -> np.ndarray:
        return np.where(fix, values, nothing)

    sites = rng.uniform((-60.0, -180.0), (65.0, 180.0), (max(1, n // 3), 2))[np.arange(n) // 3 % max(1, n // 3)]
    columns: dict[str, tuple[pa.DataType, object]] = {
        "frame_id": (pa.string(), [f"frame-{i:05d}" for i in range(n)]),
        "index": (pa.int32(), range(n)),
        "bortle": (pa.int32(), [int(v) if task.name == "bortle" else 4 for v in np.array(task.levels)[order]]),
        "width_px": (pa.int32(), [WIDTH] * n),
        "height_px": (pa.int32(), [HEIGHT] * n),
        "zenith_mag_arcsec2": (pa.float64(), 22.0 - 0.5 * difficulty),
        "true_latitude_deg": (pa.float64(), sites[:, 0]),
        "true_longitude_deg": (pa.float64(), sites[:, 1]),
        "utc_mid": (pa.string(), ["2024-01-01T00:00:00Z"] * n),
        "exposure_s": (pa.float64(), [0.5] * n),
        "n_in_field": (pa.int32(), [400] * n),
        "status": (pa.string(), np.where(fix, "fix", "refused")),
        "reason": (pa.string(), np.where(fix, "", np.where(order % 2, "too few stars", "no <b>consensus</b>"))),
        "lat_deg": (pa.float64(), where_fixed(sites[:, 0])),
        "lon_deg": (pa.float64(), where_fixed(sites[:, 1])),
        "error_km": (pa.float64(), where_fixed(error)),
        "cov_ee_km2": (pa.float64(), where_fixed((1.4 * bound) ** 2)),
        "cov_en_km2": (pa.float64(), where_fixed(np.zeros(n))),
        "cov_nn_km2": (pa.float64(), where_fixed((1.4 * bound) ** 2)),
        "confidence": (pa.float64(), where_fixed(np.clip(0.25 * chance + 0.72 * right + rng.normal(0, 0.05, n), 0, 1))),
        "n_detections": (pa.int32(), found + 6),
        "n_detected_stars": (pa.int32(), found),
        "n_matches": (pa.int32(), matched),
        "n_correct": (pa.int32(), np.where(right, (matched * 0.98).astype(int), 0)),
        "time_ms": (pa.float64(), time_ms),
        "detect_ms": (pa.float64(), 0.4 * time_ms),
        "solve_ms": (pa.float64(), 0.6 * time_ms),
        "condition": (pa.float64(), np.array(task.levels)[order]),
        "site": (pa.string(), [f"{a:+.4f} {b:+.4f} 2024-01-01" for a, b in sites]),
        "error_east_km": (pa.float64(), where_fixed(error * np.cos(angle))),
        "error_north_km": (pa.float64(), where_fixed(error * np.sin(angle))),
        "crlb_km": (pa.float64(), bound),
        "peak_memory_mib": (pa.float64(), 120.0 + 0.1 * solver.time_ms + rng.uniform(0, 5, n)),
        "stage_ms": (pa.map_(pa.string(), pa.float64()), [[("match", float(t))] for t in time_ms]),
    }
    schema = pa.schema([pa.field(name, kind) for name, (kind, _) in columns.items()])
    arrays = [pa.array(list(values), type=kind) for kind, values in columns.values()]  # type: ignore[call-overload]
    key = hashlib.sha256(f"{solver.name}{task.name}{mode}".encode()).hexdigest()[:12]
    folder = split / mode / f"{solver.name.replace('<', '').replace('>', '')}-{key}"
    folder.mkdir(parents=True)
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), folder / "frames.parquet")
    pq.write_table(_matches(found + 6, matched, right, rng), folder / "matches.parquet")
    summary = {"solver": solver.name, "family": solver.family, "task": task.name}
    (folder / "summary.json").write_text(json.dumps(summary), encoding="utf-8")


def _matches(found: np.ndarray, matched: np.ndarray, right: np.ndarray, rng: np.random.Generator) -> pa.Table:
    rows = []
    for frame, (n, m, good) in enumerate(zip(found, matched, right, strict=True)):
        uv = rng.uniform((0.0, 0.0), (WIDTH - 1.0, HEIGHT - 1.0), (n, 2))
        for i, (u, v) in enumerate(uv):
            known = i < m
            rows.append((f"frame-{frame:05d}", i, u, v, 100.0, 1000 + i if known else None, bool(good) if known else None))
    names = ("frame_id", "detection", "u_px", "v_px", "flux", "star_id", "correct")
    kinds = (pa.string(), pa.int32(), pa.float64(), pa.float64(), pa.float64(), pa.int32(), pa.bool_())
    return pa.table({name: pa.array([row[i] for row in rows], type=kinds[i]) for i, name in enumerate(names)})


def _write_previews(folder: Path, n: int, place: int) -> None:
    folder.mkdir(parents=True)
    for frame in range(n):
        rng = np.random.default_rng(np.random.SeedSequence(ROOT_SEED, spawn_key=(place, frame, 99)))
        image = rng.normal(120.0, 6.0, (HEIGHT, WIDTH))
        for _ in range(60):
            u, v = rng.integers(2, WIDTH - 3), rng.integers(2, HEIGHT - 3)
            image[v - 1 : v + 2, u - 1 : u + 2] += 10.0 ** rng.uniform(1.3, 3.3)
        (folder / f"frame-{frame:05d}.webp").write_bytes(preview_webp(np.clip(image, 0, 4095).astype(np.uint16)))
