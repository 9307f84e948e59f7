"""Reader of rendered dataset folders (docs/dataset_format.md): frames for the solver, truth for the judge."""

import dataclasses
import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from benchmark.errors import DatasetError
from benchmark.frames.conditions import FrameConditions, SequenceStep, read_conditions, read_step
from benchmark.frames.record_values import RENDER_AGAIN, integer, number, read_record, text, value
from benchmark.protocol import CameraRecord, Observation
from generator.errors import GeneratorError
from generator.frame.record import STAR_SCHEMA
from generator.reading.stars import read_stars

TRUTH_COLUMNS = ("frame_id", "star_id", "v_mag", "u_px", "v_px", "electrons_e", "snr")
CLOUD_COLUMN = "cloud_optical_depth"
STREAK_COLUMNS = ("start_u_px", "start_v_px", "end_u_px", "end_v_px")
LIGHT_COLUMNS = ("light_u_px", "light_v_px")


@dataclass(frozen=True)
class TruthStars:
    """Truth stars of one frame, each of length n.

    Ids, positions (px), expected electrons, signal-to-noise ratios, optical depth of cloud in front of the star, its path
    over the image during the exposure (px), the centroids of its light (px), which is what a detector can find, and V. Path,
    depth and centroids are None where the truth table does not state them. For photographs some electrons, ratios and
    centroids are NaN; `named` is False for a photograph whose stars nobody can identify.
    """

    star_id: NDArray[np.int64]
    uv: NDArray[np.float64]
    electrons_e: NDArray[np.float64]
    snr: NDArray[np.float64]
    cloud_optical_depth: NDArray[np.float64] | None = None
    streak_px: NDArray[np.float64] | None = None
    light_uv: NDArray[np.float64] | None = None
    v_mag: NDArray[np.float64] | None = None
    named: bool = True

    @property
    def detected_uv(self) -> NDArray[np.float64]:
        """Where a perfect detector finds the stars, shape (n, 2), px: the centroids of light where known, else `uv`."""
        return self.uv if self.light_uv is None else np.where(np.isfinite(self.light_uv), self.light_uv, self.uv)

    @property
    def brightness(self) -> NDArray[np.float64]:
        """Brightness for comparing the stars, shape (n,): electrons, or the light by V where the electrons are unknown."""
        if self.v_mag is None or not np.isnan(self.electrons_e).any():
            return self.electrons_e
        return np.asarray(10.0 ** (-0.4 * self.v_mag))


@dataclass(frozen=True)
class Frame:
    """One frame of a dataset; `observation` goes to the solver, the rest to the judge.

    `condition` is the graded value of the frame in its task, None outside a task. `record_path` is the frame record, where it
    is not stored next to the image. `step` is the frame's place in a sequence of its scenario, None for a single frame.
    `site` names the place and night with which it is counted, None for its own (`benchmark.frames.sites`).
    """

    frame_id: str
    index: int
    image_path: Path
    observation: Observation
    conditions: FrameConditions
    truth: TruthStars
    condition: float | None = None
    record_path: Path | None = None
    step: SequenceStep | None = None
    site: str | None = None


@dataclass(frozen=True)
class Dataset:
    """A whole dataset folder; its images are not read yet.

    Attributes
    ----------
    name : str
        The folder's name without its path.
    scenario_name, scenario_sha256 : str
        From the frame records, which all state the same.
    truth_sha256 : str
        See `truth_digest`; together with the scenario it identifies the frames that were scored.
    frames : tuple of Frame
        In the order of their index.
    provenance : mapping of str to str
        The generator's versions, from the first frame record.
    """

    name: str
    scenario_name: str
    scenario_sha256: str
    truth_sha256: str
    frames: tuple[Frame, ...]
    provenance: Mapping[str, str]


def open_dataset(folder: Path, truth_tables: Sequence[Path] | None = None) -> Dataset:
    """Read all frame records and the truth from a folder of frames.

    Parameters
    ----------
    folder : Path
        What `skybench render --out` wrote.
    truth_tables : sequence of Path, optional
        Tables of the stars; by default the folder's ``stars.parquet``.

    Returns
    -------
    Dataset

    Raises
    ------
    DatasetError
        The folder is missing, unfinished or contradicts itself; the message names the file and the remedy.
    """
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder; make it with `skybench render SCENARIO --out {folder}`")
    record_paths = sorted(folder.glob("frame-*.json"))
    if not record_paths:
        raise DatasetError(f"{folder}: no frame-*.json in it; make a dataset with `skybench render`")
    truth_path = folder / "stars.parquet"
    if truth_tables is None and not truth_path.is_file():
        raise DatasetError(f"{truth_path}: missing, so the rendering was not finished; {RENDER_AGAIN}")
    truth: dict[str, TruthStars] = {}
    for path in [truth_path] if truth_tables is None else truth_tables:
        truth |= _read_truth(path)
    records = [read_record(path) for path in record_paths]
    frames = [_frame(path, record, truth) for path, record in zip(record_paths, records, strict=True)]
    scenarios = {_scenario(path, record) for path, record in zip(record_paths, records, strict=True)}
    if len(scenarios) != 1:
        raise DatasetError(f"{folder}: frames of {len(scenarios)} different scenarios; keep one scenario per folder")
    scenario_name, scenario_sha256 = scenarios.pop()
    indices = [frame.index for frame in frames]
    if len(set(indices)) != len(indices):
        raise DatasetError(f"{folder}: two frame records have the same index; {RENDER_AGAIN}")
    strangers = set(truth) - {frame.frame_id for frame in frames}
    if strangers:
        raise DatasetError(f"{truth_path}: has stars of {min(strangers)}, which has no frame record; {RENDER_AGAIN}")
    return Dataset(
        name=folder.resolve().name,
        scenario_name=scenario_name,
        scenario_sha256=scenario_sha256,
        truth_sha256=truth_digest(frames),
        frames=tuple(sorted(frames, key=lambda frame: frame.index)),
        provenance=rendered_with(records[0]),
    )


def truth_digest(frames: Sequence[Frame]) -> str:
    """SHA-256 of the truth of frames: ids, sites and stars, independent of the files that hold them and of their order."""
    digest = hashlib.sha256()
    for frame in sorted(frames, key=lambda frame: frame.frame_id):
        place = frame.conditions.latitude_deg, frame.conditions.longitude_deg
        digest.update(f"{frame.frame_id}:{place!r}:{len(frame.truth.star_id)}:".encode())
        truth = frame.truth
        light = () if truth.light_uv is None else (truth.light_uv,)
        for values in (truth.star_id, truth.uv, truth.electrons_e, truth.snr, *light):
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def rendered_with(record: Mapping[str, Any]) -> dict[str, str]:
    """Versions of the generator, from a frame record."""
    found = record.get("provenance", {})
    return {str(key): str(value) for key, value in found.items()} if isinstance(found, dict) else {}


def read_frames(record_paths: Sequence[Path], truth_paths: Sequence[Path]) -> Iterator[Frame]:
    """Read frame records, each with the image next to it, and their truth from any number of tables.

    Parameters
    ----------
    record_paths : sequence of Path
    truth_paths : sequence of Path

    Yields
    ------
    Frame
        In the order of the records.

    Raises
    ------
    DatasetError
        As for `open_dataset`.
    """
    truth: dict[str, TruthStars] = {}
    for path in truth_paths:
        truth |= _read_truth(path)
    for path in record_paths:
        yield _frame(path, read_record(path), truth)


def load_image(frame: Frame) -> NDArray[np.uint16]:
    """Read a frame's PNG as DN, shape (height, width).

    Raises
    ------
    DatasetError
        Missing, truncated, not a 16-bit one-channel PNG, or not of the camera's size.
    """
    path = frame.image_path
    if not path.is_file():
        raise DatasetError(f"{path}: missing image; {RENDER_AGAIN}")
    try:
        with Image.open(path, formats=["PNG"]) as picture:
            if picture.mode not in {"I;16", "I;16B"}:
                raise DatasetError(f"{path}: expected 16 bits and one channel, found mode {picture.mode}")
            if picture.size != (frame.observation.camera.width, frame.observation.camera.height):
                raise DatasetError(_other_size(path, frame, *picture.size))
            picture.load()
            image = np.asarray(picture).astype(np.uint16)
    except UnidentifiedImageError as error:
        raise DatasetError(f"{path}: not a PNG image; {RENDER_AGAIN}") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        # Pillow reports a truncated or corrupted stream as any of these.
        raise DatasetError(f"{path}: truncated or damaged PNG ({error}); {RENDER_AGAIN}") from error
    return image


def _other_size(path: Path, frame: Frame, width: int, height: int) -> str:
    camera = frame.observation.camera
    return (
        f"{path}: the image has {width} x {height} pixels, its camera in {frame.frame_id}.json "
        f"{camera.width} x {camera.height}; the two must agree, {RENDER_AGAIN}"
    )


def true_observation(path: Path, record: Mapping[str, Any]) -> Observation:
    """Camera, time, attitude and air as a frame record states them, not as solvers receive them; `path` is for messages."""
    utc = text(path, record, "time.utc_mid")
    if not utc.endswith("Z"):
        raise DatasetError(f"{path}: time.utc_mid must be UTC with a trailing Z, found {utc!r}")
    refracts = value(path, record, "atmosphere.refraction")
    if not isinstance(refracts, bool):
        raise DatasetError(f"{path}: atmosphere.refraction must be true or false, found {refracts!r}")
    return Observation(
        camera=_camera(path, record),
        utc=utc,
        R_cam=_attitude(path, record),
        pressure_hpa=number(path, record, "atmosphere.pressure_hpa", 0.0, 1200.0) if refracts else 0.0,
        temperature_c=number(path, record, "atmosphere.temperature_c", -100.0, 80.0),
    )


def told_observation(path: Path, record: Mapping[str, Any]) -> Observation:
    """What solvers receive for a frame: the truth, except where its record states another camera and attitude as told."""
    seen = true_observation(path, record)
    if "told" not in record:
        return seen
    told = value(path, record, "told")
    # JSON has no number for the infinite deviation of an unknown heading.
    unknown = value(path, told, "attitude.heading_sigma_deg") is None
    return dataclasses.replace(
        seen,
        camera=_camera(path, told),
        R_cam=_attitude(path, told),
        tilt_sigma_deg=number(path, told, "attitude.tilt_sigma_deg", 0.0, 180.0),
        heading_sigma_deg=math.inf if unknown else number(path, told, "attitude.heading_sigma_deg", 0.0, 180.0),
    )


def _scenario(path: Path, record: Mapping[str, Any]) -> tuple[str, str]:
    return text(path, record, "scenario.name"), text(path, record, "scenario.sha256")


def _camera(path: Path, record: Mapping[str, Any]) -> CameraRecord:
    def coefficients(key: str) -> tuple[float, ...]:
        found = value(path, record, key)
        if not isinstance(found, list) or not all(isinstance(c, int | float) and math.isfinite(c) for c in found):
            raise DatasetError(f"{path}: {key} must be a list of finite numbers, found {found!r}")
        return tuple(float(c) for c in found)

    return CameraRecord(
        model=text(path, record, "camera.model"),
        width=integer(path, record, "camera.width", low=1),
        height=integer(path, record, "camera.height", low=1),
        f_px=number(path, record, "camera.f_px"),
        fy_px=number(path, record, "camera.fy_px"),
        cx_px=number(path, record, "camera.cx_px"),
        cy_px=number(path, record, "camera.cy_px"),
        k=coefficients("camera.k"),
        p=coefficients("camera.p"),
        s=coefficients("camera.s") if "s" in record["camera"] else (),
        tilt_rad=coefficients("camera.tilt_rad") if "tilt_rad" in record["camera"] else (),
    )


def _attitude(path: Path, record: Mapping[str, Any]) -> NDArray[np.float64]:
    found = value(path, record, "attitude.R_cam")
    try:
        matrix = np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{path}: attitude.R_cam must be 3 rows of 3 numbers, found {found!r}") from error
    proper = matrix.shape == (3, 3) and np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)
    if not proper or np.linalg.det(matrix) < 0.0:
        raise DatasetError(f"{path}: attitude.R_cam is not a rotation matrix; {RENDER_AGAIN}")
    return matrix


def _frame(path: Path, record: Mapping[str, Any], truth: Mapping[str, TruthStars]) -> Frame:
    frame_id = text(path, record, "frame_id")
    if frame_id != path.stem:
        raise DatasetError(f"{path}: frame_id is {frame_id!r}, the file's name says {path.stem!r}")
    n_in_field = integer(path, record, "stars.n_in_field")
    stars = truth.get(frame_id, _NO_STARS)
    if len(stars.star_id) != n_in_field:
        raise DatasetError(
            f"{path}: stars.n_in_field is {n_in_field}, stars.parquet has {len(stars.star_id)} rows of this frame; "
            f"{RENDER_AGAIN}"
        )
    photograph = record.get("photograph")
    if isinstance(photograph, dict) and photograph.get("aligned_stars") == 0:
        stars = dataclasses.replace(stars, named=False)
    observation, truth_seen = told_observation(path, record), true_observation(path, record)
    return Frame(
        frame_id=frame_id,
        index=integer(path, record, "index"),
        image_path=path.with_suffix(".png"),
        observation=observation,
        conditions=read_conditions(
            path, record, truth_seen.camera, truth_seen.R_cam, n_in_field, stars.cloud_optical_depth
        ),
        truth=stars,
        step=read_step(path, record),
    )


_NO_STARS = TruthStars(
    np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty(0, dtype=np.float64), np.empty(0, dtype=np.float64)
)


def _read_truth(path: Path) -> dict[str, TruthStars]:
    wanted = (*TRUTH_COLUMNS, CLOUD_COLUMN, *STREAK_COLUMNS, *LIGHT_COLUMNS)
    try:
        table = read_stars(path, STAR_SCHEMA, needed=TRUTH_COLUMNS, columns=wanted)
    except GeneratorError as error:
        raise DatasetError(f"{error}; {RENDER_AGAIN}") from error
    optional = CLOUD_COLUMN in table.column_names
    streaks = all(name in table.column_names for name in STREAK_COLUMNS)
    # One sort groups the rows by frame and keeps their order in the file.
    frame_ids = table["frame_id"].combine_chunks().dictionary_encode()
    code = frame_ids.indices.to_numpy(zero_copy_only=False)
    rows = np.argsort(code, kind="stable")
    starts = np.searchsorted(code[rows], np.arange(len(frame_ids.dictionary) + 1))

    def sorted_column(name: str, kind: type = np.float64) -> NDArray[Any]:
        return np.asarray(table[name].to_numpy(zero_copy_only=False)[rows], dtype=kind)

    star_id, electrons_e, snr = sorted_column("star_id", np.int64), sorted_column("electrons_e"), sorted_column("snr")
    uv = np.column_stack([sorted_column("u_px"), sorted_column("v_px")])
    v_mag = sorted_column("v_mag")
    cloud = sorted_column(CLOUD_COLUMN) if optional else None
    lit = all(name in table.column_names for name in LIGHT_COLUMNS)
    light = np.column_stack([sorted_column(name) for name in LIGHT_COLUMNS]) if lit else None
    streak = _streak(*(sorted_column(name) for name in STREAK_COLUMNS)) if streaks else None
    stars = {}
    for place, frame_id in enumerate(frame_ids.dictionary.to_pylist()):
        own = slice(starts[place], starts[place + 1])
        stars[str(frame_id)] = TruthStars(
            star_id=star_id[own],
            uv=uv[own],
            electrons_e=electrons_e[own],
            snr=snr[own],
            cloud_optical_depth=None if cloud is None else cloud[own],
            streak_px=None if streak is None else streak[own],
            light_uv=None if light is None else light[own],
            v_mag=v_mag[own],
        )
    return stars


def _streak(
    start_u: NDArray[np.float64], start_v: NDArray[np.float64], end_u: NDArray[np.float64], end_v: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Vector from start to end, shape (n, 2), px; 0 where the table has no number."""
    return np.nan_to_num(np.column_stack((end_u - start_u, end_v - start_v)).astype(np.float64))
