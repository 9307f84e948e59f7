"""From a rendered frame to a position: the two forward models meet only in files."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from PIL import Image
from small_scenes import BASE

import celnav
from generator.frame.render import render_dataset
from generator.scenario.file import parse_scenario

PLACES = {
    "latitude_deg": [52.0, -0.18, -41.29, 69.6],
    "longitude_deg": [4.36, -78.47, 174.78, 18.9],
}
TIMES = ["2020-01-15T20:00:00Z", "2021-06-10T04:00:00Z", "2023-10-14T11:00:00Z", "2024-12-01T19:30:00Z"]
EARTH_KM = 6371.0


def frames(folder: Path, name: str) -> list[tuple[Path, tuple[float, float]]]:
    scenario = BASE | {
        "site": {key: {"sweep": values, "zip": "place"} for key, values in PLACES.items()},
        "time": {"utc_start": {"sweep": TIMES, "zip": "place"}, "exposure_s": 0.5},
        "camera": BASE["camera"] | {"width": 1080, "height": 720},
        "sensor": {"noise": False},
        "sky": {"bortle": {"sweep": [1, 3]} if name == "images" else 1},
        "stars": {"limiting_magnitude": 9.0 if name == "images" else 5.0},
    }
    render_dataset(parse_scenario(yaml.safe_dump(scenario), "chain.yaml"), folder)
    return sorted(folder.glob("frame-*.json"))


def error_km(fix: celnav.Fix, record: dict) -> float:
    site = record["site"]
    north = np.radians(fix.lat_deg - site["latitude_deg"])
    east = np.radians((fix.lon_deg - site["longitude_deg"] + 180) % 360 - 180) * np.cos(
        np.radians(site["latitude_deg"])
    )
    return float(np.hypot(north, east) * EARTH_KM)


@pytest.fixture(scope="module")
def image_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chain") / "images"
    frames(folder, "images")
    return folder


def test_truth_identities_give_the_site_within_50_m(tmp_path) -> None:
    """Noise-free truth positions of all stars brighter than 5.0 with their identities: under 50 m."""
    records = frames(tmp_path / "truth", "truth")
    stars = pq.read_table(tmp_path / "truth" / "stars.parquet").to_pandas()
    assert len(records) == 4
    for path in records:
        record = yaml.safe_load(path.read_text())
        rows = stars[
            (stars["index"] == record["index"]) & (stars["fraction_in_frame"] > 0.99) & (stars["kind"] == "star")
        ]
        assert len(rows) > 100
        fix = celnav.fix_position(
            rows[["u_px", "v_px"]].to_numpy(),
            rows["star_id"].to_numpy(),
            celnav.Camera.from_json(path),
            record["time"]["utc_mid"],
            np.array(record["attitude"]["R_cam"]),
        )
        assert fix.ok
        assert error_km(fix, record) < 0.05


def test_thesis_adaptive_finds_the_site_from_noise_free_dark_skies(image_folder) -> None:
    """Images of Bortle 1 and 3, no noise: every fix within 10 km, and the identities true."""
    stars = pq.read_table(image_folder / "stars.parquet").to_pandas()
    for path in sorted(image_folder.glob("frame-*.json")):
        record = yaml.safe_load(path.read_text())
        with Image.open(path.with_suffix(".png")) as image:
            detections = celnav.detect(np.array(image))
        fix = celnav.solve(
            detections,
            celnav.Camera.from_json(path),
            utc=record["time"]["utc_mid"],
            attitude=np.array(record["attitude"]["R_cam"]),
            solver="thesis-adaptive",
        )
        assert fix.ok, fix.message
        assert error_km(fix, record) < 10
        truth = stars[stars["index"] == record["index"]].set_index("star_id")[["u_px", "v_px"]]
        known = [(detection, star) for detection, star in fix.matches if star in truth.index]
        distance = [np.hypot(*(detections.uv[detection] - truth.loc[star])) for detection, star in known]
        assert len(known) >= 0.9 * len(fix.matches)
        assert np.mean(np.array(distance) < 2) > 0.95


@pytest.mark.journey
@pytest.mark.parametrize("vertical_alone", [False, True])
def test_wrong_attitude_is_no_fix(image_folder, vertical_alone) -> None:
    """Pictures of the zenith, declared as views of the northern horizon: stars would stand in the ground."""
    level_north = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    attitude = celnav.Attitude.up(level_north[:, 2]) if vertical_alone else celnav.Attitude.exact(level_north)
    paths = sorted(image_folder.glob("frame-*.json"))
    assert len(paths) == 8
    for path in paths:
        record = yaml.safe_load(path.read_text())
        with Image.open(path.with_suffix(".png")) as image:
            detections = celnav.detect(np.array(image))
        fix = celnav.solve(detections, celnav.Camera.from_json(path), record["time"]["utc_mid"], attitude)
        assert not fix.ok
        assert fix.reason in {"no_hypothesis", "effort_spent", "inconsistent"}
        if vertical_alone:
            assert "below the horizon" in fix.message
