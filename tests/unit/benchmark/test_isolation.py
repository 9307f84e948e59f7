"""Programs of the user's run in namespaces of their own: no truth, no files of the user, no network, no other process."""

from __future__ import annotations

import dataclasses
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from unit.benchmark.fake_night import write_dataset

from benchmark.errors import SolverError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.truth_folders import truth_folders
from benchmark.run import sessions
from benchmark.run.contestants import contestant_of
from benchmark.run.engine import outcomes
from benchmark.run.sessions import SessionPool, isolation_of_programs
from benchmark.solvers import definition
from benchmark.solvers.definition import SolverFolder, SolverSpec
from benchmark.solvers.isolation import ISOLATED, isolation_obstacle, visible_places
from benchmark.solvers.messages import request_of
from benchmark.solvers.namespaces import MOST_FILES, MOST_WRITTEN_BYTES
from benchmark.solvers.program import Limits, ProgramFailedError, ProgramSession
from benchmark.solvers.registry import missing_message, missing_packages, solver_folder
from benchmark.solvers.revision import PackageTree
from benchmark.stats.metrics import FrameScore
from celnav.cache import cache_dir

ROOT = Path(__file__).parents[3]
PROGRAMS = Path(__file__).parent / "programs"
LIMITS = Limits(time_s=30.0, memory_mib=600, start_s=60.0)
pytestmark = pytest.mark.skipif(
    bool(isolation_obstacle()), reason=f"this system lets nobody make namespaces: {isolation_obstacle()}"
)


@pytest.fixture
def place(tmp_path) -> Path:
    """A solver's folder with the programs in it, and things beside it."""
    (tmp_path / "solver").mkdir()
    for path in PROGRAMS.glob("*.py"):
        shutil.copyfile(path, tmp_path / "solver" / path.name)
    (tmp_path / "truth.json").write_text("52.0 N")
    (tmp_path / "frame").mkdir()
    (tmp_path / "frame" / "1.png").write_text("stars")
    return tmp_path


HARMLESS = ("truth", "network", "caller", "image")
"""What may be tried without isolation too."""
ALL = (*HARMLESS, "above", "home", "environment", "own folder", "system", "temporary", "mount")


def spied(place: Path, port: int, attempts: tuple[str, ...], isolated: bool) -> dict[str, str]:
    command = [sys.executable, "spy.py"]
    places = visible_places(command, place / "solver", [place / "frame"]) if isolated else None
    names = {"truth": str(place / "truth.json"), "home": str(place), "image": str(place / "frame" / "1.png")}
    request = {"type": "solve", "attempts": attempts, "port": port, "caller": os.getpid(), **names}
    with ProgramSession(command, place / "solver", LIMITS, places=places) as session:
        session.start()
        return session.ask(request).message


def test_a_spy_finds_nothing_but_the_image(place, monkeypatch) -> None:
    monkeypatch.setenv("SPY_SECRET", "1")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        seen = spied(place, port, ALL, isolated=True)
        free = spied(place, port, HARMLESS, isolated=False)
    assert seen["truth"] == "FileNotFoundError"
    assert seen["above"] == seen["home"] == "['frame', 'solver']"
    assert seen["environment"] in ("nothing", "PermissionError")
    assert seen["network"] == "OSError"
    assert seen["own folder"] == seen["system"] == "OSError"
    assert seen["caller"] == "ProcessLookupError"
    assert (seen["temporary"], seen["image"], seen["mount"]) == ("written", "stars", "False")
    assert not Path("/tmp/spy.txt").exists()
    # Without isolation the same program reaches what it tries to.
    assert free == {"truth": "52.0 N", "network": "connected", "caller": "reached", "image": "stars"}


def test_what_a_program_writes_counts_against_a_limit(place) -> None:
    """Files lie in memory too, which the limit of the address space does not count."""
    command, folders = [sys.executable, "hoarder.py"], ["/", "/tmp", "/dev/shm"]
    places = visible_places(command, place / "solver", [place / "frame"])
    for memory_mib in (200, 900):
        limits = Limits(time_s=30.0, memory_mib=memory_mib, start_s=60.0)
        with ProgramSession(command, place / "solver", limits, places=places) as session:
            session.start()
            seen = session.ask({"type": "solve", "folders": folders}).message
        most = min(memory_mib * 2**20, MOST_WRITTEN_BYTES)
        for folder in folders:
            assert seen[folder] == [most, MOST_FILES, "No space left on device"]


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    return open_dataset(write_dataset(tmp_path_factory.mktemp("data") / "night", (1, 2, 3))).frames


@pytest.mark.parametrize(
    ("way", "message"),
    [
        ("crash", r"exit status 7 \(cannot go on: the stars are wrong\)"),
        ("abort", "ended by signal SIGABRT"),
        ("garbage", "not JSON: b'Solved! lat = 48'"),
        ("memory", "MemoryError"),
        ("memory of children", "held more than 600 MiB with the processes that it started"),
        ("files in memory", "held more than 600 MiB"),
        ("many processes", "more than 64 processes"),
        ("hang", "no answer within 1 s"),
    ],
)
def test_what_goes_wrong_inside_is_told_as_outside(frames, place, way, message) -> None:
    command = [sys.executable, "misbehaving.py", way]
    limits = Limits(time_s=1.0, memory_mib=600, start_s=60.0) if way == "hang" else LIMITS
    places = visible_places(command, place / "solver", [frames[0].image_path.parent])
    with ProgramSession(command, place / "solver", limits, places=places) as session:
        session.start()
        with pytest.raises(ProgramFailedError, match=message):
            session.ask(request_of(frames[0], None, frames[0].image_path))


def spec_of(**more: object) -> SolverSpec:
    values = {"name": "mine", "title": "A program", "licence": "MIT", "version": "1"} | more
    return SolverSpec(**values)


def test_a_solver_of_the_user_is_isolated_and_judged(frames, place) -> None:
    solver = SolverFolder(place / "solver", spec_of(command=("python", "misbehaving.py", "well")))
    contestant = contestant_of(solver)
    pool = SessionPool(lambda: contestant.make_session(1), 1)
    try:
        scores = [outcome.score for outcome in outcomes(frames, pool, "own", {})]
    finally:
        pool.close()
    assert [score.status for score in scores] == ["fix"] * 3
    assert contestant.facts("1", "own").isolation == isolation_of_programs() == ISOLATED


def judged_by(solver: SolverFolder, frames) -> list[FrameScore]:
    pool = SessionPool(lambda: contestant_of(solver).make_session(1), 1)
    try:
        return [outcome.score for outcome in outcomes(frames, pool, "own", {})]
    finally:
        pool.close()


def test_what_does_not_count_as_a_solver_s_is_not_there_for_it(frames, tmp_path) -> None:
    """Its README, compiled code and a repository's files; other hidden files count, and are there."""
    folder = tmp_path / "solver"
    for name in (".git/config", ".rules", "README.md", "__pycache__/x.pyc", "part/__pycache__/y.pyc", "part/code.py"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("1")
    shutil.copyfile(PROGRAMS / "looking.py", folder / "looking.py")
    solver = SolverFolder(folder, spec_of(command=("python", "looking.py")))
    assert [score.reason for score in judged_by(solver, frames[:1])] == [".rules looking.py part/code.py"]
    before = solver.revision
    for name in (".git/config", "README.md", "__pycache__/x.pyc", "part/__pycache__/y.pyc"):
        (folder / name).write_text("2")
    assert SolverFolder(folder, solver.spec).revision == before
    (folder / ".rules").write_text("2")
    assert SolverFolder(folder, solver.spec).revision != before


def test_a_solver_that_may_read_the_truth_is_refused(frames, place) -> None:
    data = frames[0].image_path.parent
    (place / "data").symlink_to(data)
    named = SolverFolder(place / "solver", spec_of(command=("python", "misbehaving.py", "well"), reads=("../data",)))
    with pytest.raises(SolverError, match=r"data, which its solver\.yaml names in reads, contains the frames"):
        judged_by(named, frames)
    shutil.copytree(data, place / "solver" / "data")
    within = [dataclasses.replace(frames[0], image_path=place / "solver" / "data" / frames[0].image_path.name)]
    inside = SolverFolder(place / "solver", spec_of(command=("python", "misbehaving.py", "well")))
    with pytest.raises(SolverError, match="mine: its folder contains the frames with their truth; keep them apart"):
        judged_by(inside, within)


@pytest.mark.parametrize(
    "reads",
    [
        "data/stars.parquet",
        "data/frame-00000.json",
        "task/stars",
        "task/unpacked/frame-00000.json",
        "private/f1",
        "private",
    ],
)
def test_a_solver_that_may_read_a_part_of_the_truth_is_refused(frames, tmp_path, reads) -> None:
    """Beside the image, beside the folder of a task's unpacked images, and where a round's record is."""
    shown = {
        "data": dataclasses.replace(frames[0], image_path=tmp_path / "data" / "frame-00000.png"),
        "task": dataclasses.replace(frames[0], image_path=tmp_path / "task" / "unpacked" / "frame-00000.png"),
        "private": dataclasses.replace(
            frames[0],
            image_path=tmp_path / "set" / "f1.png",
            record_path=tmp_path / "private" / "f1" / "frame-00000.json",
        ),
    }[reads.split("/")[0]]
    solver = SolverFolder(tmp_path / "solver", spec_of(command=("python", "misbehaving.py"), reads=(f"../{reads}",)))
    with pytest.raises(SolverError, match=r"names in reads, (contains the frames|lies in .* beside the truth)"):
        solver.check_apart_from(truth_folders(shown))
    apart = SolverFolder(tmp_path / "solver", spec_of(command=("python", "misbehaving.py"), reads=("../tables",)))
    apart.check_apart_from(truth_folders(shown))


def test_what_a_solver_reads_is_part_of_its_revision(place) -> None:
    tables = place / "tables"
    tables.mkdir()
    (tables / "index.bin").write_text("patterns")
    spec = spec_of(command=("python", "spy.py"), reads=("../tables",))
    before = SolverFolder(place / "solver", spec).revision
    tables.rename(place / "elsewhere")
    moved = spec.model_copy(update={"reads": ("../elsewhere",)})
    assert SolverFolder(place / "solver", moved).revision == before
    (place / "elsewhere" / "index.bin").write_text("answers!")
    assert SolverFolder(place / "solver", moved).revision != before


def test_what_lies_beside_skybenchs_packages_or_is_linked_into_its_cache_counts_too(place, monkeypatch) -> None:
    """Its packages are covered otherwise, and solvers keep tables in its cache; a checkout holds other things as well."""
    cache = place / "cache" / "skybench"
    cache.mkdir(parents=True)
    monkeypatch.setattr(definition, "user_cache_path", lambda name: cache)
    tree = PackageTree(place)
    (place / "celnav").mkdir()
    for name in ("celnav/a.bin", "cache/skybench/b.bin", "c.bin"):
        (place / name).write_text("1")
    (cache / "linked.bin").symlink_to(place / "c.bin")

    def revision(name: str) -> str:
        spec = spec_of(command=("python", "spy.py"), reads=(str(place / name),))
        return SolverFolder(place / "solver", spec).revision_among(tree)

    names = ("celnav/a.bin", "cache/skybench/b.bin", "c.bin", "cache/skybench/linked.bin")
    before = [revision(name) for name in names]
    for name in ("celnav/a.bin", "cache/skybench/b.bin", "c.bin"):
        (place / name).write_text("2")
    assert [revision(name) == known for name, known in zip(names, before, strict=True)] == [True, True, False, False]


@pytest.mark.parametrize(
    "name", ["skybench", "tetra3rs", "learned", "zenith-fixer", "ruststartracker", "thesis-adaptive"]
)
def test_adapters_are_isolated_too(frames, name, tmp_path, monkeypatch) -> None:
    """They see celnav's tables in its cache, and neither the frames' truth nor the folder that skybench was started in."""
    if missing_packages(solver_folder(name)):
        pytest.skip(missing_message(solver_folder(name), missing_packages(solver_folder(name))))
    monkeypatch.chdir(tmp_path)
    started: list[ProgramSession] = []
    monkeypatch.setattr(
        sessions, "ProgramSession", lambda *given: started.append(ProgramSession(*given)) or started[-1]
    )
    contestant = contestant_of(name)
    pool = SessionPool(lambda: contestant.make_session(1), 1)
    try:
        scores = [outcome.score for outcome in outcomes(frames, pool, "own", {})]
        root = Path("/proc", str(started[0]._pid), "root")
        seen = {
            str(place) for place in (tmp_path, frames[0].image_path, cache_dir()) if (root / str(place)[1:]).exists()
        }
    finally:
        pool.close()
    assert not [score.reason for score in scores if score.status == "error"]
    assert seen == {str(cache_dir())}
    assert contestant.facts("1", "own").isolation == ISOLATED


def test_skybenchs_python_sees_packages_outside_of_its_environment(place, monkeypatch) -> None:
    """Of sys.path only folders of installed packages: the folder that a program is started in may be on it too."""
    for name in ("other/site-packages", "mine"):
        (place / name).mkdir(parents=True)
        monkeypatch.syspath_prepend(str(place / name))
    ours, theirs = (visible_places([program], place / "solver") for program in (sys.executable, "/usr/bin/env"))
    assert str(place / "other" / "site-packages") in ours
    assert str(place / "mine") not in ours
    assert str(place / "other" / "site-packages") not in theirs


def test_a_program_reads_what_its_definition_declares(place) -> None:
    tables = place / "tables"
    tables.mkdir()
    (tables / "index.bin").write_text("patterns")
    plain = spec_of(command=("python", "spy.py"))
    declared = SolverFolder(place / "solver", plain.model_copy(update={"reads": ("../tables", "~/no-such-folder")}))
    assert declared.spec.settings == plain.settings  # where tables lie does not make another solver
    assert tables in declared.reads  # by its own name: a place with .. in it cannot be made
    places = visible_places([sys.executable], declared.folder, declared.reads)
    assert places[str(tables)] == str(tables.resolve())
    assert not any("no-such-folder" in name for name in places)


@pytest.mark.journey
def test_nothing_is_left_when_the_benchmark_is_killed(place) -> None:
    code = (
        "import sys; from pathlib import Path; from benchmark.solvers.isolation import visible_places\n"
        "from benchmark.solvers.program import Limits, ProgramSession\n"
        "command = [sys.executable, 'misbehaving.py', 'hang']; folder = Path(sys.argv[1])\n"
        "session = ProgramSession(command, folder, Limits(time_s=60), places=visible_places(command, folder))\n"
        "session.start(); print('on', flush=True); session.ask({'type': 'solve'})"
    )
    command = [sys.executable, "-c", code, str(place / "solver")]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as benchmark:
        assert benchmark.stdout.readline() == "on\n"
        started = psutil.Process(benchmark.pid).children(recursive=True)
        assert len(started) == 4  # the guardian, the process outside, the first one inside, the program
        benchmark.kill()
    _, alive = psutil.wait_procs(started, timeout=20)
    assert [process for process in alive if process.status() != psutil.STATUS_ZOMBIE] == []


def test_a_program_that_is_not_there_is_an_error_of_the_user(place) -> None:
    places = visible_places([sys.executable], place / "solver")
    with (
        ProgramSession(["/no/such/program"], place / "solver", LIMITS, places=places) as session,
        pytest.raises(SolverError, match="No such file"),
    ):
        session.start()
