"""Results of strangers: tables that claim gigabytes, numbers and lists that no result has."""

import hashlib
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner
from unit.benchmark.fake_results import SOLVERS, TASKS, write_results

from benchmark.cli.bench import app
from benchmark.errors import ResultsError
from benchmark.report.site.frame_source import FrameSource
from benchmark.report.site.pictures import write_into
from benchmark.report.site.tree import StoredResult
from benchmark.run import identities
from benchmark.run.packed import read_packed
from benchmark.run.packing import pack_tree
from benchmark.run.results import FRAMES_NAME, MATCHES_NAME, SUMMARY_NAME, read_summary, read_table
from benchmark.stats.frame_metrics import read_frames
from celnav.command.attitude_option import read_attitude
from celnav.errors import AttitudeError
from generator.reading import table

DEEP = "[" * 100_000


@pytest.fixture
def bomb(tmp_path, monkeypatch):
    """A table of a million equal rows in some kilobytes."""
    monkeypatch.setattr(table, "FREE_BYTES", 2**20)
    path = tmp_path / "part.parquet"
    pq.write_table(pa.table({"index": np.zeros(1_000_000)}), path, compression="zstd")
    return path


def test_tables_that_claim_more_than_they_hold_are_not_read(bomb, monkeypatch) -> None:
    digest = hashlib.sha256(bomb.read_bytes()).hexdigest()
    listing = bomb.with_suffix(".json")
    listing.write_text(json.dumps({"format": "skybench-packed/1", "table_sha256": digest, "rows": []}))
    monkeypatch.setattr(pq, "read_table", lambda *arguments, **options: pytest.fail("the table was read"))
    for read, path in ((read_packed, listing), (read_table, bomb), (read_frames, bomb)):
        with pytest.raises(ResultsError, match=r"part\.parquet: claims 8 MB in a file of"):
            read(path)


@pytest.fixture
def packed_tree(tmp_path) -> Path:
    """The listing of packed results of one task."""
    root = write_results(tmp_path / "results", TASKS[:1], SOLVERS[:2], frames_per_level=2, modes=("own",))
    pack_tree(root)
    return root / TASKS[0].label / "dev.json"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("solver", "x/../../PWNED"),
        ("solver", "../PWNED"),
        ("solver", ""),
        ("detections", "own/../../.."),
        ("key", "/../../PWNED"),
        ("key", "A" * 12),
    ],
)
def test_packed_results_name_no_file_outside_the_folder_of_the_pages(packed_tree, tmp_path, key, value) -> None:
    content = json.loads(packed_tree.read_text())
    content["rows"][0][key] = value
    packed_tree.write_text(json.dumps(content))
    before = sorted(tmp_path.rglob("*"))
    done = CliRunner().invoke(app, ["report", "--out", str(tmp_path / "results")])
    assert done.exit_code == 2
    assert "dev.json: not readable packed results" in done.stderr
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", ["solver-x/../../PWNED.html", "..", "pictures/../../PWNED.svg"])
def test_no_page_is_written_outside_its_folder(tmp_path, name) -> None:
    with pytest.raises(ResultsError, match="could lie outside the folder"):
        write_into(tmp_path / "site", name, b"")
    assert not list(tmp_path.rglob("*"))


def test_pages_read_no_table_that_claims_more_than_it_holds(bomb, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(pq, "read_table", lambda *arguments, **options: pytest.fail("the table was read"))
    result = SimpleNamespace(folder=tmp_path)
    bomb.rename(tmp_path / MATCHES_NAME)
    with pytest.raises(ResultsError, match="claims 8 MB in a file of"):
        StoredResult.detections_in(result, ["frame-00000"])
    (tmp_path / MATCHES_NAME).rename(tmp_path / "stars.parquet")
    place = SimpleNamespace(star_tables=lambda: [tmp_path / "stars.parquet"])
    monkeypatch.setattr(FrameSource, "_place", lambda source, stored: place)
    with pytest.raises(ResultsError, match="claims 8 MB in a file of"):
        FrameSource(tmp_path).true_stars(result, ["frame-00000"])


def test_no_identity_is_read_of_a_table_that_claims_more_than_it_holds(bomb, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(pq, "read_table", lambda *arguments, **options: pytest.fail("the table was read"))
    folder = tmp_path / "demo@0" / "all" / "own" / "mine-0"
    folder.mkdir(parents=True)
    (folder / SUMMARY_NAME).write_text("{}")
    bomb.rename(folder / FRAMES_NAME)
    frames = SimpleNamespace(scenario_sha256="0", place=Path("demo@0/all"))
    summary = SimpleNamespace(provenance=SimpleNamespace(frames=frames))
    monkeypatch.setattr(identities, "read_summary", lambda path: summary)
    with pytest.raises(ResultsError, match="claims 8 MB in a file of"):
        identities.recorded_identities(tmp_path, frames)


@pytest.mark.parametrize("text", [DEEP, '{"format": 1, "overall": {"n_frames": 1e400}}'])
def test_summaries_and_lists_are_strict_json(tmp_path, text) -> None:
    path = tmp_path / "summary.json"
    path.write_text(text)
    for read in (read_summary, read_packed):
        with pytest.raises(ResultsError, match=r"summary\.json: not .*(nested deeper|not finite)"):
            read(path)


def test_an_attitude_that_is_nested_deep_is_refused(tmp_path) -> None:
    (tmp_path / "a.json").write_text(DEEP)
    with pytest.raises(AttitudeError, match=r"a\.json is nested too deep"):
        read_attitude(str(tmp_path / "a.json"))
