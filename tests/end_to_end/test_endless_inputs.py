"""Files and answers without an end, where a stranger's dataset or web server has something to read."""

import http.server
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmark.errors import DatasetError, RoundError
from benchmark.frames.record_values import read_record
from benchmark.frames.sharded import open_sharded
from benchmark.rounds.commitment import read_commitment, read_json
from benchmark.submit.pack import LISTING, listed_names
from generator.dataset import reader
from generator.dataset.reader import Dataset
from generator.dataset.target import RemoteTarget
from generator.dataset.verify import problems
from generator.errors import GeneratorError, ScenarioError
from generator.scenario.file import load_scenario

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs links to devices, and pipes")
BLOCK = b" " * 65536


@pytest.fixture(params=["device", "pipe"])
def endless(request, tmp_path) -> Path:
    """A name under which reading never ends, or never begins."""
    path = tmp_path / "endless"
    if request.param == "device":
        path.symlink_to("/dev/zero")
    else:
        os.mkfifo(path)
    return path


def test_manifests_records_lists_and_scenarios_are_regular_files(endless, tmp_path) -> None:
    folder = tmp_path / "set"
    folder.mkdir()
    for name in ("manifest.json", "frame-00000.json", LISTING, "commitment.json", "scenario.yaml"):
        (folder / name).symlink_to(endless)
    with pytest.raises(GeneratorError, match=r"manifest\.json: not a manifest .*not a regular file"):
        Dataset.open(folder)
    assert "not a regular file" in problems(folder)[0]
    with pytest.raises(DatasetError, match=r"frame-00000\.json: not a regular file"):
        read_record(folder / "frame-00000.json")
    with pytest.raises(DatasetError, match=r"frames\.json: no list of frames \(not a regular file"):
        listed_names(folder)
    with pytest.raises(ScenarioError, match=r"scenario\.yaml: cannot be read \(not a regular file"):
        load_scenario(folder / "scenario.yaml")
    for read in (lambda: read_json(folder / "commitment.json"), lambda: read_commitment(folder)):
        with pytest.raises(RoundError, match=r"commitment\.json: cannot be read \(not a regular file"):
            read()


def test_a_list_of_frames_that_is_nested_deep_is_refused(tmp_path) -> None:
    (tmp_path / LISTING).write_text("[" * 100_000)
    with pytest.raises(DatasetError, match=r"no list of frames \(.*nested deeper"):
        listed_names(tmp_path)


@pytest.fixture
def server(small_set) -> Iterator[tuple[str, list[int]]]:
    """A web server of a dataset whose manifest, or whose other files, never end; and how much it has sent."""
    sent: list[int] = []

    class Handler(http.server.BaseHTTPRequestHandler):
        """Endless below /endless; below /set the dataset's manifest alone is whole."""

        def do_HEAD(self) -> None:
            self.send_response(200)
            self.end_headers()

        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            if self.path == "/set/manifest.json":
                self.wfile.write((small_set / "manifest.json").read_bytes())
                return
            try:
                while True:
                    sent.append(self.wfile.write(BLOCK))
            except OSError:
                return

        def log_message(self, *arguments: object) -> None:
            """Say nothing."""

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{running.server_address[1]}", sent
        running.shutdown()
        thread.join()


def test_answers_without_an_end_are_read_up_to_their_limit(server, tmp_path, monkeypatch) -> None:
    pytest.importorskip("aiohttp")
    url, sent = server
    monkeypatch.setattr(reader, "LARGEST_MANIFEST_BYTES", 10**6)
    monkeypatch.setattr("benchmark.frames.sharded.LARGEST_MANIFEST_BYTES", 10**6)
    with pytest.raises(GeneratorError, match=r"endless/manifest\.json: cannot be read \(larger than 1000000 bytes"):
        Dataset.open(f"{url}/endless", tmp_path / "cache")
    with pytest.raises(DatasetError, match="larger than 1000000 bytes"):
        open_sharded(f"{url}/endless", tmp_path / "data")
    with pytest.raises(GeneratorError, match=r"larger than \d+ bytes"):
        Dataset.open(f"{url}/set", tmp_path / "cache")[0]
    with pytest.raises(DatasetError, match=r"larger than \d+ bytes"):
        open_sharded(f"{url}/set", tmp_path / "data")
    # A socket holds some megabytes that nobody has read.
    assert sum(sent) < 100 * 10**6
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".tar", ".parquet")]


def test_objects_of_a_store_are_judged_by_their_size(tmp_path) -> None:
    store = RemoteTarget("memory://endless-inputs")
    (tmp_path / "a").write_bytes(b"12345")
    store.put(tmp_path / "a", "a")
    assert store.read("a", 5) == b"12345"
    assert store.fetch("a", tmp_path / "scratch", 5).read_bytes() == b"12345"
    with pytest.raises(OSError, match="larger than 4 bytes"):
        store.read("a", 4)
    with pytest.raises(OSError, match="larger than 4 bytes"):
        store.fetch("a", tmp_path / "other", 4)
    assert store.read("none", 4) is None
