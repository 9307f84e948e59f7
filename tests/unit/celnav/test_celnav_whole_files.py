"""What the commands write is whole or absent, and what hinders it is said with the option and the file."""

from __future__ import annotations

import os

import pytest

from celnav.command import whole_file
from celnav.command.whole_file import write_whole
from celnav.errors import ConfigError


def test_a_file_is_written_and_replaced(tmp_path):
    path = tmp_path / "ö.json"
    write_whole(path, "é", "--out")
    write_whole(str(path), b"2", "--out")
    assert path.read_bytes() == b"2"
    assert os.listdir(tmp_path) == [path.name]


def test_a_full_disk_leaves_nothing_behind(tmp_path, monkeypatch):
    path = tmp_path / "camera.json"
    path.write_text("before")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(whole_file.os, "replace", full)
    with pytest.raises(ConfigError, match=r"--out .*camera\.json: cannot be written: No space left on device"):
        write_whole(path, "after", "--out")
    assert [file.name for file in tmp_path.iterdir()] == ["camera.json"]
    assert path.read_text() == "before"


def test_a_folder_of_that_name_and_a_missing_one_are_refused(tmp_path):
    (tmp_path / "map.png").mkdir()
    for path in (tmp_path / "map.png", tmp_path / "none" / "map.png"):
        with pytest.raises(ConfigError, match="--map"):
            write_whole(path, b"", "--map")
    assert os.listdir(tmp_path) == ["map.png"]
