"""The reader of shards: what the format does not allow is refused with the archive and the member named."""

import io
import json
import os
import tarfile
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
from unit.benchmark.fake_night import frame_record

from generator.dataset.archive import StoredFrame, check_sizes, frame_places, read_frames, read_member
from generator.errors import GeneratorError

RECORD = json.dumps(frame_record("frame-00009", 9, 3, 48.0, 11.0, 160, 120, 0, "fake night")).encode()

LARGEST_RECORD = json.dumps(frame_record("frame-00000", 0, 3, 48.0, 11.0, 16384, 16384, 0, "fake night")).encode()


def archive_of(
    path: Path,
    *members: tuple[str, bytes],
    change: Callable[[tarfile.TarInfo], None] = lambda member: None,
    form: int = tarfile.USTAR_FORMAT,
) -> Path:
    with tarfile.open(path, "w", format=form) as archive:
        for name, data in members:
            member = tarfile.TarInfo(name)
            member.size = len(data)
            change(member)
            archive.addfile(member, io.BytesIO(data))
    return path


def test_frames_come_in_order_with_all_their_members(tmp_path) -> None:
    path = archive_of(
        tmp_path / "a.tar",
        ("frame-00009.png", b"p"), ("frame-00009.json", RECORD), ("frame-00009.developed.png", b"d"),
        ("frame-99999.jxl", b"x"),
        ("frame-100000.exr", b"e"),
    )  # fmt: skip
    assert list(read_frames(path)) == [
        StoredFrame("frame-00009", {"png": b"p", "json": RECORD, "developed.png": b"d"}),
        StoredFrame("frame-99999", {"jxl": b"x"}),
        StoredFrame("frame-100000", {"exr": b"e"}),
    ]
    assert read_member(path, "frame-00009.developed.png") == b"d"


def test_an_empty_archive_has_no_frames(tmp_path) -> None:
    assert list(read_frames(archive_of(tmp_path / "a.tar"))) == []


@pytest.mark.parametrize(
    "name",
    ["/tmp/frame-00000.png", "../frame-00000.png", "frame-00000./../../x.png", "frame-00000.png/../../x", "frame-0000.png",
     "frame-00000.sh", "frame-00000", ".bashrc", "frame-00000.png\n", "frame-٠٠٠٠٠.png", "data/frame-00000.png"],
)  # fmt: skip
def test_other_names_are_refused(tmp_path, name) -> None:
    path = archive_of(tmp_path / "a.tar", (name, b"x"))
    with pytest.raises(GeneratorError, match=r"a\.tar: its member .* is not named like a frame's file"):
        list(read_frames(path))
    with pytest.raises(GeneratorError, match="is not named like a frame's file"):
        read_member(path, name)


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.DIRTYPE, tarfile.FIFOTYPE, tarfile.CHRTYPE])
def test_links_folders_and_devices_are_refused(tmp_path, kind) -> None:
    def change(member: tarfile.TarInfo) -> None:
        member.type, member.linkname = kind, "/etc/passwd"

    path = archive_of(tmp_path / "a.tar", ("frame-00000.png", b""), change=change)
    with pytest.raises(GeneratorError, match="is not a regular file"):
        list(read_frames(path))


def test_a_sparse_member_is_refused_before_it_fills_the_memory(tmp_path) -> None:
    """10 KB that claim 5 GB of zeros, in GNU's format of the POSIX archive."""

    def change(member: tarfile.TarInfo) -> None:
        member.pax_headers = {"GNU.sparse.map": "0,1", "GNU.sparse.size": "5000000000", "GNU.sparse.numblocks": "1"}

    path = archive_of(tmp_path / "a.tar", ("frame-00000.png", b"x"), change=change, form=tarfile.PAX_FORMAT)
    with tarfile.open(path) as archive:
        assert archive.getmembers()[0].issparse()
    with pytest.raises(GeneratorError, match=r"a\.tar: its member .* is an extended header \(type 'x'\)"):
        list(read_frames(path))


@pytest.mark.parametrize("kind", [b"L", b"K", b"x", b"X", b"g"])
@pytest.mark.parametrize("after_a_frame", [False, True])
def test_extended_headers_are_refused_before_their_content_is_read(tmp_path, kind, after_a_frame) -> None:
    """A hole of gigabytes in front of a member, which a reader of long names and attributes would take into memory."""
    path = tmp_path / "a.tar"
    header = tarfile.TarInfo("././@LongLink")
    header.type, header.size = kind, 3 * 2**30
    with path.open("wb") as stream:
        if after_a_frame:
            stream.write(tarfile.TarInfo("frame-00000.png").tobuf())
        stream.write(header.tobuf(tarfile.GNU_FORMAT))
        stream.truncate(stream.tell() + header.size + 2 * tarfile.BLOCKSIZE)
    tracemalloc.start()
    try:
        for read in (lambda: list(read_frames(path)), lambda: frame_places(path), lambda: read_member(path, "other")):
            with pytest.raises(GeneratorError, match=rf"a\.tar: .* is an extended header \(type '{kind.decode()}'"):
                read()
        assert tracemalloc.get_traced_memory()[1] < 10**7
    finally:
        tracemalloc.stop()


def test_a_size_below_zero_does_not_lead_backwards(tmp_path) -> None:
    member = tarfile.TarInfo("frame-00000.png")
    header = bytearray(member.tobuf())
    header[124:136] = (-512).to_bytes(12, "big", signed=True)
    header[148:156] = b"%06o\0 " % sum(header[:148] + b" " * 8 + header[156:])
    (tmp_path / "a.tar").write_bytes(bytes(header) + bytes(1024))
    with pytest.raises(GeneratorError, match="claims -512 bytes"):
        list(read_frames(tmp_path / "a.tar"))
    with pytest.raises(GeneratorError, match="unexpected end of data"):
        read_member(tmp_path / "a.tar", "other")


@pytest.mark.skipif(os.name != "posix", reason="needs pipes")
def test_a_pipe_in_the_place_of_an_archive_is_not_waited_for(tmp_path) -> None:
    os.mkfifo(tmp_path / "a.tar")
    with pytest.raises(GeneratorError, match=r"a\.tar: damaged \(not a regular file\)"):
        list(read_frames(tmp_path / "a.tar"))


def test_a_member_larger_than_its_archive_is_refused(tmp_path) -> None:
    path = tmp_path / "a.tar"
    member = tarfile.TarInfo("frame-00000.png")
    member.size = 1_000_000_000
    path.write_bytes(member.tobuf() + bytes(1024))
    with pytest.raises(GeneratorError, match="claims 1000000000 bytes"):
        list(read_frames(path))


def hollow(path: Path, name: str, size: int) -> Path:
    """An archive of one member that is a hole in its file."""
    member = tarfile.TarInfo(name)
    member.size = size
    with path.open("wb") as stream:
        stream.write(member.tobuf(tarfile.USTAR_FORMAT))
        stream.truncate(tarfile.BLOCKSIZE * (3 + -(-size // tarfile.BLOCKSIZE)))
    return path


def test_expected_electrons_of_the_largest_frame_have_room(tmp_path) -> None:
    """Three channels of single precision that hardly compress."""
    size = 16384**2 * 3 * 4
    path = hollow(tmp_path / "a.tar", "frame-00000.exr", size)
    assert frame_places(path)["frame-00000"]["exr"].size == size
    check_sizes(path, "frame-00000", {"exr": size}, LARGEST_RECORD)


@pytest.mark.parametrize(("suffix", "size"), [("png", 1_000_000_000), ("json", 9_000_000)])
def test_a_member_larger_than_any_frame_allows_is_refused(tmp_path, suffix, size) -> None:
    path = hollow(tmp_path / "a.tar", f"frame-00000.{suffix}", size)
    for read in (frame_places, lambda path: read_member(path, f"frame-00000.{suffix}")):
        with pytest.raises(GeneratorError, match=rf"a\.tar: its member .* claims {size} bytes"):
            read(path)


@pytest.mark.parametrize(
    ("names", "problem"),
    [
        (("frame-00000.png", "frame-00000.png"), "is stored twice"),
        (("frame-00001.png", "frame-00000.png"), "comes after frame-00001"),
        (("frame-00000.png", "frame-00001.png", "frame-00000.json"), "comes after frame-00001"),
    ],
)
def test_members_twice_or_out_of_order_are_refused(tmp_path, names, problem) -> None:
    path = archive_of(tmp_path / "a.tar", *((name, b"x") for name in names))
    with pytest.raises(GeneratorError, match=problem):
        list(read_frames(path))


def test_damage_and_missing_members_are_named(tmp_path) -> None:
    (tmp_path / "a.tar").write_bytes(b"no archive")
    with pytest.raises(GeneratorError, match=r"a\.tar: damaged"):
        list(read_frames(tmp_path / "a.tar"))
    with pytest.raises(GeneratorError, match=r"b\.tar: damaged"):
        list(read_frames(tmp_path / "b.tar"))
    whole = archive_of(tmp_path / "c.tar", ("frame-00000.png", b"x"))
    with pytest.raises(GeneratorError, match=r"c\.tar: has no member 'frame-00001\.png'"):
        read_member(whole, "frame-00001.png")
