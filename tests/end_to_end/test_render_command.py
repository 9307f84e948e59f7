"""`skybench render`: the files it writes, their contents, their bytes, and what it refuses."""

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pyarrow.parquet as pq
import pytest
import yaml
from PIL import Image
from small_scenes import BASE
from typer.testing import CliRunner, Result

from benchmark.cli.app import app
from generator.imu.table import IMU_SCHEMA

ROOT = Path(__file__).parents[2]
SCENARIO = BASE | {"camera": BASE["camera"] | {"width": 200, "height": 140}, "sky": {"bortle": {"sweep": [3, 6]}}}


def skybench(*arguments: str, **environment: str) -> subprocess.CompletedProcess:
    code = "import sys; from benchmark.cli.app import main; sys.argv[0] = 'skybench'; main()"
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=os.environ | environment, check=False, cwd=ROOT)


def here(*arguments: str, **environment: str) -> Result:
    """The same command in this process, where no second interpreter has to start."""
    return CliRunner().invoke(app, list(arguments), env=environment, catch_exceptions=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("render")
    (place / "scene.yaml").write_text(yaml.safe_dump(SCENARIO))
    run = skybench("render", str(place / "scene.yaml"), "--out", str(place / "frames"))
    assert run.returncode == 0, run.stderr
    assert "2 frames in" in run.stdout
    return place / "frames"


def test_folder_holds_what_the_format_promises(folder) -> None:
    names = sorted(path.name for path in folder.iterdir())
    stems = ["frame-00000", "frame-00001"]
    assert names == sorted(
        [f"{stem}.{kind}" for stem in stems for kind in ("png", "exr", "json")]
        + ["frames-manifest.json", "stars.parquet"]
    )


def test_image_is_16_bit_dn(folder) -> None:
    with Image.open(folder / "frame-00000.png") as image:
        dn = np.array(image)
    assert dn.dtype == np.uint16
    assert dn.shape == (140, 200)
    assert dn.min() > 64
    assert dn.max() <= 4095


def test_expected_electrons_carry_their_identity(folder) -> None:
    record = json.loads((folder / "frame-00001.json").read_text())
    with OpenEXR.File(str(folder / "frame-00001.exr")) as file:
        header, electrons = dict(file.header()), file.channels()["Y"].pixels
    assert electrons.dtype == np.float32
    assert electrons.shape == (140, 200)
    assert header["skybench:frame_id"] == "frame-00001"
    assert header["skybench:scenario_sha256"] == record["scenario"]["sha256"]
    assert header["skybench:utc_start"] == record["time"]["utc_start"]
    assert header["skybench:unit"] == "electrons"


def documented(section: str) -> set[str]:
    """Names in the first column of a section's table of docs/dataset_format.md, but those of optional rows."""
    text = (ROOT / "docs" / "dataset_format.md").read_text().split(section)[1].split("\n## ")[0]
    names: set[str] = set()
    for line in text.splitlines():
        if line.startswith("| `") and "*optional*" not in line:
            names |= set(re.findall(r"`([^`]+)`", line.split("|")[1]))
    return names


def leaves(tree, prefix=""):
    for key, value in tree.items():
        path = f"{prefix}{key}"
        if isinstance(value, dict) and path != "provenance":
            yield from leaves(value, path + ".")
        else:
            yield path


def test_frame_record_is_as_documented(folder) -> None:
    record = json.loads((folder / "frame-00000.json").read_text())
    of_sequences = {f"sequence.{key}" for key in ("index", "step", "start_s", "velocity_enu_m_s")}
    only_where_given = of_sequences | {"stars.listed_magnitude"}
    assert set(leaves(record)) == documented("json: the frame record\n") - only_where_given
    assert record["format"] == "skybench-frame/1"
    assert record["sky"]["bortle"] == 3
    assert 21.0 < record["sky"]["zenith_mag_arcsec2"] < 21.7  # the class' 21.5 with the Milky Way of that evening
    assert record["sky"]["components"][0] == "airglow"
    assert record["time"]["utc_mid"] == "2020-01-15T20:00:00.250000Z"


def test_table_of_readings_is_as_documented() -> None:
    assert set(IMU_SCHEMA.names) == documented("## imu.parquet")


def test_star_table_is_as_documented(folder) -> None:
    table = pq.read_table(folder / "stars.parquet")
    assert set(table.schema.names) == documented("## stars.parquet")
    assert table.schema.field("u_px").metadata[b"unit"] == b"px"
    assert table.schema.field("electrons_e").metadata[b"unit"] == b"e"
    stars = table.to_pandas()
    for index, rows in stars.groupby("index"):
        record = json.loads((folder / f"frame-{index:05d}.json").read_text())
        assert record["stars"]["n_in_field"] == len(rows)
        assert rows["v_mag"].is_monotonic_increasing
        assert rows["star_id"].is_unique
    catalogued = stars["kind"] == "star"
    assert ((stars["hip"] == stars["star_id"]) | (-stars["hr"] == stars["star_id"]))[catalogued].all()
    assert (stars.loc[~catalogued, "star_id"] > 900_000_000).all()


def digest(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


@pytest.mark.journey
@pytest.mark.parametrize("threads", ["1", "2"])
def test_same_bytes_on_any_number_of_threads(folder, tmp_path, threads) -> None:
    code = (
        "import sys; from pathlib import Path; from generator.mitsuba_runtime import set_threads;"
        f"set_threads({threads});"
        "from generator.scenario.file import load_scenario; from generator.frame.render import render_dataset;"
        "render_dataset(load_scenario(Path(sys.argv[1])), Path(sys.argv[2]))"
    )
    scenario = folder.parent / "scene.yaml"
    subprocess.run([sys.executable, "-c", code, str(scenario), str(tmp_path / "again")], check=True, cwd=ROOT)
    assert digest(tmp_path / "again") == digest(folder)


def test_a_frame_can_be_made_again_alone(folder) -> None:
    from generator.frame.render import png_bytes, render_frame
    from generator.scenario.file import load_scenario

    frame = render_frame(load_scenario(folder.parent / "scene.yaml"), 1)
    assert png_bytes(frame.dn) == (folder / "frame-00001.png").read_bytes()


def test_bad_scenario_is_one_line_and_exit_2(tmp_path) -> None:
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(SCENARIO | {"skyy": 1}))
    run = here("render", str(tmp_path / "bad.yaml"), "--out", str(tmp_path / "out"))
    assert run.exit_code == 2
    assert run.stderr.count("\n") == 1
    assert "bad.yaml: skyy: unknown key" in run.stderr
    assert not (tmp_path / "out").exists()


def test_folder_of_something_else_is_left_alone(folder, tmp_path) -> None:
    (tmp_path / "thesis.pdf").write_text("mine")
    run = here("render", str(folder.parent / "scene.yaml"), "--out", str(tmp_path))
    assert run.exit_code == 2
    assert "thesis.pdf" in run.stderr
    assert (tmp_path / "thesis.pdf").read_text() == "mine"


def test_time_outside_the_earth_orientation_table(tmp_path) -> None:
    late = SCENARIO | {"time": {"utc_start": "1961-01-01T00:00:00Z", "exposure_s": 1.0}}
    (tmp_path / "late.yaml").write_text(yaml.safe_dump(late))
    run = here("render", str(tmp_path / "late.yaml"), "--out", str(tmp_path / "out"))
    assert run.exit_code == 2
    assert "Earth orientation table" in run.stderr
    assert "Traceback" not in run.stderr


def test_an_interrupted_run_does_not_look_finished_and_is_continued(folder, tmp_path) -> None:
    from generator.frame.render import render_dataset
    from generator.scenario.file import load_scenario

    scenario = load_scenario(folder.parent / "scene.yaml")

    def stop(index: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_dataset(scenario, tmp_path / "out", stop)
    first = tmp_path / "out" / "frame-00000.png"
    assert "stars.parquet" not in {path.name for path in (tmp_path / "out").iterdir()}
    before = first.stat().st_mtime_ns
    (tmp_path / "out" / ".frame-00001-killed.png").write_bytes(b"half")
    render_dataset(scenario, tmp_path / "out")
    assert first.stat().st_mtime_ns == before
    assert digest(tmp_path / "out") == digest(folder)


# Starts the program twice.
@pytest.mark.journey
def test_a_frame_that_is_missing_from_a_finished_folder_is_made_again(folder, tmp_path) -> None:
    shutil.copytree(folder, tmp_path / "out")
    (tmp_path / "out" / "frame-00001.exr").unlink()
    run = skybench("render", str(folder.parent / "scene.yaml"), "--out", str(tmp_path / "out"))
    assert run.returncode == 0, run.stderr
    assert digest(tmp_path / "out") == digest(folder)


# Starts the program five times.
@pytest.mark.journey
def test_frames_of_another_scenario_are_replaced_only_when_meant(folder, tmp_path) -> None:
    shutil.copytree(folder, tmp_path / "out")
    other = SCENARIO | {"sky": {"bortle": 4}, "name": "other"}
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(other))
    command = ("render", str(tmp_path / "other.yaml"), "--out", str(tmp_path / "out"))
    refused = skybench(*command)
    assert refused.returncode == 2
    assert "holds frames of another scenario" in refused.stderr
    assert "--overwrite" in refused.stderr
    assert digest(tmp_path / "out") == digest(folder)
    replaced = skybench(*command, "--overwrite", "--no-exr")
    assert replaced.returncode == 0, replaced.stderr
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["frame-00000.json", "frame-00000.png", "frames-manifest.json", "stars.parquet"]
    assert json.loads((tmp_path / "out" / "frame-00000.json").read_text())["scenario"]["name"] == "other"


def test_expected_electrons_are_left_out_of_very_large_images_unless_asked_for() -> None:
    from generator.frame.render import writes_exr
    from generator.scenario.file import parse_scenario

    def large(width: int) -> bool:
        tree = SCENARIO | {"camera": BASE["camera"] | {"width": width, "height": 4000}}
        return writes_exr(parse_scenario(yaml.safe_dump(tree), "large.yaml"))

    assert large(5000)
    assert not large(5001)


# Starts the program three times.
@pytest.mark.journey
def test_a_full_disk_is_one_clear_line(folder, tmp_path) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000));"
    code = limit + "import sys; from benchmark.cli import main; sys.argv[0] = 'skybench'; main()"
    command = [sys.executable, "-c", code, "render", str(folder.parent / "scene.yaml"), "--out", str(tmp_path / "out")]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert run.returncode == 2, run.stderr
    (line,) = [line for line in run.stderr.splitlines() if line.startswith("skybench: ")]
    assert "writing failed (File too large)" in line
    assert "finished frames are kept" in line
    assert "Traceback" not in run.stderr


@pytest.mark.journey
@pytest.mark.parametrize(
    ("command", "moment", "number"),
    [
        ("render", 0.3, signal.SIGINT),
        ("render", 2.0, signal.SIGTERM),
        ("generate", 1.0, signal.SIGTERM),
        ("generate", 4.0, signal.SIGINT),
    ],
)
def test_a_signal_says_that_the_same_command_continues(tmp_path, command, moment, number) -> None:
    long = SCENARIO | {"frames": 500}
    (tmp_path / "long.yaml").write_text(yaml.safe_dump(long))
    started = "import sys; from benchmark.cli import interrupt, main; interrupt.listen(); print('on', flush=True);"
    code = started + "sys.argv[0] = 'skybench'; main()"
    arguments = [sys.executable, "-c", code, command, str(tmp_path / "long.yaml"), "--out", str(tmp_path / "out")]
    run = subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, start_new_session=True
    )
    assert run.stdout.readline() == "on\n"
    with pytest.raises(subprocess.TimeoutExpired):
        run.wait(moment)
    os.killpg(run.pid, number)
    _, errors = run.communicate(timeout=60)
    assert run.returncode == 128 + number, errors
    assert "skybench: interrupted; the same command continues" in errors
    assert "Traceback" not in errors


def test_doctor_is_content_here() -> None:
    run = here("doctor", COLUMNS="160")
    assert run.exit_code == 0, run.stdout
    for word in ("Python", "variant", "LLVM", "GPU", "memory", "YBSC", "Hipparcos"):
        assert word in run.stdout


def test_help_has_examples() -> None:
    assert "skybench render 00_hello --out out/hello" in here("render", "--help", COLUMNS="200").stdout
