"""Reader of a dataset's archives: names and sizes are checked against the format before any byte is used."""

from __future__ import annotations

import os
import re
import stat
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from generator.errors import GeneratorError
from generator.reading.record import LARGEST_RECORD_BYTES, LARGEST_SIDE_PX, image_shape, read_record

FREE_BYTES = 1_000_000
"""Bytes allowed for a member, however few pixels its frame has."""
BYTES_PER_PIXEL = {
    "png": 3,
    "jxl": 3,
    "exr": 64,
    "developed.png": 6,
    "hud.png": 3,
    "mask.png": 3,
    "photo.jpg": 6,
    "photo.heic": 6,
    "stack.fits": 6,
    "video.mp4": 512,
}
"""Bytes per pixel allowed for a member beyond that: more than its pixels take without any compression; for expected electrons
16 channels, for a video 256 frames."""
LARGEST_MEMBER_BYTES = {
    "json": LARGEST_RECORD_BYTES,
    **{suffix: FREE_BYTES + each * LARGEST_SIDE_PX**2 for suffix, each in BYTES_PER_PIXEL.items()},
}
"""Limit of a member by its suffix, before its frame's number of pixels is known: what the largest frame is allowed."""
EXTENDED_HEADERS = (b"L", b"K", b"x", b"X", b"g")
"""Types of headers that give long names and attributes of the next member, by GNU and by pax; names of frames need none."""
SUFFIXES = (*BYTES_PER_PIXEL, "json")
"""Members that a frame may have, in any order."""
_MEMBER = re.compile(rf"(frame-\d{{5,8}})\.({'|'.join(re.escape(suffix) for suffix in SUFFIXES)})", re.ASCII)


class TooLargeError(GeneratorError):
    """A member has more bytes than its frame can need."""


@dataclass(frozen=True)
class StoredFrame:
    """One frame as stored.

    Attributes
    ----------
    frame_id : str
        ``frame-`` and five to eight digits, safe as a file name.
    members : dict of str to bytes
        Contents by suffix, one of SUFFIXES.
    """

    frame_id: str
    members: dict[str, bytes]


@dataclass(frozen=True)
class Place:
    """Place of a member's contents in its archive: first byte and number of bytes."""

    offset: int
    size: int


def read_frames(path: Path) -> Iterator[StoredFrame]:
    """Yield all frames of an archive, in order, one at a time.

    Raises
    ------
    GeneratorError
        The archive is damaged, or has a member that docs/dataset_format.md does not allow: one with another name, not a
        regular file, larger than the archive itself or than its frame's pixels can need, or given twice; or a frame is
        out of order or has an invalid record.
    """
    with _opened(path) as stream:
        for frame_id, members in _frames(path, stream):
            contents = {}
            if "json" in members:
                contents["json"] = _content(stream, members["json"])
            check_sizes(
                path, frame_id, {suffix: member.size for suffix, member in members.items()}, contents.get("json")
            )
            contents |= {suffix: _content(stream, member) for suffix, member in members.items() if suffix != "json"}
            yield StoredFrame(frame_id, contents)


def frame_places(path: Path) -> dict[str, dict[str, Place]]:
    """Return the places of each frame's members, by frame and suffix. Raises GeneratorError as :func:`read_frames`."""
    with _opened(path) as stream:
        return {
            frame_id: {suffix: Place(member.offset_data, member.size) for suffix, member in members.items()}
            for frame_id, members in _frames(path, stream)
        }


def check_sizes(path: Path, frame_id: str, sizes: dict[str, int], record: bytes | None) -> None:
    """Compare the sizes of a frame's members, by suffix, with the number of pixels that its record states.

    This matters because an archive can have holes: gigabytes of zeros that take no space on a disk.

    Raises
    ------
    TooLargeError
        A member is larger than any image of that many pixels.
    GeneratorError
        The record is invalid.
    """
    pixels = 0
    if record is not None:
        height, width = image_shape(read_record(record, f"{path}: {frame_id}", frame_id))
        pixels = height * width
    for suffix, size in sizes.items():
        most = LARGEST_RECORD_BYTES if suffix == "json" else FREE_BYTES + BYTES_PER_PIXEL[suffix] * pixels
        if size > most:
            raise TooLargeError(f"{path}: {frame_id}.{suffix} has {size} bytes, more than {most}; it is not read")


def check_holes(path: Path) -> None:
    """Refuse an archive whose members are too large, before its hash is computed over gigabytes of zeros in its holes.

    Raises
    ------
    TooLargeError
        As for :func:`check_sizes`; other damage shows in the hash.
    """
    state = path.stat()
    if state.st_blocks * 512 >= state.st_size:
        return
    try:
        with _opened(path) as stream:
            for frame_id, members in _frames(path, stream):
                record = _content(stream, members["json"]) if "json" in members else None
                check_sizes(path, frame_id, {suffix: member.size for suffix, member in members.items()}, record)
    except TooLargeError:
        raise
    except GeneratorError:
        return


def read_place(path: Path, place: Place) -> bytes:
    """Read the contents of a member. Raises GeneratorError if the archive has become shorter."""
    try:
        with path.open("rb") as stream:
            stream.seek(place.offset)
            data = stream.read(place.size)
    except OSError as error:
        raise GeneratorError(f"{path}: cannot be read ({error.strerror}); run `skybench verify`") from error
    if len(data) != place.size:
        raise GeneratorError(f"{path}: shorter than its own list of members; run `skybench verify`")
    return data


def _frames(path: Path, stream: BinaryIO) -> Iterator[tuple[str, dict[str, tarfile.TarInfo]]]:
    """Yield the frames of an archive with their members by suffix, each checked."""
    current, members = "", dict[str, tarfile.TarInfo]()
    for member in _members(path, stream):
        frame_id, suffix = _checked(path, member)
        if frame_id != current:
            if (len(frame_id), frame_id) < (len(current), current):
                raise _refused(path, member, f"comes after {current}")
            if members:
                yield current, members
            current, members = frame_id, {}
        if suffix in members:
            raise _refused(path, member, "is stored twice")
        members[suffix] = member
    if members:
        yield current, members


def read_member(path: Path, name: str) -> bytes:
    """Read the contents of one member of an archive.

    Raises
    ------
    GeneratorError
        The archive is damaged, has no such member, or the format does not allow it (see :func:`read_frames`).
    """
    with _opened(path) as stream:
        for member in _members(path, stream):
            if member.name == name:
                _checked(path, member)
                return _content(stream, member)
    raise GeneratorError(f"{path}: has no member {name!r}; run `skybench verify`")


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        # The type is that of the opened file: a pipe would wait for a writer, and a device has no end.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(handle, "rb") as stream:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise tarfile.ReadError("not a regular file")
            yield stream
    except (tarfile.TarError, OSError, EOFError, ValueError, OverflowError) as error:
        raise GeneratorError(f"{path}: damaged ({error}); run `skybench verify`") from error


def _members(path: Path, stream: BinaryIO) -> Iterator[tarfile.TarInfo]:
    """Yield the members of an archive from their headers of 512 bytes, which are all that is read here.

    A `tarfile.TarFile` would read the long names and extended attributes in front of a member first, whatever their size.
    """
    offset, end = 0, os.fstat(stream.fileno()).st_size
    while True:
        stream.seek(offset)
        block = stream.read(tarfile.BLOCKSIZE)
        if not block.strip(b"\0"):
            if end == 0:
                raise tarfile.ReadError("empty file")
            return
        member = tarfile.TarInfo.frombuf(block, "utf-8", "surrogateescape")
        if member.type in EXTENDED_HEADERS:
            raise _refused(path, member, f"is an extended header (type {member.type.decode()!r})")
        member.offset_data = offset + tarfile.BLOCKSIZE
        yield member
        if not 0 <= member.size <= end - member.offset_data:
            raise tarfile.ReadError("unexpected end of data")
        offset = member.offset_data + -(-member.size // tarfile.BLOCKSIZE) * tarfile.BLOCKSIZE


def _checked(path: Path, member: tarfile.TarInfo) -> tuple[str, str]:
    """Return frame and suffix of a member after checking that the format allows it."""
    match = _MEMBER.fullmatch(member.name)
    if match is None:
        raise _refused(path, member, "is not named like a frame's file")
    if member.type not in (tarfile.REGTYPE, tarfile.AREGTYPE) or member.issparse():
        raise _refused(path, member, "is not a regular file")
    if not 0 <= member.size <= min(LARGEST_MEMBER_BYTES[match[2]], path.stat().st_size):
        raise _refused(path, member, f"claims {member.size} bytes")
    return match[1], match[2]


def _refused(path: Path, member: tarfile.TarInfo, problem: str) -> GeneratorError:
    return GeneratorError(
        f"{path}: its member {member.name[:100]!r} {problem}, which docs/dataset_format.md does not allow; "
        "nothing of it is used. Get the dataset anew from whoever made it"
    )


def _content(stream: BinaryIO, member: tarfile.TarInfo) -> bytes:
    stream.seek(member.offset_data)
    data = stream.read(member.size)
    if len(data) != member.size:
        raise tarfile.ReadError("unexpected end of data")
    return data
