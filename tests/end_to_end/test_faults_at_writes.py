"""A fault at every write of `render`, `generate`, `bench run` and `report`: an error with a remedy; then the same bytes.

Faults: the disk is full when a file is flushed (the file is cut to half, as a short write leaves it), the renaming to the
final name fails, and an object store breaks off an upload.
"""

from __future__ import annotations

import dataclasses
import errno
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from small_scenes import BASE
from tiny_dataset import fingerprint
from unit.benchmark.fake_night import Mixed, write_dataset

from benchmark.errors import ResultsError
from benchmark.frames.dataset import open_dataset
from benchmark.report.site import pages
from benchmark.report.site.commands import Places
from benchmark.run import engine, journal
from benchmark.run import results as results_module
from generator.dataset import shard as shard_module
from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.errors import GeneratorError
from generator.frame import render as render_module
from generator.frame.folder import UNFINISHED
from generator.frame.render import render_dataset
from generator.frame.verify import problems
from generator.scenario.file import parse_scenario

MOST_WRITES = 200


class Nth:
    """Raises at the n-th call from 1, and says whether there was one."""

    def __init__(self, n: int, error: Callable[[], BaseException]) -> None:
        self._left, self._error = n, error

    @property
    def struck(self) -> bool:
        return self._left <= 0

    def call(self) -> None:
        self._left -= 1
        if self._left == 0:
            raise self._error()


def full_disk(n: int, patch: pytest.MonkeyPatch) -> Nth:
    """The n-th file is cut to half when it is flushed, and the disk is full."""

    def error() -> OSError:
        return OSError(errno.ENOSPC, "No space left on device")

    def flush(handle: int) -> None:
        try:
            fault.call()
        except OSError:
            path = os.readlink(f"/proc/self/fd/{handle}")
            os.truncate(path, os.path.getsize(path) // 2)
            raise

    fault = Nth(n, error)
    patch.setattr(os, "fsync", flush)
    return fault


def failing_rename(n: int, patch: pytest.MonkeyPatch) -> Nth:
    """The n-th renaming fails."""
    rename = Path.replace

    def replace(path: Path, target: Path) -> Path:
        fault.call()
        return rename(path, target)

    fault = Nth(n, lambda: OSError(errno.EIO, "Input/output error"))
    patch.setattr(Path, "replace", replace)
    return fault


FAULTS = (full_disk, failing_rename)


def faults_at_every_write(
    strike: Callable[[int, pytest.MonkeyPatch], Nth], work: Callable[[int], object], refusal: type[Exception]
) -> Iterator[int]:
    """Do the work with a fault at its first write, its second, and so on until there is no such write; yields each number."""
    for n in range(1, MOST_WRITES):
        with pytest.MonkeyPatch.context() as patch:
            fault = strike(n, patch)
            words = ""
            try:
                work(n)
            except refusal as error:
                words = str(error)
        if not fault.struck:
            assert not words
            return
        assert "run the same command again" in words or "choose another folder" in words, words or "passed unnoticed"
        yield n
    raise AssertionError("the writes have no end")


def visible(folder: Path) -> dict[str, str]:
    """SHA-256 of the files that do not have the names of temporary ones."""
    return {place: digest for place, digest in fingerprint(folder).items() if not Path(place).name.startswith(".")}


@pytest.fixture(scope="module")
def scenario():
    tree = BASE | {"name": "faults", "frames": 2, "camera": BASE["camera"] | {"width": 64, "height": 48}}
    return parse_scenario(yaml.safe_dump(tree), "faults.yaml")


@pytest.fixture(scope="module")
def make(scenario):
    """Generates the dataset; its frames are rendered once, for all runs of this module."""
    frames = {}
    render = shard_module.render_frame

    def rendered(scenario, index, **options):
        if index not in frames:
            frames[index] = render(scenario, index, **options)
        return frames[index]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shard_module, "render_frame", rendered)
        yield lambda out: generate(scenario, yaml.safe_dump({"name": "faults"}), out, DatasetSpec(shard_size=2))


@pytest.fixture(scope="module")
def dataset(make, tmp_path_factory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("whole") / "set"
    make(folder)
    return visible(folder)


@pytest.mark.journey
@pytest.mark.parametrize("strike", FAULTS)
def test_render(scenario, tmp_path, strike, monkeypatch) -> None:
    frames = [render_module.render_frame(scenario, index) for index in range(2)]
    monkeypatch.setattr(render_module, "render_frame", lambda scenario, index, *options, **more: frames[index])
    render_dataset(scenario, tmp_path / "whole")
    numbers = []
    for n in faults_at_every_write(strike, lambda n: render_dataset(scenario, tmp_path / str(n)), GeneratorError):
        folder = tmp_path / str(n)
        held = {place: digest for place, digest in visible(folder).items() if not place.startswith(UNFINISHED)}
        assert held.items() <= fingerprint(tmp_path / "whole").items()
        render_dataset(scenario, folder)
        assert fingerprint(folder) == fingerprint(tmp_path / "whole")
        assert problems(folder) == []
        numbers.append(n)
    assert len(numbers) >= 10


@pytest.mark.journey
@pytest.mark.parametrize("strike", FAULTS)
def test_generate(make, dataset, tmp_path, strike) -> None:
    numbers = []
    for n in faults_at_every_write(strike, lambda n: make(tmp_path / str(n)), GeneratorError):
        folder = tmp_path / str(n)
        assert visible(folder).items() <= dataset.items()
        make(folder)
        assert visible(folder) == dataset == fingerprint(folder)
        numbers.append(n)
    assert len(numbers) >= 10


@pytest.mark.journey
@pytest.mark.parametrize("error", [OSError(errno.EIO, "broken pipe"), RuntimeError("EndpointConnectionError")])
def test_generate_into_an_object_store_that_breaks_off(make, dataset, tmp_path, error) -> None:
    fsspec = pytest.importorskip("fsspec")
    store = fsspec.filesystem("memory")
    upload = type(store).put_file

    def strike(n: int, patch: pytest.MonkeyPatch) -> Nth:
        def put_file(system, local, place, **options):
            fault.call()
            return upload(system, local, place, **options)

        fault = Nth(n, lambda: error)
        patch.setattr(type(store), "put_file", put_file)
        return fault

    def held(n: int) -> dict[str, str]:
        copy = tmp_path / type(error).__name__ / str(n) / "copy"
        store.get(f"/faults/{n}/", f"{copy}/", recursive=True)
        return visible(copy)

    try:
        numbers = []
        for n in faults_at_every_write(strike, lambda n: make(f"memory://faults/{n}"), GeneratorError):
            make(f"memory://faults/{n}")
            assert held(n) == dataset
            numbers.append(n)
        assert len(numbers) >= 10
    finally:
        store.rm("/faults", recursive=True)


@dataclasses.dataclass(frozen=True)
class Settled(Mixed):
    """A contestant with a revision, so that its interrupted runs resume."""

    revision: str = "first"


@pytest.fixture(scope="module")
def night(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("night") / "night", (1, 8))


def scores(out: Path) -> dict[str, object]:
    """What results say besides times and dates, by the solver's folder."""
    found = {}
    for path in sorted(out.rglob(results_module.FRAMES_NAME)):
        table = results_module.read_table(path).to_pandas()
        found[path.parent.name] = table[["frame_id", "status", "error_km", "n_correct"]].to_csv()
        results_module.read_summary(path.with_name(results_module.SUMMARY_NAME))
    return found


@pytest.mark.parametrize("strike", FAULTS)
def test_bench_run(night, tmp_path, strike, monkeypatch) -> None:
    # Outcomes are written to the journal after each frame, as in a long run.
    monkeypatch.setattr(journal, "LONGEST_WAIT_S", 0.0)
    frames = open_dataset(night).frames

    def work(out: Path) -> None:
        engine.run(night, [Settled("one", frames)], out)

    work(tmp_path / "whole")
    numbers = []
    for n in faults_at_every_write(strike, lambda n: work(tmp_path / str(n)), ResultsError):
        for path in (tmp_path / str(n)).rglob(results_module.SUMMARY_NAME):
            results_module.read_summary(path)
        work(tmp_path / str(n))
        assert scores(tmp_path / str(n)) == scores(tmp_path / "whole")
        assert not list((tmp_path / str(n)).rglob(".*"))
        numbers.append(n)
    assert len(numbers) >= 9


@pytest.mark.parametrize("strike", FAULTS)
def test_report(night, tmp_path, strike, monkeypatch) -> None:
    frames = open_dataset(night).frames
    engine.run(night, [Settled("one", frames), Settled("three", frames)], tmp_path / "results")
    boards = pages.make_boards(tmp_path / "results")
    places = Places(tmp_path / "results", night.parent)
    site = tmp_path / "results" / "site"
    rendered = pages.render_site(
        boards,
        failed := [pages.failures_of(board) for board in boards],
        [
            pages.write_pictures(board, failures, pages.FrameSource(places.data), site, pages.MOST_PICTURES)
            for board, failures in zip(boards, failed, strict=True)
        ],
        places,
    )
    # The pages are drawn once, for all the times that they are written.
    monkeypatch.setattr(pages, "render_site", lambda *arguments: rendered)

    def work() -> None:
        pages.write_site(boards, places)

    work()
    whole = visible(site)
    shutil.rmtree(site)
    numbers = []
    for n in faults_at_every_write(strike, lambda n: work(), ResultsError):
        assert fingerprint(site) == visible(site)
        assert visible(site).items() <= whole.items()
        shutil.rmtree(site)
        numbers.append(n)
    assert visible(site) == whole
    assert len(numbers) >= 5
