"""Twins of a dataset of photographs: what is read from its records, what is refused, and the dataset of the twins."""

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from photograph_files import CAMERA, EXPOSURE_S, PLACE, standin, true_attitude, write_camera, write_fits
from small_scenes import small_scenario
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.errors import PhotographError
from benchmark.frames.dataset import open_dataset
from benchmark.importing.told import read_told
from benchmark.importing.write import Import, import_photographs
from benchmark.twin.scene import Scene, read_scene
from benchmark.twin.sources import check_names, sources_of
from benchmark.twin.truth import TruthFolder
from benchmark.twin.twin import Twin
from generator.frame.render import render_dataset, render_frame
from generator.frame.verify import problems

SCENE = {
    "name": "elsewhere",
    "site": {"latitude_deg": -30.0, "longitude_deg": 10.0, "height_m": 500.0},
    "time": {"utc_start": "2020-01-24T19:30:00Z", "exposure_s": 30.0},
    "camera": {
        "model": "equidistant",
        "width": 400,
        "height": 400,
        "hfov_deg": 180.0,
        "image_circle_px": 190.0,
        "aperture_mm": 3.0,
    },
    "sensor": {"bits": 16, "gain_e_per_dn": 0.5},
    "attitude": {"azimuth_deg": 90.0, "altitude_deg": 60.0},
    "sky": {"bortle": 4},
}


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of one photograph."""
    folder = tmp_path_factory.mktemp("imported")
    path = write_fits(folder / "Night_7.fits", standin().astype(np.float32) - 1000.0)
    told = read_told(write_camera(folder / "camera.json"))
    import_photographs(Import("night", [path], PLACE, told), folder / "set")
    return folder / "set"


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    """A scene with another camera at another place."""
    path = tmp_path / "elsewhere.yaml"
    path.write_text(yaml.safe_dump(SCENE), encoding="utf-8")
    return read_scene(path)


def changed(imported: Path, folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """A copy of the dataset with a changed record."""
    shutil.copytree(imported, folder / "changed")
    path = folder / "changed" / "frame-00000.json"
    record = json.loads(path.read_text(encoding="utf-8"))
    change(record)
    path.write_text(json.dumps(record), encoding="utf-8")
    return folder / "changed"


def test_place_time_camera_and_attitude_are_the_records(imported: Path, scene: Scene) -> None:
    (source,) = sources_of([imported])
    own, photograph = source.read(scene)
    assert photograph.name == "night_7"
    assert (photograph.latitude_deg, photograph.longitude_deg, photograph.height_m) == (52.0, 4.36, 10.0)
    assert (photograph.utc_start, photograph.exposure_s) == ("2020-01-15T20:00:00.000000Z", EXPOSURE_S)
    assert photograph.told is not None
    assert (photograph.pixels == standin().astype(np.float32) - 1000.0).all()
    assert photograph.alignment is not None
    assert photograph.alignment.stars >= 20
    turn = photograph.alignment.R_cam @ true_attitude().T
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 0.02
    assert own.camera == dataclasses.replace(CAMERA, p=own.camera.p)
    assert own.spec.R_cam == pytest.approx(photograph.alignment.R_cam, abs=1e-9)
    assert own.spec.site.latitude_deg == 52.0
    assert own.spec.camera.aperture_mm == 3.0
    assert own.spec.sensor.gain_e_per_dn == 0.5
    assert own.spec.camera.image_circle_px == pytest.approx(190.0 * CAMERA.f_px / scene.spec.camera.f_px)
    assert own.spec.atmosphere.pressure_hpa == pytest.approx(PLACE.air.pressure_hpa)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda record: record.pop("photograph"), "key photograph is missing"),
        (lambda record: record["photograph"].pop("scale"), "key photograph.scale is missing"),
        (lambda record: record["photograph"].pop("file"), "key photograph.file is missing"),
        (lambda record: record["site"].pop("height_m"), "key site.height_m is missing"),
        (lambda record: record["time"].pop("utc_start"), "key time.utc_start is missing"),
        (lambda record: record["time"].update(exposure_s=7200.0), "time.exposure_s must lie within"),
        (lambda record: record["sensor"].update(bayer_pattern="RGGB"), "sensor.bayer_pattern is RGGB"),
        (lambda record: record["camera"].update(k=[-9.0], model="brown_conrady"), "do not make a scene"),
    ],
)
def test_a_record_that_lacks_something_is_refused(
    imported: Path, scene: Scene, tmp_path: Path, change: Callable[[dict[str, Any]], object], words: str
) -> None:
    folder = changed(imported, tmp_path, change)
    with pytest.raises(PhotographError, match=words) as told:
        sources_of([folder])[0].read(scene)
    assert "frame-00000.json" in str(told.value)


def test_folders_without_photographs_are_refused(imported: Path, scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    render_dataset(small_scenario(), tmp_path / "rendered", exr=False)
    for folder, words in (("empty", "no frame-*.json in it"), ("rendered", "so the frame was rendered")):
        told = CliRunner().invoke(app, ["twin", str(tmp_path / folder), "--scene", str(scene.path)])
        assert told.exit_code == 2
        assert words in " ".join(told.stderr.split())
        assert "skybench import photos" in " ".join(told.stderr.split())
    (tmp_path / "copy").mkdir()
    shutil.copy(imported / "frame-00000.json", tmp_path / "copy")
    with pytest.raises(PhotographError, match=r"stars\.parquet: missing, .*import the photographs again"):
        sources_of([tmp_path / "copy"])
    with pytest.raises(PhotographError, match="would be named twin-night_7"):
        check_names(sources_of([imported, tmp_path / "Night_7.fits"]))


def twin_of(scene: Scene, imported: Path, **overrides: Any) -> Twin:
    """A photograph with a small frame as its twin, nothing of which is fitted."""
    _, photograph = sources_of([imported])[0].read(scene)
    frame = render_frame(small_scenario(**overrides), 0, channels=False)
    assert photograph.alignment is not None
    nothing: Any = None
    return Twin(photograph, scene.path, photograph.alignment, nothing, frame, nothing, nothing, nothing, 0.0, 0.0)


def test_twins_are_a_dataset_after_each_of_them(imported: Path, scene: Scene, tmp_path: Path) -> None:
    twins = [
        twin_of(scene, imported),
        twin_of(scene, imported, seed=8, attitude={"azimuth_deg": 9, "altitude_deg": 50}),
    ]
    folder = tmp_path / "frames"
    truth = TruthFolder(folder)
    identities = []
    for number, twin in enumerate(twins, 1):
        truth.add(twin)
        assert problems(folder) == []
        dataset = open_dataset(folder)
        assert [frame.frame_id for frame in dataset.frames] == [f"frame-{index:05d}" for index in range(number)]
        identities.append(dataset.scenario_sha256)
    assert len(set(identities)) == 2
    assert all(len(frame.truth.star_id) > 20 for frame in dataset.frames)
    # Solvers receive what they receive for the photograph.
    assert dataset.frames[0].observation.tilt_sigma_deg == 0.05
    rows = pq.read_table(folder / "stars.parquet").to_pandas()
    assert len(rows) == sum(twin.frame.stars.num_rows for twin in twins)
    record = json.loads((folder / "frame-00001.json").read_text(encoding="utf-8"))
    assert record["twin"]["photograph"] == "night_7"
    assert record["twin"]["scenario"]["seed"] == 8
    again = TruthFolder(folder)
    again.add(twins[0])
    assert problems(folder) == []
    assert len(open_dataset(folder).frames) == 1


def test_frames_that_are_no_twins_are_kept(imported: Path, tmp_path: Path) -> None:
    with pytest.raises(PhotographError, match="holds other files than twins"):
        TruthFolder(imported)
    TruthFolder(tmp_path / "new")
    (tmp_path / "note.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(PhotographError, match=r"note\.txt"):
        TruthFolder(tmp_path)
