import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image
from unit.benchmark.fake_night import HEIGHT, WIDTH, write_dataset

from benchmark.errors import DatasetError
from benchmark.frames.dataset import load_image, open_dataset
from benchmark.frames.sites import own_site
from benchmark.judge.frame_bounds import bound_of


@pytest.fixture
def folder(tmp_path):
    return write_dataset(tmp_path / "night")


def edit(path, change):
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def test_reads_frames_truth_and_pixels(folder):
    dataset = open_dataset(folder)
    assert (dataset.name, dataset.scenario_name, len(dataset.frames)) == ("night", "fake night", 3)
    frame = dataset.frames[1]
    assert (frame.frame_id, frame.index, frame.conditions.bortle) == ("frame-00001", 1, 2)
    assert frame.truth.uv.shape == (12, 2)
    image = load_image(frame)
    assert (image.shape, image.dtype) == ((HEIGHT, WIDTH), np.uint16)
    # The pixel nearest a star is among the brightest: rows are v, columns u.
    u, v = np.round(frame.truth.uv[frame.truth.electrons_e.argmax()]).astype(int)
    assert image[v, u] > np.percentile(image, 99)


def test_an_observation_holds_no_truth(folder):
    observation = open_dataset(folder).frames[0].observation
    assert set(vars(observation)) == {
        "camera", "utc", "R_cam", "tilt_sigma_deg", "heading_sigma_deg", "pressure_hpa", "temperature_c",
        "utc_sigma_s", "focal_sigma", "principal_point_sigma_px", "distortion_sigma", "pressure_sigma_hpa",
        "temperature_sigma_c", "sequence",
    }  # fmt: skip
    assert observation.sequence is None
    lens = {"f_px", "fy_px", "cx_px", "cy_px", "k", "p", "s", "tilt_rad"}
    assert set(vars(observation.camera)) == {"model", "width", "height"} | lens


def test_the_air_is_what_the_frame_was_rendered_with(folder):
    path = folder / "frame-00000.json"
    record = json.loads(path.read_text(encoding="utf-8"))
    record["atmosphere"] = {"pressure_hpa": 720.0, "temperature_c": -3.0, "refraction": True}
    path.write_text(json.dumps(record), encoding="utf-8")
    observation = open_dataset(folder).frames[0].observation
    assert (observation.pressure_hpa, observation.temperature_c) == (720.0, -3.0)
    record["atmosphere"]["refraction"] = False
    path.write_text(json.dumps(record), encoding="utf-8")
    assert open_dataset(folder).frames[0].observation.pressure_hpa == 0.0


def test_a_frame_without_stars_is_a_frame(folder):
    table = pq.read_table(folder / "stars.parquet")
    pq.write_table(table.filter(pa.compute.not_equal(table["index"], 2)), folder / "stars.parquet")
    edit(folder / "frame-00002.json", lambda record: record["stars"].update(n_in_field=0))
    assert len(open_dataset(folder).frames[2].truth.star_id) == 0


def put(section, key, value):
    return lambda record: record[section].__setitem__(key, value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda record: record.pop("camera"), "key camera is missing"),
        (lambda record: record.__setitem__("format", "skybench-frame/9"), "skybench-frame/9"),
        (lambda record: record.__setitem__("frame_id", "frame-00007"), "frame-00007"),
        (put("site", "latitude_deg", 91.0), "within -90 to 90"),
        (put("site", "latitude_deg", "48"), "finite number"),
        (put("site", "latitude_deg", float("nan")), "NaN is no number"),
        (put("time", "utc_mid", "2020-01-01T00:00:00"), "trailing Z"),
        (put("time", "utc_mid", "2015-02-30T00:00:00Z"), "time.utc_mid: there is no 2015-02-30"),
        (put("time", "utc_mid", "2015-02-20T12:00:60Z"), "time.utc_mid: there is no 2015-02-20T12:00:60Z"),
        (put("time", "utc_mid", "0001-01-01T00:00:00Z"), "time.utc_mid: there is no 0001-01-01"),
        (put("attitude", "R_cam", [[1, 0], [0, 1]]), "3 rows"),
        (put("attitude", "R_cam", [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]), "rotation"),
        (put("attitude", "R_cam", [[1, 0, 0], [0, 1]]), "3 rows"),
        (put("atmosphere", "pressure_hpa", 2000.0), "within 0 to 1200"),
        (put("atmosphere", "refraction", 1), "true or false"),
        (put("camera", "width", 0), "at least 1"),
        (put("camera", "k", "none"), "list of finite"),
        (put("sky", "bortle", 2.5), "integer"),
        (put("stars", "n_in_field", 11), "12 rows"),
        (put("scenario", "sha256", "cd" * 32), "different scenarios"),
        (lambda record: record.__setitem__("index", 0), "same index"),
    ],
)
def test_a_bad_record_is_refused_by_name(folder, change, message):
    edit(folder / "frame-00001.json", change)
    with pytest.raises(DatasetError, match=message) as caught:
        open_dataset(folder)
    assert str(folder) in str(caught.value)


def test_a_leap_second_is_a_time(folder):
    edit(folder / "frame-00001.json", put("time", "utc_mid", "2016-12-31T23:59:60.5Z"))
    frame = open_dataset(folder).frames[1]
    assert own_site(frame).endswith("2016-12-31")
    bound_of(frame)


def test_an_unfinished_run_is_refused(folder):
    (folder / "stars.parquet").unlink()
    with pytest.raises(DatasetError, match=r"stars\.parquet: missing.*not finished.*render"):
        open_dataset(folder)


def test_a_folder_that_is_no_dataset_is_refused(tmp_path):
    with pytest.raises(DatasetError, match="no such folder"):
        open_dataset(tmp_path / "nowhere")
    with pytest.raises(DatasetError, match="no frame-"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("text", ["{", "[1]", "\ud800".encode("utf-16", "surrogatepass")])
def test_a_record_that_is_no_json_object_is_refused(folder, text):
    path = folder / "frame-00002.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(DatasetError, match=r"frame-00002\.json: .*JSON"):
        open_dataset(folder)


def test_damaged_truth_is_refused(folder):
    path = folder / "stars.parquet"
    table = pq.read_table(path)
    pq.write_table(table.drop_columns(["u_px"]), path)
    with pytest.raises(DatasetError, match="column u_px"):
        open_dataset(folder)
    path.write_bytes(b"PAR1 nonsense")
    with pytest.raises(DatasetError, match="not a readable Parquet"):
        open_dataset(folder)


def test_truth_of_a_missing_frame_is_refused(folder):
    (folder / "frame-00001.json").unlink()
    with pytest.raises(DatasetError, match="frame-00001, which has no frame record"):
        open_dataset(folder)


def test_bad_images_are_refused(folder):
    frame = open_dataset(folder).frames[0]
    whole = frame.image_path.read_bytes()
    frame.image_path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DatasetError, match=r"frame-00000\.png: truncated"):
        load_image(frame)
    frame.image_path.write_bytes(b"GIF89a")
    with pytest.raises(DatasetError, match="not a PNG"):
        load_image(frame)
    Image.new("RGB", (WIDTH, HEIGHT)).save(frame.image_path)
    with pytest.raises(DatasetError, match="16 bits"):
        load_image(frame)
    Image.fromarray(np.zeros((HEIGHT, WIDTH + 1), dtype=np.uint16)).save(frame.image_path)
    with pytest.raises(DatasetError, match=r"161 x 120 pixels, its camera.*160 x 120"):
        load_image(frame)
    frame.image_path.unlink()
    with pytest.raises(DatasetError, match="missing image"):
        load_image(frame)
