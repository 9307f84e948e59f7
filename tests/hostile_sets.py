"""Datasets as a stranger could forge them: small files that claim to be huge, and nonsense where a format has numbers.

Each attack changes a finished dataset of two shards with one frame each; the manifest then lists the forged files, as it
would for whoever hands on such a dataset.
"""

import hashlib
import io
import json
import shutil
import struct
import tarfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

Attack = Callable[[Path], None]
FIRST = "shard-000000"
BOMB_ROWS = 2_000_000
"""More than a file of some kilobytes may have; few enough to forge in a moment."""
HOLE_BYTES = 50_000_000
"""More than a small image can take."""


def forged(whole: Path, folder: Path, attack: Attack) -> Path:
    """A copy of a dataset that an attack has changed, with a manifest that agrees with it."""
    shutil.copytree(whole, folder)
    attack(folder)
    shutil.rmtree(folder / "receipts", ignore_errors=True)
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8"))
    for file in manifest["files"]:
        with (folder / file["path"]).open("rb") as stream:
            file["sha256"] = hashlib.file_digest(stream, "sha256").hexdigest()
        file["bytes"] = (folder / file["path"]).stat().st_size
    path.write_text(json.dumps(manifest), encoding="utf-8")
    return folder


def archive(folder: Path) -> Path:
    return folder / f"data/train/{FIRST}.tar"


def table_file(folder: Path, name: str) -> Path:
    return folder / f"{name}/train/{FIRST}.parquet"


def member(suffix: str, change: Callable[[bytes], bytes]) -> Attack:
    """Replace the contents of the first frame's members with a suffix."""

    def attack(folder: Path) -> None:
        with tarfile.open(archive(folder)) as old:
            contents = {each.name: old.extractfile(each).read() for each in old}
        with tarfile.open(archive(folder), "w") as new:
            for name, data in contents.items():
                each = tarfile.TarInfo(name)
                found = change(data) if name.endswith(f".{suffix}") else data
                each.size = len(found)
                new.addfile(each, io.BytesIO(found))

    return attack


def record(change: Callable[[dict[str, Any]], Any]) -> Attack:
    """Change the first frame's record in place."""

    def changed(data: bytes) -> bytes:
        tree = json.loads(data)
        change(tree)
        return json.dumps(tree).encode()

    return member("json", changed)


def put(section: str, key: str, value: Any) -> Attack:
    return record(lambda tree: tree[section].__setitem__(key, value))


def table(name: str, change: Callable[[pa.Table], pa.Table]) -> Attack:
    """Change the first shard's part of a table."""

    def attack(folder: Path) -> None:
        path = table_file(folder, name)
        pq.write_table(change(pq.read_table(path)), path)

    return attack


def column(name: str, column_name: str, values: Callable[[pa.ChunkedArray], Any]) -> Attack:
    """Replace a column."""

    def change(found: pa.Table) -> pa.Table:
        place = found.schema.get_field_index(column_name)
        return found.set_column(place, column_name, pa.array(values(found[column_name])))

    return table(name, change)


def holes(folder: Path, size: int = HOLE_BYTES) -> None:
    """An archive with three members of zeros, which take no room on a disk."""
    path = archive(folder)
    with tarfile.open(path) as old:
        text = old.extractfile("frame-00000.json").read()
    with path.open("wb") as stream:
        for name, length in (
            ("frame-00000.json", len(text)),
            *((f"frame-00000.{s}", size) for s in ("png", "exr", "hud.png")),
        ):
            each = tarfile.TarInfo(name)
            each.size = length
            stream.write(each.tobuf())
            start = stream.tell()
            if name.endswith("json"):
                stream.write(text)
            stream.seek(start + -(-length // 512) * 512)
        stream.write(bytes(1024))


def sparse_headers(folder: Path) -> None:
    """An archive of 10 KB whose member claims 5.7 GB, by GNU's headers of sparse files."""
    with tarfile.open(archive(folder), "w", format=tarfile.PAX_FORMAT) as new:
        each = tarfile.TarInfo("frame-00000.png")
        each.size = 1
        each.pax_headers = {"GNU.sparse.map": "0,1", "GNU.sparse.size": "5700000000", "GNU.sparse.numblocks": "1"}
        new.addfile(each, io.BytesIO(b"x"))


def rows(name: str, count: int = BOMB_ROWS) -> Attack:
    """A table of equal rows, which Parquet stores once."""

    def attack(folder: Path) -> None:
        path = table_file(folder, name)
        one = pq.read_table(path).slice(0, 1)
        block = one.take(pa.array(np.zeros(min(count, 1_000_000), np.int64)))
        with pq.ParquetWriter(path, one.schema, compression="zstd") as writer:
            for start in range(0, count, 1_000_000):
                writer.write_table(block.slice(0, min(1_000_000, count - start)))

    return attack


def black_png(side: int) -> bytes:
    """A 16-bit PNG of zeros."""
    packer = zlib.compressobj(9)
    line = bytes(1 + 2 * side)
    data = b"".join(packer.compress(line) for _ in range(side)) + packer.flush()

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", side, side, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def manifest_number(folder: Path) -> None:
    path = folder / "manifest.json"
    path.write_text(path.read_text(encoding="utf-8").replace('"shard_size": 1,', f'"shard_size": {"9" * 401},'))


HUGE = int("9" * 401)
# Name: how, and what the message says.
ATTACKS: dict[str, tuple[Attack, str]] = {
    "sparse headers": (sparse_headers, r"shard-000000\.tar: its member .* is an extended header"),
    "holes in the archive": (holes, r"shard-000000\.tar: frame-00000\.png has 50000000 bytes, more than"),
    "stars of equal rows": (rows("stars"), r"stars/train/shard-000000\.parquet: claims 2000000 rows"),
    "objects of equal rows": (rows("objects"), r"objects/train/shard-000000\.parquet: claims 2000000 rows"),
    "frames of equal rows": (rows("frames", 200_000), r"frames/train/shard-000000\.parquet: (claims|has) 200000 rows"),
    "huge image": (member("png", lambda data: black_png(3000)), r"frame-00000.*PNG of 3000 x 3000 pixels"),
    "no image": (member("png", lambda data: b"GIF89a"), r"frame-00000.*not a PNG"),
    "deep record": (member("json", lambda data: b"[" * 100_000 + b"]" * 100_000), r"frame-00000: nested deeper"),
    "record that is a list": (member("json", lambda data: b"[1]"), r"frame-00000: expected one JSON object"),
    "record with NaN": (put("site", "latitude_deg", float("nan")), r"frame-00000: .*NaN is no number"),
    "record with infinity": (
        member("json", lambda data: data.replace(b'"seed": ', b'"seed": 1e999, "x": ', 1)), r"frame-00000: .*not finite"
    ),
    "record that is no text": (member("json", lambda data: b"\xff\xfe\x00"), r"frame-00000: not readable as JSON"),
    "text for a number": (put("camera", "f_px", "wide"), r"frame-00000: camera\.f_px must be a finite number"),
    "401 digits": (put("stars", "n_in_field", HUGE), r"frame-00000: has an integer of 1333 bits"),
    "index of 401 digits": (record(lambda tree: tree.__setitem__("index", HUGE)), r"frame-00000: has an integer"),
    "camera of another type": (record(lambda tree: tree.__setitem__("camera", [])), r"frame-00000: camera must be an object"),
    "camera of 30000 pixels": (put("camera", "width", 30000), r"frame-00000: camera\.width must be at most 16384"),
    "no time": (record(lambda tree: tree.pop("time")), r"frame-00000: key time is missing"),
    "no matrix": (put("attitude", "R_cam", [[1, 0], [0, 1]]), r"frame-00000: attitude\.R_cam must be 3 rows"),
    "half a character": (put("scenario", "name", "\ud800"), r"frame-00000: has half a character"),
    "another frame's record": (
        record(lambda tree: tree.__setitem__("frame_id", "frame-00007")), r"frame-00000: frame_id is 'frame-00007'"
    ),
    "texts for places": (
        column("stars", "u_px", lambda found: ["far"] * len(found)), r"shard-000000\.parquet: column u_px is of type string"
    ),
    "empty places": (
        column("stars", "u_px", lambda found: pa.nulls(len(found), pa.float64())), r"column u_px has \d+ empty cells"
    ),
    "lists for ids": (
        column("stars", "star_id", lambda found: [[1]] * len(found)), r"column star_id is of type list"
    ),
    "long texts": (
        column("stars", "frame_id", lambda found: ["x" * 100_000] * len(found)), r"column frame_id has a text of 100000"
    ),
    "no shard in the table": (
        table("frames", lambda found: found.drop_columns(["shard"])), r"frames/.*\.parquet: column shard is missing"
    ),
    "no index of stars": (table("stars", lambda found: found.drop_columns(["index"])), r"column index is missing"),
    "no table": (lambda folder: table_file(folder, "stars").write_bytes(b"PAR1 nonsense"), r"not a readable Parquet"),
    "manifest of 401 digits": (manifest_number, r"manifest\.json: has an integer of 1333 bits"),
}  # fmt: skip
