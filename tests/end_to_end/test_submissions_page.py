"""docs/submissions.md: its commands, in order, on a small dataset, and its program against the benchmark's own solver."""

import csv
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import yaml
from typer.testing import CliRunner
from unit.benchmark.fake_night import write_dataset
from unit.benchmark.stored import stored

from benchmark.cli.app import app
from benchmark.frames.dataset import load_image
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import FrameChoice
from benchmark.solvers.celnav_solver import CelnavSolver
from benchmark.submit.pack import withheld_names
from benchmark.tasks.definition import widest_half_width_points

PAGE = Path(__file__).parents[2] / "docs" / "submissions.md"
FIRST_DATASET_PLANET = 900_000_000
TOLD_SCENARIO = {
    "name": "told",
    # Jupiter stands near the zenith.
    "site": {"latitude_deg": 0.0, "longitude_deg": 0.0},
    "time": {"utc_start": "2022-09-26T00:30:00Z", "exposure_s": 0.5},
    "attitude": {"azimuth_deg": 0, "altitude_deg": 85, "roll_deg": 0},
    "camera": {
        "model": "brown_conrady",
        "width": 320,
        "height": 240,
        "f_px": 277.13,
        "k": [-0.06],
        "aperture_mm": 4,
        "bloom": {"share": 0},
        "veiling_glare": 0,
    },
    "stars": {"limiting_magnitude": {"sweep": [6.5, 5.5, 0.5]}},
    "sky": {"bortle": 2},
}
TOLD_TASK = {
    "name": "told",
    "revision": 1,
    "title": "Told with errors of every kind",
    "licence": "CC-BY-4.0",
    "scenario": "told.scenario.yaml",
    "condition": {"name": "limit of the stars", "unit": "mag", "values": [6.5, 5.5, 0.5], "harder": "lower"},
    "instruments": {
        "tilt_sigma_deg": 0.05,
        "heading_sigma_deg": 0.5,
        "utc_sigma_s": 2.0,
        "focal_sigma": 0.02,
        "principal_point_sigma_px": 4.0,
        "distortion_sigma": 0.05,
        "pressure_sigma_hpa": 10.0,
        "temperature_sigma_c": 5.0,
    },
    "metric": {"name": "success_100km", "unit": "1", "better": "higher"},
    "splits": {"dev": {"seed": 1}, "test": {"seed": 2}},
    "frames_per_condition": 10,
    "half_width_points": round(widest_half_width_points(10), 1),
}


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_commands_of_the_page_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_dataset(tmp_path / "out" / "demo")
    (program,) = blocks("python")
    (tmp_path / "answer_set.py").write_text(program, encoding="utf-8")
    (commands,) = blocks("bash")
    ran = 0
    for line in commands.splitlines():
        tool, *arguments = shlex.split(line)
        if tool == "skybench":
            run = CliRunner().invoke(app, arguments)
            assert run.exit_code == 0, run.output
        else:
            assert tool == "python"
            path = [str(PAGE.parents[1])]
            subprocess.run([sys.executable, *arguments], check=True, env={"PYTHONPATH": path[0]}, timeout=300)
        ran += 1
    assert ran == 5
    (result,) = stored(tmp_path / "results" / "demo").values()
    assert (result.solver, len(result.frames)) == ("my-solver", 3)
    assert (tmp_path / "results" / "demo" / "site" / "index.html").is_file()


def test_the_program_of_the_page_answers_as_the_benchmarks_own_solver(tmp_path):
    """Told with errors, with a planet in the field, and with frames without stars, which are refused."""
    (tmp_path / "told.scenario.yaml").write_text(yaml.safe_dump(TOLD_SCENARIO), encoding="utf-8")
    task = tmp_path / "told.task.yaml"
    task.write_text(yaml.safe_dump(TOLD_TASK), encoding="utf-8")
    common = ("--frames", "2", "--data", str(tmp_path / "data"))
    run = CliRunner().invoke(app, ["bench", "pack-test", str(task), "--out", str(tmp_path / "set"), *common])
    assert run.exit_code == 0, run.output
    (program,) = blocks("python")
    (tmp_path / "answer_set.py").write_text(program, encoding="utf-8")
    command = [sys.executable, "answer_set.py", "set", "answers.csv", "stars.csv"]
    subprocess.run(command, check=True, cwd=tmp_path, env={"PYTHONPATH": str(PAGE.parents[1])}, timeout=300)
    with (tmp_path / "answers.csv").open(newline="") as file:
        answers = {row["frame_id"]: row for row in csv.DictReader(file)}
    with (tmp_path / "stars.csv").open(newline="") as file:
        stars = list(csv.DictReader(file))
    frames = open_frames(str(task), FrameChoice("test", 2, data=tmp_path / "data")).frames
    names, solver = withheld_names(frames), CelnavSolver("skybench")
    planets, refused = 0, 0
    for frame in frames:
        found = solver.detect(load_image(frame))
        own = solver.solve(found, frame.observation)
        row = answers[names[frame.frame_id]]
        listed = [star for star in stars if star["frame_id"] == row["frame_id"]]
        # Two processes may add in different orders, which moves peaks of noise by some millionths of a pixel.
        places = np.array([(float(star["u_px"]), float(star["v_px"])) for star in listed]).reshape(-1, 2)
        stars_above = len(found) - found.n_faint
        np.testing.assert_allclose(places[:stars_above], found.uv[:stars_above], atol=1e-6)
        np.testing.assert_allclose(places[stars_above:], found.uv[stars_above:], atol=1e-5)
        assert row["status"] == ("fix" if own.ok else "refused")
        if not own.ok:
            refused += 1
            assert not any(star["star_id"] for star in listed)
            continue
        cov = np.array([row["cov_ee"], row["cov_en"], row["cov_nn"]], dtype=float)
        np.testing.assert_allclose(cov, own.cov_km2[[0, 0, 1], [0, 1, 1]], rtol=1e-4)
        np.testing.assert_allclose(
            [float(row[name]) for name in ("lat_deg", "lon_deg", "confidence")],
            [own.lat_deg, own.lon_deg, own.confidence],
            atol=1e-6,
        )
        assert {i: int(star["star_id"]) for i, star in enumerate(listed) if star["star_id"]} == dict(
            own.matches.tolist()
        )
        planets += int((own.matches[:, 1] > FIRST_DATASET_PLANET).sum())
    assert (planets > 0, refused > 0, refused < len(frames)) == (True, True, True)
    told = [str(tmp_path / name) for name in ("answers.csv", "stars.csv", "set")]
    checked = CliRunner().invoke(app, ["bench", "check", told[0], "--stars", told[1], "--set", told[2]])
    assert checked.exit_code == 0, checked.output
