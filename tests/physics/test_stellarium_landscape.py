"""Landscape packages of Stellarium: features at known directions appear there, for each type; hostile packages are refused.

The packages are drawn here. Where a direction falls on a picture is computed by formulas of the test's own, from the
geometry that Stellarium's user guide gives for each type.
"""

import io
import zipfile

import numpy as np
import pytest
import yaml
from PIL import Image
from small_scenes import BASE, FISHEYE_CAMERA

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.ground.stellarium.landscape import read_landscape
from generator.scenario.file import parse_scenario


def png(rgba) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(rgba).save(stream, "PNG")
    return stream.getvalue()


def pack(folder, ini: str, files=(), place="garden/", name="garden.zip"):
    with zipfile.ZipFile(folder / name, "w") as archive:
        archive.writestr(f"{place}landscape.ini", ini)
        for path, data in dict(files).items():
            archive.writestr(f"{place}{path}", data)


def scenario_of(folder, **landscape):
    tree = BASE | {"camera": FISHEYE_CAMERA, "stars": {"limiting_magnitude": -2.0}}
    tree |= {"foreground": {"landscape": {"file": "garden.zip"} | landscape}}
    return parse_scenario(yaml.safe_dump(tree), str(folder / "scene.yaml"))


def cover_of(folder, **landscape):
    cover = render_expected(plan_frame(scenario_of(folder, **landscape), 0)).cover
    distance = np.hypot(*(np.indices(cover.shape) - 199.5))
    return np.where(distance < 120 * np.radians(88), cover, 0)


def pixel_of(azimuth_deg, altitude_deg):
    """Of an equidistant camera that looks up, north at the top and east on the left."""
    radius, turn = 120 * np.radians(90 - altitude_deg), np.radians(azimuth_deg)
    return 199.5 - radius * np.sin(turn), 199.5 - radius * np.cos(turn)


def spot_in(cover):
    rows, columns = np.indices(cover.shape)
    return (cover * columns).sum() / cover.sum(), (cover * rows).sum() / cover.sum()


def dotted(height, width, column, row, radius):
    rgba = np.zeros((height, width, 4), np.uint8)
    v, u = np.indices((height, width))
    distance = np.hypot(u + 0.5 - column, v + 0.5 - row)
    rgba[..., 3] = 255 * np.clip(radius - distance + 0.5, 0, 1)
    return rgba


@pytest.mark.parametrize(
    ("azimuth", "altitude", "rotate"), [(200.0, 35.0, 0.0), (10.0, 50.0, -90.0), (123.0, 28.0, 41.5)]
)
def test_spherical_begins_in_the_east(tmp_path, azimuth, altitude, rotate) -> None:
    """The left edge is at east, turned by angle_rotatez towards south; rows run evenly from maptex_top to maptex_bottom."""
    column = (azimuth - 90 - rotate) % 360 / 360 * 2000
    row = (80 - altitude) / 100 * 556
    files = {"p.png": png(dotted(556, 2000, column, row, 5))}
    ini = (
        f"[landscape]\nname=x\ntype=spherical\nmaptex=p.png\nmaptex_top=80\nmaptex_bottom=-20\nangle_rotatez={rotate}\n"
    )
    pack(tmp_path, ini, files)
    assert spot_in(cover_of(tmp_path)) == pytest.approx(pixel_of(azimuth, altitude), abs=0.1)


@pytest.mark.parametrize(
    ("azimuth", "altitude", "rotate", "fov"), [(70.0, 40.0, 0.0, 210.0), (300.0, 20.0, -75.0, 180.0)]
)
def test_fisheye_has_south_at_the_top_and_east_on_the_right(tmp_path, azimuth, altitude, rotate, fov) -> None:
    radius = (90 - altitude) / (fov / 2) * 600
    turn = np.radians(azimuth - rotate)
    files = {"f.png": png(dotted(1200, 1200, 600 + radius * np.sin(turn), 600 + radius * np.cos(turn), 5))}
    ini = f"[landscape]\nname=x\ntype=fisheye\nmaptex=f.png\ntexturefov={fov}\nangle_rotatez={rotate}\n"
    pack(tmp_path, ini, files)
    assert spot_in(cover_of(tmp_path)) == pytest.approx(pixel_of(azimuth, altitude), abs=0.1)


@pytest.mark.parametrize("mode", ["calibrated", "calibrated tan", "plain", "plain tan"])
def test_old_style_sides_stand_side_by_side_from_the_east(tmp_path, mode) -> None:
    """Two pictures of two sides each; the spot lies on side 2, the lower half of the second picture."""
    azimuth, altitude, shift, height = 305.0, 32.0, -5.0, 60.0
    tan, calibrated = "tan" in mode, "calibrated" in mode
    tangent = np.tan(np.radians(altitude))
    if calibrated and tan:
        low, high = np.tan(np.radians([shift, shift + height]))
        up = (tangent - low) / (high - low)
    elif calibrated:
        up = (altitude - shift) / height
    else:
        law = np.tan if tan else np.sin
        up = (tangent - law(np.radians(shift))) / law(np.radians(height))
    along = ((azimuth - 90 - 20) % 360) / 360 * 4
    assert int(along) == 2
    files = {"a.png": png(np.zeros((400, 1000, 4), np.uint8)), "g.png": png(np.zeros((16, 16, 4), np.uint8))}
    files["b.png"] = png(dotted(400, 1000, (along - 2) * 500, (1 - 0.5 * up) * 400, 4))
    ini = (
        "[landscape]\nname=x\ntype=old_style\nnbsidetex=2\ntex0=a.png\ntex1=b.png\nnbside=4\n"
        "side0=tex0:0:0:0.5:0.5\nside1=tex0:0.5:0:1:0.5\nside2=tex1:0:0:0.5:0.5\nside3=tex1:0.5:0:1:0.5\n"
        f"groundtex=g.png\nground=groundtex:0:0:1:1\ndecor_alt_angle={height}\ndecor_angle_shift={shift}\n"
        f"decor_angle_rotatez=20\ncalibrated={str(calibrated).lower()}\ntan_mode={str(tan).lower()}\n"
    )
    pack(tmp_path, ini, files)
    # Two hundred pixels of picture over sixty degrees: the spot is drawn a little high where rows are stretched.
    assert spot_in(cover_of(tmp_path)) == pytest.approx(pixel_of(azimuth, altitude), abs=0.25)


def test_old_style_ground_has_south_on_the_right_and_east_at_the_top(tmp_path) -> None:
    """A dot on the ground's picture, seen by a camera that looks down through the transparent rest of it."""
    azimuth, altitude, shift, rotate = 60.0, -40.0, -10.0, 25.0
    radius = np.tan(np.radians(-shift)) / np.tan(np.radians(-altitude))
    turn = np.radians(azimuth + rotate)
    x, y = -radius * np.cos(turn), radius * np.sin(turn)
    white = np.zeros((2000, 2000, 4), np.uint8)
    white[..., 3] = 255
    dot = dotted(2000, 2000, (0.5 + x / 2) * 2000, (0.5 - y / 2) * 2000, 12)
    white[..., :3] = dot[..., 3:]
    ini = (
        "[landscape]\nname=x\ntype=old_style\nnbsidetex=1\ntex0=a.png\nnbside=1\nside0=tex0:0:0:1:1\ngroundtex=g.png\n"
        f"ground_angle_shift={shift}\nground_angle_rotatez={rotate}\ncalibrated=true\ndecor_alt_angle=20\ndecor_angle_shift=0\n"
    )
    pack(tmp_path, ini, {"a.png": png(np.zeros((64, 2000, 4), np.uint8)), "g.png": png(white)})
    tree = BASE | {
        "camera": FISHEYE_CAMERA,
        "stars": {"limiting_magnitude": -2.0},
        "foreground": {"landscape": {"file": "garden.zip"}},
    }
    tree |= {"attitude": {"azimuth_deg": 0.0, "altitude_deg": -90.0, "roll_deg": 0.0}}
    frame = render_expected(plan_frame(parse_scenario(yaml.safe_dump(tree), str(tmp_path / "scene.yaml")), 0))
    distance = np.hypot(*(np.indices(frame.electrons.shape) - 199.5))
    light = np.where(distance < 150, frame.electrons, 0).astype(float)
    # Looking down with north at the top of the image, east is on the right.
    reach = 120 * np.radians(90 + altitude)
    expected = (199.5 + reach * np.sin(np.radians(azimuth)), 199.5 - reach * np.cos(np.radians(azimuth)))
    assert spot_in(light) == pytest.approx(expected, abs=0.2)


@pytest.mark.slow  # a horizon of great circles on every pixel: fifteen seconds
def test_polygonal_fills_below_great_circles_between_its_points(tmp_path) -> None:
    """A triangle of great circles around the zenith: its altitude midway between two points, and its corners."""
    pack(
        tmp_path,
        "[landscape]\nname=x\ntype=polygonal\npolygonal_horizon_list=h.txt\npolygonal_angle_rotatez=15\nground_color=.2,.2,.2\n",
        {"h.txt": "# az alt\n0 20\n120 30\n\n240 20\n"},
    )
    cover = cover_of(tmp_path)
    a, b = (
        np.array([np.sin(z) * np.cos(h), np.cos(z) * np.cos(h), np.sin(h)])
        for z, h in np.radians([[15.0, 20.0], [135.0, 30.0]])
    )
    middle = (a + b) / np.linalg.norm(a + b)
    altitude = np.degrees(np.arcsin(middle[2]))
    azimuth = np.degrees(np.arctan2(middle[0], middle[1]))
    # Along the line from the zenith through that direction, the open part ends there.
    radii = np.arange(0, 120 * np.radians(85), 0.1)
    u, v = 199.5 - radii * np.sin(np.radians(azimuth)), 199.5 - radii * np.cos(np.radians(azimuth))
    edge = radii[np.argmax(cover[np.rint(v).astype(int), np.rint(u).astype(int)] > 0.5)]
    assert edge == pytest.approx(120 * np.radians(90 - altitude), abs=0.7)
    for zenith_mode, text in (
        ("azDeg_zdDeg", "0 70\n120 60\n240 70\n"),
        ("azGrad_altGrad", "0 22.2222\n133.3333 33.3333\n266.6667 22.2222\n"),
    ):
        pack(
            tmp_path,
            f"[landscape]\ntype=polygonal\npolygonal_horizon_list=h.txt\npolygonal_horizon_list_mode={zenith_mode}\n"
            "polygonal_angle_rotatez=15\n",
            {"h.txt": text},
        )
        np.testing.assert_allclose(cover_of(tmp_path), cover, atol=0.05)


def test_comments_and_indentation_do_not_change_a_landscape(tmp_path) -> None:
    """Stellarium's `readStelIniFile` deletes `[#;].*$` from each line, then white space around it, and joins no lines."""
    files = {"a.png": png(dotted(40, 200, 100, 20, 5)), "g.png": png(np.full((16, 16, 4), 90, np.uint8))}
    lines = (
        "name = x", "description = A place", "type = old_style", "nbsidetex = 1", "tex0 = a.png", "nbside = 1",
        "side0 = tex0:0:0:1:1", "groundtex = g.png", "decor_alt_angle = 40", "decor_angle_shift = -8", "tan_mode = true",
        "ground_angle_shift = -8", "calibrated = true",
    )  # fmt: skip
    pack(tmp_path, "\n".join(["[landscape]", *lines]), files, name="plain.zip")
    for name, line in (("hash.zip", "{} # note"), ("semicolon.zip", "{}; a = b"), ("indented.zip", "\t{}  ")):
        written = [line.format(text) if number % 2 else text for number, text in enumerate(lines)]
        pack(tmp_path, "\r\n".join(["; A header", "[landscape]", *written]), files, name=name)
    plain = read_landscape(tmp_path / "plain.zip", "plain.zip")
    assert plain.alpha.any()
    for name in ("hash.zip", "semicolon.zip", "indented.zip"):
        other = read_landscape(tmp_path / name, name)
        assert (other.top_deg, other.bottom_deg) == (plain.top_deg, plain.bottom_deg)
        np.testing.assert_array_equal(other.alpha, plain.alpha)
        np.testing.assert_array_equal(other.colour, plain.colour)


def test_light_of_a_package_shines(tmp_path) -> None:
    """maptex_illum between its own altitudes, through its alpha, on the picture's place."""
    opaque = np.full((400, 800, 4), 255, np.uint8)
    opaque[..., :3] = 0
    glow = np.zeros((100, 800, 4), np.uint8)
    glow[45:55, 395:405] = 255
    glow[45:55, 100:110] = (255, 255, 255, 0)
    ini = "[landscape]\ntype=spherical\nmaptex=p.png\nmaptex_illum=l.png\nmaptex_illum_top=40\nmaptex_illum_bottom=-5\n"
    pack(tmp_path, ini, {"p.png": png(opaque), "l.png": png(glow)})
    light = render_expected(plan_frame(scenario_of(tmp_path), 0)).electrons.astype(float)
    assert spot_in(light) == pytest.approx(pixel_of(270.0, 17.5), abs=0.3)


def hostile(folder) -> dict[str, list[str]]:
    """Packages by name, and what their refusals say."""
    small = png(np.zeros((20, 40, 4), np.uint8))
    spherical = "[landscape]\ntype=spherical\nmaptex={}\n"
    polygonal = "[landscape]\ntype=polygonal\npolygonal_horizon_list=h.txt\n"
    pack(folder, spherical.format("../../etc/passwd"), name="leaves.zip")
    pack(folder, spherical.format("/etc/passwd"), name="absolute.zip")
    pack(folder, spherical.format("other.png"), {"p.png": small}, name="lacks.zip")
    pack(folder, "[landscape]\ntype=spherical\n", name="nokey.zip")
    pack(folder, "[landscape]\ntype=cubic\n", name="cubic.zip")
    pack(folder, "no section\n", name="nosection.zip")
    pack(folder, "[other]\na=1\n", name="other.zip")
    pack(folder, "[landscape]\ntype=spherical\nmaptex=p.png\nmaptex_top=nan\n", {"p.png": small}, name="nan.zip")
    pack(folder, "[landscape]\ntype=spherical\nmaptex=p.png\n#" + "x" * 70_000, {"p.png": small}, name="longini.zip")
    pack(folder, spherical.format("p.png"), {"p.png": b"not a picture"}, name="nopicture.zip")
    pack(folder, polygonal, {"h.txt": "0 10\n5 nonsense\n9 1\n"}, name="nonsense.zip")
    pack(folder, polygonal, {"h.txt": "0 10\n10 10\n5 10\n"}, name="open.zip")
    sides = "[landscape]\ntype=old_style\nnbsidetex=1\ntex0=p.png\nnbside=1\nside0=tex7:0:0:1:1\n"
    pack(folder, sides, {"p.png": small}, name="side.zip")
    pack(folder, "[landscape]\ntype=old_style\nnbsidetex=1e9\n", name="many.zip")
    with zipfile.ZipFile(folder / "two.zip", "w") as archive:
        archive.writestr("a/landscape.ini", spherical)
        archive.writestr("b/landscape.ini", spherical)
    with zipfile.ZipFile(folder / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("landscape.ini", spherical.format("p.png"))
        archive.writestr("p.png", bytes(210_000_000))
    with zipfile.ZipFile(folder / "crowd.zip", "w") as archive:
        for number in range(2500):
            archive.writestr(f"{number}", b"")
    pack(folder, spherical.format("p.png"), {"p.png": small}, name="whole.zip")
    data = (folder / "whole.zip").read_bytes()
    (folder / "cut.zip").write_bytes(data[: len(data) // 2])
    (folder / "damaged.zip").write_bytes(data.replace(small[20:60], bytes(40)))
    (folder / "text.zip").write_text("no archive")
    return {
        "leaves.zip": ["maptex = ../../etc/passwd leaves the package"],
        "absolute.zip": ["maptex = /etc/passwd leaves the package"],
        "lacks.zip": ["maptex = other.png", "no such file in the package; add it"],
        "nokey.zip": ["maptex is missing; add it"],
        "cubic.zip": ["type = cubic: expected one of spherical, old_style, fisheye, polygonal"],
        "nosection.zip": ["has no section [landscape]"],
        "other.zip": ["has no section [landscape]"],
        "nan.zip": ["maptex_top: found 'nan', expected a number from -90 to 90"],
        "longini.zip": ["landscape.ini' has more than 65536 bytes"],
        "nopicture.zip": ["p.png' cannot be read as a picture"],
        "nonsense.zip": ["polygonal_horizon_list, line 2", "'nonsense'"],
        "open.zip": ["does not go once around the horizon"],
        "side.zip": ["side0 = tex7:0:0:1:1", "expected texN:x0:y0:x1:y1"],
        "many.zip": ["nbsidetex: found '1e9', expected a number from 1 to 64"],
        "two.zip": ["has 2 files landscape.ini, expected one"],
        "bomb.zip": ["p.png' has more than 200000000 bytes"],
        "crowd.zip": ["has 2500 files"],
        "cut.zip": ["is not a zip archive"],
        "damaged.zip": ["cannot be unpacked", "pack it again"],
        "text.zip": ["is not a zip archive"],
    }


def test_hostile_packages_are_refused_by_file_and_key(tmp_path) -> None:
    for name, fragments in hostile(tmp_path).items():
        with pytest.raises(ScenarioError) as caught:
            scenario_of(tmp_path, file=name)
        for fragment in ["foreground.landscape", f"'{name}", *fragments]:
            assert fragment in str(caught.value), (name, str(caught.value))
    assert scenario_of(tmp_path, file="whole.zip").frame_count == 1
    with pytest.raises(ScenarioError, match="azimuth_deg belongs to a picture"):
        scenario_of(tmp_path, file="whole.zip", azimuth_deg=3.0)
