"""Peers' adapters against their libraries' own examples and conventions; skipped where a library is not installed."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import shutil
import subprocess

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image
from unit.benchmark.exact_fields import FISHEYE, PINHOLE, PLACE, image_of, stars_in, told

import celnav
from benchmark.judge.geodesy import geodesic_km
from benchmark.protocol import CameraRecord, Observation
from benchmark.run.contestants import contestant_of
from benchmark.solvers.definition import FOLDER, environments_folder
from benchmark.solvers.detected_points import Points
from benchmark.solvers.pinhole import WIDEST_DEG, pinhole_view
from benchmark.solvers.star_naming import named_matches, star_ids_at
from celnav.sky.catalog import load_catalog, propagate

PEERS = {
    "tetra3rs": ("tetra3rs", "Tetra3rs"),
    "ruststartracker": ("ruststartracker", "RustStarTracker"),
    "zenith": ("zenith_fixer", "ZenithFixer"),
}


def peer(library):
    """The adapter of a library that is installed."""
    pytest.importorskip(library, reason=f"{library} is not installed: pip install 'skybench[peers]'")
    folder, name = PEERS[library]
    module = __import__(f"benchmark.solvers.{folder}.adapter", fromlist=[name])
    return getattr(module, name)()


@pytest.mark.parametrize(("library", "limit_km"), [("tetra3rs", 0.15), ("ruststartracker", 0.05), ("zenith", 0.35)])
@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
def test_exact_positions_of_stars_give_the_place_and_their_names(library, limit_km, camera):
    solver, observation = peer(library), told(camera)
    ids, uv, flux = stars_in(observation)
    answer = solver.solve(Points(uv, flux), observation)
    assert answer.ok, answer.reason
    # A fisheye's pixel is twice as large, and a pinhole that shows it stretches its edges.
    assert geodesic_km(*PLACE, answer.lat_deg, answer.lon_deg) < limit_km * (1.0 if camera is PINHOLE else 4.0)
    if library != "zenith":  # which names no detections
        assert len(answer.matches) >= 10
        assert (ids[answer.matches[:, 0]] == answer.matches[:, 1]).mean() > 0.95


@pytest.mark.parametrize("library", list(PEERS))
def test_detectors_count_from_the_middle_of_the_first_pixel(library):
    solver, observation = peer(library), told(PINHOLE)
    found = solver.detect(image_of(observation))
    _, uv, _ = stars_in(observation, 4.5)
    offsets = np.array([(found.uv - star)[np.argmin(np.hypot(*(found.uv - star).T))] for star in uv])
    near = offsets[np.hypot(*offsets.T) < 1.5]
    assert len(near) >= 10
    np.testing.assert_allclose(np.median(near, axis=0), 0.0, atol=0.1)


def test_tetra3rs_as_its_guide_solves_an_image():
    """`extract_centroids` of an image, its centroids to `solve_from_centroids` with the field of view: the same attitude."""
    solver, observation = peer("tetra3rs"), told(PINHOLE)
    import tetra3rs

    image = image_of(observation)
    database = tetra3rs.SolverDatabase.generate_from_gaia(max_fov_deg=70.0, epoch_proper_motion_year=2020.0)
    guide = database.solve_from_centroids(
        tetra3rs.extract_centroids(image).centroids, fov_estimate_deg=60.0, fov_max_error_deg=5.0,
        image_shape=image.shape,
    )  # fmt: skip
    assert guide
    from benchmark.solvers.tetra3rs.adapter import Tetra3rs, solve_frame

    found, _, _ = solve_frame(Tetra3rs({}).detect(image), observation)
    turn = np.asarray(guide.rotation_matrix_icrs_to_camera) @ np.asarray(found.rotation_matrix_icrs_to_camera).T
    np.testing.assert_allclose(turn, np.eye(3), atol=1e-6)
    assert solver.solve(solver.detect(image), observation).ok


def test_tetra3rs_with_calibration_finds_the_focal_length_of_a_frame():
    """The lens fitted to a frame whose supplied focal length is 2 % off has the right one, and solves the frame again."""
    peer("tetra3rs")
    from benchmark.solvers.tetra3rs.adapter import Tetra3rs, solve_frame
    from benchmark.solvers.tetra3rs_calibrated.adapter import Tetra3rsCalibrated, solved_again

    exact = told(PINHOLE)
    wrong = dataclasses.replace(PINHOLE, f_px=1.02 * PINHOLE.f_px, fy_px=1.02 * PINHOLE.fy_px)
    observation = dataclasses.replace(exact, camera=wrong)
    found = Tetra3rs().detect(image_of(exact))
    first, _, stars = solve_frame(found, observation)
    again = solved_again(first, stars, found, observation)
    assert again
    assert again.camera_model.focal_length_px == pytest.approx(PINHOLE.f_px, rel=1e-3)
    assert again.rmse_arcsec < 0.5 * first.rmse_arcsec
    answer = Tetra3rsCalibrated().solve(found, observation)
    assert geodesic_km(answer.lat_deg, answer.lon_deg, *PLACE) < 5.0


def test_ruststartracker_as_its_readme_processes_an_image():
    """`process_image` of an 8-bit image: the quaternion of the adapter's detections and rays is the same."""
    solver, observation = peer("ruststartracker"), told(PINHOLE)
    from ruststartracker.libruststartracker import get_threshold_from_histogram

    from benchmark.solvers.ruststartracker.adapter import tracker

    image = np.clip((image_of(observation).astype(float) - 400.0) / 40.0, 0.0, 255.0).astype(np.uint8)
    own = tracker(PINHOLE.f_px, PINHOLE.width, PINHOLE.height, solver.min_matches, 1.0)
    threshold = get_threshold_from_histogram(image, fraction=0.99)
    readme = own.process_image(image, threshold=threshold)
    uv = own.get_centroids(image, threshold=threshold)
    ours = own.process_observation_vectors(pinhole_view(uv.astype(float), PINHOLE).rays)
    assert readme.n_matches >= solver.min_matches
    np.testing.assert_allclose(np.abs(readme.quat @ ours.quat), 1.0, atol=1e-6)


def test_zenith_fixer_as_its_quickstart_fixes_a_scene_of_its_own():
    """`synthesize_scene` and `resolve_fix` of its quickstart: the adapter gives the same place from the scene's pixels."""
    solver = peer("zenith")
    import zenith

    catalogue = zenith.bundled_catalog()
    utc = (2026, 7, 14, 21, 0, 0.0)
    scene = zenith.synthesize_scene(
        catalogue, 51.5, -0.1, zenith.julian_date(*utc), 10.0, 1280, 960, 1400.0, 5.5, 0.0, 0.0, 40.0, 7
    )
    own = zenith.resolve_fix(scene.pixels, 1400.0, 640.0, 480.0, scene.up_cam, utc, catalogue)
    assert zenith.great_circle_nm(own.latitude_deg, own.longitude_deg, 51.5, -0.1) < 1.0
    up = np.array(scene.up_cam)
    across = np.linalg.svd(up[None])[2][1:]
    R_cam = np.column_stack((*across, up))
    camera = CameraRecord("pinhole", 1280, 960, 1400.0, 1400.0, 640.0, 480.0)
    observation = Observation(camera, "2026-07-14T21:00:00Z", R_cam, heading_sigma_deg=np.inf)
    found = zenith.detect_centroids(scene.pixels, 60)
    answer = solver.solve(
        Points(np.array([one[:2] for one in found]), np.array([one[2] for one in found])), observation
    )
    assert geodesic_km(own.latitude_deg, own.longitude_deg, answer.lat_deg, answer.lon_deg) < 0.02


@pytest.mark.parametrize("latitude_deg", [0.5, 75.0])
def test_zenith_fixers_covariance_is_the_ellipse_that_it_prints(latitude_deg):
    """`ellipse_2sigma_nm`: semi-axes in nautical miles and the azimuth of the longer one; told errors are added to it."""
    peer("zenith")
    import zenith

    from benchmark.solvers.zenith_fixer.adapter import position_covariance

    utc = (2026, 7, 14, 21, 0, 0.0)
    stars, date = zenith.bundled_catalog(), zenith.julian_date(*utc)
    scene = zenith.synthesize_scene(
        stars, latitude_deg, -0.1, date, 10.0, 1280, 960, 1400.0, 5.5, 0.0, 0.0, 40.0, 7
    )  # fmt: skip
    fix = zenith.resolve_fix(scene.pixels, 1400.0, 640.0, 480.0, scene.up_cam, utc, stars)
    cov_km2 = position_covariance(fix.covariance, latitude_deg, told(PINHOLE))
    variances, axes = np.linalg.eigh(cov_km2)
    longer_nm, shorter_nm, azimuth_deg = fix.ellipse_2sigma_nm
    np.testing.assert_allclose(2.0 * np.sqrt(variances) / 1.852, [shorter_nm, longer_nm], rtol=2e-3)
    east, north = axes[:, 1]
    assert np.degrees(np.arctan2(east, north)) % 180.0 == pytest.approx(azimuth_deg % 180.0, abs=0.01)
    tilted = dataclasses.replace(told(PINHOLE), tilt_sigma_deg=0.1, utc_sigma_s=1.0)
    added = position_covariance(fix.covariance, latitude_deg, tilted) - cov_km2
    tilt_km, time_km = 6371.0 * np.radians(0.1), 0.4646 * np.cos(np.radians(latitude_deg))
    np.testing.assert_allclose(added, np.diag([tilt_km**2 + time_km**2, tilt_km**2]), rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
def test_a_pinhole_view_shows_the_rays_of_any_lens(camera):
    lens = celnav.Camera.from_dict(dataclasses.asdict(camera))
    uv = np.array([[10.0, 20.0], [400.0, 240.0], [camera.width / 2, camera.height / 2]])
    view = pinhole_view(uv, camera)
    np.testing.assert_allclose(view.rays, lens.to_rays(uv[view.rows]), atol=1e-12)
    assert view.fov_deg == pytest.approx(60.0 if camera is PINHOLE else WIDEST_DEG, abs=0.1)


def test_names_are_those_of_the_catalogue_and_no_star_has_none():
    stars = load_catalog()
    rows = np.flatnonzero((stars.v_mag < 4.0) & (stars.hip > 0))[:50]
    places = propagate(stars.vectors[rows], stars.motion[rows], 2020.0 - stars.epoch_jyear[rows])
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    expected = stars.star_id[rows].copy()
    expected[expected == 71681] = 71683  # of alpha Centauri the brighter one is meant
    np.testing.assert_array_equal(star_ids_at(places), expected)
    pole = np.array([[0.001, 0.001, 1.0]]) / np.linalg.norm([0.001, 0.001, 1.0])
    assert star_ids_at(pole).tolist() == [0]
    twice = named_matches(np.array([4, 2, 4, 7]), np.vstack((places[:3], pole)))
    assert twice.tolist() == [[4, stars.star_id[rows[0]]], [2, stars.star_id[rows[1]]]]


def test_an_absent_program_is_named_with_what_installs_it(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    obstacle = contestant_of("astrometry-net").obstacle()
    assert obstacle == (
        "astrometry-net: needs the program solve-field; install with: "
        "apt-get install -y astrometry.net astrometry-data-tycho2"
    )


@pytest.mark.journey  # half a minute of searching
@pytest.mark.skipif(shutil.which("solve-field") is None, reason="astrometry.net is not installed")
def test_astrometry_net_as_its_manual_solves_a_list_of_positions(tmp_path):
    """`solve-field` on positions of stars within 20 deg: the same centre as the program's rotation gives."""
    program = load_program("astrometry-net")
    camera = CameraRecord("pinhole", 640, 480, 1814.0, 1814.0, 319.5, 239.5)
    observation = told(camera)
    _, uv, _ = stars_in(observation, 8.0)
    request = {
        "camera": dataclasses.asdict(camera),
        "detections": {"uv": uv.tolist()},
        "image": None,
        "time_limit_s": 200.0,  # found in some ten seconds; a busy machine changes no answer here
    }
    (tmp_path / "ours").mkdir()
    answer = program.solve(request, tmp_path / "ours")
    assert answer["status"] == "attitude", answer
    # It accepts odds of a thousand million to one by default (--odds-to-solve).
    assert 1.0 - 1e-9 < answer["confidence"] <= 1.0
    program.write_detections(uv, tmp_path / "stars.xyls")
    manual = [
        "solve-field", "stars.xyls", "--width", "640", "--height", "480", "--no-plots", "--no-tweak", "--crpix-center",
        "--scale-low", "18", "--scale-high", "22", "--depth", "60",
    ]  # fmt: skip
    subprocess.run(manual, cwd=tmp_path, check=True, capture_output=True)
    header = fits.getheader(tmp_path / "stars.wcs")
    ra, dec = np.radians([header["CRVAL1"], header["CRVAL2"]])
    centre = np.array([np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)])
    assert np.degrees(np.arccos(centre @ np.array(answer["R_icrs_to_camera"])[2])) < 0.02


def load_program(folder):
    spec = importlib.util.spec_from_file_location("program_of_a_peer", FOLDER / folder / "program.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_cedar_solve_as_its_readme_solves_an_image(tmp_path):
    """`solve_from_image` with the field of view: the boresight and the roll of the program's rotation."""
    python = environments_folder() / "cedar-solve" / "bin" / "python"
    if not python.is_file():
        pytest.skip("cedar-solve has no environment: skybench bench run prints the command that makes it")
    camera = CameraRecord("pinhole", 640, 480, 1194.3, 1194.3, 319.5, 239.5)
    Image.fromarray(image_of(told(camera), faintest=8.0)).save(tmp_path / "field.png")
    code = (
        "import json, logging, sys; logging.disable(logging.CRITICAL)\n"
        f"sys.path.insert(0, {str(FOLDER / 'cedar-solve')!r})\n"
        "import program, tetra3, numpy as np; from PIL import Image\n"
        "base = tetra3.Tetra3(); path = sys.argv[1]\n"
        "camera = {'width': 640, 'height': 480, 'f_px': 1194.3, 'fy_px': 1194.3, 'cx_px': 319.5, 'cy_px': 239.5}\n"
        "request = {'camera': camera, 'detections': None, 'image': path, 'time_limit_s': 10.0}\n"
        "ours = program.answer(tetra3, {30.0: base}, request)\n"
        "with Image.open(path) as picture: pixels = np.asarray(picture).astype(np.float32)\n"
        "theirs = base.solve_from_image(Image.fromarray(pixels), fov_estimate=30.0)\n"
        "print(json.dumps([ours['R_icrs_to_camera'], {key: float(theirs[key]) for key in ('RA', 'Dec', 'Roll')}]))"
    )
    done = subprocess.run([python, "-c", code, tmp_path / "field.png"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rotation, theirs = json.loads(done.stdout.splitlines()[-1])
    ra, dec = np.radians([theirs["RA"], theirs["Dec"]])
    centre = np.array([np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)])
    assert np.degrees(np.arccos(min(1.0, centre @ np.array(rotation)[2]))) < 0.01
    # Roll: north counter-clockwise from up. Towards north from the boresight, in the image.
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    right, down, _ = np.array(rotation) @ north
    assert np.degrees(np.arctan2(-right, -down)) % 360.0 == pytest.approx(theirs["Roll"] % 360.0, abs=0.05)
