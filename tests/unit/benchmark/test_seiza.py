"""seiza's program: its index by the rules of seiza's own builder, its answers against seiza's own example and the truth."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import struct
import subprocess
from itertools import combinations

import numpy as np
import pytest
from PIL import Image
from unit.benchmark.exact_fields import image_of, stars_in, told

from benchmark.protocol import CameraRecord
from benchmark.solvers.definition import FOLDER, environments_folder
from celnav.sky.catalog import load_catalog

PROGRAM = FOLDER / "seiza"
CAMERA = CameraRecord("pinhole", 640, 480, 1194.3, 1194.3, 319.5, 239.5)


def load_index_maker():
    spec = importlib.util.spec_from_file_location("pattern_index_of_seiza", PROGRAM / "pattern_index.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def scattered(number, seed):
    """Right ascension, declination and magnitude of stars all over the sky, 2 to 6.5."""
    random = np.random.default_rng(seed)
    dec = np.degrees(np.arcsin(random.uniform(-1.0, 1.0, number)))
    return random.uniform(0.0, 360.0, number), dec, random.uniform(2.0, 6.5, number)


def in_environment(code, *arguments):
    """What a Python program prints last in the solver's environment, as JSON."""
    python = environments_folder() / "seiza" / "bin" / "python"
    if not python.is_file():
        pytest.skip("seiza has no environment: skybench bench run prints the command that makes it")
    lines = ["import json, sys", f"sys.path.insert(0, {str(PROGRAM)!r})", "import numpy as np, program, seiza", code]
    done = subprocess.run([python, "-c", "\n".join(lines), *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_patterns_are_of_the_brightest_about_a_star_that_none_nearby_outshines():
    maker = load_index_maker()
    ra, dec, mag = scattered(3000, 1)
    order = np.argsort(mag)
    ra, dec, mag = np.radians(ra[order]), np.radians(dec[order]), mag[order]
    stars = np.column_stack((np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)))
    expected = set()
    for radius_deg, faintest in ((6.0, 6.1), (3.0, 7.6)):
        near = (stars @ stars.T >= np.cos(np.radians(radius_deg))) & (mag <= faintest)[:, None] & (mag <= faintest)
        for row in range(len(mag)):
            members = np.flatnonzero(near[row])
            if len(members) and members[0] == row:
                expected |= {tuple(map(int, four)) for four in combinations(members[:6], 4)}
    found = [tuple(map(int, four)) for four in maker.quads_of(stars, mag)]
    assert len(expected) > 500
    assert len(found) == len(set(found))
    assert expected <= set(found)
    # What the two widest radii do not give is nearer together than the third's.
    others = np.array(sorted(set(found) - expected), dtype=int).reshape(-1, 4)
    assert all((stars[four] @ stars[four[0]]).min() > np.cos(np.radians(3.0)) for four in others)


def test_the_file_holds_sorted_keys_and_the_patterns_they_lead_to():
    data = load_index_maker().index_of(*scattered(3000, 1), magnitude_limit=6.5)
    magic, keys_n, candidates_n, patterns_n, limit, longest, bins, schema, stars_n, spare = struct.unpack_from(
        "<8sQQQffIIQQ", data
    )
    assert (magic, limit, longest, bins, schema, stars_n, spare) == (b"SEIZABI1", 6.5, 6.0, 128, 1, 3000, 0)
    assert candidates_n == patterns_n > 500
    keys = np.frombuffer(data, "<u8", keys_n, 64)
    starts = np.frombuffer(data, "<u4", keys_n + 1, 64 + 8 * keys_n)
    candidates = np.frombuffer(data, "<u4", candidates_n, 68 + 12 * keys_n)
    records = np.frombuffer(data, "<f4", offset=68 + 12 * keys_n + 4 * candidates_n).reshape(patterns_n, 11)
    assert (np.diff(keys.astype(object)) > 0).all()
    assert starts[0] == 0
    assert starts[-1] == candidates_n
    assert sorted(candidates) == list(range(patterns_n))
    for place in range(0, keys_n, 50):
        for row in candidates[starts[place] : starts[place + 1]]:
            points = records[row, :8].astype(float).reshape(4, 2)
            apart = np.array([np.hypot(*(one - other)) for one, other in combinations(points, 2)])
            assert apart.max() == pytest.approx(records[row, 10], rel=1e-5)
            shape = (np.sort(apart)[:5] / apart.max() * 128).astype(int)
            assert list(int(keys[place]).to_bytes(5, "big")) == list(shape)
            sums = [sum(np.hypot(*(one - other)) for other in points) for one in points]
            assert sums == sorted(sums)


def test_its_own_example_of_an_unknown_field():
    """`blind_solves_an_unknown_field` of its source: 49,000 stars, 4000 x 3000 px of 6 arcsec, 15 % of them not detected."""
    centre, scale, sizes = in_environment(
        """
random = np.random.default_rng(99)
sky = [np.concatenate(parts) for parts in zip(*(
    (random.uniform(0, 360, n), np.degrees(np.arcsin(random.uniform(-1, 1, n))), random.uniform(a, b, n))
    for n, a, b in ((9000, 2.0, 6.5), (40000, 6.5, 12.0))))]
from pathlib import Path; import tempfile
path = Path(tempfile.mkdtemp()) / "own.idx"
path.write_bytes(program.index_of(*sky, magnitude_limit=12.7))
index, stars = seiza.BlindIndex.open(path), [tuple(map(float, star)) for star in zip(*sky)]
truth = seiza.Wcs.from_center_scale_rotation((212.4, -35.7), (2000.0, 1500.0), 6.0, 74.0, False)
seen = [(truth.world_to_pixel(ra, dec), mag) for ra, dec, mag in stars]
seen = [(*pixel, mag) for pixel, mag in seen if pixel and 0 < pixel[0] < 4000 and 0 < pixel[1] < 3000]
detected = [(x + random.uniform(-0.3, 0.3), y + random.uniform(-0.3, 0.3), 1e6 * 10 ** (-0.4 * mag))
            for x, y, mag in seen if random.uniform() > 0.15]
found = seiza.solve_blind(detected, seiza.StarCatalog.from_stars(stars), index, 4000, 3000,
                          min_scale_arcsec_px=1.0, max_scale_arcsec_px=15.0)
print(json.dumps([found.wcs.pixel_to_world(2000.0, 1500.0), found.scale_arcsec_px, [len(detected), index.pattern_count()]]))
"""
    )
    # The bounds of that example.
    assert sizes[0] > 25
    assert sizes[1] > 1000
    assert np.hypot((centre[0] - 212.4) * np.cos(np.radians(35.7)), centre[1] + 35.7) < 0.01
    assert scale == pytest.approx(6.0, abs=0.05)


ASK = """
tables = program.open_tables()
requests = json.loads(sys.argv[1])
print(json.dumps([program.answer(*tables, request | {"time_limit_s": 10.0}) for request in requests]))
"""


def test_an_image_is_solved_with_the_camera_the_right_way_round(tmp_path):
    observation = told(CAMERA)
    pixels = image_of(observation, faintest=8.0)
    Image.fromarray(pixels).save(tmp_path / "field.png")
    Image.fromarray(pixels[:, ::-1]).save(tmp_path / "mirrored.png")
    ids, uv, flux = stars_in(observation, 8.0)
    camera = dataclasses.asdict(CAMERA)
    asked = [
        {"camera": camera, "detections": None, "image": str(tmp_path / name)} for name in ("field.png", "mirrored.png")
    ]
    asked.append({"camera": camera, "detections": {"uv": uv.tolist(), "flux": flux.tolist()}, "image": None})
    own, mirrored, given = in_environment(ASK, json.dumps(asked))
    assert mirrored["status"] == "refused", mirrored
    catalogue = load_catalog()
    places = dict(zip(catalogue.star_id, catalogue.vectors, strict=True))
    for answer in (own, given):
        assert answer["status"] == "attitude", answer
        assert answer["confidence"] > 0.999999
        rays = np.array([places[star] for star in ids]) @ np.array(answer["R_icrs_to_camera"]).T
        shown = CAMERA.f_px * rays[:, :2] / rays[:, 2:] + [CAMERA.cx_px, CAMERA.cy_px]
        assert np.median(np.hypot(*(shown - uv).T)) < 0.3  # annual aberration and refraction are left in
    assert "detections" not in given
    found = np.array(own["detections"]["uv"])
    offsets = np.array([(found - star)[np.argmin(np.hypot(*(found - star).T))] for star in uv[:40]])
    near = offsets[np.hypot(*offsets.T) < 1.5]
    assert len(near) >= 20
    np.testing.assert_allclose(np.median(near, axis=0), 0.0, atol=0.1)
