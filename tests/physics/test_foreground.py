"""Horizons and meshes in front of the sky: what they hide, and the light that they send back."""

import gc
import math
import struct

import numpy as np
import pytest
import yaml
from small_scenes import BASE

from generator import plugins
from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.scenario.file import parse_scenario

FISHEYE = {
    "width": 240, "height": 240, "model": "equidistant", "f_px": 75.0, "aperture_mm": 4.0, "bloom": {"share": 0},
    "veiling_glare": 0,
}  # fmt: skip
PROFILE = "azimuth_deg,elevation_deg\n0,10\n90,30\n180,5\n270,20\n"


def scenario_in(folder, **overrides):
    tree = BASE | {"camera": FISHEYE, "stars": {"limiting_magnitude": 4.5}} | overrides
    return parse_scenario(yaml.safe_dump(tree), str(folder / "scene.yaml"))


def cube_ply(size: float, centre: tuple[float, float, float], faces: int = 12) -> str:
    corners = [[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))][:faces]
    vertices = "".join(" ".join(str(c + size / 2 * x) for c, x in zip(centre, v, strict=True)) + "\n" for v in corners)
    return (
        f"ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
        + vertices + "".join(f"3 {a} {b} {c}\n" for a, b, c in triangles)
    )  # fmt: skip


def test_a_horizon_profile_hides_what_lies_below_it(tmp_path) -> None:
    """Each star is occluded exactly if its altitude is below the profile at its azimuth; hidden stars leave no light."""
    (tmp_path / "horizon.csv").write_text(PROFILE)
    plan = plan_frame(scenario_in(tmp_path, foreground={"horizon": {"file": "horizon.csv"}, "lit_directions": 0}), 0)
    frame = render_expected(plan)
    edge = np.interp(plan.middle.azimuth_deg, [0, 90, 180, 270], [10, 30, 5, 20], period=360)
    clear = np.abs(plan.middle.altitude_deg - edge) > 0.1
    hidden = plan.middle.altitude_deg < edge
    assert hidden.sum() > 30
    np.testing.assert_array_equal(frame.occluded[clear], hidden[clear])
    assert frame.star_electrons[hidden & clear].max() == 0
    v, u = np.mgrid[0:240, 0:240]
    altitude = 90 - np.degrees(np.hypot(u - 119.5, v - 119.5) / 75.0)
    # Looking up with north up in the image, east is on the left.
    azimuth = np.degrees(np.arctan2(-(u - 119.5), -(v - 119.5))) % 360
    below = altitude < np.interp(azimuth, [0, 90, 180, 270], [10, 30, 5, 20], period=360)
    far = np.abs(altitude - np.interp(azimuth, [0, 90, 180, 270], [10, 30, 5, 20], period=360)) > 1
    assert frame.sky_electrons[below & far].max() == 0
    assert frame.sky_electrons[~below & far].min() > 0


def test_a_white_floor_sends_back_what_falls_on_it(tmp_path) -> None:
    """Under an open sky, a white horizontal plane seen from above has the irradiance / pi as its radiance, within 2 %."""
    plane = (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
        "property list uchar int vertex_indices\nend_header\n"
        "-500 -500 -5\n500 -500 -5\n500 500 -5\n-500 500 -5\n3 0 1 2\n3 0 2 3\n"
    )
    (tmp_path / "floor.ply").write_text(plane)
    shape = {"file": "floor.ply", "closed": False, "reflectance": 1.0}
    down = {"azimuth_deg": 0.0, "altitude_deg": -90.0}
    scenario = scenario_in(
        tmp_path, attitude=down, foreground={"shapes": [shape], "lit_directions": 256}, stars={"limiting_magnitude": -2.0},
        camera={"width": 32, "height": 32, "f_px": 200.0, "aperture_mm": 4.0},
    )  # fmt: skip
    floor = render_expected(plan_frame(scenario, 0)).electrons
    sky = render_expected(plan_frame(scenario_in(tmp_path, stars={"limiting_magnitude": -2.0}), 0)).sky_electrons
    # Electrons per steradian from the all-sky fisheye, whose pixels cover sin(theta)/theta / f^2, integrated with the cosine.
    v, u = np.mgrid[0:240, 0:240]
    theta = np.hypot(u - 119.5, v - 119.5) / 75.0
    inside = theta < math.pi / 2
    irradiance = float((sky * np.cos(theta))[inside].sum())
    solid_angle = 1 / 200.0**2
    assert floor[16, 16] == pytest.approx(irradiance / math.pi * solid_angle, rel=0.02)


def test_a_cube_hides_and_is_lit_from_above(tmp_path) -> None:
    """A closed cube east of the camera: stars behind it are occluded, its face gives less light than the sky, not none."""
    (tmp_path / "cube.ply").write_text(cube_ply(20, (30.0, 0.0, 5.0)))
    plan = plan_frame(scenario_in(tmp_path, foreground={"shapes": [{"file": "cube.ply"}]}), 0)
    frame = render_expected(plan)
    inside = (np.abs(plan.middle.azimuth_deg - 90) < 20) & (plan.middle.altitude_deg < 30)
    outside = (np.abs(plan.middle.azimuth_deg - 90) > 40) | (plan.middle.altitude_deg > 50)
    assert inside.sum() > 2
    assert frame.occluded[inside].all()
    assert not frame.occluded[outside].any()
    # 15 deg above the horizon due east: image left.
    column = round(119.5 - math.radians(75) * 75.0)
    face, sky = frame.sky_electrons[120, column], frame.sky_electrons[120, 239 - column]
    assert 0 < face < 0.3 * sky


def test_an_obj_mesh_is_the_same_as_its_ply(tmp_path) -> None:
    """Moved and scaled, too: the cube of 20 m around (30, 0, 5) from one of 1 m around the origin."""
    (tmp_path / "cube.ply").write_text(cube_ply(20, (30.0, 0.0, 5.0)))
    lines = cube_ply(1, (0.0, 0.0, 0.0)).split("end_header\n")[1].splitlines()
    faces = [[int(corner) + 1 for corner in line.split()[1:]] for line in lines[8:]]
    text = "".join(f"v {line}\n" for line in lines[:8]) + "".join(f"f {a} {b} {c}\n" for a, b, c in faces)
    (tmp_path / "cube.obj").write_text(text)
    moved = {"file": "cube.obj", "translate_m": [30.0, 0.0, 5.0], "scale": 20.0}
    by_ply, by_obj = (
        render_expected(plan_frame(scenario_in(tmp_path, foreground={"shapes": [shape]}), 0))
        for shape in ({"file": "cube.ply"}, moved)
    )
    assert by_obj.occluded.sum() > 5
    np.testing.assert_array_equal(by_obj.occluded, by_ply.occluded)
    assert by_obj.star_electrons[by_obj.occluded].max() == 0
    assert np.abs(by_obj.sky_electrons - by_ply.sky_electrons).max() < 0.02 * by_ply.sky_electrons.max()


def test_foreground_has_the_same_bits_again(tmp_path) -> None:
    plugins.start()
    (tmp_path / "horizon.csv").write_text(PROFILE)
    plan = plan_frame(scenario_in(tmp_path, foreground={"horizon": {"file": "horizon.csv"}}), 0)
    first, second = render_expected(plan), render_expected(plan)
    np.testing.assert_array_equal(first.electrons, second.electrons)


def test_a_moving_camera_smears_the_horizon_s_edge(tmp_path) -> None:
    """A level wall under a camera that pitches: the edge becomes a ramp as long as rate x time x focal length."""
    (tmp_path / "flat.csv").write_text("azimuth_deg,elevation_deg\n0,10\n180,10\n")
    values = {
        "attitude": {"azimuth_deg": 0.0, "altitude_deg": 10.0}, "stars": {"limiting_magnitude": -2.0},
        "motion": {"rate_deg_s": [8.0, 0.0, 0.0]}, "camera": {"width": 64, "height": 180, "f_px": 300.0, "aperture_mm": 4.0},
    }  # fmt: skip
    wall = {"horizon": {"file": "flat.csv"}, "lit_directions": 0}
    walled, free = (
        render_expected(plan_frame(scenario_in(tmp_path, **values, foreground=foreground), 0))
        .electrons[:, 32]
        .astype(float)
        for foreground in (wall, {})
    )
    length = 300 * math.radians(8.0 * 0.5)
    lit = walled[:140] / free[:140]
    ramp = np.flatnonzero((lit > 0.02) & (lit < 0.97))
    assert len(ramp) == pytest.approx(length, abs=2.5)
    assert lit[89:91].mean() == pytest.approx(0.5, abs=0.05)


def test_bad_foregrounds_are_refused(tmp_path) -> None:
    (tmp_path / "columns.csv").write_text("az,el\n0,1\n")
    (tmp_path / "falling.csv").write_text("azimuth_deg,elevation_deg\n10,1\n5,1\n")
    (tmp_path / "open.ply").write_text(cube_ply(2, (5, 0, 0), faces=11))
    (tmp_path / "noise.ply").write_bytes(b"ply\n" + struct.pack("d", 1.5) * 20)
    whole = cube_ply(2, (5, 0, 0))
    (tmp_path / "huge.ply").write_text(whole.replace("vertex 8", "vertex 2000000000"))
    (tmp_path / "astray.ply").write_text(whole.replace("3 0 2 3", "3 0 2 99"))
    (tmp_path / "nan.ply").write_text(whole.replace("6.0", "nan"))
    (tmp_path / "astray.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    (tmp_path / "points.obj").write_text("v 0 0 0\n")
    cases = [
        ({"horizon": {"file": "columns.csv"}}, ["foreground.horizon", "line 1", "columns az, el", "azimuth_deg"]),
        (
            {"horizon": {"file": "falling.csv"}},
            ["foreground.horizon", "line 3", "column azimuth_deg", "found 5 after 10"],
        ),
        ({"shapes": [{"file": "/etc/passwd"}]}, ["foreground.shapes.0.file", "leaves the scenario's folder"]),
        ({"shapes": [{"file": "none.ply"}]}, ["foreground.shapes.0.file", "cannot be read"]),
        ({"shapes": [{"file": "columns.csv"}]}, ["foreground.shapes.0.file", ".ply or .obj"]),
        ({"shapes": [{"file": "open.ply"}]}, ["foreground.shapes.0.closed", "not closed", "3 edges"]),
        ({"shapes": [{"file": "huge.ply"}]}, ["foreground.shapes.0.file", "announces 2000000012 elements"]),
        ({"shapes": [{"file": "astray.ply"}]}, ["foreground.shapes.0.file", "faces of vertex 99, but only 8"]),
        ({"shapes": [{"file": "nan.ply"}]}, ["foreground.shapes.0.file", "cannot be read as a mesh"]),
        ({"shapes": [{"file": "astray.obj"}]}, ["foreground.shapes.0.file", "invalid vertex 9"]),
        ({"shapes": [{"file": "points.obj"}]}, ["foreground.shapes.0.file", "0 faces"]),
        ({"shapes": [{"file": "noise.ply"}]}, ["foreground.shapes.0.file", "cannot be read as a mesh"]),
    ]
    for foreground, fragments in cases:
        with pytest.raises(ScenarioError) as caught:
            scenario_in(tmp_path, foreground=foreground)
        for fragment in fragments:
            assert fragment in str(caught.value)


def test_a_refused_mesh_does_not_end_later_renderings(tmp_path) -> None:
    """Even while its error is kept: Mitsuba cannot trace rays in a process that still holds a mesh without faces."""
    (tmp_path / "points.obj").write_text("v 0 0 0\n")
    (tmp_path / "cube.ply").write_text(cube_ply(2, (0, 0, 5)))
    gc.disable()
    try:
        with pytest.raises(ScenarioError) as kept:
            scenario_in(tmp_path, foreground={"shapes": [{"file": "points.obj"}]})
        frame = render_expected(plan_frame(scenario_in(tmp_path, foreground={"shapes": [{"file": "cube.ply"}]}), 0))
    finally:
        gc.enable()
    assert "0 faces" in str(kept.value)
    assert frame.sky_electrons.max() > 0
