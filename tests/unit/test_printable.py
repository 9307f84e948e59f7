"""Names of strangers in messages: a terminal shows them, and obeys none of them."""

import pytest
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.cli.output import printable
from celnav.__main__ import main
from celnav.command import answer


@pytest.mark.parametrize("printable", [printable, answer.printable])
def test_what_a_terminal_obeys_is_written_out(printable) -> None:
    assert printable("a\x1b[31mb\rc\x9bd\n\udcff é") == "a\\x1b[31mb\\rc\\x9bd\n\\udcff é"
    assert printable("a\nb", kept="") == "a\\nb"


def test_commands_write_names_out(tmp_path, capsys) -> None:
    name = "x\x1b]0;owned\x07"
    assert main(["solve", str(tmp_path / f"{name}.png"), "--utc", "2020-01-01T00:00:00Z"]) == 2
    told = capsys.readouterr().err
    assert "\x1b" not in told
    assert "\\x1b]0;owned\\x07" in told
    result = CliRunner().invoke(app, ["plan", str(tmp_path / f"{name}.yaml")])
    assert result.exit_code == 2
    assert "\x1b]0" not in result.output
    assert "\\x1b]0;owned\\x07" in result.output.replace("\n", "")


@pytest.mark.parametrize("name", ["x\x1b[2K.txt", "x\nset: whole.txt"])
def test_verify_gives_each_file_a_line_of_its_own(tmp_path, name) -> None:
    (tmp_path / name).write_text("")
    (tmp_path / "frames-manifest.json").write_text(
        '{"format": "skybench-frames/1", "scenario": "a", "scenario_sha256": "", "skybench": "0", '
        '"seed": 0, "frames": 0, "files": []}'
    )
    result = CliRunner().invoke(app, ["verify", str(tmp_path)])
    assert result.exit_code == 1
    assert "\x1b" not in result.output
    assert f"{printable(name, kept='')}: not in the manifest" in result.output.splitlines()
