"""`skybench show --video`: frames in order as they were developed, the truth on request, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import av
import numpy as np
import pytest
import yaml
from PIL import Image
from small_scenes import BASE
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.report.show.source import open_source
from benchmark.report.show.truth_overlay import STAR_COLOUR, draw_truth, truth_lines
from benchmark.report.show.video import video_picture, write_video
from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.errors import GeneratorError
from generator.frame.render import render_dataset
from generator.scenario.file import parse_scenario
from generator.scenario.model import Pointing, pointing_matrix

TREE = BASE | {
    "time": BASE["time"] | {"every_s": 60, "count": 3},
    "camera": {"width": 161, "height": 121, "hfov_deg": 60, "aperture_mm": 4},
    "stars": {"limiting_magnitude": 5.0},
    "sky": {},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("video") / "frames"
    tree = TREE | {"sensor": {"develop": {"exposure": "auto"}}}
    render_dataset(parse_scenario(yaml.safe_dump(tree), "s.yaml"), place, exr=False)
    return place


def frames_of(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def test_video_holds_the_developed_pictures_in_order(folder, tmp_path) -> None:
    result = CliRunner().invoke(app, ["show", str(folder), "--video", str(tmp_path / "v.mp4"), "--fps", "2", "--json"])
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert (report["frames"], report["seconds"]) == (3, 1.5)
    frames = frames_of(tmp_path / "v.mp4")
    assert [frame.shape for frame in frames] == [(122, 162, 3)] * 3  # made even
    for index in range(3):
        wanted = np.asarray(Image.open(folder / f"frame-{index:05d}-developed.png"), dtype=float)
        errors = [np.abs(other[:121, :161].mean(axis=2) - wanted).mean() for other in frames]
        assert int(np.argmin(errors)) == index
        assert errors[index] < 4
    assert sorted(path.name for path in tmp_path.iterdir()) == ["v.mp4"]


def test_truth_is_drawn_around_the_stars(folder, tmp_path) -> None:
    source = open_source(folder)
    stars = source.stars(1)
    picture = np.zeros((121, 161, 3), np.uint8)
    drawn = draw_truth(picture, source.record(1), stars)
    brightest = stars[stars["fraction_in_frame"] > 0.5].nsmallest(1, "v_mag").iloc[0]
    v, u = np.nonzero((drawn == STAR_COLOUR).all(axis=2))
    distance = np.hypot(u - brightest["centroid_u_px"], v - brightest["centroid_v_px"])
    assert distance.min() > 5
    assert np.count_nonzero(distance < 8) > 20
    assert write_video(folder, tmp_path / "v.mp4", 10, truth=True) == 3
    encoded = frames_of(tmp_path / "v.mp4")[1].astype(int)
    # Red over blue where amber circles were drawn; half as many colours as pixels are stored.
    assert (encoded[v, u, 0] - encoded[v, u, 2]).mean() > 40


def test_truth_says_where_when_and_whither() -> None:
    R_cam = pointing_matrix(Pointing(azimuth_deg=12.0, altitude_deg=65.0, roll_deg=-3.0)).tolist()
    record = {
        "site": {"latitude_deg": -33.5, "longitude_deg": 290.25, "height_m": 120.4},
        "time": {"utc_mid": "2020-01-15T20:00:00.123456Z"},
        "attitude": {"R_cam": R_cam},
    }
    assert truth_lines(record) == (
        "2020-01-15T20:00:00.123Z",
        "33.50000° S  69.75000° W  120 m",
        "azimuth 12.00°  altitude 65.00°  roll -3.00°",
    )
    assert truth_lines(record | {"sequence": {"velocity_enu_m_s": [3.0, 4.0, -0.5]}})[3] == (
        "5.0 m/s  course 36.9°  climb -0.5 m/s"
    )


def test_frames_of_a_dataset_that_are_not_developed_are_developed_for_the_video(folder, tmp_path) -> None:
    text = yaml.safe_dump(TREE)
    generate(parse_scenario(text, "s.yaml"), text, tmp_path / "set", DatasetSpec(shard_size=2), frames=(0, 3))
    stored, raw = open_source(folder), open_source(tmp_path / "set")
    for position in range(3):
        pictures = [
            video_picture(source, position, place, False)
            for source, place in ((stored, folder), (raw, tmp_path / "set"))
        ]
        np.testing.assert_array_equal(*pictures)
    assert write_video(tmp_path / "set", tmp_path / "b.mp4", 5) == 3
    assert np.abs(pictures[-1].astype(float) - frames_of(tmp_path / "b.mp4")[-1]).mean() < 4


def test_refusals_leave_nothing_behind(folder, tmp_path) -> None:
    for arguments, message in (
        (["--video", str(tmp_path / "v.avi")], "must end in .mp4"),
        (["--video", str(tmp_path / "v.mp4"), "--fps", "0"], "from 0.1 to 120"),
        (["--truth"], "only with --video"),
    ):
        result = CliRunner().invoke(app, ["show", str(folder), *arguments])
        assert result.exit_code == 2
        assert message in result.stderr
    with pytest.raises(GeneratorError, match="no finished dataset"):
        write_video(tmp_path, tmp_path / "v.mp4", 5)
    assert not list(tmp_path.iterdir())


def test_frames_of_different_sizes_make_no_video(tmp_path) -> None:
    tree = TREE | {"time": BASE["time"], "camera": TREE["camera"] | {"width": {"sweep": [64, 80]}, "height": 48}}
    render_dataset(parse_scenario(yaml.safe_dump(tree), "s.yaml"), tmp_path / "frames", exr=False)
    with pytest.raises(GeneratorError, match="frame-00001 has another size"):
        write_video(tmp_path / "frames", tmp_path / "v.mp4", 5)
    assert [path.name for path in tmp_path.iterdir()] == ["frames"]
