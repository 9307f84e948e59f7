"""Atomic writing, and names that cannot leave their folder."""

import pytest

from generator.errors import GeneratorError
from generator.files import atomic_path, path_within, write_bytes


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
