"""Lenses of RMS' platepars: every type of distortion against RMS' published formulae, written out for one star at a time."""

import json
import math

import numpy as np
import pytest

from celnav.camera import Camera
from celnav.command.camera_file import read_camera_file
from celnav.command.platepar import TYPES, lens_of_platepar, plane_of_platepar
from celnav.errors import CameraError

WIDTH, HEIGHT, SCALE = 1280, 720, 15.6
RADIAL = {
    "radial3-all": (-0.02, 0.03),
    "radial4-all": (-0.01, 0.02, 0.01),
    "radial5-all": (-0.01, 0.02, 0.005, 0.004),
    "radial3-odd": (0.05,),
    "radial5-odd": (0.04, 0.01),
    "radial7-odd": (0.063, 0.019, 0.0026),
    "radial9-odd": (0.05, 0.01, 0.004, 0.002),
}
CUBIC_X = [3.1, 0.004, -0.002, 1e-6, -2e-6, 3e-6, 4e-8, 1e-9, 3e-8, -2e-9, 2e-5, -1e-6]
CUBIC_Y = [-2.4, 0.003, 0.005, -2e-6, 1e-6, 2e-6, 2e-9, 4e-8, -1e-9, 3e-8, 3e-5, 2e-6]
FURTHER = {"poly3+radial": [], "poly3+radial3": [2e-10], "poly3+radial5": [2e-10, 1e-16]}


def platepar(kind, centre=True, aspect=True, asymmetry=True):
    """A platepar with all terms that are asked for; numbers of a lens of 88 x 47 deg."""
    record = {"F_scale": SCALE, "X_res": WIDTH, "Y_res": HEIGHT, "distortion_type": kind}
    if kind in RADIAL:
        numbers = [-0.023, 0.098] * centre + [0.004] * aspect + [0.0055, 0.31] * asymmetry + list(RADIAL[kind])
        flags = {"force_distortion_centre": not centre, "equal_aspect": not aspect, "asymmetry_corr": asymmetry}
        return record | flags | {"x_poly_fwd": numbers, "y_poly_fwd": [0.5] + [0.0] * (len(numbers) - 1)}
    return record | {"x_poly_fwd": CUBIC_X + FURTHER[kind], "y_poly_fwd": CUBIC_Y + FURTHER[kind]}


def of_one_star(kind, column, row, centre, aspect, asymmetry):
    """Degrees from the axis along columns and rows, by RMS' correction dx, dy of a pixel from the middle of the frame."""
    x, y = column - WIDTH / 2, row - HEIGHT / 2
    if kind in RADIAL:
        x0, y0 = (-0.023 * WIDTH / 2, 0.098 * HEIGHT / 2) if centre else (0.5, 0.5)
        xy = 0.004 if aspect else 0.0
        a1, a2 = (0.0055, 0.31 * 2 * math.pi) if asymmetry else (0.0, 0.0)
        r = math.sqrt((x - x0) ** 2 + ((1 + xy) * (y - y0)) ** 2)
        r += a1 * (1 + xy) * (y - y0) * math.cos(a2) - a1 * (x - x0) * math.sin(a2)
        r /= WIDTH / 2
        powers = [2 * i + 3 for i in range(4)] if kind.endswith("odd") else [2, 3, 4, 5]
        corrected = r + sum(k * r**n for k, n in zip(RADIAL[kind], powers, strict=False))
        grown = corrected / r - 1
        dx = (x - x0) * grown - x0
        dy = (y - y0) * grown * (1 + xy) - y0 * (1 + xy) + y * xy
    else:
        r = math.sqrt((x - CUBIC_X[0]) ** 2 + (y - CUBIC_Y[0]) ** 2)
        cubic = [1, x, y, x**2, x * y, y**2, x**3, x**2 * y, x * y**2, y**3]
        dx = sum(c * t for c, t in zip(CUBIC_X, [*cubic, x * r, y * r], strict=True))
        dy = sum(c * t for c, t in zip(CUBIC_Y, [*cubic, y * r, x * r], strict=True))
        for power, c in zip((3, 5), FURTHER[kind], strict=False):
            dx += c * x * r**power
            dy += c * y * r**power
    return (x + dx) / SCALE, (y + dy) / SCALE


PLACES = [(0.0, 0.0), (1279.0, 719.0), (640.5, 360.25), (100.75, 650.5), (1200.0, 30.0)]


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize(("centre", "aspect", "asymmetry"), [(1, 1, 1), (0, 1, 1), (1, 0, 0), (0, 0, 1), (1, 0, 1)])
def test_every_type_is_mapped_as_rms_does(kind, centre, aspect, asymmetry):
    found = plane_of_platepar(platepar(kind, centre, aspect, asymmetry), np.array(PLACES))
    expected = [of_one_star(kind, u, v, centre, aspect, asymmetry) for u, v in PLACES]
    assert np.abs(found - expected).max() < 1e-9


@pytest.mark.parametrize("kind", ["poly3+radial3", "radial5-all", "radial7-odd"])
def test_the_lens_keeps_the_angles_between_stars(kind, tmp_path):
    """Angles between places all over the frame, by the platepar and by the camera read from its file: as good as it says."""
    path = tmp_path / "platepar_cmn2010.cal"
    path.write_text(json.dumps(platepar(kind)))
    read = read_camera_file(path)
    assert read.kind == "platepar of RMS"
    assert "px rms" in read.assumed[0]
    rays = []
    for u, v in PLACES:
        east, south = of_one_star(kind, u, v, 1, 1, 1)
        off = math.radians(math.hypot(east, south))
        turn = math.atan2(south, east)
        rays.append([math.sin(off) * math.cos(turn), math.sin(off) * math.sin(turn), math.cos(off)])
    expected = np.degrees(np.arccos(np.clip(np.array(rays) @ np.array(rays).T, -1, 1)))
    seen = read.camera.to_rays(np.array(PLACES))
    found = np.degrees(np.arccos(np.clip(seen @ seen.T, -1, 1)))
    stated = lens_of_platepar(platepar(kind)).largest_px
    assert stated < (0.3 if kind.endswith("odd") else 2.0)
    assert np.abs(found - expected).max() * SCALE < 2 * stated
    # Of the scale alone they are off by many pixels.
    alone = Camera("equidistant", WIDTH, HEIGHT, math.degrees(SCALE)).to_rays(np.array(PLACES))
    assert np.abs(np.degrees(np.arccos(np.clip(alone @ alone.T, -1, 1))) - expected).max() * SCALE > 10


def test_the_first_version_has_one_polynomial_and_needs_no_flags():
    record = platepar("poly3+radial")
    first = {"F_scale": SCALE, "X_res": WIDTH, "Y_res": HEIGHT, "x_poly": CUBIC_X, "y_poly": CUBIC_Y}
    uv = np.array(PLACES)
    assert (plane_of_platepar(first, uv) == plane_of_platepar(record, uv)).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distortion_type": "radial6-all"}, "not known"),
        ({"x_poly_fwd": "0.1"}, "list of numbers"),
        ({"x_poly_fwd": [0.0] * 65}, "list of numbers"),
        ({"x_poly_fwd": [0.0, float("nan")]}, "x_poly_fwd"),
        ({"F_scale": 0.0}, "F_scale"),
        ({"X_res": 1280.5}, "whole numbers"),
        ({"x_poly_fwd": [0.0, 0.0, 0.0, 0.0, 0.0, -40.0, 0.0, 0.0]}, "one to one"),
    ],
)
def test_what_is_no_platepar_is_refused(change, message):
    with pytest.raises(CameraError, match=message):
        lens_of_platepar(platepar("radial7-odd") | change)
