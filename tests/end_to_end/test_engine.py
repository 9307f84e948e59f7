"""Every kind of frames with every kind of solver through one command; each page's commands make it again."""

import html
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from object_store import served
from small_scenes import BASE
from typer.testing import CliRunner
from unit.benchmark.stored import stored
from unit.benchmark.test_solver_programs import PROGRAM
from unit.benchmark.test_tasks import TINY, TINY_SCENARIO

from benchmark.cli.app import app
from benchmark.report.site.tree import read_tree
from benchmark.run.provenance import blanks

ROOT = Path(__file__).parents[2]
CODE = "import sys; from benchmark.cli.app import main; sys.argv[0] = 'skybench'; main()"
SCENARIO = BASE | {
    "name": "two-skies",
    "frames": 2,
    "camera": BASE["camera"] | {"width": 240, "height": 160},
    "sky": {"bortle": {"sweep": [2, 6]}},
}


def skybench(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)


def write_solver(folder, way):
    folder.mkdir(parents=True)
    (folder / "program.py").write_bytes(PROGRAM.read_bytes())
    spec = {"name": folder.name, "title": "A program", "licence": "MIT", "version": "1"}
    spec |= {"command": ["python", "program.py", way], "time_limit_s": 20}
    (folder / "solver.yaml").write_text(yaml.safe_dump(spec))


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder to work in: a scenario rendered and generated, a task, solvers."""
    root = tmp_path_factory.mktemp("engine")
    (root / "skies.yaml").write_text(yaml.safe_dump(SCENARIO))
    for name, text in (("task", TINY), ("scenario", TINY_SCENARIO)):
        (root / f"tiny.{name}.yaml").write_text(text)
    for name, way in (("mine", "well"), ("broken", "crash"), ("loud", "loud")):
        write_solver(root / name, way)
    before = Path.cwd()
    os.chdir(root)
    try:
        assert skybench("render", "skies.yaml", "--out", "skies").exit_code == 0
        made = skybench("generate", "skies.yaml", "--out", "shards", "--shard-size", 3, "--workers", 0)
        assert made.exit_code == 0, made.output
        yield root
    finally:
        os.chdir(before)


@pytest.mark.journey
def test_a_folder_and_a_dataset_of_the_same_frames_are_one_set(place):
    for target, solver in (("skies", "./mine"), ("shards", "skybench")):
        run = skybench("bench", "run", target, "--solver", solver, "--out", "results/same")
        assert run.exit_code == 0, run.output
        assert ": 4 frames in" in run.output
    groups = read_tree(Path("results/same"))
    # The split of a dataset is its own; what the frames are is told by the label.
    (label,) = {group[0].provenance.frames.label for group in groups}
    assert re.fullmatch(r"two-skies@[0-9a-f]{12}", label)
    results = [result for group in groups for result in group]
    assert {result.solver: result.split for result in results} == {"mine": "all", "skybench": "train"}
    assert len({result.provenance.frames.truth_sha256 for result in results}) == 1
    for result in results:
        assert blanks(result.provenance) == []
    again = skybench("bench", "run", "shards", "--solver", "skybench", "--out", "results/same")
    assert "skybench: finished before" in again.output


# Two programs and a server.
@pytest.mark.journey
def test_a_dataset_in_an_object_store_is_solved_like_one_on_disk(place):
    make = (
        "import fsspec; s = fsspec.filesystem('s3'); s.mkdir('skies'); s.put('shards/', 'skies/set/', recursive=True)"
    )
    command = ["bench", "run", "s3://skies/set", "--solver", "skybench", "--out", "results/url", "--data", "fetched"]
    with served() as store:
        environment = os.environ | store | {"PYTHONPATH": str(ROOT)}
        subprocess.run([sys.executable, "-c", make], check=True, env=environment, capture_output=True)
        run = subprocess.run(
            [sys.executable, "-c", CODE, *command], capture_output=True, text=True, env=environment, check=False
        )
    assert run.returncode == 0, run.stderr
    assert skybench("bench", "run", "shards", "--solver", "skybench", "--out", "results/disk").exit_code == 0
    far, near = (stored(Path("results") / name)["skybench"] for name in ("url", "disk"))
    assert far.provenance.frames.target == "s3://skies/set"
    assert (far.key, far.provenance.frames.label) == (near.key, near.provenance.frames.label)
    assert far.frames["error_km"].equals(near.frames["error_km"])
    assert far.frames["n_detections"].tolist() == near.frames["n_detections"].tolist()


def test_a_shard_that_was_changed_is_refused(place, tmp_path):
    copy = shutil.copytree("shards", tmp_path / "shards")
    (shard,) = copy.glob("data/train/shard-000000.tar")
    content = bytearray(shard.read_bytes())
    content[5000] ^= 1
    shard.write_bytes(content)
    run = skybench("bench", "run", copy, "--solver", "./mine", "--out", tmp_path / "out", "--data", tmp_path / "data")
    assert run.exit_code == 2
    assert "shard-000000.tar is not what its manifest says" in run.output


def test_one_condition_of_a_task_has_a_place_of_its_own(place):
    arguments = ("bench", "run", "tiny.task.yaml", "--solver", "./mine", "--frames", 2, "--out", "results/one")
    run = skybench(*arguments, "--condition", 4)
    assert run.exit_code == 0, run.output
    assert "mine: 2 frames in" in run.output
    result = stored(Path("results/one"))["mine"]
    assert (result.split, set(result.frames["condition"])) == ("dev-4", {4.0})
    assert "limiting magnitude 4 mag" in result.task.title
    assert not result.task.graded
    wrong = skybench(*arguments, "--condition", 4.5)
    assert wrong.exit_code == 2
    assert "limiting magnitude 4.5 is not one of its values: 5, 4, 3" in wrong.output
    assert skybench("bench", "run", "skies", "--solver", "./mine", "--condition", 4).exit_code == 2


@pytest.mark.journey
def test_a_few_frames_are_tried_with_standard_error_shown_and_no_result(place):
    run = skybench("bench", "run", "skies", "--solver", "./loud", "--try", 2, "--out", "results/tried")
    assert run.exit_code == 0, run.output
    assert run.stderr.count("I am looking at frame-0000") == 3  # the first is the warm-up, which is not judged
    assert re.findall(r"^(frame-\d+): fix, .* off", run.stdout, re.MULTILINE) == ["frame-00000", "frame-00002"]
    assert "2 fixes, 0 refused, 0 errors" in run.stdout
    assert not Path("results/tried").exists()
    task = skybench("bench", "run", "tiny.task.yaml", "--solver", "./loud", "--try", 3, "--out", "results/tried")
    assert [float(value) for value in re.findall(r"^frame-\d+ \((\d)\)", task.stdout, re.MULTILINE)] == [5, 4, 3]
    two = skybench("bench", "run", "skies", "--solver", "./loud", "--solver", "./mine", "--try", 1)
    assert two.exit_code == 2


@pytest.mark.journey
def test_answers_that_are_all_errors_are_cried_out_and_not_taken_for_finished(place):
    for more in (("--try", 1), (), ()):
        run = skybench("bench", "run", "skies", "--solver", "./broken", "--out", "results/broken", *more)
        assert run.exit_code == 1, run.output
        assert "every answer" in run.stderr
        assert "error" in run.stderr
        assert "finished before" not in run.output
    assert (stored(Path("results/broken"))["broken"].frames["status"] == "error").all()


COMMANDS = re.compile(r'<pre class="commands">(.*?)</pre>', re.DOTALL)


@pytest.mark.journey
def test_each_pages_commands_make_it_again_when_pasted(place, tmp_path):
    """Run every page's commands in a shell, in a fresh folder that has the frames and solvers, and compare the tables."""
    for arguments in (
        ("skies", "--solver", "./mine", "--solver", "./loud"),
        ("tiny.task.yaml", "--solver", "./mine", "--frames", 1, "--condition", 3, "--detections", "shared"),
    ):
        run = skybench("bench", "run", *arguments, "--out", "results/again run")
        assert run.exit_code == 0, run.output
    assert skybench("bench", "report", "--out", "results/again run").exit_code == 0
    site = Path("results/again run/site")
    pages = sorted(site.glob("*.html"))
    assert len(pages) == 1 + 2 * 2 + 2
    shim = tmp_path / "bin" / "skybench"
    shim.parent.mkdir()
    shim.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{CODE}" "$@"\n')
    shim.chmod(0o755)
    environment = os.environ | {"PATH": f"{shim.parent}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    before = {summary.parent.relative_to("results") for summary in Path("results/again run").rglob("summary.json")}
    made, ran = set(), set()
    for page in pages:
        text = page.read_text(encoding="utf-8")
        commands = html.unescape(COMMANDS.search(text).group(1)).strip()
        assert commands.startswith("skybench bench"), page.name
        if commands in ran:
            continue
        ran.add(commands)
        folder = tmp_path / f"shell-{len(ran)}"
        folder.mkdir()
        for name in ("skies", "mine", "loud", "tiny.task.yaml", "tiny.scenario.yaml", "out"):
            if (place / name).exists():
                (folder / name).symlink_to(place / name)
        if not commands.startswith("skybench bench run"):  # only the report: of the results that are there
            (folder / "results").symlink_to(place / "results")
        done = subprocess.run(
            ["sh", "-ec", commands], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, (page.name, commands, done.stderr)
        again = folder / "results" / "again run" / "site" / page.name
        assert again.is_file(), page.name
        made |= {
            summary.parent.relative_to(folder / "results") for summary in (folder / "results").rglob("summary.json")
        }
    assert made >= before
