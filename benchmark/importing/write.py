"""Writer of datasets of photographs: a folder as from `skybench render`, with a record per photograph and its known stars."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmark.errors import PhotographError
from benchmark.importing.known_sky import FAINTEST_MAG, KnownSky, known_sky
from benchmark.importing.photographs import Clock, Photograph, check_tagged_times, file_sha256, read_photograph
from benchmark.importing.star_truth import Pointing, find_pointing, star_rows
from benchmark.importing.told import ToldCamera, camera_object
from benchmark.place import Place
from generator import __version__
from generator.dataset.images import encode
from generator.errors import GeneratorError
from generator.files import atomic_path, write_bytes
from generator.frame.folder import STARS_FILE, frame_id
from generator.frame.manifest import FRAMES_MANIFEST, FramesManifest, read_frames_manifest, write_manifest
from generator.frame.record import pointing_object, record_bytes, visible_stars
from generator.frame.verify import problems
from generator.reading.record import FORMAT
from generator.stored_files import stored_file

IMPORT_FORMAT = 3
"""Increases with every change of what an import produces from the same files."""
_FRAME = re.compile(r"frame-\d{5,8}\.(png|json)")
"""Names of a frame's files as an import writes them."""


@dataclass(frozen=True, eq=False)
class Import:
    """Input of a dataset.

    Attributes
    ----------
    name : str
        Name of the dataset, used like a scenario's.
    photographs : sequence of Path
    place : Place
    told : ToldCamera
    clock : Clock
    gain_e_per_dn : float or None
        Electrons per unit of the files' numbers.
    """

    name: str
    photographs: Sequence[Path]
    place: Place
    told: ToldCamera
    clock: Clock = field(default_factory=Clock)
    gain_e_per_dn: float | None = None


@dataclass(frozen=True)
class Imported:
    """A photograph of a dataset that has been written.

    Attributes
    ----------
    frame_id, file, utc_mid : str
    stars : int
        Number of stars used to find the attitude; 0 where there were too few.
    named : int
        Number of rows of stars.
    rms_px, turned_deg : float or None
    """

    frame_id: str
    file: str
    utc_mid: str
    stars: int
    named: int
    rms_px: float | None
    turned_deg: float | None


def import_photographs(
    given: Import, out: Path, overwrite: bool = False, progress: Callable[[Imported | None], None] = lambda done: None
) -> list[Imported]:
    """Write a dataset of photographs; a complete existing one is left as it is.

    Parameters
    ----------
    given : Import
    out : Path
        A new or empty folder, or one with an earlier import.
    overwrite : bool
        Whether to replace frames of other photographs.
    progress : callable
        Called after each photograph, and with None where the dataset existed.

    Returns
    -------
    list of Imported
        Empty for a dataset that existed.

    Raises
    ------
    PhotographError
        A photograph or the folder cannot be used.
    """
    for path in given.photographs:
        if path.resolve().parent == out.resolve():
            raise PhotographError(f"{out}: holds the photographs themselves ({path.name}, …); choose another folder")
    hashes = [file_sha256(path) for path in given.photographs]
    check_tagged_times(given.photographs, given.clock)
    identity = _identity(given, hashes)
    if _there(out, identity, overwrite):
        return []
    done, tables, files = [], [], []
    try:
        for index, (path, digest) in enumerate(zip(given.photographs, hashes, strict=True)):
            made, rows, written = _import_one(given, index, path, digest, identity, out)
            done.append(made)
            tables.append(rows)
            files += written
            progress(made)
        with atomic_path(out / STARS_FILE) as temporary:
            pq.write_table(pa.concat_tables(tables), temporary, compression="zstd")
        stored = tuple(sorted((stored_file(out, name) for name in (*files, STARS_FILE)), key=lambda file: file.path))
        write_manifest(out, FramesManifest(given.name, identity, 0, __version__, len(done), stored))
    except OSError as error:
        raise PhotographError(f"{error.filename or out}: writing failed ({error.strerror})") from error
    return done


def _import_one(
    given: Import, index: int, path: Path, digest: str, identity: str, out: Path
) -> tuple[Imported, pa.Table, list[str]]:
    photograph = read_photograph(path, given.clock)
    camera = given.told.camera
    height, width = photograph.pixels.shape
    if (width, height) != (camera.width, camera.height):
        raise PhotographError(
            f"{path}: has {width} x {height} px, the camera {camera.width} x {camera.height}; calibrate a camera of this size"
        )
    try:
        sky = known_sky(given.place, photograph.utc_mid, photograph.exposure_s)
    except PhotographError as error:
        raise PhotographError(f"{path}: {error}") from error
    told = given.told.at(photograph.utc_mid)
    light = photograph.light
    pointing = find_pointing(light, told, sky)
    name = frame_id(index)
    # The gain is that of the file's numbers, the frame's are scaled.
    gain = None if given.gain_e_per_dn is None else given.gain_e_per_dn / photograph.scale
    rows = star_rows(light, photograph.full, camera, pointing, sky, (index, name), gain)
    record = _record(given, told, photograph, sky, pointing, rows, gain) | {
        "frame_id": name,
        "index": index,
        "scenario": {"name": given.name, "sha256": identity, "seed": 0},
    }
    record["photograph"] |= {"file": path.name, "sha256": digest}
    # The record comes first, so that a picture without one is never an import's.
    write_bytes(out / f"{name}.json", record_bytes(record))
    write_bytes(out / f"{name}.png", encode(photograph.pixels, "png"))
    made = Imported(
        name, path.name, photograph.utc_mid, pointing.stars, rows.num_rows, pointing.rms_px, pointing.turned_deg
    )
    return made, rows, [f"{name}.png", f"{name}.json"]


def _record(
    given: Import,
    told: ToldCamera,
    photograph: Photograph,
    sky: KnownSky,
    pointing: Pointing,
    rows: pa.Table,
    gain_e_per_dn: float | None,
) -> dict[str, Any]:
    """Make the frame record (docs/dataset_format.md); what is unknown about a photograph is null."""
    place, state = given.place, sky.state
    camera = camera_object(told.camera)
    unknown = dict.fromkeys
    return {
        "format": FORMAT,
        "site": {
            "latitude_deg": place.latitude_deg,
            "longitude_deg": place.longitude_deg,
            "height_m": place.height_m,
            "ground_height_m": None,
        },
        "time": {
            "utc_start": sky.utc_start.isoformat(),
            "utc_mid": sky.utc_mid.isoformat(),
            "exposure_s": photograph.exposure_s,
            "ut1_utc_s": sky.orientation.ut1_utc_s,
            "polar_motion_x_arcsec": sky.orientation.polar_motion_x_arcsec,
            "polar_motion_y_arcsec": sky.orientation.polar_motion_y_arcsec,
        },
        "camera": camera,
        "attitude": _attitude(pointing.R_cam),
        "told": {
            "camera": camera,
            "attitude": _attitude(told.R_cam)
            | {
                "tilt_sigma_deg": told.tilt_sigma_deg,
                "heading_sigma_deg": None if math.isinf(told.heading_sigma_deg) else told.heading_sigma_deg,
            },
        },
        "optics": unknown(("aperture_mm", "transmission", "psf_sigma_px", "pupil", "vignetting", "image_circle_px")),
        "sensor": unknown(
            ("black_level_dn", "full_well_e", "read_noise_e", "dark_current_e_s", "quantum_efficiency", "line_time_s",
             "readout_direction")
        )
        | {
            "bits": photograph.bits,
            "gain_e_per_dn": gain_e_per_dn,
            "bayer_pattern": photograph.bayer_pattern,
        },
        "atmosphere": unknown(
            ("aerosol_tau_550", "angstrom_exponent", "ozone_du", "precipitable_water_mm", "extinction")
        )
        | {
            "pressure_hpa": place.air.pressure_hpa,
            "temperature_c": place.air.temperature_c,
            "relative_humidity": place.air.relative_humidity,
            "refraction": True,
        },
        "sky": unknown(("bortle", "zenith_mag_arcsec2", "components", "horizon_altitude_deg", "clouds"))
        | {
            "sun_altitude_deg": state.sun_altitude_deg,
            "moon_altitude_deg": state.moon_altitude_deg,
            "moon_phase_angle_deg": state.moon.phase_angle_deg,
        },
        "stars": {
            "n_in_field": rows.num_rows,
            "n_visible": visible_stars(rows) if pointing.named else None,
            "limiting_magnitude": FAINTEST_MAG,
            "catalogue": "ybsc+hipparcos",
        },
        "photograph": {
            "scale": photograph.scale,
            "offset_dn": photograph.offset,
            "time": list(photograph.assumed),
            "aligned_stars": pointing.stars,
            "aligned_rms_px": pointing.rms_px,
            "turned_deg": pointing.turned_deg,
        },
        "provenance": {"skybench": __version__, "numpy": np.__version__},
    }  # fmt: skip


def _attitude(R_cam: Any) -> dict[str, Any]:
    rows = (np.round(np.asarray(R_cam), 15) + 0.0).tolist()
    return {
        "R_cam": rows,
        **pointing_object(np.asarray(R_cam)),
        "sample_time_s": [0.0],
        "sample_R_cam": [rows],
        "imu_time_s": [],
        "imu_rate_deg_s": [],
        "imu_bias_deg_s": [0.0, 0.0, 0.0],
    }


def _identity(given: Import, hashes: Sequence[str]) -> str:
    """SHA-256 of everything that determines the dataset."""
    meaning = {
        "import": IMPORT_FORMAT,
        "place": [given.place.latitude_deg, given.place.longitude_deg, given.place.height_m],
        "told": given.told.meaning(),
        "clock": [given.clock.time_zone, given.clock.stamp, given.clock.exposure_s, dict(given.clock.table)],
        "gain_e_per_dn": given.gain_e_per_dn,
        "files": [[path.name, digest] for path, digest in zip(given.photographs, hashes, strict=True)],
    }
    return hashlib.sha256(json.dumps(meaning, sort_keys=True).encode()).hexdigest()


def _there(out: Path, identity: str, overwrite: bool) -> bool:
    """Whether the dataset exists and is complete; otherwise prepare the folder for it. Raises PhotographError."""
    try:
        manifest = read_frames_manifest(out)
        if manifest.scenario_sha256 == identity and not problems(out):
            return True
        same = manifest.scenario_sha256 == identity
    except GeneratorError:
        same = False
    try:
        out.mkdir(parents=True, exist_ok=True)
        found = sorted(out.iterdir())
        dataset = (out / FRAMES_MANIFEST).exists()
        own = [path for path in found if (_is_of_dataset(path) if dataset else _is_of_import(path))]
        strangers = [path.name for path in found if path not in own]
        if strangers:
            raise PhotographError(f"{out}: holds other files ({strangers[0]}, …); choose an empty folder")
        if dataset and not (overwrite or same):
            raise PhotographError(
                f"{out}: holds another dataset; choose another folder, or replace it with --overwrite"
            )
        for path in sorted(own, key=lambda path: path.name != FRAMES_MANIFEST):
            path.unlink()
    except OSError as error:
        raise PhotographError(f"{out}: cannot be written ({error.strerror}); choose another folder") from error
    return False


def _is_of_dataset(path: Path) -> bool:
    """Whether a file in a folder with a manifest belongs to the dataset, by its name."""
    return path.name in (STARS_FILE, FRAMES_MANIFEST) or path.name.startswith("frame-")


def _is_of_import(path: Path) -> bool:
    """Whether a file in a folder without a manifest is left from an import that was interrupted, by the records."""
    if path.name == STARS_FILE:
        return _is_of_import(path.with_name(f"{frame_id(0)}.json"))
    if _FRAME.fullmatch(path.name) is None:
        return False
    try:
        return "photograph" in json.loads(path.with_suffix(".json").read_bytes())
    except (OSError, ValueError, TypeError, RecursionError):
        return False
