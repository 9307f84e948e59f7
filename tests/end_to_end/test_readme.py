"""The README and the documents do what they say: code, commands, output."""

import functools
import io
import json
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from documented_commands import (
    ROOT,
    commands_that_exist,
    filled_in,
    name_of,
    refusal,
    shown_in_blocks,
    shown_in_words,
    skybench_app,
)
from photograph_files import standin, write_camera, write_ff, write_fits
from small_rounds import RULES
from typer.testing import CliRunner

from benchmark.cli.datasets.exporting import FORMS
from benchmark.real_tasks import fetch
from celnav.__main__ import main as celnav_main
from generator.frame.render import render_frame, write_frame
from generator.scenario.file import load_scenario
from generator.scenario.shipped import find_scenario

README = (ROOT / "README.md").read_text(encoding="utf-8")
ROWS = [line.replace("\\|", "|") for line in re.findall(r"^\| `((?:skybench|celnav) [^`]*)` \|", README, re.MULTILINE)]
DOCUMENTS = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
}
# `skybench bake` writes into the package; tests/physics/test_bake.py makes pieces of its maps again.
CELNAV_COMMANDS = ("solve", "calibrate")
NOT_RUN = {"skybench bake"}
TAKE_LONG = {
    "skybench gallery": "skybench gallery --out pictures",
    "skybench speed": "skybench speed --frames 1 --pairs 1",
    "skybench study thesis": "skybench study thesis --frames 2 --sites 2 --out thesis --work work",
    "skybench study calibration": (
        "skybench study calibration --sites 2 --pictures 1 --gradient 2 --out calibration --work work"
    ),
    "skybench study realism": (
        f"skybench study realism {ROOT}/tests/data/allsky/005.fits.bz2 a.fits.bz2 b.fits.bz2 "
        f"--calibrate-on {ROOT}/tests/data/allsky/008.fits.bz2 --scene observatory_allsky --solver skybench "
        "--solver tetra3rs --out realism --work work"
    ),
    "skybench study independence": (
        "skybench study independence --frames 6 --solver skybench --out independence --work work"
    ),
    "skybench twin": f"skybench twin {ROOT}/tests/data/allsky/008.fits.bz2 --scene observatory_allsky --out twins",
}
# On what the rows of the table have made; tests/end_to_end/test_command_line.py has those that need nothing.
AS_JSON = (
    "skybench render small.yaml --out out-again",
    "skybench verify set",
    "skybench show set",
    "skybench export set --to coco --out coco-again",
    "skybench bench run out --solver skybench --out results",
    "skybench bench run out --solver skybench --try 1",
    "skybench bench report --out results",
    "skybench bench boards bortle --solver skybench --plan --out results/board",
    "skybench bench pack-results --out results",
    "skybench bench confirm out --out results",
    "skybench bench pack-test out --out packed-again",
    "skybench bench check packed/answers.csv --set packed",
    "skybench bench score packed/answers.csv --truth out --name again --out results",
    "skybench bench round draw --secret again.hex --rules small.rules.yaml --frames 1 --out round-again",
    "skybench bench round pack round-again --secret again.hex --truth again-truth --out again-set",
    "skybench bench round score round-again --secret again.hex --truth again-truth --set again-set --solver skybench --later",
    "skybench bench round open round-again --secret again.hex --truth again-truth",
    "skybench bench round verify round-again",
    "skybench demo --scenario small.yaml --frames out/demo --out results/demo",
)
SMALL = """\
name: small
seed: 3
frames: 2
site: {latitude_deg: 52.0, longitude_deg: 4.36}
time: {utc_start: 2020-01-15T20:00:00Z, exposure_s: 0.5}
camera: {width: 540, height: 360, hfov_deg: 90, aperture_mm: 4}
sky: {bortle: 4}
attitude: zenith-north-up
"""


@pytest.mark.journey
def test_code_prints_what_the_readme_shows(tmp_path, monkeypatch) -> None:
    code, printed = re.search(r"```python\n(.*?)```\n\n```\n(.*?)```", README, re.DOTALL).groups()
    monkeypatch.chdir(tmp_path)
    number = int(re.search(r"out/demo/frame-(\d{5}).png", code).group(1))
    write_frame(Path("out/demo"), render_frame(load_scenario(find_scenario("demo")), number))
    output = io.StringIO()
    with redirect_stdout(output):
        exec(compile(code, "README.md", "exec"), {})
    assert output.getvalue() == printed


def test_the_table_lists_the_commands_that_exist_and_no_others() -> None:
    existing = commands_that_exist()
    listed = [name_of(row, existing) for row in ROWS if row.startswith("skybench ")]
    assert None not in listed
    assert sorted(listed) == sorted(existing)
    assert [row for row in ROWS if row.startswith("celnav ")] != []


@pytest.mark.parametrize("row", ROWS)
def test_rows_of_the_table_are_acceptable_command_lines(row: str) -> None:
    assert refusal(filled_in(row, {})) is None


@pytest.mark.parametrize("name", DOCUMENTS)
def test_commands_in_documents_are_acceptable(name: str) -> None:
    lines = shown_in_blocks(DOCUMENTS[name])
    assert {line: refusal(line) for line in lines if refusal(line) is not None} == {}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_commands_in_sentences_exist_with_their_options(name: str) -> None:
    existing = commands_that_exist()
    groups = {" ".join(command.split()[:length]) for command in existing for length in range(2, len(command.split()))}
    faults = []
    for line in shown_in_words(DOCUMENTS[name]):
        options = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", line))
        if line.startswith("celnav "):
            command = line.split()[1]
            known = set(re.findall(r"--[a-z-]+", help_of(command) if command in CELNAV_COMMANDS else ""))
            if command not in CELNAV_COMMANDS or options - known:
                faults.append(line)
            continue
        command = name_of(line, existing)
        if command is None:
            faults += [] if line in groups and not options else [line]
            continue
        known = {option for parameter in existing[command].params for option in parameter.opts}
        faults += [line] if options - known else []
    assert faults == []


def test_faulty_commands_are_noticed() -> None:
    assert refusal("skybench render scenes/00_hello.yaml --out out/hello") is None
    assert refusal("skybench render scenes/00_hello.yaml --into out/hello") is not None
    assert refusal("skybench render --out out/hello") is not None
    assert refusal("skybench bench run bortle --solver skybench --detections nonsense") is not None
    assert refusal("skybench draw") == "there is no such command"
    assert refusal("celnav solve --camera c.json") is not None


def test_targets_of_make_that_documents_name_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    named = {
        target for text in DOCUMENTS.values() for target in re.findall(r"(?:^|`)make ([a-z-]+)", text, re.MULTILINE)
    }
    assert {"demo", "test", "docs"} <= named <= targets
    shown = set(re.findall(r'^\t@echo "make ([a-z-]+)', (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert targets - {"help", "install", "demo-small"} == shown


@pytest.mark.journey
def test_rows_of_the_table_run(tmp_path, monkeypatch) -> None:
    """Each row once, in an order in which each finds what it needs, on two small frames."""
    monkeypatch.chdir(tmp_path)
    Path("small.yaml").write_text(SMALL, encoding="utf-8")
    write_photographs()
    monkeypatch.setattr(fetch, "missing_sources", lambda task, data: [])  # a third of them is at hand here
    Path("fetched").mkdir()
    Path("small.rules.yaml").write_text(RULES, encoding="utf-8")
    frame = "out/frame-00000"
    rendered = {"SCENARIO": "small.yaml", "DIR": "out"}
    made = {"SCENARIO": "small.yaml", "DIR": "set"}
    plan: dict[str, list[str]] = {
        "skybench render": [filled_in(row("skybench render"), rendered)],
        "skybench plan": ["skybench plan small.yaml", filled_in(row("skybench plan"), rendered)],
        "skybench generate": [filled_in(row("skybench generate"), made)],
        "skybench verify": [filled_in(row("skybench verify"), made)],
        "skybench show": ["skybench show set", "skybench show set --video set.mp4 --truth"],
        "skybench export": [f"skybench export set --to {form} --out {form}" for form in FORMS],
        "skybench import photos": [
            "skybench import photos photos --site 52.0 4.36 10 --camera told.json --out imported",
            "skybench verify imported",
        ],
        "skybench import rms": ["skybench import rms night --site 52.0 4.36 10 --camera told.json --out meteors"],
        "skybench fetch": ["skybench fetch allsky-real --from fetched", "skybench fetch allsky-real --json"],
        "skybench bench list": [row("skybench bench list")],
        "skybench bench run": ["skybench bench run out --solver skybench --solver brightest-n --out results"],
        "skybench bench report": ["skybench bench report --out results"],
        "skybench bench boards": ["skybench bench boards bortle --solver skybench --plan --out results/board"],
        "skybench bench pack-results": ["skybench bench pack-results --out results"],
        "skybench bench confirm": ["skybench bench confirm out --out results"],
        "skybench bench revisions": ["skybench bench revisions"],
        "skybench bench stale": [f"skybench bench stale --root {ROOT}"],
        "skybench bench pack-test": ["skybench bench pack-test out --out packed"],
        "skybench bench check": ["skybench bench check packed/answers.csv --set packed"],
        "skybench bench score": ["skybench bench score packed/answers.csv --truth out --name mine --out results"],
        "skybench bench round draw": [
            "skybench bench round draw --rules small.rules.yaml --frames 2 --solver skybench"
        ],
        "skybench bench round pack": ["skybench bench round pack round --out round-set"],
        "skybench bench round score": ["skybench bench round score round --set round-set --solver skybench"],
        "skybench bench round open": ["skybench bench round open round"],
        "skybench bench round verify": ["skybench bench round verify round --render 1"],
        "skybench doctor": [row("skybench doctor")],
        "skybench scenes": ["skybench scenes", "skybench scenes horizon --copy copied"],
        "skybench presets": ["skybench presets", "skybench presets imx477-6mm"],
        "skybench demo": ["skybench demo --scenario small.yaml --frames out/demo --out results/demo"],
        "celnav calibrate": [f"celnav calibrate {frame}.png --lat 52.0 --lon 4.36 --out camera.json"],
        "celnav solve": [
            filled_in(
                row("celnav solve"),
                {"IMAGE": f"{frame}.png", "FILE": f"{frame}.json", "UTC": "2020-01-15T20:00:00.25Z"},
            )
        ],
    }
    for name in ("draw", "pack", "score", "open"):
        plan[f"skybench bench round {name}"][0] += " --secret secret.hex" + (
            " --out round" if name == "draw" else " --truth round-truth"
        )
    assert {name for name in plan if name.startswith("skybench")} | set(TAKE_LONG) | NOT_RUN == set(
        commands_that_exist()
    )
    for lines in plan.values():
        for line in lines:
            assert refusal(line) is None, line
            assert run(line) == 0, line
    assert Path("set-show/index.html").is_file()
    assert Path("results/site/index.html").is_file()
    for line in (*AS_JSON, "skybench generate small.yaml --out set --json"):
        text = printed(f"{line} --json".replace("--json --json", "--json"))
        documents = text.splitlines() if "generate" in line else [text]
        assert documents, line
        assert all(isinstance(json.loads(document), dict) for document in documents), line


@pytest.mark.slow  # pictures of all-sky maps, and studies on rendered frames: a minute or more each
@pytest.mark.parametrize("name", TAKE_LONG)
def test_rows_of_the_table_that_take_long_run(name: str, tmp_path, monkeypatch) -> None:
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    for photograph in ("a", "b"):  # photographs are few here
        shutil.copyfile(ROOT / "tests/data/allsky/005.fits.bz2", tmp_path / f"{photograph}.fits.bz2")
    monkeypatch.chdir(tmp_path)
    assert refusal(TAKE_LONG[name]) is None
    assert run(TAKE_LONG[name]) == 0


def write_photographs() -> None:
    """A photograph, a meteor station's night, and the camera of both."""
    for folder in ("photos", "night"):
        Path(folder).mkdir()
    write_camera(Path("told.json"))
    write_fits(Path("photos/a.fits"))
    mean = np.clip(standin("2020-01-15T20:00:00Z") // 4, 0, 255).astype(np.uint8)
    write_ff(Path("night"), "FF_XX0001_20200115_195954_880_0000000.fits", mean)


def row(name: str) -> str:
    """The row of the table that shows a command."""
    return next(line for line in ROWS if line.startswith(name))


def run(line: str) -> int:
    """Exit status of a command line, run in this process."""
    program, *arguments = shlex.split(line)
    if program == "celnav":
        return int(celnav_main(arguments) or 0)
    result = CliRunner().invoke(skybench_app(), arguments)
    assert result.exception is None or isinstance(result.exception, SystemExit), (line, result.output, result.exception)
    return result.exit_code


def printed(line: str) -> str:
    """Standard output of a command line of `skybench`, which must succeed."""
    result = CliRunner().invoke(skybench_app(), shlex.split(line)[1:])
    assert result.exit_code == 0, (line, result.output, result.exception)
    return result.stdout


@functools.cache
def help_of(command: str) -> str:
    """What the help of a command of `celnav` prints."""
    asked = [sys.executable, "-m", "celnav", command, "--help"]
    return subprocess.run(asked, capture_output=True, text=True, check=True).stdout
