"""Frames of any lens as a pinhole shows them, there and back."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import Image
from unit.benchmark.fake_night import write_dataset

import celnav
from benchmark.frames.dataset import open_dataset
from benchmark.judge.answers import Response
from benchmark.protocol import Answer, CameraRecord
from benchmark.run.pinhole_frames import as_pinhole, is_centred_pinhole
from benchmark.solvers.detected_points import Points
from benchmark.stats.metrics import FIX

FISHEYE = CameraRecord("equisolid", 300, 300, 100.0, 100.0, 149.5, 149.5)
BENT = CameraRecord("brown_conrady", 320, 240, 280.0, 280.0, 155.0, 121.0, k=(-0.2, 0.03))


@pytest.fixture
def frame(tmp_path):
    return open_dataset(write_dataset(tmp_path / "night", (1,))).frames[0]


def with_lens(frame, lens):
    return dataclasses.replace(frame, observation=dataclasses.replace(frame.observation, camera=lens))


def camera(record):
    return celnav.Camera.from_dict(dataclasses.asdict(record))


def response(uv, matches):
    answer = Answer(True, "", 1.0, 2.0, matches=np.array(matches, dtype=np.int64))
    return Response(answer, FIX, uv, np.full(len(uv), np.nan), 1.0, 1.0, None)


@pytest.mark.parametrize("lens", [FISHEYE, BENT], ids=["fisheye", "distorted"])
def test_detections_go_there_and_matches_come_back(frame, lens):
    assert not is_centred_pinhole(lens)
    uv = np.array([[5.0, 5.0], [160.0, 100.0], [200.0, 170.0], [140.0, 150.0]])
    shown = as_pinhole(with_lens(frame, lens), Points(uv, np.array([4.0, 3.0, 2.0, 1.0])))
    pinhole = shown.frame.observation.camera
    assert is_centred_pinhole(pinhole)
    np.testing.assert_allclose(
        camera(pinhole).to_rays(shown.shared.uv), camera(lens).to_rays(uv[shown.rows]), atol=1e-9
    )
    assert shown.rows.tolist() == ([1, 2, 3] if lens is FISHEYE else [0, 1, 2, 3]), "a fisheye's corner is not shown"
    last = len(shown.rows) - 1
    back = shown.back(response(shown.shared.uv, [[last, 32349]]), Points(uv, None))
    assert back.answer.matches.tolist() == [[3, 32349]]
    np.testing.assert_array_equal(back.uv, uv)


@pytest.mark.parametrize("lens", [FISHEYE, BENT], ids=["fisheye", "distorted"])
def test_a_spot_lies_in_the_image_where_its_ray_goes_and_is_found_again_in_the_frame(frame, lens, tmp_path):
    spot = np.array([[170.0, 110.0]])
    v, u = np.mgrid[: lens.height, : lens.width]
    pixels = 1000.0 + 20000.0 * np.exp(-((u - spot[0, 0]) ** 2 + (v - spot[0, 1]) ** 2) / 8.0)
    image = tmp_path / "frame.png"
    Image.fromarray(pixels.astype(np.uint16)).save(image)
    shown = as_pinhole(dataclasses.replace(with_lens(frame, lens), image_path=image), None)
    shown.write_image(tmp_path / "pinhole.png")
    with Image.open(tmp_path / "pinhole.png") as picture:
        seen = np.asarray(picture).astype(float)
    pinhole = shown.frame.observation.camera
    assert seen.shape == (pinhole.height, pinhole.width)
    light = np.maximum(seen - 1100.0, 0.0)
    rows, columns = np.mgrid[: pinhole.height, : pinhole.width]
    centroid = np.array([[(light * columns).sum(), (light * rows).sum()]]) / light.sum()
    np.testing.assert_allclose(centroid, camera(pinhole).project(camera(lens).to_rays(spot)), atol=0.1)
    outside = np.array([[-1e5, 0.0]])
    back = shown.back(response(np.vstack((outside, centroid)) if lens is FISHEYE else centroid, [[0, 7]]), None)
    np.testing.assert_allclose(back.uv[-1:], spot, atol=0.1)


def test_an_ideal_pinhole_with_its_point_in_the_middle_is_left_alone(frame):
    ideal = CameraRecord("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
    assert is_centred_pinhole(ideal)
    for change in ({"cx_px": 320.0}, {"fy_px": 501.0}, {"p": (1e-3,)}, {"tilt_rad": (0.01, 0.0)}):
        assert not is_centred_pinhole(dataclasses.replace(ideal, **change))


@pytest.mark.parametrize("k", [(), (0.2,)], ids=["off its middle", "pincushion"])
def test_a_view_has_the_noise_of_its_image_and_no_dark_edge(frame, k, tmp_path):
    lens = CameraRecord("brown_conrady", 320, 240, 280.0, 280.0, 159.8, 119.3, k=k)
    image = tmp_path / "frame.png"
    pixels = np.random.default_rng(5).normal(1000.0, 20.0, (lens.height, lens.width))
    Image.fromarray(np.round(pixels).astype(np.uint16)).save(image)
    shown = as_pinhole(dataclasses.replace(with_lens(frame, lens), image_path=image), None)
    shown.write_image(tmp_path / "pinhole.png")
    with Image.open(tmp_path / "pinhole.png") as picture:
        seen = np.asarray(picture).astype(float)
    assert np.abs(seen - 1000.0).max() < 6.5 * 20.0, "a pixel of 0 is 50 standard deviations below"
    middle = seen[60:-60, 80:-80]  # shown with either lens
    # An interpolation between pixels cannot keep all of the noise: linear, at half a pixel, keeps a half.
    assert 0.75 * 20.0 < middle.std() < 1.05 * 20.0
    beyond = (
        np.isnan(shown.to_lens(np.array([[0.0, 0.0]]))).any() or (shown.to_lens(np.array([[0.0, 0.0]])) < -1.0).any()
    )
    assert beyond == bool(k)
    assert (seen[0, 0] == np.median(seen)) or not k
