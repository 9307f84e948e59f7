"""Tasks are frozen: what they mean does not change without a new revision, and what is done is not done again."""

import dataclasses
import io
import json
import math
import runpy
import shutil

import numpy as np
import pytest
from PIL import Image
from scipy import stats
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner
from unit.benchmark.stored import stored
from unit.benchmark.test_solver_programs import PROGRAM

import celnav
from benchmark.cli.bench import app
from benchmark.cli.listing import listed_tasks
from benchmark.errors import ResultsError, TaskError
from benchmark.frames.task_frames import FrameChoice, make_task_frames
from benchmark.instruments import told
from benchmark.protocol import CameraRecord, Observation
from benchmark.report.site.task_groups import OTHERS, group_of, groups_among
from benchmark.run.provenance import blanks
from benchmark.solvers.celnav_solver import answer_of
from benchmark.stats.frame_metrics import success_limit_km
from benchmark.tasks import definition
from benchmark.tasks.card import card
from benchmark.tasks.definition import FOLDER, Instruments, load_task, task_names, widest_half_width_points
from generator.dataset.archive import read_frames as read_archive
from generator.seeds import random_stream

FROZEN = {
    "allsky@1": "39b1ced7b55f49b8d390489ab3cd97ec673d74c5e0c26b705e969d89dbb4c14b",
    "attitude@2": "8deb835b9e749e7b5a700fe7effd0cbca8ad7e2bf8eb5e858fa7a03d38b4c486",
    "bortle@2": "e9cee7fd43c8ef60712c4e8435a7f763ca0896cec64f82de6984aa4af8f4c6f4",
    "city@1": "358609eb67b9f3aa50ed71383af57ba40558a477e86f74fdede72b6b1f8549cd",
    "clutter@2": "05d3ebde7a23b3daf1be5aa878763ad87f72119eef221c399be815b21dd3fb6b",
    "drift@1": "53cb05078059c5c12874b53a2d2d7c705f360be805c71d82acf56bd764277c7f",
    "glints@1": "1f42b6f129641992e761a21043bf84244275c62b275987a3b028fd2c3c03b728",
    "meteor@1": "4078a6d3856ab32aa12f2734e65bdb157598a4b8964b5a44b12d50d166620cb6",
    "motion@2": "62ecacc737f36f294864de3981465a97ddb7b147a58e7a4169896d9fd79ae8c5",
    "optics@2": "6010a97fa7dcab8f0c0cdc6ec6c4f5e4a5e3296f9ae0c61efe978aa896e09085",
    "phone@1": "d567c787914a9bfe5481ed8023a3ea8c2ea52c8077ac92cba9c6daca66d3b7ee",
    "startracker@1": "6cc2e52a976a15b28356c2dc1180a65760a642d8085f3bea6d8d521c0b0cd144",
    "startracker-false@1": "0ba22897a6c996333145c919580754631a16b7e581f006a56c1483d308fdc5cd",
    "startracker-field@1": "170767c8af0d64dfbe52c1376d840f2f65122156333484ff39a0452f16391450",
    "thesis-mag@2": "16e61b01b70f9908ce4ac86458cda3f6c2b3deba8d6580a5ede223616eec3216",
    "uav@1": "21fb9f84449a37c5766da604586629a52afecc6e65096560dfe5dcb4852274aa",
    "unknown-camera@1": "2186d604988e4bab55afd38ea1f357df9de2e3d709612b225d2b8da6fdc51499",
    "weather@2": "0be5a2be34d64d444dd0a74040df4c75d9bfa3ee2623c9ae5a15209c326c44d9",
}


def test_no_task_changes_without_a_new_revision():
    found = {load_task(name).label: load_task(name).sha256 for name in task_names()}
    assert found == FROZEN, "a task's meaning changed: raise its revision, and freeze the hash of the new one"


@pytest.mark.parametrize("name", sorted(label.partition("@")[0] for label in FROZEN))
def test_every_task_is_whole(name):
    task = load_task(name)
    dev, test = (task.scenario_of(split) for split in definition.SPLITS)
    assert dev.seed != test.seed
    assert dev.sha256 != test.sha256
    # 3 points over a task of 1000 frames; of tasks whose frames are few and dear, 7.
    frames = task.definition.frames_per_condition * len(task.definition.condition.values)
    assert widest_half_width_points(frames) <= (3.05 if task.definition.frames_per_condition >= 150 else 7.0)
    dev.check()


def test_splits_of_all_tasks_have_seeds_of_their_own():
    seeds = [split.seed for name in task_names() for split in load_task(name).definition.splits.values()]
    assert len(set(seeds)) == len(seeds) == 2 * len(FROZEN)


def test_a_card_says_whose_intervals_its_half_width_is_of() -> None:
    """Wilson's of independent frames; those of the pages, by site, are wider."""
    (score,) = (line for line in card(load_task("city")).splitlines() if line.startswith("| score"))
    assert "(Wilson's, of independent frames) within ±14.8 points" in score
    assert "those of the pages, clustered by site, are up to 1 point wider" in score


def test_cards_are_those_of_the_tasks() -> None:
    path = FOLDER.parents[1] / "tools/build_task_cards.py"
    made = runpy.run_path(str(path))["page"]()
    assert made == (FOLDER.parents[1] / "docs/task_cards.md").read_text(), "run: python tools/build_task_cards.py"
    for name in task_names():
        assert f"## {load_task(name).label}\n" in made
        assert load_task(name).sha256 in made


# A thousand million texts in lists of lists, of three hundred bytes.
ALIASES = "a0: &a0 [1]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10))


def test_formatting_does_not_count_but_meaning_does(tmp_path):
    for file in FOLDER.glob("bortle.*"):
        shutil.copy(file, tmp_path)
    before = load_task("bortle", tmp_path)
    path = tmp_path / "bortle.scenario.yaml"
    path.write_text("# another comment\n" + path.read_text())
    assert load_task("bortle", tmp_path).sha256 == before.sha256
    path.write_text(path.read_text().replace("aperture_mm: 0.7", "aperture_mm: 0.9"))
    assert load_task("bortle", tmp_path).sha256 != before.sha256


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("task", "revision: 2", "revision: 0", "revision"),
        ("task", "revision: 2", "revision: 2\nnote: x", "note"),
        ("task", "half_width_points: 7.9", "half_width_points: 2.0", "150 frames give 7.9"),
        ("task", "9, 10, 11]", "9, 11, 10]", "from easy to hard"),
        ("task", "3, 4, 5, 6, 7, 8, 9, 10, 11]", "3]", "needs 3 on one axis"),
        ("task", "seed: 8626", "seed: 8126", "different seeds"),
        ("task", "name: bortle\n", "name: other\n", "file's name says 'bortle'"),
        ("task", "scenario: bortle.scenario.yaml", "scenario: ../x.scenario.yaml", "scenario"),
        ("scenario", "name: task-bortle", "name: task-bortle\nseed: 3", "comes from the task"),
        ("scenario", "hfov_deg: 60", "hfov_deg: -60", "hfov_deg"),
        (
            "scenario",
            "name: task-bortle",
            f"{ALIASES}name: task-bortle",
            r"bortle\.scenario\.yaml: .*aliases are not allowed",
        ),
        ("task", "name: bortle\n", f"{ALIASES}name: bortle\n", r"bortle\.task\.yaml: .*aliases are not allowed"),
        (
            "scenario",
            "name: task-bortle",
            "name: x\nname: task-bortle",
            r"bortle\.scenario\.yaml: .*'name' is given twice",
        ),
        (
            "scenario",
            "name: task-bortle",
            f"x: {'[' * 2000}",
            r"bortle\.scenario\.yaml: cannot be read \(nested too deep",
        ),
        ("task", "revision: 2", f"x: {'[' * 2000}", r"bortle\.task\.yaml: cannot be read \(nested too deep"),
        ("task", "revision: 2", f"revision: {'1' * 5000}", r"bortle\.task\.yaml: cannot be read \(.*digits"),
        (
            "scenario",
            "name: task-bortle",
            f"# {'x' * 100_000}",
            r"bortle\.scenario\.yaml: cannot be read \(larger than",
        ),
    ],
)
def test_a_wrong_task_is_refused_by_key(tmp_path, file, old, new, message):
    for path in FOLDER.glob("bortle.*"):
        shutil.copy(path, tmp_path)
    path = tmp_path / f"bortle.{file}.yaml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(TaskError, match=message):
        load_task("bortle", tmp_path)


def test_a_task_whose_scenario_sweeps_other_values_is_refused(tmp_path):
    for path in FOLDER.glob("weather.*"):
        shutil.copy(path, tmp_path)
    path = tmp_path / "weather.scenario.yaml"
    assert "3.5, 4, 5]" in path.read_text()
    path.write_text(path.read_text().replace("3.5, 4, 5]", "3.5, 4, 6]"))
    with pytest.raises(TaskError, match="differs from the task's"):
        load_task("weather", tmp_path)


def test_unknown_tasks_and_revisions_are_refused():
    with pytest.raises(TaskError, match="known: allsky, attitude"):
        load_task("bortel")
    with pytest.raises(TaskError, match="use bortle@2"):
        load_task("bortle@1")
    assert load_task("bortle@2").label == "bortle@2"
    with pytest.raises(TaskError, match="unknown task"):
        load_task("../tasks/bortle")


CAMERA = CameraRecord("brown_conrady", 640, 480, 500.0, 500.0, 319.5, 239.5, (-0.05,), (0.0, 0.0))
SEEN = Observation(
    CAMERA,
    "2020-01-01T00:00:00.000Z",
    Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix(),
    pressure_hpa=1001.234,
)


def heard(instruments: Instruments, level: int, count: int) -> list[Observation]:
    return [told(SEEN, instruments.at(level), random_stream(1, "test", index)) for index in range(count)]


def test_what_is_told_errs_as_the_task_says():
    instruments = Instruments(tilt_sigma_deg=(0.0, 0.5), heading_sigma_deg=(0.0, 2.0))
    exact = heard(instruments, 0, 1)[0]
    names = [field.name for field in dataclasses.fields(SEEN) if field.name != "R_cam"]
    assert [getattr(exact, name) for name in names] == [getattr(SEEN, name) for name in names]
    assert exact.R_cam == pytest.approx(SEEN.R_cam, abs=1e-15)
    found = heard(instruments, 1, 4000)
    assert {one.camera for one in found} == {CAMERA}
    # Rounded to 0.1 deg: 0.5 and 2 deg become 0.501 and 2.00.
    assert {(one.tilt_sigma_deg, one.heading_sigma_deg) for one in found} == {(0.501, 2.0)}
    off = [Rotation.from_matrix(SEEN.R_cam.T @ one.R_cam).as_rotvec(degrees=True) for one in found]
    # The standard deviation of 4000 Gaussian numbers is within 5 % of theirs with a probability of 1 - 8e-6.
    assert np.std(off, axis=0) == pytest.approx([0.5, 0.5, 2.0], rel=0.05)
    assert np.abs(np.mean(off, axis=0)).max() < 5 * 2.0 / math.sqrt(4000)


def test_an_unknown_heading_is_said_to_be_unknown():
    found = heard(Instruments(heading_sigma_deg=(0.0, 10.0, 180.0)), 2, 500)
    assert all(math.isinf(one.heading_sigma_deg) for one in found)
    # The vertical stays what it was; the heading is anything.
    assert all(one.R_cam[:, 2] == pytest.approx(SEEN.R_cam[:, 2], abs=1e-12) for one in found)
    turned = [Rotation.from_matrix(SEEN.R_cam.T @ one.R_cam).as_rotvec(degrees=True)[2] for one in found]
    quarters, _ = np.histogram(turned, [-180, -90, 0, 90, 180])
    assert quarters.min() > 80  # of 125 expected: chance 2e-5


def test_an_unknown_lens_is_told_plain_and_its_focal_length_within_a_range():
    found = heard(Instruments(focal_range=(0.0, 0.3, 0.4), distortion_sigma=0.05), 1, 2000)
    assert {(one.camera.model, one.camera.k, one.distortion_sigma) for one in found} == {("pinhole", (), 0.05)}
    off = np.array([one.camera.f_px for one in found]) / 500.0 - 1.0
    # Of 2000 uniform numbers the range lacks 0.5 % or less with a probability of 1 - 9e-4 (the seed is fixed).
    assert (off.min(), off.max()) == pytest.approx((-0.3, 0.3), abs=0.003)
    assert stats.kstest((off + 0.3) / 0.6, "uniform").pvalue > 1e-3
    assert {one.focal_sigma for one in found} == {0.173}  # 0.3 / sqrt(3)
    assert all(one.camera.fy_px == pytest.approx(one.camera.f_px, rel=1e-6) for one in found)


def test_limits_of_success_are_lengths_angles_and_pixels(tmp_path):
    # One arcsec on a sphere of the Earth's mean radius: 6371.0088 km / 206264.806.
    for name, limit_km in (
        ("success_10km", 10.0),
        ("success_180arcsec", 180 * 6371.0088 / 206264.806),
        ("success_2px", 2 * math.degrees(math.atan(1 / 135.0)) * 111.1951),
    ):
        (tmp_path / "tiny.task.yaml").write_text(TINY.replace("success_10km", name))
        (tmp_path / "tiny.scenario.yaml").write_text(TINY_SCENARIO)
        task = load_task("tiny", tmp_path)
        assert task.limit_km == pytest.approx(limit_km, rel=1e-6)
        assert success_limit_km(task.metric_key) == pytest.approx(limit_km, rel=1e-3)
    (tmp_path / "tiny.task.yaml").write_text(TINY.replace("success_10km", "success_10mi"))
    with pytest.raises(TaskError, match=r"metric\.name"):
        load_task("tiny", tmp_path)
    with pytest.raises(ResultsError, match="success_Nkm"):
        success_limit_km("success_10mi")


def test_a_task_graded_by_what_is_told_has_frames_of_its_own_for_each_condition(tmp_path):
    told_task = TINY.replace("metric:", "instruments: {tilt_sigma_deg: [0, 0.1, 0.2], utc_sigma_s: 0.1}\nmetric:")
    (tmp_path / "tiny.task.yaml").write_text(told_task)
    (tmp_path / "tiny.scenario.yaml").write_text(TINY_SCENARIO.replace("{sweep: [5.0, 4.0, 3.0]}", "5.0"))
    task = load_task("tiny", tmp_path)
    assert task.graded_by_what_is_told
    assert task.scenario_of("dev").frame_count == 30
    levels = task.definition.instruments
    assert [levels.at(level).tilt_sigma_deg for level in range(3)] == [0.0, 0.1, 0.2]
    assert {levels.at(level).utc_sigma_s for level in range(3)} == {0.1}
    (tmp_path / "tiny.task.yaml").write_text(told_task.replace("[0, 0.1, 0.2]", "[0, 0.1]"))
    with pytest.raises(TaskError, match="one value for each of the 3 conditions"):
        load_task("tiny", tmp_path)


def test_solvers_of_a_task_of_photographs_get_the_luma_of_the_jpeg(tmp_path):
    (tmp_path / "tiny.task.yaml").write_text(TINY.replace("metric:", "image: photo\nmetric:"))
    with_photo = TINY_SCENARIO + "sensor: {colour: {}, develop: {exposure: 4.0, photo: {quality: 90}}}\n"
    (tmp_path / "tiny.scenario.yaml").write_text(with_photo)
    task = load_task("tiny", tmp_path)
    found = make_task_frames(task, "tiny", FrameChoice(per_condition=1, condition=5.0, data=tmp_path, workers=0))
    (frame,) = found.frames
    (archive,) = tmp_path.rglob("*.tar")
    (stored_frame,) = read_archive(archive)
    # Pillow's own decoder gives the luma of a JPEG where asked for one channel.
    jpeg = Image.open(io.BytesIO(stored_frame.members["photo.jpg"]))
    assert jpeg.mode == "RGB"
    jpeg.draft("L", jpeg.size)
    luma = np.asarray(jpeg)
    seen = np.asarray(Image.open(frame.image_path))
    assert luma.shape == seen.shape == (180, 270)
    assert np.abs(seen.astype(int) - luma).max() <= 2  # of 255: Pillow's goes by whole numbers, ours over the colours
    assert luma.std() > 1
    (tmp_path / "tiny.scenario.yaml").write_text(TINY_SCENARIO)
    with pytest.raises(TaskError, match=r"sensor\.develop\.photo"):
        load_task("tiny", tmp_path)


TINY = """
name: tiny
revision: 1
title: A task for this test alone
licence: CC-BY-4.0
scenario: tiny.scenario.yaml
condition: {name: limiting magnitude, unit: mag, values: [5.0, 4.0, 3.0], harder: lower}
splits: {dev: {seed: 1}, test: {seed: 2}}
metric: {name: success_10km, unit: "1", better: higher}
frames_per_condition: 10
half_width_points: 26.3
"""
TINY_SCENARIO = """
name: tiny
site: {latitude_deg: 52.0, longitude_deg: 4.36}
time: {utc_start: {utc: [2020-01-15T18:00:00Z, 2020-01-16T05:00:00Z]}, exposure_s: 0.5}
camera: {width: 270, height: 180, hfov_deg: 90, aperture_mm: 4}
stars: {limiting_magnitude: {sweep: [5.0, 4.0, 3.0]}}
"""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    root = tmp_path_factory.mktemp("tiny")
    tasks, solver = root / "tasks", root / "mine"
    tasks.mkdir()
    solver.mkdir()
    (tasks / "tiny.task.yaml").write_text(TINY)
    (tasks / "tiny.scenario.yaml").write_text(TINY_SCENARIO)
    (solver / "program.py").write_bytes(PROGRAM.read_bytes())
    (solver / "solver.yaml").write_text(
        'name: mine\ntitle: Says Munich\nlicence: MIT\nversion: "1"\ncommand: [python, program.py, well]\n'
    )
    return root


def bench(root, *arguments, out="out"):
    """Run a task of the user's own by its file."""
    places = ["--out", str(root / out), "--data", str(root / "data")]
    command = ["run", str(root / "tasks" / "tiny.task.yaml"), *map(str, arguments), *places]
    return CliRunner().invoke(app, command, catch_exceptions=False)


@pytest.mark.journey
def test_a_task_is_rendered_run_and_skipped_when_done(tiny):
    mine = ["--solver", str(tiny / "mine")]
    first = bench(tiny, "--solver", "skybench", *mine, "--frames", "2")
    assert first.exit_code == 0, first.output
    assert "mine: 6 frames" in first.output
    results = stored(tiny / "out")
    assert set(results) == {"skybench", "mine"}
    assert {len(result.frames) for result in results.values()} == {6}
    assert (results["skybench"].frames["error_km"] < 10.0).mean() > 0.6
    assert not (results["mine"].frames["error_km"] < 10.0).any()
    assert (results["mine"].frames["status"] == "fix").all()
    for result in results.values():
        assert result.provenance.frames.grading.values == (5.0, 4.0, 3.0)
        assert blanks(result.provenance) == []
        assert set(result.provenance.frames.rendered_with) >= {"skybench", "mitsuba"}
    (folder,) = (tiny / "out" / "tiny@1" / "dev" / "own").glob("mine-*")
    assert len(folder.name) == len("mine-") + 12
    stamp = (folder / "summary.json").stat().st_mtime_ns
    # The same again, and less: nothing to do. More: done anew. Another configuration: beside it.
    for frames in ("2", "1"):
        assert "mine: finished before" in bench(tiny, *mine, "--frames", frames).output
    assert (folder / "summary.json").stat().st_mtime_ns == stamp
    assert "mine: 9 frames" in bench(tiny, *mine, "--frames", "3").output
    assert json.loads((folder / "summary.json").read_text())["provenance"]["frames"]["per_condition"] == 3
    (tiny / "mine" / "weights.csv").write_text("0.5")
    assert "mine: 9 frames" in bench(tiny, *mine, "--frames", "3").output
    assert len(list((tiny / "out" / "tiny@1" / "dev" / "own").glob("mine-*"))) == 2
    # Frames carry what the statistics need.
    import pyarrow.parquet as pq

    rows = pq.read_table(folder / "frames.parquet").to_pylist()
    assert [row["condition"] for row in rows] == [5.0] * 3 + [4.0] * 3 + [3.0] * 3
    assert all(row["site"].startswith("+52.0000 +4.3600 2020-01-15") for row in rows)
    assert all(row["peak_memory_mib"] > 1.0 and row["time_ms"] > 0.0 for row in rows)


@pytest.mark.journey
def test_shared_detections_are_the_same_for_all(tiny):
    outcome = bench(
        tiny,
        "--solver",
        "skybench",
        "--solver",
        "thesis-adaptive",
        "--frames",
        "2",
        "--detections",
        "shared",
        out="shared",
    )
    assert outcome.exit_code == 0, outcome.output
    one, two = stored(tiny / "shared").values()
    assert one.detections == two.detections == "shared"
    assert one.frames["n_detections"].tolist() == two.frames["n_detections"].tolist()
    assert one.frames["n_detections"].max() > 10


def test_requests_that_cannot_be_met_end_with_status_two(tiny):
    for arguments, message in (
        (["--solver", "skybanch"], "did you mean skybench"),
        (["--solver", "skybench", "--frames", "11"], "it has 1 to 10"),
        ([], "at least one --solver"),
        (["--solver", "skybench", "--all"], "give tasks or frames to run on, or --all"),
        (["--solver", "skybench", "--condition", "7"], "limiting magnitude 7 is not one of its values: 5, 4, 3"),
    ):
        outcome = bench(tiny, *arguments)
        assert outcome.exit_code == 2, outcome.output
        assert message in outcome.output


def test_celnavs_planets_get_the_datasets_ids():
    matches = np.array([[0, 11767], [1, -1_000_005], [2, -8000]])
    answer = answer_of(celnav.Fix(ok=True, reason="ok", lat_deg=0.0, lon_deg=0.0, matches=matches))
    assert answer.matches.tolist() == [[0, 11767], [1, 900_000_599], [2, -8000]]


def test_the_list_shows_all_tasks_and_solvers():
    outcome = CliRunner().invoke(app, ["list"])
    assert outcome.exit_code == 0
    for name in (*FROZEN, "tetra3rs", "cedar-solve"):
        assert name in outcome.output


def test_every_task_has_a_group_in_the_report():
    assert OTHERS not in {group_of(name) for name in task_names()}
    assert groups_among(["phone", "mine", "bortle"]) == ("sky and camera", "hand, vehicle, street", OTHERS)


def test_the_list_states_the_limit_of_each_task():
    limits = {task.task: task.limit_km for task in listed_tasks()}
    assert limits == {load_task(name).label: load_task(name).limit_km for name in task_names()}
    assert (limits["bortle@2"], limits["drift@1"], limits["uav@1"]) == (10.0, 2500.0, 30.0)
    shown = CliRunner().invoke(app, ["list"], env={"COLUMNS": "200"}).output
    assert "2500 km" in shown
    assert "nearer than 10 km" not in shown
