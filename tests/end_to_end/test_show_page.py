"""`skybench show`: the page in a real browser (headless Chromium), from disk, without a network."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from browser import chromium
from small_scenes import BASE, small_scenario
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.report.show.page import paged, spread, write_page
from benchmark.report.show.source import open_source
from benchmark.report.show.star_names import star_name
from celnav.sky.star_names import PROPER_NAMES
from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.errors import GeneratorError
from generator.frame.render import render_dataset
from generator.places.catalogue import load_catalogue
from generator.scenario.file import parse_scenario

TRAIL = {
    "kind": "satellite",
    "start": {"azimuth_deg": 100, "altitude_deg": 70},
    "end": {"azimuth_deg": 120, "altitude_deg": 75},
    "v_mag": 1.0,
}
VIEW = {
    "camera": BASE["camera"] | {"width": 240, "height": 160},
    "stars": {"limiting_magnitude": 6.0},
    "foreground": {"trails": [TRAIL]},
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    text = yaml.safe_dump(BASE | VIEW | {"frames": 2, "sky": {"bortle": {"sweep": [2, 5, 8]}}})
    folder = tmp_path_factory.mktemp("show") / "set"
    generate(parse_scenario(text, "set.yaml"), text, folder, DatasetSpec(shard_size=4))
    return folder


@pytest.fixture(scope="module")
def page(dataset) -> Path:
    return write_page(dataset, dataset.with_name("page")).page


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


class Viewer:
    """The open page, by what a user does with it."""

    def __init__(self, driver, page: Path) -> None:
        self.driver = driver
        driver.get_log("browser"), driver.get_log("performance")
        driver.get(page.as_uri())

    def run(self, code: str, *arguments):
        return self.driver.execute_script(code, *arguments)

    def click(self, name: str) -> None:
        self.driver.find_element("id", name).click()

    def open_frame(self, number: int) -> None:
        self.driver.find_elements("css selector", "#sheet button")[number].click()
        self.wait("return document.getElementById('zoom').textContent !== '' && "
                  "document.querySelectorAll('#stars tbody tr').length > 0")  # fmt: skip

    def wait(self, code: str) -> None:
        from selenium.webdriver.support.ui import WebDriverWait

        WebDriverWait(self.driver, 20).until(lambda driver: driver.execute_script(code))

    def fill(self, name: str, value: str) -> None:
        """Give an input a value as a user's hand would."""
        self.run(
            "const f = document.getElementById(arguments[0]); f.value = arguments[1]; f.dispatchEvent(new Event('input'));",
            name, value,
        )  # fmt: skip

    def picture(self) -> np.ndarray:
        """The canvas, (height, width, 4)."""
        width, height, data = self.run(
            "const c = document.getElementById('canvas'); const copy = document.createElement('canvas');"
            "copy.width = c.width; copy.height = c.height; const pen = copy.getContext('2d'); pen.drawImage(c, 0, 0);"
            "const d = pen.getImageData(0, 0, c.width, c.height);"
            "return [c.width, c.height, Array.from(d.data)];"
        )
        return np.array(data, dtype=np.uint8).reshape(height, width, 4)

    def shown(self) -> list[str]:
        return self.run(
            "return [...document.querySelectorAll('#sheet button:not([hidden])')].map(b => b.textContent.split(',')[0]);"
        )

    def problems(self) -> list[str]:
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]

    def requested(self) -> set[str]:
        """Schemes of everything that the page asked for."""
        events = (json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance"))
        return {
            event["params"]["request"]["url"].split(":")[0]
            for event in events
            if event["method"] == "Network.requestWillBeSent"
        }


def test_sheet_filters_and_histograms(browser, page) -> None:
    viewer = Viewer(browser, page)
    assert viewer.shown() == [f"frame-{index:05d}" for index in range(6)]
    assert viewer.run(
        "return [...document.querySelectorAll('#sheet img')].every(i => i.complete && i.naturalWidth > 0)"
    )
    assert "6 of 6" in viewer.run("return document.getElementById('matching').textContent")
    bars = viewer.run("return [...document.querySelectorAll('#histograms title')].map(t => t.textContent)")
    assert sum(int(bar.rsplit(": ", 1)[1]) for bar in bars if ":" in bar) == 6 * len(
        viewer.run("return [...document.querySelectorAll('#histograms figure')]")
    )
    viewer.fill("zenith_mag_arcsec2-low", "19")
    bright = viewer.shown()
    assert bright == ["frame-00000", "frame-00001", "frame-00002", "frame-00003"]
    assert 0 < viewer.run("return document.querySelectorAll('#histograms rect.in').length") < len(bars)
    viewer.run(
        "const l = document.getElementById('choice-bortle'); l.selectedIndex = 2; l.dispatchEvent(new Event('change'))"
    )
    assert viewer.shown() == ["frame-00002", "frame-00003"]
    viewer.click("reset")
    assert len(viewer.shown()) == 6
    assert viewer.problems() == []


# A browser develops and draws frames; `test_pages_fit.py` opens one every day.
@pytest.mark.journey
def test_frame_stretch_zoom_and_overlay(browser, dataset, page) -> None:
    viewer = Viewer(browser, page)
    viewer.open_frame(1)
    source = open_source(dataset)
    dn = source.image(1)
    brightest = source.stars(1).query("fraction_in_frame > 0.5").sort_values("v_mag").iloc[0]
    first = viewer.run("return [...document.querySelector('#stars tbody tr').cells].map(c => c.textContent)")
    assert first[0] == star_name(brightest.star_id, brightest.hip, brightest.hr)
    assert float(first[1]) == pytest.approx(brightest.v_mag, abs=0.006)
    assert float(first[3]) == pytest.approx(brightest.snr, abs=0.06)
    assert viewer.run("return document.querySelector('#objects tbody').textContent").startswith("satellite")

    with_truth = viewer.picture()
    viewer.click("overlay")
    plain = viewer.picture()
    assert (with_truth != plain).any()
    assert (plain[..., 0] == plain[..., 1]).all()

    viewer.fill("stretch", "0")
    soft = viewer.picture()[..., 0].astype(float)
    viewer.fill("stretch", "4")
    hard = viewer.picture()[..., 0].astype(float)
    assert hard.mean() > soft.mean() + 20
    viewer.fill("white", "0.5")
    assert viewer.picture()[..., 0].mean() > hard.mean()
    viewer.fill("white", "1")

    # At 1:1 every pixel of the canvas is one of the frame, through the documented curve.
    viewer.click("one")
    assert viewer.run("return document.getElementById('zoom').textContent") == "100 %"
    viewer.fill("stretch", "2")
    shown = viewer.picture()[..., 0]
    black, a = int(np.percentile(dn, 0.5)), 10.0**2 - 1
    wanted = np.rint(255 * np.log1p(a * np.clip((dn - float(black)) / (dn.max() - black), 0, 1)) / np.log1p(a))
    top, left = (np.array(np.where(shown > 0)).min(axis=1)).tolist()
    matches = [
        np.abs(shown[y : y + 160, x : x + 240].astype(float) - wanted).max()
        for y in range(max(top - 3, 0), top + 4)
        for x in range(max(left - 3, 0), left + 4)
        if shown[y : y + 160, x : x + 240].shape == (160, 240)
    ]
    assert min(matches) <= 1
    viewer.click("zoom-in")
    assert viewer.run("return document.getElementById('zoom').textContent") == "150 %"
    viewer.click("fit")
    assert viewer.problems() == []


def test_an_open_frame_fits_a_telephone(browser, page) -> None:
    size = {"width": 400, "height": 900, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        viewer = Viewer(browser, page)
        viewer.open_frame(0)
        inside, room = viewer.run("const v = document.getElementById('viewer'); return [v.scrollWidth, v.clientWidth]")
        assert inside <= room
        assert viewer.run("return document.documentElement.scrollWidth") <= 400
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


# As above.
@pytest.mark.journey
def test_pointer_wheel_keys_and_neighbours(browser, page) -> None:
    from selenium.webdriver import ActionChains, Keys
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    viewer = Viewer(browser, page)
    viewer.open_frame(0)
    canvas = viewer.driver.find_element("id", "canvas")
    ActionChains(viewer.driver).move_to_element(canvas).perform()
    assert "DN" in viewer.run("return document.getElementById('pixel').textContent")
    before = viewer.run("return parseInt(document.getElementById('zoom').textContent)")
    ActionChains(viewer.driver).scroll_from_origin(ScrollOrigin.from_element(canvas), 0, -400).perform()
    assert viewer.run("return parseInt(document.getElementById('zoom').textContent)") > before
    picture = viewer.picture()
    ActionChains(viewer.driver).drag_and_drop_by_offset(canvas, 60, 30).perform()
    assert (viewer.picture() != picture).any()
    ActionChains(viewer.driver).send_keys(Keys.ARROW_RIGHT).perform()
    viewer.wait("return document.getElementById('frame-title').textContent.startsWith('frame-00001')")
    ActionChains(viewer.driver).send_keys(Keys.ESCAPE).perform()
    assert not viewer.run("return document.getElementById('viewer').open")
    assert viewer.problems() == []


def test_nothing_is_asked_of_any_network(browser, page) -> None:
    viewer = Viewer(browser, page)
    viewer.open_frame(0)
    assert viewer.requested() <= {"file", "data"}
    text = page.read_text()
    assert "http://" not in text.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in text


def test_hostile_texts_stay_texts(browser, tmp_path) -> None:
    """A folder from others whose frame record and truth try to be markup: shown as they are, nothing runs."""
    hostile = "</script><img src=x onerror=\"document.title='owned'\">"
    render_dataset(small_scenario(camera=VIEW["camera"], stars={"limiting_magnitude": 4.0}), tmp_path / "set")
    record = json.loads((tmp_path / "set/frame-00000.json").read_text())
    record["scenario"]["name"] = record["camera"]["model"] = hostile
    (tmp_path / "set/frame-00000.json").write_text(json.dumps(record))
    viewer = Viewer(browser, write_page(tmp_path / "set", tmp_path / "page").page)
    viewer.open_frame(0)
    assert viewer.run("return document.querySelector('h1').textContent") == hostile
    assert hostile in viewer.run("return document.getElementById('frame-conditions').textContent")
    assert "owned" not in viewer.driver.title.replace(hostile, "")
    assert viewer.run("return document.querySelectorAll('img[src=x]').length") == 0
    assert viewer.problems() == []


def test_a_large_dataset_is_sampled_and_large_frames_are_reduced(dataset, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("benchmark.report.show.page.MOST_PIXELS", 240 * 160 // 4)
    written = write_page(dataset, tmp_path / "page", most=3)
    assert (written.shown, written.frames) == (3, 6)
    assert "3 of 6 frames, evenly spread" in written.page.read_text()
    text = (tmp_path / "page/frames/1.js").read_text()
    frame = json.loads(text.removeprefix("skybench.receive(").removesuffix(");\n"))
    assert (frame["width"], frame["height"], frame["block"]) == (120, 80, 2)
    assert spread(1000, 5) == [0, 250, 500, 749, 999]
    assert spread(2, 48) == [0, 1]


def test_a_large_dataset_is_turned_page_by_page(dataset, tmp_path) -> None:
    """Every frame is on one page."""
    found = []
    for number, words in ((1, "Frames 1 to 4 of 6, page 1 of 2."), (2, "Frames 5 to 6 of 6, page 2 of 2.")):
        words_of = ["show", str(dataset), "--out", str(tmp_path / "page"), "--frames", "4", "--page", str(number)]
        done = CliRunner().invoke(app, words_of)
        assert done.exit_code == 0, done.output
        text = (tmp_path / "page/index.html").read_text()
        assert words in text
        found += re.findall(r'"id": "(frame-\d{5})"', text)
    assert found == [f"frame-{index:05d}" for index in range(6)]
    assert len(list((tmp_path / "page/frames").iterdir())) == 2
    assert paged(100_000, 48, 2084) == range(99_984, 100_000)
    refused = CliRunner().invoke(app, ["show", str(dataset), "--out", str(tmp_path / "page"), "--page", "2"])
    assert refused.exit_code == 2
    assert "--page 2: 6 frames fill 1 pages of 48" in refused.output


def test_command_says_what_to_open(dataset, tmp_path) -> None:
    copied = shutil.copytree(dataset, tmp_path / "set")
    done = CliRunner().invoke(app, ["show", str(copied), "--frames", "2"])
    assert done.exit_code == 0, done.output
    assert "2 of 6 frames" in done.output
    assert (tmp_path / "set-show/index.html").is_file()
    assert "open" in done.output
    refused = CliRunner().invoke(app, ["show", str(tmp_path / "nowhere")])
    assert refused.exit_code == 2
    assert "no finished dataset" in refused.output


def test_refusals_name_the_folder(dataset, tmp_path) -> None:
    with pytest.raises(GeneratorError, match=r"no finished dataset; make one with"):
        write_page(tmp_path, tmp_path / "out")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.tex").write_text("precious")
    with pytest.raises(GeneratorError, match=r"thesis\.tex"):
        write_page(dataset, tmp_path / "mine")
    damaged = shutil.copytree(dataset, tmp_path / "damaged")
    (damaged / "data/train/shard-000000.tar").write_bytes(b"no archive")
    with pytest.raises(GeneratorError, match=r"shard-000000\.tar: damaged"):
        write_page(damaged, tmp_path / "out")


def test_proper_names_belong_to_these_stars() -> None:
    """Against Skyfield's own table of names by Hipparcos number."""
    from skyfield.named_stars import named_star_dict

    catalogue = load_catalogue()
    hip_of = dict(zip(catalogue.hr.tolist(), catalogue.hip.tolist(), strict=True))
    # Skyfield gives these two to ε Cyg (Aljanah) and κ Vel (Markeb).
    elsewhere = {"Gienah", "Markab"}
    common = {hr: name for hr, name in PROPER_NAMES.items() if name in named_star_dict and name not in elsewhere}
    assert len(common) > 60
    assert {name: hip_of[hr] for hr, name in common.items()} == {
        name: named_star_dict[name] for name in common.values()
    }
    assert [star_name(0, 0, hr) for hr in (2618, 3, 264, 8085)] == ["Adhara", "33 Psc", "γ Cas", "61 Cyg"]
    assert star_name(900_000_599, 0, 0) == "Jupiter"
    assert star_name(1, 1, 0) == "HIP 1"
