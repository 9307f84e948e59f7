"""Lamps in view and on the landscape: published photometry against electrons, and truth."""

import dataclasses

import numpy as np
import pytest
import yaml
from PIL import Image
from small_scenes import BASE, V_BAND_QE

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.object_table import object_table
from generator.frame.plan import plan_frame
from generator.ground.lamp import KINDS, Lamp, spectrum
from generator.ground.lighting import lamp_illuminance
from generator.ground.panorama import Panorama, reduced
from generator.light.lamps import luminous
from generator.light.photometry import BESSELL_V, GRID_NM
from generator.scenario.file import parse_scenario

CAMERA = {"width": 120, "height": 90, "f_px": 100.0, "aperture_mm": 5.0, "bloom": {"share": 0}, "veiling_glare": 0}
LAMP = {"azimuth_deg": 180.0, "altitude_deg": 12.0, "distance_m": 500.0, "intensity_cd": 1000.0}


def frame_with(folder, foreground, **overrides):
    tree = BASE | {"camera": CAMERA, "attitude": {"azimuth_deg": 180.0, "altitude_deg": 10.0}, "sky": {}}
    tree |= {"stars": {"limiting_magnitude": -2.0}, "foreground": foreground} | overrides
    plan = plan_frame(parse_scenario(yaml.safe_dump(tree), str(folder / "scene.yaml")), 0)
    return plan, render_expected(plan)


@pytest.mark.parametrize("kind", ["HPS", "LED", "mercury"])
def test_a_lamp_s_electrons_follow_from_its_candela(tmp_path, kind) -> None:
    """1000 cd at 500 m are 4 mlx; a camera with Bessell's V as its quantum efficiency sees that lamp's V, by its zero point.

    The lux of each kind of lamp of V = 0 are tested in tests/physics/test_lumens.py.
    """
    sensor = {"quantum_efficiency": V_BAND_QE}
    air = {"extinction": False, "refraction": False}
    plan, frame = frame_with(tmp_path, {"lamps": [LAMP | {"kind": kind}]}, sensor=sensor, atmosphere=air)
    table = object_table(plan, frame).to_pylist()
    assert [row["kind"] for row in table] == ["lamp"]
    lux = 1000 / 500**2
    v_mag = -2.5 * np.log10(lux / float(luminous(BESSELL_V.zero_point * spectrum(kind))))
    photons = 1003.3e5 * np.trapezoid([point[1] for point in V_BAND_QE], [point[0] for point in V_BAND_QE])
    area = np.pi / 4 * 0.005**2 * np.cos(np.radians(2.0))
    expected = photons * 10 ** (-0.4 * v_mag) * area * 0.5 * plan.spec.camera.transmission
    assert table[0]["v_mag"] == pytest.approx(v_mag, abs=1e-4)
    assert table[0]["electrons_e"] == pytest.approx(expected, rel=0.01)
    assert frame.electrons.sum() == pytest.approx(expected, rel=0.01)
    assert (table[0]["centroid_u_px"], table[0]["centroid_v_px"]) == pytest.approx(
        (59.5, 44.5 - 100 * np.tan(np.radians(2.0))), abs=1e-3
    )


def test_air_dims_a_far_lamp(tmp_path) -> None:
    """Through 10 km of air with an aerosol depth of 0.1 over 1.5 km and 0.097 of gas over 8 km: exp(-0.79)."""
    far = LAMP | {"distance_m": 10_000.0}
    sensor = {"quantum_efficiency": V_BAND_QE}
    dim, clear = (
        frame_with(tmp_path, {"lamps": [far]}, sensor=sensor, atmosphere={"extinction": on})[1].electrons.sum()
        for on in (True, False)
    )
    assert dim / clear == pytest.approx(np.exp(-10 * (0.1 / 1.5 + 0.097 / 8)), rel=0.02)


def test_a_lamp_stands_in_front_and_shines_below_the_horizon(tmp_path) -> None:
    rgba = np.full((90, 180, 4), 255, np.uint8)
    Image.fromarray(rgba).save(tmp_path / "wall.png")
    low = LAMP | {"altitude_deg": -1.0}
    _, frame = frame_with(tmp_path, {"lamps": [LAMP, low], "landscape": {"file": "wall.png"}})
    assert (frame.lamps.hidden_fraction == 0).all()
    assert (frame.lamps.electrons > 0).all()
    assert frame.lamps.electrons[1] == pytest.approx(frame.lamps.electrons[0], rel=0.03)


def test_a_very_near_lamp_keeps_its_light(tmp_path) -> None:
    """A floodlight of 1e6 cd at 20 m, 30 s: more electrons than the integers of the splats hold, none lost."""
    bright = LAMP | {"intensity_cd": 1e6, "distance_m": 20.0}
    time = BASE["time"] | {"exposure_s": 30.0}
    weak = LAMP | {"intensity_cd": 1.0, "distance_m": 20.0}
    sums = [
        frame_with(tmp_path, {"lamps": [lamp]}, time=time)[1].electrons.sum(dtype=np.float64) for lamp in (bright, weak)
    ]
    assert sums[0] > 1e12
    assert sums[0] / sums[1] == pytest.approx(1e6, rel=1e-3)


def test_a_lamp_lights_the_ground_and_a_wall_by_the_inverse_square() -> None:
    """E = I cos / r^2 on level ground below the camera and on an upright wall, computed by hand at two places."""
    rgba = np.full((180, 360, 4), 255, np.uint8)
    layers = reduced(Panorama(rgba[..., :3], rgba[..., 3]), 1.0)
    lamp = Lamp(0.5, float(np.degrees(np.arctan2(6.4, 10.0))), float(np.hypot(6.4, 10.0)), 100.0, 900.0)
    lux = lamp_illuminance(layers, (lamp,), (1.6, 30.0))
    # Straight under the lamp, 10 m to the north: 8 m above the ground.
    depth = 90 + np.degrees(np.arctan2(1.6, 10.0))
    assert lux[int(depth), 0] == pytest.approx(900 / 64, rel=0.05)
    # The wall 30 m to the north faces the camera and the lamp, which hangs 20 m before it.
    assert lux[89, 0] == pytest.approx(900 * 20 / np.hypot(20, 6.14) ** 3, rel=0.01)
    # The wall to the south at 30 m: 40 m from the lamp, 6.4 m lower.
    place = np.array([0.0, -30.0, 30 * np.tan(np.radians(0.5))])
    away = lamp.place_m - place
    expected = 900 * away[1] / np.linalg.norm(away) ** 3
    assert lux[89, 180] == pytest.approx(expected, rel=0.01)


def test_spectra_of_all_kinds_are_scaled_to_v() -> None:
    for kind in KINDS:
        assert BESSELL_V.mean(GRID_NM, spectrum(kind)) == pytest.approx(1, rel=1e-6)
    red = spectrum("red")
    assert GRID_NM[np.argmax(red)] == 630


def test_bad_lamps_are_refused(tmp_path) -> None:
    for change, words in (({"kind": "neon"}, "lamps.0.kind"), ({"distance_m": 0}, "lamps.0.distance_m")):
        with pytest.raises(ScenarioError, match=words):
            frame_with(tmp_path, {"lamps": [LAMP | change]})


def test_lamps_have_a_layer_of_their_own(tmp_path) -> None:
    plan, _ = frame_with(tmp_path, {"lamps": [LAMP]}, sky={"bortle": 4})
    frame = render_expected(plan, layers=True)
    assert frame.layers["lamps"].sum() == pytest.approx(frame.lamps.electrons.sum(), rel=0.01)
    assert dataclasses.fields(frame)
