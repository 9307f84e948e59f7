"""Submissions from the packed set to the leaderboard: the truth scores perfectly, an empty and a random one as they must."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner
from unit.benchmark.fake_night import rng_for, write_dataset
from unit.benchmark.stored import stored

import celnav
from benchmark.cli.app import app
from benchmark.frames import opening
from benchmark.frames.dataset import open_dataset
from benchmark.frames.opening import open_frames
from benchmark.report.site.tree import read_tree
from benchmark.stats.frame_metrics import measure
from benchmark.stats.intervals import wilson
from benchmark.submit.csv_cells import csv_lines
from benchmark.submit.pack import public_record, withheld_names
from benchmark.submit.submission import FRAME_COLUMNS, STAR_COLUMNS

N = 9


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "night", (1, 2, None), per_class=3)


@pytest.fixture(scope="module")
def packed(folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("packed") / "set"
    run = CliRunner().invoke(app, ["bench", "pack-test", str(folder), "--out", str(out)])
    assert run.exit_code == 0, run.output
    assert f"{N} frames in {out}" in run.output
    return out


@pytest.fixture(scope="module")
def frames(folder):
    return open_dataset(folder).frames


def submit(tmp_path, folder, rows, stars=None, name="mine"):
    """Write, check and score a submission; return its exit status, output and table of frames."""
    answers = tmp_path / "answers.csv"
    answers.write_text(csv_lines([FRAME_COLUMNS, *rows]), encoding="utf-8")
    command = ["bench", "score", str(answers), "--truth", str(folder), "--name", name, "--out", str(tmp_path / "out")]
    if stars is not None:
        table = tmp_path / "stars.csv"
        table.write_text(csv_lines([STAR_COLUMNS, *stars]), encoding="utf-8")
        command += ["--stars", str(table)]
    return CliRunner().invoke(app, command)


def scores_of(tmp_path, name="mine"):
    return measure(stored(tmp_path / "out")[name].frames)


def truth_rows(frames, names):
    places = [(frame.conditions.latitude_deg, frame.conditions.longitude_deg) for frame in frames]
    rows = [
        (names[frame.frame_id], "fix", *place, 0.01, 0.004, 0.02, 1.0, 5.0)
        for frame, place in zip(frames, places, strict=True)
    ]
    stars = [
        (names[frame.frame_id], *uv, star)
        for frame in frames
        for uv, star in zip(frame.truth.uv.tolist(), frame.truth.star_id.tolist(), strict=True)
    ]
    return rows, stars


def test_the_truth_scores_perfectly(tmp_path, folder, packed, frames):
    rows, stars = truth_rows(frames, withheld_names(frames))
    run = submit(tmp_path, folder, rows[::-1], stars)
    assert run.exit_code == 0, run.output
    assert f"mine: {N} frames, {N} fixes, 100 % within 10 km, median error 0 km" in run.output
    found = scores_of(tmp_path)
    for km in (1, 3, 10, 30):
        assert found[f"success_{km}km"].value == 1.0
    # Three sites, three nights of one date: three clusters are all that stands behind the interval.
    assert (found["success_10km"].low, found["success_10km"].high) == pytest.approx(wilson(3, 3))
    assert found["median_error_km"].value == found["p90_error_km"].value == 0.0
    assert found["wrong_and_confident"].value == 0.0
    assert found["star_precision"].value == found["star_recall"].value == found["kelvins_score"].value == 1.0
    assert found["median_time_ms"].value == 5.0
    (result,) = stored(tmp_path / "out").values()
    assert (result.solver, result.provenance.solver.detector) == ("mine", "submission")
    assert result.provenance.solver.version.startswith("sha256:")
    assert result.frames["n_correct"].sum() == N * 12
    for name, value in (("cov_ee_km2", 0.01), ("cov_en_km2", 0.004), ("cov_nn_km2", 0.02), ("confidence", 1.0)):
        assert result.frames[name].tolist() == [value] * N


@pytest.mark.parametrize(
    "left_out", ["nothing", "refused frames", "all without a name", "every row but one of a frame"]
)
def test_recall_does_not_rise_with_what_a_star_table_leaves_out(tmp_path, folder, frames, left_out):
    """A third of the frames is refused, and of the others half of the stars are named: recall is a third."""
    names = withheld_names(frames)
    rows, stars = truth_rows(frames, names)
    refused = {row[0] for row in rows[::3]}
    rows = [(row[0], "refused", *[""] * 7) if row[0] in refused else row for row in rows]
    kept = []
    for i, (name, u, v, star) in enumerate(stars):
        named = name not in refused and i % 2 == 0
        gone = {
            "nothing": False,
            "refused frames": name in refused,
            "all without a name": not named,
            "every row but one of a frame": not named and i % 12 != 1,
        }[left_out]
        if not gone:
            kept.append((name, u, v, star if named else ""))
    run = submit(tmp_path, folder, rows, kept)
    assert run.exit_code == 0, run.output
    found = scores_of(tmp_path)
    assert found["star_precision"].value == 1.0
    assert found["star_recall"].value == pytest.approx(1 / 3)


def test_an_empty_submission_scores_nothing(tmp_path, folder, packed):
    """The form as it was packed: every frame refused."""
    form = packed / "answers.csv"
    assert CliRunner().invoke(app, ["bench", "check", str(form), "--set", str(packed)]).exit_code == 0
    command = ["bench", "score", str(form), "--truth", str(folder), "--name", "empty", "--out", str(tmp_path / "out")]
    run = CliRunner().invoke(app, command)
    assert run.exit_code == 0, run.output
    found = scores_of(tmp_path, "empty")
    assert found["success_30km"].value == found["wrong_and_confident"].value == found["kelvins_score"].value == 0.0
    assert found["median_error_km"].value == math.inf
    assert found["median_time_ms"].value == math.inf
    assert math.isnan(found["star_precision"].value)


def test_a_random_submission_is_wrong_and_confident(tmp_path, folder, frames):
    names = withheld_names(frames)
    rng = rng_for(4000)
    rows, stars = [], []
    for frame in frames:
        lat, lon = float(np.degrees(np.arcsin(rng.uniform(-1, 1)))), float(rng.uniform(-180, 180))
        rows.append((names[frame.frame_id], "fix", lat, lon, "", "", "", 0.9, 1.0))
        ids = rng.choice(np.arange(118001, 10**6), len(frame.truth.uv), replace=False).tolist()
        stars += [(names[frame.frame_id], *uv, star) for uv, star in zip(frame.truth.uv.tolist(), ids, strict=True)]
    run = submit(tmp_path, folder, rows, stars)
    assert run.exit_code == 0, run.output
    found = scores_of(tmp_path)
    # A cap of 30 km holds 5.5e-6 of the sphere: none of nine frames hits it but with probability 5e-5.
    assert (found["success_30km"].value, found["wrong_and_confident"].value) == (0.0, 1.0)
    assert 1000.0 < found["median_error_km"].value < 19_000.0
    assert (found["star_precision"].value, found["kelvins_score"].value) == (0.0, -1.0)


def test_the_set_holds_no_truth(packed, folder, frames):
    names = withheld_names(frames)
    listing = json.loads((packed / "frames.json").read_text())
    assert [entry["frame_id"] for entry in listing] == sorted(names.values())
    assert {path.name for path in packed.iterdir()} == {
        *(f"{name}.{kind}" for name in names.values() for kind in ("png", "json")), "frames.json", "answers.csv"
    }  # fmt: skip
    for frame in frames:
        record = json.loads((packed / f"{names[frame.frame_id]}.json").read_text())
        assert set(record) == {"format", "frame_id", "time", "camera", "camera_sigma", "attitude", "atmosphere"}
        assert set(record["atmosphere"]) == {
            "pressure_hpa", "temperature_c", "pressure_sigma_hpa", "temperature_sigma_c"
        }  # fmt: skip
        assert set(record["time"]) == {"utc_mid", "utc_sigma_s"}
        assert record["camera_sigma"] == {
            "focal_sigma": 0.0,
            "principal_point_sigma_px": 0.0,
            "distortion_sigma": 0.0,
        }
        assert set(record["attitude"]) == {
            "R_cam", "azimuth_deg", "altitude_deg", "roll_deg", "tilt_sigma_deg", "heading_sigma_deg"
        }  # fmt: skip
        with Image.open(packed / f"{names[frame.frame_id]}.png") as image, Image.open(frame.image_path) as original:
            assert image.info == {}
            assert np.array_equal(np.asarray(image), np.asarray(original))
    text = "".join(path.read_text() for path in packed.glob("*.json"))
    for secret in ("site", "latitude", "zenith", "bortle", "stars", "scenario", "seed", "provenance", "frame-0"):
        assert secret not in text


def test_a_packed_record_keeps_what_is_known_of_the_attitude(frames):
    """JSON has no infinity: null stands for a heading that is not known."""
    seen = dataclasses.replace(frames[0].observation, tilt_sigma_deg=0.25, heading_sigma_deg=math.inf)
    attitude = public_record("test-0", dataclasses.replace(frames[0], observation=seen))["attitude"]
    assert (attitude["tilt_sigma_deg"], attitude["heading_sigma_deg"]) == (0.25, None)
    assert attitude["R_cam"] == np.asarray(seen.R_cam).tolist()
    np.testing.assert_allclose(
        celnav.Pointing(*(attitude[f"{name}_deg"] for name in ("azimuth", "altitude", "roll"))).R_cam,
        seen.R_cam,
        atol=1e-12,
    )
    known = dataclasses.replace(seen, heading_sigma_deg=1.5)
    assert (
        public_record("test-0", dataclasses.replace(frames[0], observation=known))["attitude"]["heading_sigma_deg"]
        == 1.5
    )


def test_names_need_the_truth(frames):
    """Another truth gives other names: nobody can work them out from what is public."""
    one, two = withheld_names(frames), withheld_names(frames[:-1])
    assert not set(one.values()) & set(two.values())
    assert one == withheld_names(frames[::-1])


def test_a_set_of_known_frames_is_answered_by_their_ids(tmp_path, folder, frames):
    rows, stars = truth_rows(frames, {frame.frame_id: frame.frame_id for frame in frames})
    assert submit(tmp_path, folder, rows, stars).exit_code == 0
    assert scores_of(tmp_path)["success_1km"].value == 1.0


def test_a_faulty_submission_is_not_scored(tmp_path, folder, frames):
    rows, _ = truth_rows(frames, withheld_names(frames))
    run = submit(tmp_path, folder, rows[:-1])
    assert run.exit_code == 1
    assert "is missing; give it the status refused" in run.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("faulty", ["answers", "stars"])
def test_a_faulty_file_is_refused_before_frames_are_rendered(tmp_path, folder, frames, monkeypatch, faulty):
    opened = []
    monkeypatch.setattr(opening, "open_frames", lambda *arguments: opened.append(arguments) or open_frames(*arguments))
    rows, stars = truth_rows(frames, withheld_names(frames))
    assert submit(tmp_path, folder, rows, stars).exit_code == 0
    assert len(opened) == 1
    if faulty == "answers":
        rows[3] = (rows[3][0], "fix", 95, 0, 0.01, 0.004, 0.02, 1.0, 5.0)
    else:
        stars[3] = (stars[3][0], "left", 0, "")
    run = submit(tmp_path, folder, rows, stars, name="other")
    assert run.exit_code == 1
    expected = "line 5: lat_deg: found 95" if faulty == "answers" else "line 5: u_px: found 'left'"
    assert f"{tmp_path / faulty}.csv: {expected}" in run.output
    assert len(opened) == 1


@pytest.mark.parametrize(
    "name", ["../evil", "=HYPERLINK(1)", "<script>alert(1)</script>", "a/b", "", "skybench", "thesis-adaptive"]
)
def test_names_that_cannot_be(tmp_path, folder, frames, name):
    rows, _ = truth_rows(frames, withheld_names(frames))
    assert submit(tmp_path, folder, rows, name=name).exit_code == 2
    assert not (tmp_path / "out").exists()


def test_results_on_another_dataset_are_not_mixed(tmp_path, folder, frames):
    rows, _ = truth_rows(frames, withheld_names(frames))
    assert submit(tmp_path, folder, rows).exit_code == 0
    other = write_dataset(tmp_path / "other", (1,), scenario="another night")
    others = open_dataset(other).frames
    assert submit(tmp_path, other, truth_rows(others, withheld_names(others))[0], name="second").exit_code == 0
    assert [[result.solver for result in group] for group in read_tree(tmp_path / "out")] == [["second"], ["mine"]]


def test_the_folder_must_be_empty_and_the_dataset_whole(tmp_path, folder):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    for source, out in (
        (folder, tmp_path / "full"),
        (tmp_path, tmp_path / "out"),
        (Path("/nowhere"), tmp_path / "out"),
    ):
        assert CliRunner().invoke(app, ["bench", "pack-test", str(source), "--out", str(out)]).exit_code == 2
