"""The options --ground and --mask of `skybench twin` with a dataset of photographs: what they take from its records."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from astropy.io import fits
from PIL import Image
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import celnav
from benchmark.cli.app import app
from benchmark.errors import PhotographError
from benchmark.importing.told import ToldCamera
from benchmark.importing.write import Import, import_photographs
from benchmark.photographed.alignment import directions
from benchmark.photographed.view import view_of
from benchmark.place import Place
from benchmark.twin import of_source, render_twin
from benchmark.twin.ground import check_fixed
from benchmark.twin.scene import read_scene

SITE = Place(52.0, 4.36, 10.0)
CAMERA = celnav.Camera("equidistant", 480, 400, f_px=125.0)
MOUNT = np.array(celnav.Attitude.zenith_north_up().rows)
TURNED = Rotation.from_rotvec([0, 0, 40], degrees=True).as_matrix()
"""North is 40 deg from where the scene's camera has it."""
SCENE: dict[str, Any] = {
    "name": "elsewhere",
    "site": {"latitude_deg": -30.0, "longitude_deg": 10.0, "height_m": 500.0},
    "time": {"utc_start": "2020-01-24T19:30:00Z", "exposure_s": 30.0},
    "camera": {
        "model": "equidistant",
        "width": 400,
        "height": 400,
        "hfov_deg": 180.0,
        "image_circle_px": 190.0,
        "aperture_mm": 3.0,
    },
    "sensor": {"bits": 16, "gain_e_per_dn": 0.5},
    "attitude": {"azimuth_deg": 90.0, "altitude_deg": 60.0},
    "sky": {"bortle": 4},
}
TREE_DEG = (80.0, 100.0, 22.0)
"""A tree in the photographs: its azimuths, and its highest altitude."""


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two photographs by a fixed fisheye in front of a tree, without stars: the attitude is that told."""
    folder = tmp_path_factory.mktemp("fisheye")
    R_cam = MOUNT @ TURNED
    view = view_of(CAMERA, R_cam)
    azimuth, altitude = np.nan_to_num(view.azimuth_deg), np.nan_to_num(view.altitude_deg, nan=-90)
    tree = (azimuth > TREE_DEG[0]) & (azimuth < TREE_DEG[1]) & (altitude < TREE_DEG[2])
    paths = []
    for number, light in enumerate((1500.0, 4000.0)):
        dn = np.where(altitude > 0, np.where(tree, 0.3, 1.0) * light, 0.0)
        pixels = np.random.default_rng(number).normal(dn + 500, 10).clip(0).astype(np.uint16)
        unit = fits.PrimaryHDU(pixels)
        unit.header.update({"DATE-OBS": f"2020-01-15T2{number}:00:00", "EXPTIME": 10.0})
        unit.writeto(folder / f"night_{number}.fits")
        paths.append(folder / f"night_{number}.fits")
    told = ToldCamera(CAMERA, R_cam, 0.05, 0.05)
    import_photographs(Import("night", paths, SITE, told), folder / "set")
    return folder / "set"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene with another camera, which looks elsewhere, at another place."""
    path = tmp_path / "elsewhere.yaml"
    path.write_text(yaml.safe_dump(SCENE), encoding="utf-8")
    return path


def run(*words: object) -> Any:
    return CliRunner().invoke(app, ["twin", *map(str, words)])


def test_the_ground_is_seen_by_lens_and_attitude_of_the_records(imported: Path, scene: Path, tmp_path: Path) -> None:
    told = run(imported, "--scene", scene, "--ground", tmp_path / "ground.png")
    assert told.exit_code == 0, told.output
    with Image.open(tmp_path / "ground.png") as picture:
        alpha = np.asarray(picture)[..., 3]

    def covered(azimuth_deg: float, altitude_deg: float) -> bool:
        """Whether the fisheye picture (north at the top, east on the left) has ground in a direction."""
        east, north, _ = directions(np.array([azimuth_deg]), np.array([altitude_deg]))[0]
        out = (90 - altitude_deg) / 90 * alpha.shape[0] / 2 / np.hypot(east, north)
        middle = (alpha.shape[0] - 1) / 2
        return bool(alpha[round(middle - out * north), round(middle - out * east)])

    assert covered(90, 10)
    assert covered(85, 17)
    assert not any(covered(azimuth, 10) for azimuth in (30, 60, 120, 180, 270, 330))
    assert not covered(90, 30)


def test_a_scene_takes_the_ground_and_its_twin_has_it(imported: Path, scene: Path, tmp_path: Path) -> None:
    """Ground of another scene is replaced by that of the photographs, in the scenario of which twins are made."""
    assert run(imported, "--scene", scene, "--ground", tmp_path / "ground.png").exit_code == 0
    with_ground = SCENE | {"foreground": {"landscape": {"file": "ground.png", "projection": "fisheye"}}}
    scene.write_text(yaml.safe_dump(with_ground), encoding="utf-8")
    from benchmark.twin.sources import sources_of
    from generator.frame.exposure.expected import render_expected
    from generator.frame.plan import plan_frame

    own, photograph = sources_of([imported])[0].read(read_scene(scene))
    expected = render_expected(plan_frame(own.scenario, 0), False, False)
    ground = render_twin.ground_of(expected, photograph.pixels.shape)
    uv = own.camera.project(directions(np.array([90.0, 180.0]), np.array([10.0, 10.0])) @ own.spec.R_cam.T)
    (tree, sky) = np.rint(uv).astype(int)
    assert ground[tree[1], tree[0]]
    assert not ground[sky[1], sky[0]]
    # The photograph's tree is where the twin's is.
    assert photograph.pixels[tree[1], tree[0]] < 0.6 * photograph.pixels[sky[1], sky[0]]


def test_a_mask_hides_pixels_of_every_photograph(
    imported: Path, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    white = np.full((CAMERA.height, CAMERA.width), 255, np.uint8)
    white[300:, :200] = 0
    Image.fromarray(white).save(tmp_path / "mask.png")
    seen = []

    def stopped(scene: object, photograph: Any, folder: Path, **given: Any) -> None:
        seen.append((photograph.name, given["not_sky"]))
        raise PhotographError("enough")

    monkeypatch.setattr(of_source, "make_twin", stopped)
    words = (imported, "--scene", scene, "--out", tmp_path / "out", "--mask", tmp_path / "mask.png")
    assert "enough" in run(*words).stderr
    ((name, hidden),) = seen
    assert name == "night_0"
    assert (hidden == (white == 0)).all()
    # The size is the record's, not the scene's.
    Image.fromarray(white[:, :400]).save(tmp_path / "small.png")
    refused = run(*words[:-1], tmp_path / "small.png")
    assert refused.exit_code == 2
    assert "small.png: has 400 x 400 pixels, the camera 480 x 400" in " ".join(refused.stderr.split())


@pytest.mark.parametrize("option", ["--mask", "--passing"])
def test_options_that_the_ground_has_no_use_for_are_refused(
    imported: Path, scene: Path, tmp_path: Path, option: str
) -> None:
    given = tmp_path / "given"
    given.write_text("{}", encoding="utf-8")
    refused = run(imported, "--scene", scene, "--ground", tmp_path / "ground.png", option, given)
    assert refused.exit_code == 2
    assert f"leave {option} " in " ".join(refused.stderr.split())
    assert not (tmp_path / "ground.png").exists()


def test_a_camera_that_moved_has_no_one_ground() -> None:
    first = (CAMERA, MOUNT)
    check_fixed("here", (CAMERA, MOUNT @ Rotation.from_rotvec([0.9, 0, 0], degrees=True).as_matrix()), first)
    with pytest.raises(PhotographError, match=r"moved: its camera looks up to 2 deg away"):
        check_fixed("moved", (CAMERA, MOUNT @ Rotation.from_rotvec([0, 2, 0], degrees=True).as_matrix()), first)
    longer = celnav.Camera("equidistant", 480, 400, f_px=130.0)
    with pytest.raises(PhotographError, match="photographs of one fixed camera"):
        check_fixed("zoomed", (longer, MOUNT), first)
