"""celnav's inputs: any file, number, text or other value is taken, or refused with a CelnavError.

Warnings of Pillow on the way to a refusal are no errors here.
"""

import dataclasses
import json
import math
from contextlib import suppress

import numpy as np
import pytest
from fuzz.fuzzing import NUMBERS, ODD, corpus, damaged, fuzzed, grafted
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import celnav
from celnav.adjustment import CameraPriors
from celnav.camera import MODELS
from celnav.command.calibration_frames import read_rms_centroids
from celnav.command.camera_file import read_camera_file
from celnav.command.exif import read_tags
from celnav.identification.search_config import SearchConfig, Stage
from celnav.matching.ddr_dai import DaiConfig
from celnav.matching.patterns import PatternConfig
from celnav.reading.image_file import read_image
from celnav.sky.utc import parse_utc

CAMERAS = corpus("camera_file")
PICTURES = corpus("picture")
CENTROIDS = corpus("rms_centroids")
SHAPES = st.tuples(st.integers(0, 12), st.integers(0, 12)) | st.tuples(
    st.integers(1, 9), st.integers(1, 9), st.integers(1, 4)
)
CONFIGURATIONS = (
    celnav.SkybenchConfig, celnav.DdrConfig, celnav.DetectionConfig, celnav.FloodFillConfig, celnav.PositionConfig,
    celnav.TrackConfig, celnav.Weather, celnav.LastKnown, CameraPriors, DaiConfig, PatternConfig, SearchConfig, Stage,
)  # fmt: skip
CAMERA = celnav.Camera.pinhole(width=108, height=72, hfov_deg=120)
UTC = "2020-01-01T00:00:00Z"
TIMES = st.from_regex(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?", fullmatch=True)


def needed(kind: type) -> list[str]:
    """Fields without a default."""
    return [field.name for field in dataclasses.fields(kind) if field.default is field.default_factory]


pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:PIL")


@pytest.mark.parametrize("path", CAMERAS, ids=lambda path: path.stem)
def test_the_corpus_of_cameras(path) -> None:
    with suppress(celnav.CelnavError):
        read_camera_file(path)


@pytest.mark.parametrize("path", PICTURES, ids=lambda path: path.stem)
def test_the_corpus_of_pictures(path) -> None:
    with suppress(celnav.CelnavError):
        read_tags(path)
    with suppress(celnav.CelnavError):
        read_image(path)


@fuzzed(60)
@given(content=damaged([path.read_bytes() for path in CAMERAS]))
def test_any_bytes_of_a_camera_file(tmp_path_factory, content) -> None:
    path = tmp_path_factory.getbasetemp() / "camera.yaml"
    path.write_bytes(content)
    with suppress(celnav.CelnavError):
        read_camera_file(path, (160, 120))


@fuzzed(60)
@given(tree=grafted([json.loads(path.read_text()) for path in CAMERAS if path.name.startswith("whole-")], ODD))
def test_any_values_of_a_camera_file(tmp_path_factory, tree) -> None:
    path = tmp_path_factory.getbasetemp() / "camera.json"
    path.write_text(json.dumps(tree))
    with suppress(celnav.CelnavError):
        read_camera_file(path, (160, 120))
    with suppress(celnav.CelnavError):
        celnav.Camera.from_json(path)
    with suppress(celnav.CelnavError):
        celnav.Attitude.from_json(path)


@fuzzed(60)
@given(content=damaged([path.read_bytes() for path in PICTURES]))
def test_any_bytes_of_a_picture(tmp_path_factory, content) -> None:
    path = tmp_path_factory.getbasetemp() / "picture.png"
    path.write_bytes(content)
    with suppress(celnav.CelnavError):
        read_tags(path)
    with suppress(celnav.CelnavError):
        celnav.detect(read_image(path))


@fuzzed(60)
@given(content=damaged([path.read_bytes() for path in CENTROIDS]))
def test_any_bytes_of_rms_centroids(tmp_path_factory, content) -> None:
    path = tmp_path_factory.getbasetemp() / "centroids.json"
    path.write_bytes(content)
    with suppress(celnav.CelnavError):
        read_rms_centroids(path)


@fuzzed(200)
@given(text=TIMES | ODD)
def test_any_time(text) -> None:
    with suppress(celnav.CelnavError):
        assert math.isfinite(parse_utc(text).mjd)


@fuzzed(100)
@given(
    model=st.sampled_from(MODELS),
    size=st.tuples(st.integers(1, 200) | NUMBERS, st.integers(1, 200) | NUMBERS),
    numbers=st.lists(st.floats(1, 1000) | NUMBERS, min_size=4, max_size=4),
    k=st.lists(st.floats(-1, 1) | NUMBERS, max_size=7) | ODD,
    uv=st.lists(st.tuples(st.floats(-10, 210), st.floats(-10, 210)), max_size=4),
)
def test_any_camera(model, size, numbers, k, uv) -> None:
    with suppress(celnav.CelnavError):
        camera = celnav.Camera(model, *size, *numbers, k=k)
        rays = camera.to_rays(np.array(uv).reshape(-1, 2))
        assert rays.shape == (len(uv), 3)


@fuzzed(60)
@given(rows=st.lists(st.lists(st.floats(-1, 1) | NUMBERS, min_size=3, max_size=3), min_size=3, max_size=3) | ODD)
def test_any_attitude(rows) -> None:
    for kind in (celnav.Attitude.exact, celnav.Attitude.up):
        with suppress(celnav.CelnavError):
            kind(rows)


@fuzzed(25)
@given(
    uv=st.lists(st.tuples(st.floats(0, 107), st.floats(0, 71)), max_size=12) | ODD,
    flux=st.none() | st.lists(st.floats(0, 1e5), max_size=12) | ODD,
    air=st.tuples(st.floats(0, 1200) | ODD, st.floats(-100, 80) | ODD),
    dut1_s=st.none() | st.floats(-1, 1) | ODD,
    near=st.none() | ODD,
    solver=st.sampled_from(celnav.solvers()) | ODD,
)
def test_any_question(uv, flux, air, dut1_s, near, solver) -> None:
    attitude = celnav.Attitude.zenith_north_up()
    with suppress(celnav.CelnavError):
        fix = celnav.solve(
            uv, CAMERA, UTC, attitude, solver, flux=flux, pressure_hpa=air[0], temperature_c=air[1], dut1_s=dut1_s, near=near
        )  # fmt: skip
        assert fix.ok or fix.reason


@fuzzed(150)
@given(kind=st.sampled_from(CONFIGURATIONS), data=st.data())
def test_any_configuration(kind, data) -> None:
    names = [field.name for field in dataclasses.fields(kind)]
    given_values = data.draw(st.dictionaries(st.sampled_from(names), ODD, min_size=len(needed(kind)), max_size=4))
    given_values |= {name: data.draw(ODD) for name in needed(kind) if name not in given_values}
    with suppress(celnav.CelnavError):
        kind(**given_values)


@fuzzed(40)
@given(uv=st.lists(st.tuples(st.floats(0, 107), st.floats(0, 71)), max_size=3) | ODD, ids=st.just([32349, 30438]) | ODD)
def test_any_named_stars(uv, ids) -> None:
    with suppress(celnav.CelnavError):
        celnav.fix_position(uv, ids, CAMERA, UTC, celnav.Attitude.zenith_north_up())


@fuzzed(60)
@given(
    image=arrays(st.sampled_from([np.float64, np.uint16, np.float32, np.int64, np.complex128, np.bool_]), SHAPES) | ODD,
    mask=st.none() | arrays(np.bool_, SHAPES) | ODD,
)
def test_any_image(image, mask) -> None:
    with suppress(celnav.CelnavError):
        found = celnav.detect(image, mask)
        assert np.isfinite(found.uv).all()


@fuzzed(40)
@given(values=st.tuples(st.floats(-180, 180) | ODD, ODD | st.just(UTC)))
def test_any_step_of_a_track(values) -> None:
    fix = celnav.Fix(True, celnav.Reason.OK, 10.0, 20.0, np.eye(2))
    with suppress(celnav.CelnavError):
        celnav.Track().update(fix, values[1], values[0])
