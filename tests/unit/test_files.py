"""Atomic writing: a file is whole under its name, or not there."""

import pytest

from generator.files import atomic_path, write_bytes


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
