"""Atomic writing, names that cannot leave their folder, and reading within limits."""

import os

import pytest

from generator.errors import GeneratorError
from generator.files import _umask, atomic_path, linked_within, path_within, read_at_most, write_bytes


def test_success_replaces_and_leaves_nothing_else(tmp_path) -> None:
    target = tmp_path / "a.bin"
    write_bytes(target, b"one")
    write_bytes(target, b"two")
    assert target.read_bytes() == b"two"
    assert [path.name for path in tmp_path.iterdir()] == ["a.bin"]


def test_failure_keeps_the_old_file(tmp_path) -> None:
    target = tmp_path / "a.bin"
    write_bytes(target, b"old")

    def fail_midway() -> None:
        with atomic_path(target) as temporary:
            temporary.write_bytes(b"ne")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail_midway()
    assert target.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.bin"]


def test_the_folder_is_made_and_temporary_names_can_be_found(tmp_path) -> None:
    with atomic_path(tmp_path / "a/b/c.tar", prefix=".mine-") as temporary:
        assert temporary.name.startswith(".mine-")
        assert temporary.suffix == ".tar"
        temporary.write_bytes(b"whole")
    assert [path.name for path in (tmp_path / "a/b").iterdir()] == ["c.tar"]


@pytest.mark.parametrize("place", ["a.png", "data/train/shard-000000.tar", "..a", "a..b/c", "sub.folder/x y"])
def test_plain_relative_names_are_joined(tmp_path, place) -> None:
    assert path_within(tmp_path, place) == tmp_path / place


@pytest.mark.parametrize(
    "place",
    [
        "",
        ".",
        "..",
        "/etc/passwd",
        "../x",
        "a/../../x",
        "a/..",
        "a//b",
        "./a",
        "a/",
        "a\\..\\b",
        "a\0b",
        "a\nb",
        "//host/x",
    ],
)
def test_names_that_could_leave_the_folder_are_refused(tmp_path, place) -> None:
    with pytest.raises(GeneratorError, match="could lie outside the folder"):
        path_within(tmp_path, place)


def test_what_is_read_is_a_regular_file_of_at_most_so_many_bytes(tmp_path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_at_most(path, 5) == b"12345"
    with pytest.raises(OSError, match="larger than 4 bytes, and not read"):
        read_at_most(path, 4)
    with pytest.raises(FileNotFoundError):
        read_at_most(tmp_path / "none", 4)


@pytest.mark.skipif(os.name != "posix", reason="needs links to devices, and pipes")
@pytest.mark.parametrize("kind", ["endless", "pipe", "folder"])
def test_what_has_no_end_is_not_read(tmp_path, kind) -> None:
    path = tmp_path / "a"
    if kind == "endless":
        path.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.mkdir()
    with pytest.raises(OSError, match=r"not a regular file|Is a directory"):
        read_at_most(path, 5)


def test_links_are_followed_within_the_folder_alone(tmp_path) -> None:
    folder = tmp_path / "set"
    (folder / "inner").mkdir(parents=True)
    (tmp_path / "secret").write_bytes(b"x")
    (folder / "inner/a").symlink_to("../b")
    (folder / "out").symlink_to("../secret")
    (folder / "up").symlink_to("..")
    assert linked_within(folder, "inner/a") == folder / "inner/a"
    for place in ("out", "up/secret"):
        with pytest.raises(GeneratorError, match="is a link that leads out of"):
            linked_within(folder, place)
    (tmp_path / "link").symlink_to("set")
    assert linked_within(tmp_path / "link", "inner/a") == tmp_path / "link/inner/a"


def test_files_are_kept_from_whom_the_umask_keeps_them(tmp_path) -> None:
    before = os.umask(0o077)
    _umask.cache_clear()
    try:
        write_bytes(tmp_path / "a", b"1")
    finally:
        os.umask(before)
        _umask.cache_clear()
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o600
