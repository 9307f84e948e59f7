"""`skybench export`: plain files, COCO, FITS with a world coordinate system, and a copy that gives nothing away."""

import hashlib
import io
import json
import shutil
import tarfile
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.utils.exceptions import AstropyWarning
from astropy.wcs import WCS
from PIL import Image
from small_scenes import BASE

from generator.dataset.export import EXPORTS, export, withheld_name
from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.dataset.reader import Dataset
from generator.dataset.verify import problems
from generator.errors import GeneratorError
from generator.scenario.file import parse_scenario


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    tree = BASE | {
        "camera": BASE["camera"] | {"width": 240, "height": 160, "hfov_deg": 60},
        "sky": {"bortle": {"sweep": [3, 7]}},
        "stars": {"limiting_magnitude": 6.5},
    }
    text = yaml.safe_dump(tree)
    folder = tmp_path_factory.mktemp("export") / "set"
    generate(parse_scenario(text, "set.yaml"), text, folder, DatasetSpec())
    return folder


def test_plain_files(dataset, tmp_path) -> None:
    export(dataset, "files", tmp_path / "out")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"frame-00000.png", "frame-00000.json", "frame-00001.png", "frame-00001.json", "frames.parquet",
                     "stars.parquet", "objects.parquet"}  # fmt: skip
    assert len(pd.read_parquet(tmp_path / "out/stars.parquet")) == Dataset.open(dataset).stars().num_rows


def test_coco_keypoints(dataset, tmp_path) -> None:
    export(dataset, "coco", tmp_path / "out")
    content = json.loads((tmp_path / "out/annotations.json").read_text())
    assert [image["file_name"] for image in content["images"]] == ["frame-00000.png", "frame-00001.png"]
    stars = Dataset.open(dataset).stars().to_pandas()
    first = stars[(stars["index"] == 0) & (stars["fraction_in_frame"] > 0.5)].iloc[0]
    annotation = content["annotations"][0]
    assert annotation["star_id"] == first["star_id"]
    assert annotation["keypoints"] == pytest.approx([first["u_px"] + 0.5, first["v_px"] + 0.5, 2])
    assert len({annotation["id"] for annotation in content["annotations"]}) == len(content["annotations"])


def test_fits_world_coordinates_lead_back_to_the_stars(dataset, tmp_path) -> None:
    """Astropy's own reading of the header puts the truth stars within 0.3 px of their true places."""
    export(dataset, "fits", tmp_path / "out")
    stars = Dataset.open(dataset).stars().to_pandas()
    rows = stars[(stars["index"] == 0) & (stars["fraction_in_frame"] > 0.99)]
    with fits.open(tmp_path / "out/frame-00000.fits") as file, Image.open(export_png(dataset, tmp_path)) as image:
        header = file[0].header
        np.testing.assert_array_equal(file[0].data, np.array(image))
    assert header["WCSFIT"] < 0.1
    assert header["CTYPE1"] == "RA---TAN-SIP"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AstropyWarning)
        found = WCS(header).pixel_to_world(rows["u_px"].to_numpy(), rows["v_px"].to_numpy())
    truth = SkyCoord(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy(), unit="deg")
    focal_px = 120 / np.tan(np.radians(30))
    assert found.separation(truth).radian.max() * focal_px < 0.3


def export_png(dataset: Path, tmp_path: Path) -> Path:
    export(dataset, "files", tmp_path / "png")
    return tmp_path / "png" / "frame-00000.png"


def test_withheld_copy_tells_nothing_of_the_truth(dataset, tmp_path) -> None:
    export(dataset, "withheld", tmp_path / "out")
    opened = Dataset.open(dataset)
    frames = opened.frames().to_pylist()
    names = [withheld_name(opened.manifest.scenario_sha256, row["index"]) for row in frames]
    assert [entry["frame_id"] for entry in json.loads((tmp_path / "out/frames.json").read_text())] == sorted(names)
    text = "".join(path.read_text() for path in (tmp_path / "out").glob("*.json"))
    secrets = [
        "site",
        '"sky"',
        "stars",
        "scenario",
        "seed",
        "frame-0",
        opened.manifest.scenario_sha256,
        "latitude",
        "bortle",
    ]
    assert [secret for secret in secrets if secret in text] == []
    public = json.loads((tmp_path / f"out/{names[0]}.json").read_text())
    assert public["camera"]["f_px"] == pytest.approx(frames[0]["f_px"])
    assert public["time"]["utc_mid"] == frames[0]["utc_mid"]


def test_refusals(dataset, tmp_path) -> None:
    with pytest.raises(GeneratorError, match="one of files, coco, fits, withheld"):
        export(dataset, "mp4", tmp_path / "out")
    (tmp_path / "full").mkdir()
    (tmp_path / "full/a").write_text("")
    with pytest.raises(GeneratorError, match="not empty"):
        export(dataset, "files", tmp_path / "full")
    with pytest.raises(GeneratorError, match=r"manifest\.json: missing"):
        export(tmp_path, "files", tmp_path / "out")


def with_another_name(dataset: Path, folder: Path, name: str) -> Path:
    """A copy of a dataset whose first frame's members are called `name` in the archive, its manifest brought in line."""
    shutil.copytree(dataset, folder)
    path = folder / "data/train/shard-000000.tar"
    with tarfile.open(path) as archive:
        stored = [(member.name, archive.extractfile(member).read()) for member in archive]
    with tarfile.open(path, "w") as archive:
        for old, data in stored:
            member = tarfile.TarInfo(old.replace("frame-00000", name))
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    manifest = json.loads((folder / "manifest.json").read_text())
    for entry in manifest["files"]:
        if entry["path"] == "data/train/shard-000000.tar":
            entry["bytes"], entry["sha256"] = path.stat().st_size, hashlib.sha256(path.read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


@pytest.mark.parametrize("kind", EXPORTS)
@pytest.mark.parametrize("way_out", ["absolute", "upwards"])
def test_no_member_s_name_leads_out_of_the_folder(dataset, tmp_path, kind, way_out) -> None:
    """A stranger's dataset, whole by its own manifest, writes nothing outside of --out, and `verify` names it."""
    name = str(tmp_path / "victim") if way_out == "absolute" else "../victim"
    hostile = with_another_name(dataset, tmp_path / "set", name)
    before = {path for path in tmp_path.rglob("*") if not path.is_relative_to(tmp_path / "out")}
    with pytest.raises(
        GeneratorError, match=r"shard-000000\.tar: its member .*victim.* is not named like a frame's file"
    ):
        export(hostile, kind, tmp_path / "out")
    assert {path for path in tmp_path.rglob("*") if not path.is_relative_to(tmp_path / "out")} == before
    (problem,) = problems(hostile)
    assert "is not named like a frame's file" in problem
