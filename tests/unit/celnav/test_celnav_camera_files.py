"""Camera files against OpenCV itself, which writes them and projects with them."""

import json

import cv2
import numpy as np
import pytest

from celnav import Camera
from celnav.command.camera_file import camera_of_field, read_camera_file
from celnav.errors import CameraError

MATRIX = np.array([[812.5, 0.0, 633.25], [0.0, 809.75, 355.5], [0.0, 0.0, 1.0]])
BROWN = np.array([-0.21, 0.07, 1.1e-3, -7e-4, -0.012, 0.03, 0.004, -0.001])
FISHEYE = np.array([-0.031, 0.012, -0.006, 0.0011])
DIRECTIONS = np.array([[0.0, 0.0, 1.0], [0.3, -0.2, 1.0], [-0.5, 0.1, 1.0], [0.25, 0.35, 1.0]])


def by_opencv(distortion, fisheye=False):
    points, zero = DIRECTIONS.reshape(-1, 1, 3), np.zeros(3)
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    return project(points, zero, zero, MATRIX, distortion)[0].reshape(-1, 2)


def storage(path, distortion, **more):
    """Write a calibration with OpenCV's FileStorage."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in {"image_width": 1280, "image_height": 720, **more}.items():
        file.write(name, value)
    file.write("camera_matrix", MATRIX)
    file.write("distortion_coefficients", distortion.reshape(-1, 1))
    file.release()
    return path


@pytest.mark.parametrize("suffix", ["yml", "json"])
@pytest.mark.parametrize("n", [4, 5, 8])
def test_a_file_of_opencv_projects_as_opencv_does(tmp_path, suffix, n) -> None:
    found = read_camera_file(storage(tmp_path / f"c.{suffix}", BROWN[:n]))
    assert (found.camera.width, found.camera.height) == (1280, 720)
    np.testing.assert_allclose(found.camera.project(DIRECTIONS), by_opencv(BROWN[:n]), atol=1e-6)
    assert bool(found.assumed) == (n == 4)


def test_the_first_line_that_older_opencv_writes(tmp_path) -> None:
    path = storage(tmp_path / "c.yml", BROWN)
    path.write_text(path.read_text().replace("%YAML 1.2", "%YAML:1.0", 1))
    assert path.read_text().startswith("%YAML:1.0")
    np.testing.assert_allclose(read_camera_file(path).camera.project(DIRECTIONS), by_opencv(BROWN), atol=1e-6)


def test_a_fisheye_of_opencv(tmp_path) -> None:
    path = storage(tmp_path / "c.yml", FISHEYE, fisheye_model=1)
    found = read_camera_file(path)
    assert found.camera.model == "kannala_brandt"
    np.testing.assert_allclose(found.camera.project(DIRECTIONS), by_opencv(FISHEYE, fisheye=True), atol=1e-6)


ROS_FILE = f"""
image_width: 1280
image_height: 720
camera_name: sky
camera_matrix: {{rows: 3, cols: 3, data: {MATRIX.ravel().tolist()}}}
distortion_model: MODEL
distortion_coefficients: {{rows: 1, cols: N, data: DATA}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
projection_matrix: {{rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}}
"""


@pytest.mark.parametrize(
    ("model", "distortion"),
    [("plumb_bob", BROWN[:5]), ("rational_polynomial", BROWN), ("equidistant", FISHEYE)],
)
def test_camera_info_of_ros(tmp_path, model, distortion) -> None:
    path = tmp_path / "ost.yaml"
    path.write_text(ROS_FILE.replace("MODEL", model).replace("DATA", str(distortion.tolist())))
    expected = by_opencv(distortion, model == "equidistant")
    np.testing.assert_allclose(read_camera_file(path).camera.project(DIRECTIONS), expected, atol=1e-6)
    message = {"width": 1280, "height": 720, "distortion_model": model, "k": MATRIX.ravel().tolist()}
    (tmp_path / "message.json").write_text(json.dumps(message | {"d": distortion.tolist()}))
    again = read_camera_file(tmp_path / "message.json").camera
    np.testing.assert_allclose(again.project(DIRECTIONS), expected, atol=1e-6)


def test_lists_and_the_size_of_the_image(tmp_path) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps({"cameraMatrix": MATRIX.tolist(), "distCoeffs": [BROWN[:5].tolist()]}))
    found = read_camera_file(path, (1280, 720))
    np.testing.assert_allclose(found.camera.project(DIRECTIONS), by_opencv(BROWN[:5]), atol=1e-6)
    assert "as large as this one" in found.assumed[0]
    with pytest.raises(CameraError, match="image_width"):
        read_camera_file(path)


def test_files_may_begin_with_a_byte_order_mark(tmp_path) -> None:
    content = json.dumps({"model": "equidistant", "width": 640, "height": 480, "f_px": 200.0})
    for name in ("c.json", "c.yml"):
        (tmp_path / name).write_text(content, encoding="utf-8-sig")
        assert read_camera_file(tmp_path / name).camera.f_px == 200.0


def test_own_cameras_and_frame_records(tmp_path) -> None:
    camera = {"model": "equidistant", "width": 640, "height": 480, "f_px": 200.0}
    for content in (camera, {"camera": camera}):
        (tmp_path / "c.json").write_text(json.dumps(content))
        assert read_camera_file(tmp_path / "c.json").camera == Camera.from_dict(camera)


@pytest.mark.parametrize(
    ("model", "hfov_deg", "k"),
    [("pinhole", 70, ()), ("equidistant", 180, ()), ("equisolid", 170, ()), ("stereographic", 200, ()),
     ("orthographic", 150, ()), ("kannala_brandt", 120, tuple(FISHEYE))],
)  # fmt: skip
def test_the_field_gives_the_focal_length(tmp_path, model, hfov_deg, k) -> None:
    (tmp_path / "c.json").write_text(
        json.dumps({"model": model, "width": 640, "height": 480, "hfov_deg": hfov_deg, "k": k})
    )
    camera = read_camera_file(tmp_path / "c.json").camera
    assert camera == camera_of_field(model, 640, 480, hfov_deg, k)
    x, _, z = camera.to_rays([[639.5 - 1e-9, 239.5]])[0]
    assert 2 * np.degrees(np.arctan2(x, z)) == pytest.approx(hfov_deg, abs=1e-5)


# A billion numbers in lists of lists, of three hundred bytes.
ALIASES = (
    "a0: &a0 [1]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10)) + "K: *a9\n"
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "neither JSON nor YAML"),
        ("a: [1", "line"),
        ("- 1", "must hold an object"),
        ("a: 1", "holds no camera"),
        ("!!python/object/apply:os.system ['true']", r"the tag !!python/object/apply:os\.system is not read"),
        ("a: !!bool x", "the tag !!bool is not read: leave only the value in line 1"),
        ("a: !!timestamp x", "the tag !!timestamp is not read"),
        ("a: !!int ''", "the tag !!int is not read"),
        ("image_width: 01000", r"found 01000, which YAML may read as octal: write 1000 in line 1"),
        ("K: [1.0,\n -017]", "found -017, which YAML may read as octal: write -17 in line 2"),
        ("[" * 5000, "neither JSON nor YAML"),
        ('{"model": "pinhole", "width": 64, "height": 48, "hfov_deg": 60, "f_px": 60}', "not both"),
        ('{"model": "pinhole", "width": 64, "height": 48, "hfov_deg": 190}', "hfov_deg"),
        ('{"model": "orthographic", "width": 64, "height": 48, "hfov_deg": 190}', "more than the model"),
        ('{"model": "brown_conrady", "width": 64, "height": 48, "hfov_deg": 90}', "give f_px"),
        ('{"model": "pinhole", "hfov_deg": 90, "width": -1, "height": 48}', "width"),
        ('{"model": "pinhole", "hfov_deg": 90, "width": null, "height": 48}', "lacks width"),
        ("{1: 2, model: pinhole, width: 64, height: 48, hfov_deg: 90}", "unknown keys 1"),
        (ALIASES, r"the alias \*a0 is not read: write its value in its place in line 2"),
        (
            "{image_width: 64, image_height: 48, K: " + str([[[1.0] * 10] * 10] * 11) + "}",
            "K has more than 1000 numbers",
        ),
        ('{"camera": 3}', "camera must be an object"),
        ("{image_width: 64, image_height: 48, K: [1, 2]}", "3 x 3"),
        ("{image_width: 64, image_height: 48, K: [1, .5, 0, 0, 1, 0, 0, 0, 1]}", "skew"),
        ("{image_width: 64, image_height: 48, K: [1, .nan, 0, 0, 1, 0, 0, 0, 1]}", "finite"),
        ("{image_width: 64, image_height: 48, K: [1, 0, 0, 0, 1, 0, 0, 0, 1], D: [1, 2, 3]}", "4, 5, 8"),
        ("{image_width: 64, image_height: 48, K: [1, 0, 0, 0, 1, 0, 0, 0, 1], D: {data: x}}", "matrix of numbers"),
        ("{image_width: 64, image_height: 48, K: [1, 0, 0, 0, 1, 0, 0, 0, 1], distortion_model: fov}", "'fov'"),
        ('{"model": "pinhole", "width": 64, "height": 48, "hfov_deg": 60, "tilt_rad": [2, 0]}', "within 0.5 radians"),
        ('{"model": "pinhole", "width": 64, "height": 48, "hfov_deg": 60, "s": 1}', "list of numbers"),
        (
            '{"model": "pinhole", "width": 64, "height": 48, "f_px": 60, "cx_px": NaN}',
            "cx_px = nan must be a finite number",
        ),
        ("{model: pinhole, width: 64, height: 48, f_px: 60.0, fy_px: .nan}", "fy_px = nan must be a finite number"),
    ],
)
def test_faulty_files_are_refused_in_one_line(tmp_path, text, message) -> None:
    path = tmp_path / "c.yml"
    path.write_text(text)
    with pytest.raises(CameraError, match=message) as refusal:
        read_camera_file(path)
    assert "\n" not in str(refusal.value)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize(
    "number", ["500", "500.", "5e2", "5E+2", "+500.0", "0.5e3", "5.0000000000000000e+02", "05.0e2"]
)
def test_numbers_are_read_as_they_seem(tmp_path, number) -> None:
    path = tmp_path / "c.yml"
    path.write_text(f"{{image_width: 64, image_height: 48, K: [{number}, 0, 32, 0, {number}, 24., 0, 0, 1]}}")
    assert read_camera_file(path).camera.f_px == 500.0


def test_a_file_that_is_no_text_or_too_large_is_refused(tmp_path) -> None:
    (tmp_path / "c.yml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CameraError, match="not a text file"):
        read_camera_file(tmp_path / "c.yml")
    with (tmp_path / "c.yml").open("wb") as file:
        file.truncate(20_000_000)
    with pytest.raises(CameraError, match="larger than"):
        read_camera_file(tmp_path / "c.yml")
    with pytest.raises(CameraError, match="cannot read camera file"):
        read_camera_file(tmp_path / "none.yml")
