"""`skybench presets`: every name of the scenario language, with values that a scenario has by that name."""

import json

import numpy as np
import pytest
from small_scenes import BASE
from typer.testing import CliRunner

from benchmark.cli.app import app
from generator import presets
from generator.light.lamps import lamp_spectra
from generator.scenario.model import NAMED_ATTITUDES, FrameSpec
from generator.scenario.presets.camera_presets import PRESETS
from generator.scenario.presets.own_values import OWN_VALUES
from generator.scenario.quantum_efficiency import QE_CURVES
from generator.sky.zenith import BORTLE_ZENITH_MAG

# A whole number of video frames.
FRAME = {"site": BASE["site"], "time": BASE["time"] | {"exposure_s": 1.0}}


def names_of(kind: str) -> set[str]:
    return {named.name for named in presets.all_named() if named.kind == kind}


def test_every_name_of_the_language_is_listed() -> None:
    assert names_of(presets.CAMERA) == set(PRESETS)
    assert names_of(presets.CURVE) == set(QE_CURVES)
    assert names_of(presets.ATTITUDE) == set(NAMED_ATTITUDES)
    assert names_of(presets.SKY) == {f"bortle-{bortle}" for bortle in BORTLE_ZENITH_MAG}
    assert names_of(presets.LAMP) == set(lamp_spectra())
    assert len({named.name for named in presets.all_named()}) == len(presets.all_named())
    assert all(named.source and named.title for named in presets.all_named())


@pytest.mark.parametrize("name", PRESETS)
def test_values_and_defaults_of_a_camera_make_the_same_camera_without_the_name(name: str) -> None:
    preset = presets.preset_named(name)
    by_name = FrameSpec.model_validate(FRAME | {"camera": {"preset": name}})
    written = {part: merged(preset.defaults[part], preset.values[part]) for part in ("camera", "sensor")}
    by_values = FrameSpec.model_validate(FRAME | written)
    assert by_values.camera == by_name.camera.model_copy(update={"preset": None})
    assert by_values.sensor == by_name.sensor


@pytest.mark.parametrize("bortle", [1, 9])
def test_a_sky_is_that_of_its_values(bortle: int) -> None:
    values = presets.preset_named(f"bortle-{bortle}").values
    camera = {"preset": "thesis-720p"}
    spec = FrameSpec.model_validate(FRAME | {"camera": camera, "sky": values})
    assert spec.sky.zenith_mag_arcsec2 == BORTLE_ZENITH_MAG[bortle]


def test_a_camera_is_shown_whole() -> None:
    run = CliRunner().invoke(app, ["presets", "imx477-6mm"], env={"COLUMNS": "160"})
    assert run.exit_code == 0, run.output
    for words in ("strollswithmydog.com", "camera: {preset: NAME}", "sensor.full_well_e", "8180.0", "default"):
        assert words in run.stdout


def test_values_without_a_source_are_labelled() -> None:
    """Every preset has its list; what it names is among the preset's values, and `skybench presets` prints it."""
    assert set(OWN_VALUES) == set(PRESETS)
    for name, keys in OWN_VALUES.items():
        given = {f"{part}.{key}" for part in ("camera", "sensor") for key in getattr(PRESETS[name], part)}
        assert set(keys) <= given, name
        assert len(set(keys)) == len(keys)
    sources = {named.name: named.source for named in presets.all_named()}
    assert "skybench's own, of the usual size: camera.k, " in sources["pixel-8-main"]


@pytest.mark.parametrize("name", ["uav-pregius-8mm", "machine-vision-mono"])
def test_front_illuminated_pixels_have_the_published_quantum_efficiency(name: str) -> None:
    """Basler states 70 % at 545 nm for its acA4112-30u, whose pixels of 3.45 um are those of the presets (docs.baslerweb.com,
    "About EMVA1288 Reports for Color Sensors")."""
    spec = FrameSpec.model_validate(FRAME | {"camera": {"preset": name}})
    points = np.array(spec.sensor.quantum_efficiency)
    assert np.interp(545, *points.T) == pytest.approx(0.70, abs=0.01)
    assert points[:, 1].max() < 0.75


def test_the_high_quality_camera_reads_out_at_its_drivers_pace() -> None:
    """imx477.c of raspberrypi/linux: `line_length_pix` 0x5dc0 at `IMX477_PIXEL_RATE` 840 MHz in the mode of 4056 x 3040
    pixels, which has ten frames a second."""
    spec = FrameSpec.model_validate(FRAME | {"camera": {"preset": "imx477-6mm"}})
    assert spec.sensor.rolling_shutter is not None
    assert spec.sensor.rolling_shutter.line_time_us == pytest.approx(0x5DC0 / 840, abs=0.01)
    assert 0.08 < spec.sensor.read_out_s(spec.camera.height) < 0.1


def test_an_unknown_name_is_refused_with_those_that_exist() -> None:
    run = CliRunner().invoke(app, ["presets", "imx999"])
    assert run.exit_code == 2
    assert "imx477-6mm" in run.stderr


def test_json_has_all_values() -> None:
    answer = json.loads(CliRunner().invoke(app, ["presets", "--json"]).stdout)
    assert {entry["named"]["name"] for entry in answer} == {named.name for named in presets.all_named()}
    (curve,) = [entry for entry in answer if entry["named"]["name"] == "cmos-red"]
    assert [tuple(point) for point in curve["values"]["quantum_efficiency"]] == list(QE_CURVES["cmos-red"])


def merged(tree: dict, over: dict) -> dict:
    """A tree with another one's values over its own."""
    both = {key: merged(tree[key], over[key]) for key in tree.keys() & over.keys() if isinstance(over[key], dict)}
    return tree | over | both
