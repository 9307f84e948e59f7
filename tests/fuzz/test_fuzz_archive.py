"""The reader of archives: any file is a sequence of frames with allowed members, or a GeneratorError."""

import io
import tarfile
from contextlib import suppress
from pathlib import Path

import pytest
from fuzz.fuzzing import corpus, damaged, fuzzed
from hypothesis import given
from hypothesis import strategies as st

from generator.dataset.archive import SUFFIXES, frame_places, read_frames, read_member, read_place
from generator.errors import GeneratorError

FILES = corpus("archive")
NAMES = st.sampled_from([f"frame-00000.{suffix}" for suffix in SUFFIXES]) | st.sampled_from(
    [
        "frame-00001.png",
        "frame-1.png",
        "../frame-00000.png",
        "/frame-00000.png",
        "frame-00000.png/..",
        "frame-٠٠٠٠٠.png",
    ]
)
TYPES = st.sampled_from([tarfile.REGTYPE, tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.DIRTYPE, tarfile.CHRTYPE, b"?"])
MEMBERS = st.tuples(NAMES | st.text(max_size=120), TYPES, st.binary(max_size=700), st.sampled_from(["", "/etc/passwd"]))


def read(path: Path) -> None:
    """Read an archive in each of the ways there are; nothing comes out that the format does not allow."""
    with suppress(GeneratorError):
        for frame in read_frames(path):
            assert frame.frame_id.startswith("frame-")
            assert set(frame.members) <= set(SUFFIXES)
    with suppress(GeneratorError):
        for members in frame_places(path).values():
            for place in members.values():
                assert len(read_place(path, place)) == place.size <= path.stat().st_size
    with suppress(GeneratorError):
        read_member(path, "frame-00000.json")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_corpus(path) -> None:
    read(path)


@fuzzed(100)
@given(content=damaged([path.read_bytes() for path in FILES]))
def test_any_bytes(tmp_path_factory, content) -> None:
    path = tmp_path_factory.getbasetemp() / "any.tar"
    path.write_bytes(content)
    read(path)


@fuzzed(100)
@given(
    members=st.lists(MEMBERS, max_size=5),
    kind=st.sampled_from([tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT]),
)
def test_any_members(tmp_path_factory, members, kind) -> None:
    path = tmp_path_factory.getbasetemp() / "members.tar"
    with tarfile.open(path, "w", format=kind) as archive:
        for name, member_type, content, link in members:
            member = tarfile.TarInfo(name)
            member.type, member.size, member.linkname = member_type, len(content), link
            with suppress(ValueError, tarfile.TarError, UnicodeError):  # of names that the form of archive cannot hold
                archive.addfile(member, io.BytesIO(content))
    read(path)
