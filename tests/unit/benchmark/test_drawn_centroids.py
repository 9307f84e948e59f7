"""Frames of measured centroids: pictures whose spots are where RMS measured stars, as datasets and as a task."""

import hashlib
import json
import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from photograph_files import CAMERA, PLACE, true_attitude, write_camera, write_fits
from typer.testing import CliRunner

import celnav
from benchmark.cli.app import app
from benchmark.cli.listing import listed_real_tasks
from benchmark.errors import PhotographError, TaskError
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import FrameChoice
from benchmark.importing.drawn_centroids import DN_PER_UNIT, SKY_DN, draw_centroids, drawn
from benchmark.importing.known_sky import known_sky
from benchmark.importing.photographs import Clock, read_photograph
from benchmark.real_tasks import definition
from benchmark.real_tasks.definition import load_real_task
from benchmark.real_tasks.fetch import fetch_sources
from benchmark.run.engine import run as run_engine
from celnav.command.calibration_frames import read_rms_centroids

BLOCK_S = 10.24
NIGHT = ("FF_XX0001_20200115_195955_000_0000000.fits", "FF_XX0001_20200115_203000_500_0000000.fits")
MIDDLES = ("2020-01-15T20:00:00.120Z", "2020-01-15T20:30:05.620Z")


def star_list(utc_mid: str) -> list[list[float]]:
    """Stars to V 4.5 where the camera has them, with the noise of a tenth of a pixel; Julian date, row, column, light."""
    sky = known_sky(PLACE, utc_mid, BLOCK_S)
    uv = CAMERA.project(sky.middle.enu @ true_attitude().T)
    height, width = CAMERA.height, CAMERA.width
    good = (sky.stars.v_mag < 4.5) & (sky.middle.altitude_deg > 12) & (uv > 8).all(axis=1)
    good &= (uv < np.array([width, height]) - 9).all(axis=1)
    uv = uv[good] + np.random.default_rng(5).normal(0, 0.1, (int(good.sum()), 2))
    light = 3000.0 * 10 ** (-0.4 * (sky.stars.v_mag[good] - 1.0))
    return [[2458864.3, v, u, light, 0.0, 0.0, 1.0] for (u, v), light in zip(uv.tolist(), light.tolist(), strict=True)]


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of RMS without images: two frames with centroids, and one with too few."""
    folder = tmp_path_factory.mktemp("night")
    common = {"X_res": CAMERA.width, "Y_res": CAMERA.height, "auto_recalibrated": True}
    place = {"lat": PLACE.latitude_deg, "lon": PLACE.longitude_deg, "elev": PLACE.height_m}
    content = {
        name: common | place | {"star_list": star_list(middle)} for name, middle in zip(NIGHT, MIDDLES, strict=True)
    }
    content["FF_XX0001_20200115_210000_000_0000000.fits"] = common | place | {"star_list": star_list(MIDDLES[0])[:5]}
    (folder / "platepars_all_recalibrated.json").write_text(json.dumps(content))
    return folder


def test_spots_are_where_the_stars_were_measured_and_as_bright(night: Path, tmp_path: Path) -> None:
    platepars = night / "platepars_all_recalibrated.json"
    paths = draw_centroids(platepars, tmp_path)
    assert [path.name for path in paths] == [name.replace(".fits", ".centroids.fits") for name in NIGHT]
    frame = read_rms_centroids(platepars)[0]
    picture = read_photograph(paths[0], Clock())
    assert (picture.utc_mid, picture.exposure_s) == ("2020-01-15T20:00:00.120000Z", BLOCK_S)
    assert (picture.pixels == drawn(frame)).all()
    found = celnav.detect(picture.pixels).uv
    misses = np.array([np.hypot(*(found - uv).T).min() for uv in frame.uv])
    # A tenth of a pixel is what RMS' centroids are good for; the picture must not add to it.
    assert np.median(misses) < 0.02
    assert np.mean(misses < 0.1) > 0.95
    flux = frame.detections.flux
    assert flux is not None
    total = picture.pixels.astype(np.float64).sum() - SKY_DN * picture.pixels.size
    assert total == pytest.approx(DN_PER_UNIT * flux.sum(), rel=0.02)


def test_the_same_centroids_give_the_same_bytes_and_absent_ones_are_named(night: Path, tmp_path: Path) -> None:
    platepars = night / "platepars_all_recalibrated.json"
    once, again = (draw_centroids(platepars, tmp_path / name, NIGHT[1:]) for name in ("one", "two"))
    assert once[0].read_bytes() == again[0].read_bytes()
    with pytest.raises(PhotographError, match="has no centroids of FF_XX0001_20200115_210000"):
        draw_centroids(platepars, tmp_path, ["FF_XX0001_20200115_210000_000_0000000.fits"])
    (tmp_path / "broken.json").write_text("[" * 3000)
    with pytest.raises(PhotographError, match="is not JSON"):
        draw_centroids(tmp_path / "broken.json", tmp_path)


def test_a_spot_at_the_edge_is_cut_off(night: Path) -> None:
    frame = read_rms_centroids(night / "platepars_all_recalibrated.json")[0]
    frame.detections.uv[0] = 0.0, 100.0
    frame.detections.uv[1] = -400.0, 100.0
    picture = drawn(frame)
    assert picture.shape == (CAMERA.height, CAMERA.width)
    assert picture[100, 0] > SKY_DN + 100


def test_a_night_of_centroids_is_a_dataset(night: Path, tmp_path: Path) -> None:
    camera = write_camera(tmp_path / "camera.json")
    command = ["import", "rms", str(night), "--centroids", "--camera", str(camera), "--out", str(tmp_path / "set")]
    told = CliRunner().invoke(app, command)
    assert told.exit_code == 0, told.output
    assert "2 photographs in" in told.stdout
    (done,) = run_engine(tmp_path / "set", ["skybench"], tmp_path / "results")
    assert done.summary.n_fixes == 2
    assert done.summary.star_precision.value > 0.97
    # A tenth of a pixel is 5 km at this scale.
    assert done.summary.median_error_km.value < 10.0


def test_a_task_of_centroids_grades_its_frames(night: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "definition"
    folder.mkdir()
    write_camera(folder / "small-drawn.camera.json")
    content = (night / "platepars_all_recalibrated.json").read_bytes()
    source = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    tree = {
        "name": "small-drawn", "revision": 1, "title": "Two frames of centroids", "licence": "CC0-1.0",
        "credit": "nobody", "origin": "these tests", "camera": "small-drawn.camera.json", "calibrated_on": "nothing",
        "site": {"latitude_deg": PLACE.latitude_deg, "longitude_deg": PLACE.longitude_deg, "height_m": PLACE.height_m},
        "condition": {"name": "hours since then", "unit": "h", "values": [0.5, 1], "harder": "higher"},
        "sources": [source | {"file": "one.platepars.json", "published": "platepars_all_recalibrated.json"}],
        "drawn": [
            {"frame": NIGHT[1], "night": "one.platepars.json", "condition": 0.5},
            {"frame": NIGHT[0], "night": "one.platepars.json", "condition": 1},
        ],
    }  # fmt: skip
    (folder / "small-drawn.yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")
    monkeypatch.setattr(definition, "FOLDER", folder)
    task = load_real_task("small-drawn")
    assert fetch_sources(task, tmp_path / "data", night) == ["one.platepars.json"]
    (listed,) = [each for each in listed_real_tasks() if each.task == task.label]
    assert listed.photographs == 2
    found = open_frames("small-drawn", FrameChoice(data=tmp_path / "data"))
    assert [(frame.condition, frame.observation.utc) for frame in found.frames] == [
        (0.5, MIDDLES[1].replace("Z", "000Z")),
        (1.0, MIDDLES[0].replace("Z", "000Z")),
    ]
    for change, words in (
        ({"drawn": [tree["drawn"][0] | {"night": "two.json"}]}, "night two.json is none of the sources"),
        ({"drawn": [tree["drawn"][0], dict(tree["drawn"][0])]}, "a frame is listed twice"),
        ({"drawn": []}, "each photograph has one"),
        ({"drawn": [tree["drawn"][0] | {"condition": 7}]}, "condition 7 is none of"),
    ):
        (folder / "small-drawn.yaml").write_text(yaml.safe_dump(tree | change), encoding="utf-8")
        with pytest.raises(TaskError, match=words):
            load_real_task("small-drawn")


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        (
            NIGHT[0],
            {"X_res": 100_000, "Y_res": 100_000},
            "X_res = 100000 and Y_res = 100000 must be at most 16384 pixels",
        ),
        (NIGHT[0], {"X_res": 16_000, "Y_res": 16_000}, "100 million together"),
        (NIGHT[0], {"star_list": 5}, "star_list must be rows"),
        (NIGHT[0], {"star_list": [[10**400, 1, 2, 3]] * 20}, "star_list has a number beyond the range of floats"),
        ("FF_\ud800.fits", {}, r"FF_\\ud800\.fits': its name must be that of a file"),
        ("FF_\0.fits", {}, r"FF_\\x00\.fits': its name must be that of a file"),
    ],
)
def test_centroids_of_a_stranger_are_refused_in_a_line(name, change, words, tmp_path: Path) -> None:
    place = {"lat": PLACE.latitude_deg, "lon": PLACE.longitude_deg, "elev": PLACE.height_m}
    platepar = place | {"X_res": 320, "Y_res": 240, "auto_recalibrated": True}
    platepar |= {"star_list": [[2458864.3, 10.0 + n, 20.0, 100.0] for n in range(30)]} | change
    (tmp_path / "night").mkdir()
    path = tmp_path / "night" / "platepars_all_recalibrated.json"
    path.write_text(json.dumps({name: platepar}))
    with pytest.raises(PhotographError, match=words):
        draw_centroids(path, tmp_path / "drawn")
    camera = write_camera(tmp_path / "camera.json")
    command = [
        "import",
        "rms",
        str(path.parent),
        "--centroids",
        "--camera",
        str(camera),
        "--out",
        str(tmp_path / "set"),
    ]
    told = CliRunner().invoke(app, command)
    assert told.exit_code == 2, told.output
    assert str(path) in told.output


@pytest.mark.skipif(os.name != "posix", reason="needs pipes")
def test_pipes_are_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "platepars_all_recalibrated.json"
    os.mkfifo(pipe)
    camera = str(write_camera(tmp_path / "camera.json"))
    site = ["--site", "52", "4", "0"]
    for words in (
        ["rms", str(tmp_path), "--centroids", *site],
        ["photos", str(tmp_path), *site, "--camera", str(pipe)],
        ["photos", str(tmp_path), *site, "--camera", camera, "--attitude", str(pipe)],
        ["photos", str(tmp_path), *site, "--camera", camera, "--times", str(pipe)],
    ):
        write_fits(tmp_path / "one.fits")
        told = CliRunner().invoke(app, ["import", *words, "--out", str(tmp_path / "set")])
        assert told.exit_code == 2, told.output
        assert "is a pipe or a device" in told.output
