"""The wheel alone, in an environment without the repository and an empty folder: files, scenarios, commands."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path

import pytest

from generator.mitsuba_runtime import LLVM_VARIABLE, find_llvm

ROOT = Path(__file__).parents[2]
PACKAGES = ("generator", "celnav", "benchmark")
SMALL = """\
name: small
frames: 2
site: {latitude_deg: 52.0, longitude_deg: 4.36}
time: {utc_start: 2020-01-15T20:00:00Z, exposure_s: 0.5}
camera: {width: 540, height: 360, hfov_deg: 90, aperture_mm: 4}
sky: {bortle: 4}
"""

# Each test here needs a wheel to be built, and an environment to be made or commands to be run in it.
pytestmark = pytest.mark.journey


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """The folder of commands of an environment that holds the wheel, and what it depends on by a path."""
    place = tmp_path_factory.mktemp("environment")
    uv = [sys.executable, "-m", "uv"]
    python = place / "bin" / "python"
    subprocess.run([*uv, "venv", "--quiet", "--clear", "--python", sys.executable, str(place)], check=True)
    install = [*uv, "pip", "install", "--quiet", "--offline", "--no-deps", "--python", str(python), str(wheel)]
    subprocess.run(install, check=True)
    # A path in a .pth file brings modules; the .pth files there, such as that of the editable skybench, it does not read.
    (site,) = place.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    return python.parent


@pytest.fixture(scope="module")
def empty(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("empty")


def run(installed: Path, folder: Path, *words: str) -> str:
    """Standard output of a command of the wheel's; it must succeed."""
    keep = {key: os.environ[key] for key in ("HOME", "LANG", "XDG_CACHE_HOME") if key in os.environ}
    environment = keep | {LLVM_VARIABLE: find_llvm().path, "PATH": f"{installed}:{os.defpath}"}
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (words, done.stdout, done.stderr)
    return done.stdout


def test_the_wheel_holds_every_file_of_the_packages_and_the_scenes(wheel) -> None:
    listed = subprocess.run(
        ["git", "ls-files", *PACKAGES, "scenes"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    wanted = {
        name.replace("scenes/", "generator/scenes/", 1) if name.startswith("scenes/") else name for name in listed
    }
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert wanted <= held
    assert {name.split("/")[0] for name in held} == set(PACKAGES)
    assert not [name for name in held if "__pycache__" in name]


def test_it_is_the_wheel_that_runs(installed, empty) -> None:
    code = "import benchmark, generator, celnav; print(benchmark.__file__, generator.__file__, celnav.__file__)"
    found = run(installed, empty, "python", "-c", code).split()
    assert all(Path(path).is_relative_to(installed.parent) for path in found)
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert run(installed, empty, "skybench", "--version").split() == ["skybench", version]


def test_its_revisions_are_those_of_the_repository(installed, empty) -> None:
    code = "from generator.identity.revision import generator_revision; print(generator_revision())"
    here = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert run(installed, empty, "python", "-c", code) == here
    revisions = (sys.executable, "-c", "from benchmark.cli import main; main()", "bench", "revisions", "--json")
    listed = subprocess.run(revisions, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert json.loads(run(installed, empty, "skybench", "bench", "revisions", "--json")) == json.loads(listed)


def test_commands_find_their_scenes_and_data_in_an_empty_folder(installed, empty) -> None:
    shutil.rmtree(empty / "mine", ignore_errors=True)
    scenes = json.loads(run(installed, empty, "skybench", "scenes", "--json"))
    assert {path.stem for path in (ROOT / "scenes").glob("*.yaml")} == set(scenes)
    run(installed, empty, "skybench", "scenes", "clutter", "--copy", "mine")
    for scenario in ("scenes/horizon.yaml", "mine/clutter.yaml"):  # both name files beside them
        assert json.loads(run(installed, empty, "skybench", "plan", scenario, "--json"))["files"]
    listed = json.loads(run(installed, empty, "skybench", "bench", "list", "--json"))
    assert len(listed["tasks"]) == len(list((ROOT / "benchmark" / "tasks").glob("*.task.yaml")))
    assert {solver["solver"]: solver["obstacle"] for solver in listed["solvers"]}["skybench"] == ""
    health = json.loads(run(installed, empty, "skybench", "doctor", "--json"))
    assert health["ok"], health


def test_the_demonstration_and_a_position(installed, empty) -> None:
    (empty / "small.yaml").write_text(SMALL, encoding="utf-8")
    answer = json.loads(run(installed, empty, "skybench", "demo", "--scenario", "small.yaml", "--json"))
    assert (empty / answer["page"]).is_file()
    assert (empty / answer["details"]).is_file()
    assert {row["name"]: row["found"] for row in answer["solvers"]}["skybench"] == 2
    frame = "out/demo/frame-00000"
    options = ("--camera", f"{frame}.json", "--attitude", f"{frame}.json", "--utc", "2020-01-15T20:00:00.25Z")
    assert "latitude" in run(installed, empty, "celnav", "solve", f"{frame}.png", *options)


def test_wheel_and_source_archive_have_the_same_bytes_wherever_and_whenever_they_are_built(tmp_path) -> None:
    """From two copies of the tracked files, with other dates and other rights, under other variables."""
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.decode()
    built = []
    for number, rights in enumerate((0o644, 0o600)):
        copy = tmp_path / ("here" * (number + 1))
        for name in tracked.rstrip("\0").split("\0"):
            if name.startswith(("results/", "docs/images/")) or not (ROOT / name).is_file():
                continue
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, copy / name)
            (copy / name).chmod(rights)
            os.utime(copy / name, (10**9 + number * 10**7, 10**9 + number * 10**7))
        environment = os.environ | {"TZ": ("UTC", "Asia/Tokyo")[number], "PYTHONHASHSEED": str(number)}
        out = tmp_path / f"out-{number}"
        command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(copy)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, done.stderr
        built.append({path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in out.iterdir()})
    assert built[0] == built[1]
    assert sorted(Path(name).suffix for name in built[0]) == [".gz", ".whl"]
