"""`skybench export`: plain files, COCO, FITS with a world coordinate system, and a copy that gives nothing away."""

import hashlib
import io
import json
import shutil
import tarfile
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import typer
import yaml
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.utils.exceptions import AstropyWarning
from astropy.wcs import WCS
from PIL import Image
from scipy.interpolate import RegularGridInterpolator
from small_scenes import small_scenario, small_scenario_text
from typer.testing import CliRunner, Result

from benchmark.cli.datasets.exporting import FORMS, add_to
from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.dataset.reader import Dataset, Frame
from generator.dataset.verify import problems
from generator.errors import GeneratorError
from generator.export.annotations import CATEGORIES, annotate, clipped
from generator.export.export import EXPORTS, export
from generator.export.fits_image import fits_file
from generator.export.form import ExportOptions
from generator.export.full_pixels import FullPixels
from generator.frame.manifest import FRAMES_MANIFEST
from generator.frame.record import frame_record, record_bytes
from generator.frame.render import png_bytes, render_frame
from generator.scenario.file import parse_scenario


@pytest.fixture
def dataset(small_set) -> Path:
    return small_set


def test_plain_files(dataset, tmp_path) -> None:
    export(dataset, "files", tmp_path / "out")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"frame-00000.png", "frame-00000.json", "frame-00001.png", "frame-00001.json", "frames.parquet",
                     "stars.parquet", "objects.parquet"}  # fmt: skip
    assert len(pd.read_parquet(tmp_path / "out/stars.parquet")) == Dataset.open(dataset).stars().num_rows


def test_a_disk_that_is_full_is_named_whoever_writes(dataset, tmp_path, monkeypatch) -> None:
    """astropy raises an OSError of words alone, without the system's number and name of the error."""

    def full(*arguments, **options):
        raise OSError("No space left on device: requested 100, available 0")

    monkeypatch.setattr(fits.HDUList, "writeto", full)
    with pytest.raises(GeneratorError, match=r"writing failed \(No space left on device.*\); choose another folder"):
        export(dataset, "fits", tmp_path / "out")


def test_plain_files_of_jpeg_xl_are_png_and_the_table_names_them(small_set, tmp_path) -> None:
    text = (small_set / "scenario.yaml").read_text()
    generate(parse_scenario(text, "set.yaml"), text, tmp_path / "jxl", DatasetSpec(shard_size=2, codec="jxl"))
    export(tmp_path / "jxl", "files", tmp_path / "out")
    frames = pd.read_parquet(tmp_path / "out/frames.parquet")
    assert frames["image"].tolist() == ["frame-00000.png", "frame-00001.png"]
    for name, digest, frame in zip(frames["image"], frames["image_sha256"], Dataset.open(small_set), strict=True):
        written = (tmp_path / "out" / name).read_bytes()
        assert hashlib.sha256(written).hexdigest() == digest
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(written))), frame.image)
    assert not [*(tmp_path / "out").glob("*.jxl")]


@pytest.fixture(scope="module")
def coco(small_set, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("coco") / "out"
    export(small_set, "coco", out)
    return out


def test_coco_annotates_what_can_be_seen_in_every_category(dataset, coco) -> None:
    content = json.loads((coco / "annotations.json").read_text())
    assert [image["file_name"] for image in content["images"]] == ["frame-00000.png", "frame-00001.png"]
    names = {category["id"]: category["name"] for category in content["categories"]}
    assert list(names.items()) == list(enumerate(CATEGORIES, start=1))
    found = pd.DataFrame(content["annotations"])
    assert {names[number] for number in found["category_id"]} >= set(CATEGORIES) - {"planet"}
    assert found["id"].is_unique
    assert found["snr"].min() >= 5
    opened = Dataset.open(dataset)
    stars, objects = opened.stars().to_pandas(), opened.objects().to_pandas()
    seen = stars[(stars["snr"] >= 5) & (stars["fraction_in_frame"] >= 0.5)]
    assert sorted(found["star_id"].dropna()) == sorted(seen["star_id"])
    assert len(found) == len(seen) + (objects["snr"] >= 5).sum() < len(stars)
    assert opened.frames()["n_visible"].to_pylist() == seen.groupby("index").size().tolist()


def test_coco_boxes_hold_the_light(dataset, coco) -> None:
    """Each box holds its keypoint, lies in the image, and is brighter than what lies around it where the SNR is high."""
    content = json.loads((coco / "annotations.json").read_text())
    image = Dataset.open(dataset)[0].image.astype(float)
    brighter = []
    for each in content["annotations"]:
        left, top, width, height = each["bbox"]
        assert min(left, top, 240 - left - width, 160 - top - height) >= -1e-3
        u, v, flag = each["keypoints"]
        if flag:
            assert left <= u <= left + width
            assert top <= v <= top + height
        assert 0 < each["area"] <= width * height + 1e-3
        if each["image_id"] == 0 and each["snr"] >= 20:
            right, bottom = int(np.ceil(left + width)), int(np.ceil(top + height))
            inside = image[int(top) : bottom, int(left) : right]
            around = image[max(int(top) - 6, 0) : bottom + 6, max(int(left) - 6, 0) : right + 6]
            noise = 1.48 * np.median(np.abs(around - np.median(around)))
            # Around the Moon all pixels are full.
            brighter.append(inside.max() > np.median(around) + 3 * noise or inside.max() > 0.9 * image.max())
    assert np.mean(brighter) > 0.9


def test_a_sky_that_fills_the_sensor_hides_its_sources(tmp_path) -> None:
    """Half a minute of twilight fills every pixel, half a second of the night hardly one."""
    counts = []
    for name, utc_start, exposure_s in (("full", "2020-01-15T16:50:00Z", 30.0), ("dark", "2020-01-15T20:00:00Z", 0.5)):
        text = small_scenario_text(time={"utc_start": utc_start, "exposure_s": exposure_s})
        generate(parse_scenario(text, "test.yaml"), text, tmp_path / name, DatasetSpec())
        frame = Dataset.open(tmp_path / name)[0]
        reach = frame.stars.to_pandas().query("snr >= 5 and fraction_in_frame >= 0.5")
        counts.append((len(reach), len(annotate(frame, 5.0))))
    (reach_full, annotated_full), (reach_dark, annotated_dark) = counts
    assert reach_full > 20, "the matched filter does not know that the sensor is full"
    assert annotated_full == 0
    assert annotated_dark == reach_dark > 0


def pixels_of(image, bits=12, full_well_e=1e6, black=64):
    sensor = {
        "bits": bits,
        "gain_e_per_dn": 4.0,
        "black_level_dn": black,
        "full_well_e": full_well_e,
        "read_noise_e": 3.0,
    }
    return FullPixels(SimpleNamespace(image=image, record={"sensor": sensor}))


def test_full_pixels_around_a_source_hide_it_unless_it_may_have_filled_them() -> None:
    image = np.full((100, 120), 200, np.uint16)
    image[:, 60:] = 4095
    box = np.array([[20.0, 40, 26, 46], [90.0, 40, 96, 46], [57.0, 40, 63, 46]])
    pixels = pixels_of(image)
    assert pixels.behind(box, np.full(3, 1e4)).tolist() == [False, True, False]
    assert pixels.behind(box, np.full(3, 1e9)).tolist() == [False, False, False]
    assert pixels.touched(box).tolist() == [False, True, True]
    # A bright star fills its own pixels, not those around it.
    image = np.full((100, 120), 200, np.uint16)
    image[40:46, 20:26] = 4095
    assert not pixels_of(image).behind(box[:1], np.array([1e5])).any()
    everywhere = pixels_of(np.full((100, 120), 4095, np.uint16))
    assert everywhere.behind(box, np.array([1e4, 1e9, np.nan])).all()


def test_a_full_well_below_the_largest_value_is_full() -> None:
    box = np.array([[20.0, 40, 26, 46]])
    full = 64 + 8000 / 4
    for level, hidden in ((full - 1, True), (full - 60, False)):
        image = np.full((100, 120), level, np.uint16)
        assert pixels_of(image, full_well_e=8000.0).behind(box, np.array([1e4])).tolist() == [hidden]


def test_coco_says_what_is_saturated(dataset, coco) -> None:
    found = pd.DataFrame(json.loads((coco / "annotations.json").read_text())["annotations"])
    stars = Dataset.open(dataset).stars().to_pandas()
    merged = found.dropna(subset=["star_id"]).merge(
        stars, left_on=["image_id", "star_id"], right_on=["index", "star_id"], suffixes=("", "_truth")
    )
    assert len(merged) == found["star_id"].notna().sum() > 0
    assert (merged["saturated"] == merged["saturated_truth"]).all()
    assert found[found["category_id"] == 1 + CATEGORIES.index("moon")]["saturated"].all()


def test_coco_follows_the_least_snr(dataset, tmp_path) -> None:
    for least, out in ((0.0, "all"), (30.0, "bright")):
        export(dataset, "coco", tmp_path / out, ExportOptions(least_snr=least))
    counts = [
        len(json.loads((tmp_path / out / "annotations.json").read_text())["annotations"]) for out in ("all", "bright")
    ]
    assert counts[0] > 3 * counts[1] > 0


def test_yolo_has_the_same_boxes(dataset, coco, tmp_path) -> None:
    export(dataset, "yolo", tmp_path / "out")
    described = yaml.safe_load((tmp_path / "out/data.yaml").read_text())
    assert list(described["names"].values()) == list(CATEGORIES)
    content = json.loads((coco / "annotations.json").read_text())
    for index in (0, 1):
        lines = (tmp_path / f"out/labels/train/frame-{index:05d}.txt").read_text().splitlines()
        rows = np.array([[float(word) for word in line.split()] for line in lines])
        wanted = [each for each in content["annotations"] if each["image_id"] == index]
        assert (rows[:, 0] + 1).tolist() == [each["category_id"] for each in wanted]
        boxes = np.array([each["bbox"] for each in wanted])
        np.testing.assert_allclose(rows[:, 3:] * (240, 160), boxes[:, 2:], atol=2e-3)
        np.testing.assert_allclose(rows[:, 1:3] * (240, 160), boxes[:, :2] + boxes[:, 2:] / 2, atol=2e-3)
    with Image.open(tmp_path / "out/images/train/frame-00000.png") as image:
        assert (image.mode, image.size) == ("L", (240, 160))
        shown = np.array(image).astype(float)
    order = np.argsort(Dataset.open(dataset)[0].image.ravel(), kind="stable")
    assert (np.diff(shown.ravel()[order]) >= 0).all()


def test_polygons_are_cut_at_the_image() -> None:
    square = np.array([[-2.0, 1.0], [3.0, 1.0], [3.0, 4.0], [-2.0, 4.0]])
    assert sorted(map(tuple, clipped(square, 10, 3).tolist())) == [(0, 1), (0, 3), (3, 1), (3, 3)]
    assert clipped(square - 20, 10, 3).size == 0


def test_fits_world_coordinates_lead_back_to_the_stars(dataset, tmp_path) -> None:
    """Astropy's own reading of the header puts the truth's stars within 0.1 px of their places, both ways."""
    export(dataset, "fits", tmp_path / "out")
    frame = Dataset.open(dataset)[0]
    with fits.open(tmp_path / "out/frame-00000.fits") as file:
        header = file[0].header
        np.testing.assert_array_equal(file[0].data, frame.image)
        assert len(file) == 1
    assert header["WCSFIT"] == "SIP"
    assert header["WCSALT"] == 0
    assert distance_px(header, frame.record, frame.stars.to_pandas()) < 0.1


def distance_px(header: fits.Header, record: dict, stars: pd.DataFrame) -> float:
    """Largest distance of a system from the truth's stars, px, either way."""
    rows = stars[(stars["kind"] == "star") & (stars["fraction_in_frame"] > 0.9)]
    rows = rows[rows["altitude_deg"] > header["WCSALT"]]
    assert len(rows) > 30
    place = rows[["u_px", "v_px"]].to_numpy()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AstropyWarning)
        system = WCS(header)
    truth = SkyCoord(rows["ra_deg"].to_numpy(), rows["dec_deg"].to_numpy(), unit="deg")
    there = np.stack(system.world_to_pixel(truth), axis=1) - place
    back = np.stack(system.world_to_pixel(system.pixel_to_world(*place.T)), axis=1) - place
    apart = system.pixel_to_world(*place.T).separation(truth).radian * record["camera"]["f_px"]
    assert header["WCSRES"] < 0.1
    return max(np.hypot(*there.T).max(), np.hypot(*back.T).max(), apart.max())


STARS_OF_A_LENS = {
    "brown_conrady": {"width": 540, "height": 360, "f_px": 450, "k": [-0.2, 0.05], "p": [1e-3, -5e-4]},
    "equisolid": {"width": 300, "height": 300, "f_px": 150},
    "kannala_brandt": {
        "width": 540,
        "height": 360,
        "f_px": 300,
        "k": [-0.02],
        "p": [1e-3, -5e-4],
        "s": [2e-3, 0, -1e-3, 0],
        "tilt_rad": [0.01, -0.02],
    },
}


@pytest.mark.parametrize("model", STARS_OF_A_LENS)
def test_systems_of_lenses_with_distortion(model) -> None:
    """A lens with distortion that looks down to the horizon, and a fisheye; nothing is rendered but the truth."""
    frame = frame_of(model, {"azimuth_deg": 200, "altitude_deg": 50, "roll_deg": 20})
    header = fits_file(frame)[0].header
    code = {"brown_conrady": "TAN", "equisolid": "ZEA", "kannala_brandt": "ARC"}[model]
    assert header["CTYPE1"] == f"RA---{code}-SIP"
    assert distance_px(header, frame.record, frame.stars.to_pandas()) < 0.1


def test_a_table_has_the_directions_down_to_the_horizon() -> None:
    """A fisheye that sees the horizon: its system begins above it, the table goes on."""
    frame = frame_of("equisolid", {"azimuth_deg": 200, "altitude_deg": 50, "roll_deg": 20})
    image, table = fits_file(frame)
    assert image.header["WCSALT"] > 0
    shape = (table.header["NDOWN"], table.header["NACROSS"])
    lattice = {name: table.data[name].astype(float).reshape(shape) for name in table.columns.names}
    ra, dec = np.radians(lattice["ra_deg"]), np.radians(lattice["dec_deg"])
    vectors = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)
    follow = RegularGridInterpolator((lattice["v_px"][:, 0], lattice["u_px"][0]), vectors)
    stars = frame.stars.to_pandas()
    stars = stars[(stars["kind"] == "star") & (stars["fraction_in_frame"] > 0.9)]
    found = follow(stars[["v_px", "u_px"]].to_numpy())
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    ra, dec = np.radians(stars["ra_deg"].to_numpy()), np.radians(stars["dec_deg"].to_numpy())
    truth = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)
    known = np.isfinite(found).all(axis=1)
    assert known.mean() > 0.95
    assert stars["altitude_deg"][known].min() < image.header["WCSALT"]
    assert np.linalg.norm(found - truth, axis=1)[known].max() * frame.record["camera"]["f_px"] < 0.1


def frame_of(model: str, attitude: dict[str, float]) -> Frame:
    """A rendered frame of a lens as a dataset has it."""
    overrides = {f"camera__{key}": value for key, value in STARS_OF_A_LENS[model].items()}
    scenario = small_scenario(
        **overrides, camera__model=model, camera__hfov_deg=None, attitude=attitude, sky__bortle=None,
        stars={"limiting_magnitude": 5.5},
    )  # fmt: skip
    rendered = render_frame(scenario, 0)
    record = record_bytes(frame_record(rendered.plan, rendered.expected, rendered.stars))
    members = {"png": png_bytes(rendered.dn), "json": record}
    tables = {"stars": rendered.stars, "objects": rendered.objects}
    return Frame("frame-00000", members, Path("made"), lambda table, index: tables[table])


def test_the_command_knows_every_form() -> None:
    assert set(FORMS) == set(EXPORTS)


def command(*words: str) -> Result:
    app = typer.Typer()
    add_to(app)
    return CliRunner().invoke(app, list(words))


def test_the_command_says_what_a_folder_of_rendered_frames_is(tmp_path) -> None:
    (tmp_path / FRAMES_MANIFEST).write_text("{}")
    done = command(str(tmp_path), "--to", "coco", "--out", str(tmp_path / "out"))
    assert done.exit_code != 0
    assert "holds frames of `skybench render`; a dataset is what `skybench generate` writes" in done.output


@pytest.mark.parametrize("form", sorted(set(EXPORTS) - {"coco", "yolo"}))
def test_a_least_snr_is_refused_where_nothing_is_annotated(dataset, tmp_path, form) -> None:
    done = command(str(dataset), "--to", form, "--out", str(tmp_path / "out"), "--least-snr", "20")
    assert done.exit_code != 0
    assert f"--least-snr: only with --to coco or yolo; {form} has no annotations" in done.output
    assert not (tmp_path / "out").exists()


def test_the_command_takes_a_least_snr(dataset, tmp_path) -> None:
    counts = []
    for out, options in (("all", ()), ("bright", ("--least-snr", "30"))):
        assert command(str(dataset), "--to", "coco", "--out", str(tmp_path / out), *options).exit_code == 0
        counts.append(len(json.loads((tmp_path / out / "annotations.json").read_text())["annotations"]))
    assert counts[0] > counts[1] > 0


def test_refusals(dataset, tmp_path) -> None:
    with pytest.raises(GeneratorError, match="one of files, coco, yolo, fits, huggingface"):
        export(dataset, "mp4", tmp_path / "out")
    (tmp_path / "full").mkdir()
    (tmp_path / "full/a").write_text("")
    with pytest.raises(GeneratorError, match="not empty"):
        export(dataset, "files", tmp_path / "full")
    with pytest.raises(GeneratorError, match=r"manifest\.json: missing"):
        export(tmp_path, "files", tmp_path / "out")
    with pytest.raises(GeneratorError, match="nowhere: no such folder"):
        export(tmp_path / "nowhere", "files", tmp_path / "out")
    (tmp_path / FRAMES_MANIFEST).write_text("{}")
    with pytest.raises(GeneratorError, match="holds frames of `skybench render`"):
        export(tmp_path, "files", tmp_path / "out")


def with_another_name(dataset: Path, folder: Path, name: str) -> Path:
    """A copy of a dataset whose first frame's members are called `name` in the archive, its lists in line with it."""
    shutil.copytree(dataset, folder)
    path = folder / "data/train/shard-000000.tar"
    with tarfile.open(path) as archive:
        stored = [(member.name, archive.extractfile(member).read()) for member in archive]
    with tarfile.open(path, "w") as archive:
        for old, data in stored:
            member = tarfile.TarInfo(old.replace("frame-00000", name))
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    for listing in ("manifest.json", "receipts/train/shard-000000.json"):
        content = json.loads((folder / listing).read_text())
        for entry in content["files"]:
            if entry["path"] == "data/train/shard-000000.tar":
                entry["bytes"], entry["sha256"] = path.stat().st_size, hashlib.sha256(path.read_bytes()).hexdigest()
        (folder / listing).write_text(json.dumps(content))
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
