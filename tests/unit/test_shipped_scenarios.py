"""Scenarios that come with skybench: found by name wherever it is installed, files of the user's own first."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmark.cli.app import app
from generator.errors import ScenarioError
from generator.scenario import shipped
from generator.scenario.file import load_scenario

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("written", ["demo", "demo.yaml", "scenes/demo.yaml"])
def test_a_scenario_is_found_by_its_name_in_an_empty_folder(written: str, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = shipped.find_scenario(written)
    assert found.read_bytes() == (ROOT / "scenes/demo.yaml").read_bytes()
    assert load_scenario(found).sha256 == load_scenario(ROOT / "scenes/demo.yaml").sha256


def test_a_file_comes_before_a_name_and_a_folder_does_not(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("demo").mkdir()
    assert shipped.find_scenario("demo").name == "demo.yaml"
    Path("demo").rmdir()
    Path("demo").write_text("mine", encoding="utf-8")
    assert shipped.find_scenario("demo") == Path("demo")


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("demos", ["demos: cannot be read", "did you mean demo?", "thesis_mag"]),
        ("elsewhere/demo.yaml", ["elsewhere/demo.yaml: cannot be read", "skybench scenes"]),
        ("../scenes/demo.yaml", ["cannot be read"]),
        ("/demo.yaml", ["cannot be read"]),
    ],
)
def test_what_is_neither_is_refused_with_the_names(written: str, said: list[str], tmp_path, monkeypatch) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    with pytest.raises(ScenarioError) as refused:
        shipped.find_scenario(written)
    assert all(words in str(refused.value) for words in said)


def test_every_scenario_begins_with_a_line_about_it() -> None:
    for path in shipped.shipped_scenarios().values():
        assert path.read_text(encoding="utf-8").startswith("# "), path
        assert 20 < len(shipped.title_of(path)) < 125, path


def test_a_copy_brings_the_files_that_a_scenario_names(tmp_path) -> None:
    run = CliRunner().invoke(app, ["scenes", "horizon", "--copy", str(tmp_path / "mine")])
    assert run.exit_code == 0, run.output
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {"horizon.yaml", "horizon_ridge.csv", "schema.json"}
    load_scenario(tmp_path / "mine/horizon.yaml")
    (tmp_path / "mine/horizon.yaml").write_text("changed", encoding="utf-8")
    again = CliRunner().invoke(app, ["scenes", "horizon", "--copy", str(tmp_path / "mine")])
    assert (again.exit_code, "is another" in again.output) == (2, True)


def test_one_scenario_is_printed_as_it_stands() -> None:
    run = CliRunner().invoke(app, ["scenes", "optics"])
    assert run.stdout == (ROOT / "scenes/optics.yaml").read_text(encoding="utf-8")
