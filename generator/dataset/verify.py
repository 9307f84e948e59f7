"""`skybench verify`: compares a dataset on disk with its manifest, and the manifest with its scenario.

Logs are not covered: they contain times, and nothing depends on them. Receipts, which a distributed dataset may lack,
must agree with the manifest if they exist.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa

from generator.dataset.archive import check_holes
from generator.dataset.images import PHOTOS, photo
from generator.dataset.layout import CROISSANT, IMU, MANIFEST, SCENARIO_COPY, TABLES, DatasetSpec, divide, imu_places
from generator.dataset.manifest import Manifest, read_manifest
from generator.dataset.reader import Dataset, checked_table, read_shard
from generator.dataset.receipt import read_receipt
from generator.dataset.target import LocalTarget
from generator.errors import GeneratorError
from generator.files import linked_within
from generator.reading.png_header import check_png
from generator.reading.record import image_shape
from generator.reading.stars import missing_rows
from generator.scenario.file import load_scenario
from generator.stored_files import StoredFile, file_problem, problems_of_files, strange_files

OPTIONAL_PICTURES = {"developed.png", "hud.png", "mask.png"}
"""Additional members of a frame whose sensor develops a picture or shows a head-up display, or whose sky is partly hidden."""
OPTIONAL_MEMBERS = OPTIONAL_PICTURES | {*PHOTOS, "stack.fits", "video.mp4"}
"""These, photograph files, and members of a frame that is a stack of a video."""
PNG_MEMBERS = {"png"} | OPTIONAL_PICTURES
NOT_COVERED = "logs"


def problems(folder: Path, progress: Callable[[str], None] = lambda path: None) -> list[str]:
    """Problems of a dataset, one line each with the file's name; an empty list for an intact dataset.

    Parameters
    ----------
    folder : Path
    progress : callable
        Called with each file that has been read.
    """
    try:
        manifest = read_manifest(folder)
    except GeneratorError as error:
        return [str(error)]
    found = _scenario_problems(folder, manifest)
    listed = {file.path for file in manifest.files}
    found += problems_of_files(folder, manifest.files, progress, _file_problem)
    receipts, more = _receipt_problems(folder, manifest)
    found += more
    for stranger in strange_files(folder, listed | receipts | {MANIFEST}):
        if not stranger.startswith(f"{NOT_COVERED}/"):
            found.append(f"{stranger}: not in the manifest")
    return found if found else _content_problems(Dataset(folder, manifest))


def _scenario_problems(folder: Path, manifest: Manifest) -> list[str]:
    """Contradictions between the manifest and the scenario next to it, and shards that the manifest does not list."""
    try:
        scenario = load_scenario(folder / SCENARIO_COPY)
        spec = DatasetSpec(manifest.split, manifest.shard_size, manifest.exr, manifest.codec)
        shards = divide(scenario, spec, manifest.first, manifest.stop)
    except GeneratorError as error:
        return [str(error)]
    if scenario.sha256 != manifest.scenario_sha256:
        return [f"{MANIFEST}: belongs to another scenario than {SCENARIO_COPY} (or to another version of skybench)"]
    for key, value in (("scenario", scenario.name), ("seed", scenario.seed)):
        if getattr(manifest, key) != value:
            return [f"{MANIFEST}: {key} is {getattr(manifest, key)!r}, but {SCENARIO_COPY} says {value!r}"]
    listed = {file.path for file in manifest.files}
    wanted = [place for shard in shards for place in shard.files] + [SCENARIO_COPY, CROISSANT]
    wanted += [file.path for file in scenario.files]
    wanted += imu_places(scenario, spec.split, manifest.first, manifest.stop).values()
    return [f"{place}: missing from the manifest" for place in wanted if place not in listed]


def _receipt_problems(folder: Path, manifest: Manifest) -> tuple[set[str], list[str]]:
    """Paths at which receipts may be, and problems of receipts that are damaged or contradict the manifest."""
    try:
        scenario = load_scenario(folder / SCENARIO_COPY)
        spec = DatasetSpec(manifest.split, manifest.shard_size, manifest.exr, manifest.codec)
        shards = divide(scenario, spec, manifest.first, manifest.stop)
    except GeneratorError:  # reported by the check of the scenario
        return set(), []
    listed = {file.path: file for file in manifest.files}
    found = []
    for shard in shards:
        if not (folder / shard.receipt).exists():
            continue
        try:
            files = read_receipt(LocalTarget(folder), shard, scenario, spec)
        except GeneratorError as error:
            found.append(str(error))
            continue
        except OSError as error:
            found.append(f"{shard.receipt}: cannot be read ({error.strerror})")
            continue
        if files is None or any(listed.get(file.path) != file for file in files):
            found.append(f"{shard.receipt}: damaged, or not of the files that the manifest lists")
    return {shard.receipt for shard in shards}, found


def _file_problem(folder: Path, listed: StoredFile) -> str:
    path = folder / listed.path
    try:
        linked_within(folder, listed.path)
        if path.suffix == ".tar" and path.is_file() and path.stat().st_size == listed.bytes:
            check_holes(path)
    except GeneratorError as error:
        return str(error)
    except OSError as error:
        return f"{listed.path}: cannot be read ({error.strerror})"
    return file_problem(folder, listed)


def _content_problems(dataset: Dataset) -> list[str]:
    """Contradictions between tables and archives whose bytes are as listed, with one shard in memory at a time."""
    found = []
    try:
        for name in (*TABLES[1:], IMU):
            for path in dataset.paths(name):
                checked_table(name, path)
        for path in dataset.paths("data"):
            found += _shard_problems(dataset, path)
    except (GeneratorError, OSError, pa.ArrowException) as error:
        found.append(str(error))
    return found


def _shard_problems(dataset: Dataset, archive: Path) -> list[str]:
    """Contradictions between a shard's table of frames, its records and its images. Raises GeneratorError."""
    table = archive.parents[2] / "frames" / archive.parent.name / f"{archive.stem}.parquet"
    rows = checked_table("frames", table, dataset.manifest.shard_size)["frame_id"].to_pylist()
    wanted = {dataset.manifest.codec, "json"} | ({"exr"} if dataset.manifest.exr else set())
    found: list[str] = []
    stored: list[str] = []
    stars_of: dict[int, int] = {}
    for frame in read_shard(archive):
        stored.append(frame.frame_id)
        if not wanted <= set(frame.members) <= wanted | OPTIONAL_MEMBERS:
            found.append(f"{archive.stem}: {frame.frame_id} has {sorted(frame.members)}, expected {sorted(wanted)}")
            continue
        stars_of[frame.index] = frame.record["stars"]["n_in_field"]
        if frame.record["scenario"]["sha256"] != dataset.manifest.scenario_sha256:
            found.append(f"{archive.stem}: {frame.frame_id} belongs to another scenario")
        for suffix in sorted(set(frame.members) & PNG_MEMBERS):
            try:
                check_png(frame.members[suffix], image_shape(frame.record))
            except GeneratorError as error:
                found.append(f"{archive.stem}: {frame.frame_id}.{suffix} is {error}")
        for suffix in sorted(frame.members.keys() & set(PHOTOS)):
            try:
                photo(frame.members[suffix], image_shape(frame.record))
            except GeneratorError as error:
                found.append(f"{archive.stem}: {frame.frame_id}.{suffix} is {error}")
    if rows != stored:
        found.append(f"{table.relative_to(dataset.folder)}: the table lists other frames than the shard holds")
    stars = table.parents[2] / "stars" / archive.parent.name / table.name
    listed = Counter(checked_table("stars", stars, columns=["index"])["index"].to_pylist())
    return found or list(missing_rows(stars.relative_to(dataset.folder).as_posix(), stars_of, listed))
