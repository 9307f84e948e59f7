"""celnav's inputs: any file, number or text is taken, or refused with a CelnavError.

docs/reliability.md lists what is left out: integers beyond the range of floating-point numbers, and arguments of another type
than the signatures say. Warnings of NumPy and Pillow on the way to a refusal are no errors here.
"""

import json
import math
from contextlib import suppress

import numpy as np
import pytest
from fuzz.fuzzing import WITHIN_DOUBLES, corpus, damaged, fuzzed, grafted, values
from hypothesis import given
from hypothesis import strategies as st

import celnav
from celnav.camera import MODELS
from celnav.command.camera_file import read_camera_file
from celnav.command.exif import read_tags
from celnav.images import read_image
from celnav.sky.utc import parse_utc

CAMERAS = corpus("camera_file")
PICTURES = corpus("picture")
CAMERA = celnav.Camera.pinhole(width=108, height=72, hfov_deg=120)
UTC = "2020-01-01T00:00:00Z"
VALUES = values(WITHIN_DOUBLES)
TIMES = st.from_regex(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?", fullmatch=True)

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::UserWarning")


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
@given(tree=grafted([json.loads(path.read_text()) for path in CAMERAS if path.name.startswith("whole-")], VALUES))
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


@fuzzed(200)
@given(text=TIMES | VALUES)
def test_any_time(text) -> None:
    with suppress(celnav.CelnavError):
        assert math.isfinite(parse_utc(text).mjd)


@fuzzed(100)
@given(
    model=st.sampled_from(MODELS),
    size=st.tuples(st.integers(1, 200) | WITHIN_DOUBLES, st.integers(1, 200) | WITHIN_DOUBLES),
    numbers=st.lists(st.floats(1, 1000) | WITHIN_DOUBLES, min_size=4, max_size=4),
    k=st.lists(st.floats(-1, 1) | WITHIN_DOUBLES, max_size=7) | VALUES,
    uv=st.lists(st.tuples(st.floats(-10, 210), st.floats(-10, 210)), max_size=4),
)
def test_any_camera(model, size, numbers, k, uv) -> None:
    with suppress(celnav.CelnavError):
        camera = celnav.Camera(model, *size, *numbers, k=k)
        rays = camera.to_rays(np.array(uv).reshape(-1, 2))
        assert rays.shape == (len(uv), 3)


@fuzzed(60)
@given(
    rows=st.lists(st.lists(st.floats(-1, 1) | WITHIN_DOUBLES, min_size=3, max_size=3), min_size=3, max_size=3) | VALUES
)
def test_any_attitude(rows) -> None:
    for kind in (celnav.Attitude.exact, celnav.Attitude.up):
        with suppress(celnav.CelnavError):
            kind(rows)


@fuzzed(25)
@given(
    uv=st.lists(st.tuples(st.floats(0, 107), st.floats(0, 71)), max_size=12) | VALUES,
    flux=st.none() | st.lists(st.floats(0, 1e5), max_size=12) | VALUES,
    air=st.tuples(st.floats(0, 1200) | st.floats(), st.floats(-100, 80) | st.floats()),
    dut1_s=st.none() | st.floats(-1, 1) | st.floats(),
    solver=st.sampled_from(celnav.solvers()),
)
def test_any_question(uv, flux, air, dut1_s, solver) -> None:
    attitude = celnav.Attitude.zenith_north_up()
    with suppress(celnav.CelnavError):
        fix = celnav.solve(
            uv, CAMERA, UTC, attitude, solver, flux=flux, pressure_hpa=air[0], temperature_c=air[1], dut1_s=dut1_s
        )
        assert fix.ok or fix.reason
