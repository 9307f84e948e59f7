"""A tree of results in the documented layout, made of random numbers with a known law, and pictures to go with it."""

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from benchmark.frames.conditions import FrameConditions
from benchmark.frames.frame_set import FrameFacts, Grading
from benchmark.judge.outcome import DetectionRow, FrameDetails, SolverOutcome
from benchmark.run.provenance import RunProvenance, SolverFacts
from benchmark.run.result_tables import frame_table, match_table
from benchmark.run.results import result_folder, write_result
from benchmark.stats.metrics import FIX, REFUSED, FrameScore

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
    revision: int = 1

    @property
    def label(self) -> str:
        return f"{self.name}@{self.revision}"


@dataclass(frozen=True)
class FakeSolver:
    """`strength` moves the level (in steps along the condition) at which half the frames are solved."""

    name: str
    strength: float
    time_ms: float
    wrong: float = 0.15


TASKS = (
    FakeTask("bortle", "From a dark site to a city", "Bortle class", "", tuple(float(n) for n in range(1, 10))),
    FakeTask("motion", "A camera that turns", "rate", "deg/s", (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)),
    FakeTask("thesis-mag", "Fewer and fewer stars", "limiting magnitude", "mag", (3.0, 4.0, 5.0, 6.0, 7.0), False),
)
SOLVERS = (
    FakeSolver("skybench", 2.2, 45.0, 0.02),
    FakeSolver("tetra3rs", 1.4, 21.0, 0.05),
    FakeSolver("ruststartracker", 1.2, 64.0, 0.08),
    FakeSolver("thesis-baseline+si+pr", -0.2, 420.0, 0.3),
    FakeSolver("brightest-n", -1.0, 12.0, 0.4),
    FakeSolver("never", -50.0, 3.0, 0.0),
)


def write_results(
    root: Path,
    tasks: tuple[FakeTask, ...] = TASKS,
    solvers: tuple[FakeSolver, ...] = SOLVERS,
    frames_per_level: int = 20,
    modes: tuple[str, ...] = ("own", "shared"),
) -> Path:
    """Write ``root/<task>@<revision>/dev/<mode>/<solver>-<key>/`` for all."""
    for place, task in enumerate(tasks):
        for mode in modes:
            for number, solver in enumerate(solvers):
                rng = np.random.default_rng(np.random.SeedSequence(ROOT_SEED, spawn_key=(place, number, len(mode))))
                _write_one(root, task, solver, mode, frames_per_level, rng)
    return root


def write_frames(data: Path, tasks: tuple[FakeTask, ...] = TASKS, frames_per_level: int = 20) -> Path:
    """Write the pictures of the tasks' frames where those of rendered tasks lie."""
    for place, task in enumerate(tasks):
        folder = data / task.label / f"dev-{SCENARIO_SHA256[:12]}" / "unpacked"
        _write_pictures(folder, len(task.levels) * frames_per_level, place)
    return data


def _write_one(
    root: Path, task: FakeTask, solver: FakeSolver, mode: str, per_level: int, rng: np.random.Generator
) -> None:
    n = per_level * len(task.levels)
    order = np.arange(n) // per_level
    difficulty = order if task.larger_is_harder else len(task.levels) - 1 - order
    middle = (len(task.levels) - 1) / 2.0 + solver.strength
    chance = 1.0 / (1.0 + np.exp(1.7 * (difficulty - middle)))
    right = rng.uniform(size=n) < chance
    fix = right | (rng.uniform(size=n) < solver.wrong)
    bound = 0.05 * 1.35**difficulty
    error = np.where(right, np.minimum(bound * 10.0 ** rng.normal(0.25, 0.3, n), 9.0), 10.0 ** rng.uniform(1.2, 3.9, n))
    confidence = np.clip(0.25 * chance + 0.72 * right + rng.normal(0.0, 0.05, n), 0.0, 1.0)
    outcomes = []
    for i in range(n):
        # Three frames a site; a site is the same for all solvers.
        place = np.random.default_rng(np.random.SeedSequence(ROOT_SEED, spawn_key=(i // 3, 77)))
        lat, lon = float(place.uniform(-60.0, 65.0)), float(place.uniform(-180.0, 180.0))
        found = int(rng.integers(8, 40))
        matched = int(found * rng.uniform(0.5, 0.95)) if fix[i] else 0
        angle, time_ms = float(rng.uniform(0.0, 2.0 * math.pi)), solver.time_ms * math.exp(rng.normal(0.0, 0.35))
        uv = rng.uniform((0.0, 0.0), (WIDTH - 1.0, HEIGHT - 1.0), (found + 6, 2))
        score = FrameScore(
            frame_id=f"frame-{i:05d}",
            index=i,
            bortle=int(task.levels[order[i]]) if task.name == "bortle" else 4,
            width_px=WIDTH,
            height_px=HEIGHT,
            status=FIX if fix[i] else REFUSED,
            reason="" if fix[i] else ("too few stars" if i % 3 else "no <b>consensus</b>"),
            lat_deg=lat if fix[i] else None,
            lon_deg=lon if fix[i] else None,
            error_km=float(error[i]) if fix[i] else math.inf,
            n_detections=found + 6,
            n_detected_stars=found,
            n_matches=matched,
            n_correct=int(0.98 * matched) if right[i] else 0,
            time_ms=time_ms,
            condition=task.levels[order[i]],
        )
        variance = float((1.4 * bound[i]) ** 2)
        details = FrameDetails(
            cov_km2=(variance, 0.0, variance) if fix[i] else None,
            confidence=float(confidence[i]) if fix[i] else None,
            detect_ms=0.4 * time_ms,
            solve_ms=0.6 * time_ms,
            stage_ms={"match": 0.3 * time_ms},
            utc="2024-01-01T00:00:00Z",
            conditions=FrameConditions(lat, lon, score.bortle, 21.0, 0.5, 400, moon_altitude_deg=float(i % 3)),
            site=f"{lat:+.4f} {lon:+.4f} 2024-01-01",
            error_east_km=float(error[i]) * math.cos(angle) if fix[i] else None,
            error_north_km=float(error[i]) * math.sin(angle) if fix[i] else None,
            crlb_km=float(bound[i]),
            peak_memory_mib=120.0 + 0.1 * solver.time_ms + float(rng.uniform(0.0, 5.0)),
        )
        rows = tuple(
            DetectionRow(
                f"frame-{i:05d}",
                k,
                float(u),
                float(v),
                100.0,
                1000 + k if k < matched else None,
                bool(right[i]) if k < matched else None,
            )
            for k, (u, v) in enumerate(uv)
        )
        outcomes.append(SolverOutcome(score, details, rows))
    key = hashlib.sha256(f"{solver.name}{task.name}{mode}".encode()).hexdigest()[:12]
    source = _provenance(task, solver, mode, per_level, key)
    folder = result_folder(root, solver.name, source)
    write_result(folder, solver.name, frame_table(outcomes), match_table(outcomes), source)


SCENARIO_SHA256 = "ab" * 32


def _provenance(task: FakeTask, solver: FakeSolver, mode: str, per_level: int, key: str) -> RunProvenance:
    return RunProvenance(
        frames=FrameFacts(
            target=task.label,
            label=task.label,
            title=task.title,
            split="dev",
            condition=None,
            per_condition=per_level,
            grading=Grading(task.condition, task.unit, task.levels, "higher" if task.larger_is_harder else "lower"),
            metric="success_10km",
            definition_sha256="ef" * 32,
            scenario_name=task.name,
            scenario_sha256=SCENARIO_SHA256,
            truth_sha256="cd" * 32,
            rendered_with={"skybench": "0.1.0", "mitsuba": "3.9.1"},
        ),
        solver=SolverFacts(
            target=solver.name,
            kind="registered",
            title=f"The solver {solver.name} & <i>its</i> title",
            licence="MIT",
            version="1.0",
            detector="truth <i>",
            revision="12" * 32,
            time_limit_s=10.0,
            memory_limit_mib=4096.0,
        ),
        detections=mode,
        key=key,
        versions={"skybench": "0.1.0", "python": "3.11.7"},
        machine={"cpu": "a processor", "cores": "2", "system": "Linux x86_64"},
        date_utc="2026-01-01T00:00:00Z",
        jobs=1,
    )


def _write_pictures(folder: Path, n: int, place: int) -> None:
    folder.mkdir(parents=True)
    for frame in range(n):
        rng = np.random.default_rng(np.random.SeedSequence(ROOT_SEED, spawn_key=(place, frame, 99)))
        image = rng.normal(120.0, 6.0, (HEIGHT, WIDTH))
        for _ in range(60):
            u, v = rng.integers(2, WIDTH - 3), rng.integers(2, HEIGHT - 3)
            image[v - 1 : v + 2, u - 1 : u + 2] += 10.0 ** rng.uniform(1.3, 3.3)
        Image.fromarray(np.clip(image, 0, 4095).astype(np.uint16)).save(
            folder / f"frame-{frame:05d}.png", compress_level=1
        )
