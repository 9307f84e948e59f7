"""Datasets of photographs: what is read, what becomes the truth, what nobody knows, and what is refused."""

import dataclasses
import hashlib
import json
import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from photograph_files import (
    CAMERA,
    EXPOSURE_S,
    MOUNT,
    NOISE_DN,
    PLACE,
    R_MOUNT,
    SKY_DN,
    UTC_MID,
    WANDER_DEG,
    standin,
    true_attitude,
    write_camera,
    write_ff,
    write_fits,
    write_jpeg,
)
from PIL import Image
from scipy.spatial.transform import Rotation

import celnav
from benchmark.errors import PhotographError
from benchmark.frames.dataset import open_dataset
from benchmark.importing import photographs
from benchmark.importing.known_sky import known_sky
from benchmark.importing.photographs import (
    Clock,
    check_names,
    check_tagged_times,
    file_sha256,
    photographs_in,
    read_photograph,
    read_times,
)
from benchmark.importing.photometry import measure_light
from benchmark.importing.rms import calibrate_night, read_night
from benchmark.importing.star_truth import find_pointing
from benchmark.importing.told import read_told, told_by
from benchmark.importing.write import Import, import_photographs
from benchmark.judge.frame_bounds import bound_of
from benchmark.judge.geodesy import geodesic_km
from benchmark.judge.star_id import score_matches
from benchmark.place import Place
from celnav.sky.utc import parse_utc
from generator.errors import GeneratorError
from generator.frame.record import STAR_SCHEMA
from generator.frame.verify import problems
from generator.reading.stars import PHOTOGRAPHS, UNKNOWN_OF_PHOTOGRAPHS, photograph_schema, read_stars

OSLO = Clock(time_zone="Europe/Oslo")
TOLD = told_by(CAMERA, celnav.Attitude.with_sigma(R_MOUNT, tilt_deg=0.05, heading_deg=0.05))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    write_fits(folder / "a.fits")
    given = Import("night", photographs_in(folder), PLACE, TOLD)
    import_photographs(given, folder / "out")
    return folder / "out"


def angle_deg(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(Rotation.from_matrix(one @ other.T).magnitude()))


def test_the_attitude_is_that_of_the_stars_and_solvers_are_told_the_mounts(dataset: Path) -> None:
    record = json.loads((dataset / "frame-00000.json").read_text())
    # 0.08 px at the frame's edge: centroids in apertures of some tens of stars.
    assert angle_deg(np.array(record["attitude"]["R_cam"]), true_attitude()) < 0.01
    assert record["photograph"]["turned_deg"] == pytest.approx(WANDER_DEG, abs=0.01)
    (frame,) = open_dataset(dataset).frames
    assert np.allclose(frame.observation.R_cam, R_MOUNT)
    assert (frame.observation.tilt_sigma_deg, frame.observation.heading_sigma_deg) == (0.05, 0.05)
    assert frame.observation.utc == "2020-01-15T20:00:05.000000Z"


def test_stars_are_named_where_they_are_and_measured(dataset: Path) -> None:
    stars = pq.read_table(dataset / "stars.parquet").to_pandas()
    sky = known_sky(PLACE, UTC_MID, EXPOSURE_S)
    true_uv = dict(zip(sky.stars.star_id.tolist(), CAMERA.project(sky.middle.enu @ true_attitude().T), strict=True))
    uv = np.array([true_uv[star] for star in stars["star_id"]])
    assert np.abs(stars[["u_px", "v_px"]].to_numpy() - uv).max() < 0.1
    bright = stars[(stars["v_mag"] < 4) & stars["snr"].notna()]
    assert len(bright) >= 15
    assert np.abs(bright[["light_u_px", "light_v_px"]] - bright[["u_px", "v_px"]].to_numpy()).to_numpy().max() < 0.2
    # A matched filter of the peak P and the width s has the ratio P s sqrt(pi) / noise; faint stars around raise the noise.
    expected = 2e4 * 10 ** (-0.4 * bright["v_mag"]) * 0.9 * math.sqrt(math.pi) / NOISE_DN
    assert float((bright["snr"] / expected).median()) == pytest.approx(0.9, abs=0.1)


def test_noise_alone_has_the_ratios_of_noise() -> None:
    image = np.random.default_rng(7).normal(SKY_DN, NOISE_DN, (600, 600))
    v, u = np.mgrid[20:580:20, 20:580:20]
    snr = measure_light(image, np.column_stack((u.ravel(), v.ravel())).astype(float)).snr
    # 784 independent ratios: their scatter is 1 within 0.13 but for chances of 1e-6.
    assert np.std(snr) == pytest.approx(1.0, abs=0.13)
    assert abs(np.mean(snr)) < 0.2


def test_what_nobody_knows_is_empty_and_what_reads_it_copes(dataset: Path) -> None:
    assert problems(dataset) == []
    table = pq.read_table(dataset / "stars.parquet")
    assert {name for name in table.column_names if table[name].null_count == len(table)} == {
        "electrons_e", "occluded", "hidden_fraction", "cloud_optical_depth", "cloud_transmission", "scintillation",
    }  # fmt: skip
    record = json.loads((dataset / "frame-00000.json").read_text())
    assert record["sky"]["bortle"] is None
    assert record["optics"]["psf_sigma_px"] is None
    (frame,) = open_dataset(dataset).frames
    assert frame.conditions.cloud_optical_depth is None
    assert frame.conditions.bortle is None
    assert bound_of(frame) is None
    assert np.isfinite(frame.truth.brightness).all()
    assert np.isfinite(frame.truth.detected_uv).all()


def test_another_astrometry_finds_the_place(dataset: Path) -> None:
    (frame,) = open_dataset(dataset).frames
    image = np.asarray(Image.open(frame.image_path)).astype(np.uint16)
    seen = frame.observation
    fix = celnav.solve(
        celnav.detect(image), CAMERA, utc=seen.utc, attitude=celnav.Attitude.exact(true_attitude()),
        pressure_hpa=seen.pressure_hpa, temperature_c=seen.temperature_c,
    )  # fmt: skip
    assert fix.ok
    assert geodesic_km(fix.lat_deg, fix.lon_deg, PLACE.latitude_deg, PLACE.longitude_deg) < 1.0


def test_a_dataset_that_is_there_is_left_and_another_is_not_replaced_unasked(dataset: Path, tmp_path: Path) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in dataset.iterdir()}
    given = Import("night", [dataset.parent / "a.fits"], PLACE, TOLD)
    assert import_photographs(given, dataset) == []
    assert {path.name: path.stat().st_mtime_ns for path in dataset.iterdir()} == before
    other = dataclasses.replace(given, place=Place(51.0, 4.0, 0.0))
    with pytest.raises(PhotographError, match="--overwrite"):
        import_photographs(other, dataset)
    (tmp_path / "letter.txt").write_text("mine")
    with pytest.raises(PhotographError, match="other files"):
        import_photographs(given, tmp_path)


def test_files_of_others_are_never_deleted(dataset: Path, tmp_path: Path) -> None:
    """Frames of a film are often named as those of a dataset are."""
    mine = write_fits(tmp_path / "frame-0001.fits")
    with pytest.raises(PhotographError, match="the photographs themselves"):
        import_photographs(Import("night", [mine], PLACE, TOLD), tmp_path)
    assert mine.exists()
    given = Import("night", [dataset.parent / "a.fits"], PLACE, TOLD)
    for name in ("frame-0001.fits", "frame-00001.png", "frame-00000.json", "stars.parquet"):
        folder = tmp_path / f"of-{name}"
        folder.mkdir()
        (folder / name).write_text("{}")
        with pytest.raises(PhotographError, match="other files"):
            import_photographs(given, folder, overwrite=True)
        assert (folder / name).read_text() == "{}"


def test_an_interrupted_import_is_made_again(dataset: Path, tmp_path: Path) -> None:
    given = Import("night", [dataset.parent / "a.fits"], PLACE, TOLD)
    import_photographs(given, tmp_path)
    (tmp_path / "frames-manifest.json").unlink()
    assert len(import_photographs(dataclasses.replace(given, name="other"), tmp_path)) == 1


def test_a_damaged_dataset_is_made_again(dataset: Path, tmp_path: Path) -> None:
    given = Import("night", [dataset.parent / "a.fits"], PLACE, TOLD)
    import_photographs(given, tmp_path)
    whole = (tmp_path / "frame-00000.png").read_bytes()
    (tmp_path / "frame-00000.png").write_bytes(whole[:-1])
    assert len(import_photographs(given, tmp_path)) == 1
    assert (tmp_path / "frame-00000.png").read_bytes() == whole


def test_stars_of_the_wrong_place_are_not_named() -> None:
    away = known_sky(Place(20.0, 100.0, 0.0), UTC_MID, EXPOSURE_S)
    found = find_pointing(standin(), TOLD, away)
    assert (found.stars, found.turned_deg) == (0, None)
    assert np.array_equal(found.R_cam, R_MOUNT)
    rough = told_by(CAMERA, celnav.Attitude.with_sigma(R_MOUNT, tilt_deg=3.0, heading_deg=3.0))
    assert not find_pointing(standin(), rough, away).named


def test_an_unknown_heading_is_told_as_unknown(tmp_path: Path) -> None:
    path = write_fits(tmp_path / "a.fits")
    upright = told_by(CAMERA, celnav.Attitude.up([0.0, 0.0, 1.0], tilt_deg=0.1))
    import_photographs(Import("night", [path], PLACE, upright), tmp_path / "out")
    (frame,) = open_dataset(tmp_path / "out").frames
    assert math.isinf(frame.observation.heading_sigma_deg)
    assert np.allclose(frame.observation.R_cam[:, 2], [0, 0, 1])
    assert len(frame.truth.star_id) == 0
    judged = score_matches(np.array([[5.0, 5.0]]), np.array([[0, 7]]), frame.truth)
    assert (judged.n_matches, judged.n_correct, judged.n_detected_stars) == (0, 0, 0)
    assert problems(tmp_path / "out") == []


def test_rendered_stars_may_have_no_empty_cells(tmp_path: Path) -> None:
    assert set(STAR_SCHEMA.names) >= UNKNOWN_OF_PHOTOGRAPHS
    loose = photograph_schema(STAR_SCHEMA)
    row = {field.name: [None if field.nullable else {"string": "x"}.get(str(field.type), 1)] for field in loose}
    table = pa.Table.from_arrays([pa.array(row[field.name], field.type) for field in loose], schema=loose)
    pq.write_table(table, tmp_path / "photographs.parquet")
    assert read_stars(tmp_path / "photographs.parquet", STAR_SCHEMA).num_rows == 1
    bare = {key: value for key, value in loose.metadata.items() if key not in PHOTOGRAPHS}
    pq.write_table(table.replace_schema_metadata(bare), tmp_path / "rendered.parquet")
    with pytest.raises(GeneratorError, match="has 1 empty cells"):
        read_stars(tmp_path / "rendered.parquet", STAR_SCHEMA)


def test_times_of_clocks_need_a_zone(tmp_path: Path) -> None:
    path = write_jpeg(tmp_path / "a.jpg", "2020:01:15 21:00:00")
    with pytest.raises(PhotographError, match="--time-zone"):
        read_photograph(path, Clock())
    # Oslo is an hour ahead of UTC in January; the tag marks the start, and the exposure takes 10 s.
    assert read_photograph(path, OSLO).utc_mid == "2020-01-15T20:00:05Z"
    zoned = write_jpeg(tmp_path / "b.jpg", "2020:01:15 21:00:00", "+01:00")
    assert read_photograph(zoned, Clock()).utc_mid == "2020-01-15T20:00:05Z"
    assert read_photograph(zoned, Clock(stamp="end")).utc_mid == "2020-01-15T19:59:55Z"


def test_times_and_exposures_that_are_missing_have_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(PhotographError, match=r"a.jpg: has no tag DateTimeOriginal.*--times"):
        read_photograph(write_jpeg(tmp_path / "a.jpg", None), Clock())
    bare = write_jpeg(tmp_path / "b.jpg", "2020:01:15 21:00:00", "+01:00", None)
    with pytest.raises(PhotographError, match=r"b.jpg: has no tag ExposureTime; give --exposure-s"):
        read_photograph(bare, Clock())
    assert read_photograph(bare, Clock(exposure_s=4.0)).utc_mid == "2020-01-15T20:00:02Z"
    with pytest.raises(PhotographError, match=r"c.fits.*DATE-OBS"):
        read_photograph(write_fits(tmp_path / "c.fits", DATE_OBS=""), Clock())


def test_a_file_without_a_time_is_found_before_any_is_imported(tmp_path: Path) -> None:
    timed = write_jpeg(tmp_path / "a.jpg", "2020:01:15 21:00:00", "+01:00")
    files = [timed, write_fits(tmp_path / "b.fits", DATE_OBS=""), write_jpeg(tmp_path / "z.jpg", None)]
    seen: list[object] = []
    with pytest.raises(PhotographError, match=r"z.jpg: has no tag DateTimeOriginal.*--times"):
        import_photographs(Import("night", files, PLACE, TOLD), tmp_path / "out", progress=seen.append)
    assert (seen, sorted((tmp_path / "out").glob("*"))) == ([], [])
    # The header of a FITS file is read with its pixels: it is refused in its turn.
    check_tagged_times(files[:2], Clock())


def test_a_table_of_times_comes_before_tags(tmp_path: Path) -> None:
    table = tmp_path / "times.csv"
    table.write_text("file,utc_mid,exposure_s\na.jpg,2021-02-03T04:05:06Z,2.5\n", encoding="utf-8")
    clock = Clock(table=read_times(table))
    read = read_photograph(write_jpeg(tmp_path / "a.jpg", None), clock)
    assert (read.utc_mid, read.exposure_s) == ("2021-02-03T04:05:06Z", 2.5)
    table.write_text("file,utc_mid,exposure_s\na.jpg,yesterday,2.5\n", encoding="utf-8")
    with pytest.raises(PhotographError, match="line 2"):
        read_times(table)


def test_a_table_is_of_these_photographs(tmp_path: Path) -> None:
    table, files = tmp_path / "times.csv", [tmp_path / "a.jpg", tmp_path / "b.jpg"]
    rows = "{0},2021-02-03T04:05:06Z,2.5\n"
    # Spreadsheets begin their files with a byte order mark.
    table.write_text("\ufefffile,utc_mid,exposure_s\n" + rows.format("a.jpg"), encoding="utf-8")
    check_names(read_times(table), files, table)
    for name, words in (("B.JPG", "the photograph is b.jpg"), ("c.jpg", "none of the photographs, such as a.jpg")):
        table.write_text("file,utc_mid,exposure_s\n" + rows.format(name), encoding="utf-8")
        with pytest.raises(PhotographError, match=words):
            check_names(read_times(table), files, table)
    table.write_text("file,utc_mid,exposure_s\n" + 2 * rows.format("a.jpg"), encoding="utf-8")
    with pytest.raises(PhotographError, match=r"line 3: a\.jpg is listed twice"):
        read_times(table)


def test_packed_tiles_are_photographs_and_hidden_files_are_not(tmp_path: Path) -> None:
    for name in ("a.fits.fz", "b.FITS.GZ", "._b.fits.gz", "._c.jpg", "notes.gz"):
        (tmp_path / name).touch()
    assert [path.name for path in photographs_in(tmp_path)] == ["a.fits.fz", "b.FITS.GZ"]


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    with pytest.raises(PhotographError, match="no photograph"):
        photographs_in(tmp_path)
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(PhotographError, match=r"a\.png"):
        read_photograph(tmp_path / "a.png", Clock())
    small = write_fits(tmp_path / "small.fits", np.zeros((3, 4), np.uint16))
    with pytest.raises(PhotographError, match="4 x 3 px, the camera 480 x 360"):
        import_photographs(Import("x", [small], PLACE, TOLD), tmp_path / "out")


def test_a_camera_without_attitude_has_a_remedy(tmp_path: Path) -> None:
    path = write_camera(tmp_path / "camera.json", attitude=False)
    with pytest.raises(PhotographError, match="--attitude"):
        read_told(path)
    assert read_told(path, "zenith-north-up").R_cam.tolist() == np.array(MOUNT.rows).tolist()
    with pytest.raises(PhotographError, match="vertical"):
        read_told(path, "unknown")


def test_the_attitude_told_is_that_for_the_time_of_the_photograph(tmp_path: Path) -> None:
    turned = Rotation.from_euler("x", 0.03, degrees=True).as_matrix() @ R_MOUNT
    camera = write_camera(tmp_path / "camera.json")
    record = json.loads(camera.read_text())
    record["attitude"] |= {"tilt_sigma_deg": 0.05, "heading_sigma_deg": 0.05}
    frame = {"R_cam": turned.tolist(), "tilt_sigma_deg": 0.001, "heading_sigma_deg": 0.001}
    record["calibration"] = {"frames": [frame | {"utc_mjd": parse_utc(UTC_MID).mjd - 10 / 1440}]}
    camera.write_text(json.dumps(record))
    told = read_told(camera)
    assert angle_deg(told.R_cam, R_MOUNT) < 1e-6
    soon, later = told.at(UTC_MID), told.at("2030-01-01T00:00:00Z")
    assert angle_deg(soon.R_cam, turned) < 1e-6
    assert 0.001 < soon.tilt_sigma_deg < 0.012
    assert (angle_deg(later.R_cam, R_MOUNT) < 1e-6, later.tilt_sigma_deg) == (True, 0.05)
    assert told.for_another_night().at(UTC_MID).tilt_sigma_deg == 0.05
    import_photographs(Import("night", [write_fits(tmp_path / "a.fits")], PLACE, told), tmp_path / "out")
    (observed,) = open_dataset(tmp_path / "out").frames
    assert observed.observation.tilt_sigma_deg == pytest.approx(soon.tilt_sigma_deg)
    assert angle_deg(observed.observation.R_cam, turned) < 1e-6


NIGHT = "FF_XX0001_20200115_195954_880_0000000.fits"  # 256 frames at 25 a second: its middle is at 20:00:00
CONFIG = "[System]\nstationID: XX0001\nlatitude: 52.0 ; north\nlongitude: 4.36\nelevation: 10\n"


def test_a_night_of_a_meteor_station_is_a_dataset(tmp_path: Path) -> None:
    mean = np.clip(standin("2020-01-15T20:00:00Z") // 4, 0, 255).astype(np.uint8)
    write_ff(tmp_path, NIGHT, mean)
    (tmp_path / ".config").write_text(CONFIG, encoding="utf-8")
    night = read_night(tmp_path)
    assert (night.station, night.place) == ("XX0001", PLACE)
    (made,) = import_photographs(Import("m", night.files, night.place, TOLD), tmp_path / "out")
    assert made.utc_mid == "2020-01-15T20:00:00.000000Z"
    assert made.stars >= 20
    record = json.loads((tmp_path / "out" / "frame-00000.json").read_text())
    assert record["time"]["exposure_s"] == 10.24
    assert record["sensor"]["bits"] == 8


@pytest.mark.skipif(os.name != "posix", reason="needs links to devices, and pipes")
@pytest.mark.parametrize("make", [lambda path: path.symlink_to("/dev/zero"), os.mkfifo], ids=["device", "pipe"])
def test_no_device_and_no_pipe_is_read(tmp_path: Path, make: Callable[[Path], None]) -> None:
    make(tmp_path / NIGHT)
    with pytest.raises(PhotographError, match="no FF file"):
        read_night(tmp_path)
    with pytest.raises(PhotographError, match=r"cannot be read \(not a regular file"):
        file_sha256(tmp_path / NIGHT)


def test_a_file_larger_than_a_photograph_is_not_hashed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(photographs, "LARGEST_FILE_BYTES", 3)
    for content, fits in ((b"abc", True), (b"abcd", False)):
        (tmp_path / "a.fits").write_bytes(content)
        if fits:
            assert file_sha256(tmp_path / "a.fits") == hashlib.sha256(content).hexdigest()
        else:
            with pytest.raises(PhotographError, match="larger than 3 bytes"):
                file_sha256(tmp_path / "a.fits")


def test_a_night_without_place_or_camera_has_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(PhotographError, match="no FF file"):
        read_night(tmp_path)
    write_ff(tmp_path, NIGHT, np.zeros((4, 4), np.uint8))
    with pytest.raises(PhotographError, match="--site"):
        read_night(tmp_path)
    (tmp_path / ".config").write_text("[System]\nlatitude: north\n", encoding="utf-8")
    with pytest.raises(PhotographError, match="latitude"):
        read_night(tmp_path)
    with pytest.raises(PhotographError, match="--camera"):
        calibrate_night(tmp_path, PLACE)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        (".config", "[System]\nlatitude: 91\nlongitude: 0\nelevation: 0\n", "latitude_deg 91.0 is not within"),
        ("platepars_all_recalibrated.json", "{}", "its first platepar must have the numbers lat, lon and elev"),
        ("platepars_all_recalibrated.json", '{"a": 1}', "its first platepar"),
        ("platepars_all_recalibrated.json", '{"a": {"lat": 1, "lon": 999, "elev": 0}}', "longitude_deg 999.0"),
        ("platepars_all_recalibrated.json", "[" * 1000, "nested"),
    ],
)
def test_a_station_whose_place_is_wrong_is_named_by_its_file(
    tmp_path: Path, name: str, content: str, words: str
) -> None:
    write_ff(tmp_path, NIGHT, np.zeros((4, 4), np.uint8))
    (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(PhotographError, match="give --site") as raised:
        read_night(tmp_path)
    text = str(raised.value)
    assert text.startswith(f"{tmp_path / name}: ")
    assert text.count(str(tmp_path)) == 1
    assert words in text
