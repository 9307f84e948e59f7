"""A tiny dataset in the documented format, made of Gaussian blobs, and contestants of known score."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image
from scipy.ndimage import maximum_filter

from benchmark.frames.dataset import Frame
from benchmark.protocol import Answer, Observation

WIDTH, HEIGHT = 160, 120
R_ZENITH = [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
SITES = [(48.0, 11.0), (-33.5, 18.4), (64.1, -21.9)]
ROOT_SEED = 20260101


def rng_for(*key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(ROOT_SEED, spawn_key=key))


def write_dataset(
    folder: Path,
    bortle_classes: tuple[int | None, ...] = (1, 2, 3),
    per_class: int = 1,
    n_stars: int = 12,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    scenario: str = "fake night",
) -> Path:
    """Write a dataset folder; stars keep 10 px from each other, so that identities are beyond doubt."""
    folder.mkdir(parents=True)
    width, height = size
    rows = []
    for index in range(len(bortle_classes) * per_class):
        rng = rng_for(index)
        bortle = bortle_classes[index // per_class]
        uv = _spread(rng, n_stars, width, height)
        electrons = 10.0 ** rng.uniform(3.5, 5.0, n_stars)
        frame_id = f"frame-{index:05d}"
        v, u = np.mgrid[0:height, 0:width]
        image = 100.0 + 20.0 * (bortle or 0) + rng.normal(0.0, 3.0, (height, width))
        for (su, sv), e in zip(uv, electrons, strict=True):
            image += e / (2 * math.pi) * np.exp(-0.5 * ((u - su) ** 2 + (v - sv) ** 2)) / 10.0
        pixels = np.clip(np.round(image), 0, 4095).astype(np.uint16)
        Image.fromarray(pixels).save(folder / f"{frame_id}.png")
        lat, lon = SITES[index % len(SITES)]
        record = frame_record(frame_id, index, bortle, lat, lon, width, height, n_stars, scenario)
        (folder / f"{frame_id}.json").write_text(json.dumps(record), encoding="utf-8")
        ids = rng.choice(np.arange(1, 118000), n_stars, replace=False)
        rows += [
            {
                "index": index,
                "frame_id": frame_id,
                "star_id": int(star),
                "v_mag": float(12.0 - 2.5 * math.log10(e) / 1.0),
                "u_px": float(p[0]),
                "v_px": float(p[1]),
                "electrons_e": float(e),
                "snr": float(math.sqrt(e)),
            }
            for star, p, e in zip(ids, uv, electrons, strict=True)
        ]
    pq.write_table(pa.Table.from_pylist(rows), folder / "stars.parquet")
    return folder


def frame_record(
    frame_id: str,
    index: int,
    bortle: int | None,
    lat: float,
    lon: float,
    width: int,
    height: int,
    n_stars: int,
    scenario: str,
) -> dict[str, object]:
    return {
        "format": "skybench-frame/1",
        "frame_id": frame_id,
        "index": index,
        "scenario": {"name": scenario, "sha256": "ab" * 32, "seed": 0},
        "site": {"latitude_deg": lat, "longitude_deg": lon, "height_m": 100.0},
        "time": {
            "utc_start": f"2020-01-01T00:{index:02d}:00Z",
            "utc_mid": f"2020-01-01T00:{index:02d}:00.5Z",
            "exposure_s": 1.0,
        },
        "camera": {
            "model": "pinhole",
            "width": width,
            "height": height,
            "f_px": 60.0,
            "fy_px": 60.0,
            "cx_px": (width - 1) / 2,
            "cy_px": (height - 1) / 2,
            "k": [],
            "p": [],
        },
        "attitude": {"R_cam": R_ZENITH},
        "atmosphere": {"pressure_hpa": 1010.0, "temperature_c": 10.0, "refraction": True},
        "sky": {"bortle": bortle, "zenith_mag_arcsec2": None if bortle is None else 22.0 - 0.5 * bortle},
        "stars": {"n_in_field": n_stars, "limiting_magnitude": 6.0},
        "provenance": {"skybench": "0.0", "mitsuba": "0.0"},
    }


def _spread(rng: np.random.Generator, n: int, width: int, height: int) -> np.ndarray:
    chosen: list[np.ndarray] = []
    while len(chosen) < n:
        candidate = rng.uniform((5.0, 5.0), (width - 6.0, height - 6.0))
        if all(np.hypot(*(candidate - other)) > 10.0 for other in chosen):
            chosen.append(candidate)
    return np.array(chosen)


@dataclass(frozen=True)
class Points:
    uv: np.ndarray
    flux: np.ndarray


@dataclass(frozen=True)
class Contestant:
    """Base: knows the truth by the frame's time, which only a cheat can; each test's contestant bends it its way."""

    name: str
    frames: tuple[Frame, ...]
    version: str = "1"
    detector: str = "truth"

    def detect(self, image: np.ndarray) -> Points:
        # Of equal neighbours the last is the peak: a star has one detection.
        light = image + 1e-9 * np.arange(image.size).reshape(image.shape)
        peaks = np.argwhere((light == maximum_filter(light, 7)) & (image > np.median(image) + 25))
        return Points(peaks[:, ::-1].astype(float), image[peaks[:, 0], peaks[:, 1]].astype(float))

    def frame_of(self, observation: Observation) -> Frame:
        return next(frame for frame in self.frames if frame.observation.utc == observation.utc)


class Truth(Contestant):
    """Submits the truth: every detection near a star gets that star's id."""

    def solve(self, detections: Points, observation: Observation) -> Answer:
        frame = self.frame_of(observation)
        return Answer(
            ok=True,
            lat_deg=frame.conditions.latitude_deg,
            lon_deg=frame.conditions.longitude_deg,
            cov_km2=np.diag([0.01, 0.02]),
            confidence=1.0,
            matches=true_matches(detections.uv, frame),
            time_ms={"look up": 0.1},
        )


class Refusing(Contestant):
    def solve(self, detections: Points, observation: Observation) -> Answer:
        return Answer(ok=False, reason="too few stars")


class Raising(Contestant):
    def solve(self, detections: Points, observation: Observation) -> Answer:
        raise RuntimeError("singular\nmatrix <script>alert(1)</script>")


class Random(Contestant):
    """A random position anywhere and a random permutation of the frame's own star ids."""

    def solve(self, detections: Points, observation: Observation) -> Answer:
        frame = self.frame_of(observation)
        rng = rng_for(1000, frame.index)
        ids = rng.choice(np.arange(118001, 10**6), len(detections.uv), replace=False)
        return Answer(
            ok=True,
            lat_deg=float(np.degrees(np.arcsin(rng.uniform(-1.0, 1.0)))),
            lon_deg=float(rng.uniform(-180.0, 180.0)),
            matches=np.column_stack([np.arange(len(ids)), ids]).astype(np.int64),
        )


class Mixed(Contestant):
    """Errors that grow with the Bortle class, refusals in the brightest skies, some matches swapped."""

    def solve(self, detections: Points, observation: Observation) -> Answer:
        frame = self.frame_of(observation)
        rng = rng_for(2000 + len(self.name), frame.index)
        bortle = frame.conditions.bortle or 0
        if rng.uniform() < 0.12 * (bortle - 3):
            return Answer(ok=False, reason="no consensus")
        matches = true_matches(detections.uv, frame)
        if rng.uniform() < 0.06 * bortle and len(matches) > 2:
            wrong = rng.choice(len(matches), max(1, len(matches) // 3), replace=False)
            matches[wrong, 1] = 118002
        error_deg = 10.0 ** (rng.normal(-1.8, 0.5) + 0.12 * bortle + (0.3 if len(self.name) % 2 else 0.0))
        return Answer(
            ok=True,
            lat_deg=frame.conditions.latitude_deg + error_deg * (-1) ** frame.index,
            lon_deg=frame.conditions.longitude_deg,
            confidence=0.9,
            matches=matches,
        )


def true_matches(uv: np.ndarray, frame: Frame) -> np.ndarray:
    pairs = []
    for i, place in enumerate(uv):
        distance = np.hypot(*(frame.truth.uv - place).T)
        if distance.min() <= 3.0:
            pairs.append((i, int(frame.truth.star_id[distance.argmin()])))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)
