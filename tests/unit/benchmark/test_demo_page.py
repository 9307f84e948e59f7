"""The page of the demonstration: its numbers are those of the results, and what it is given cannot harm it."""

import re

import numpy as np
import pytest
from documented_commands import refusal
from unit.benchmark.fake_night import Contestant, Random, Refusing, Truth, write_dataset

from benchmark.cli import running
from benchmark.frames.dataset import open_dataset
from benchmark.protocol import Answer, Observation
from benchmark.report.demo_page import make_demo, shown_frames, write_demo
from benchmark.report.site.commands import Places
from benchmark.report.site.pages import make_boards, write_site
from benchmark.run import engine
from benchmark.solvers import registry
from generator.scenario.file import parse_scenario

SCENARIO = """\
name: night
description: <b>Nine</b> skies over three sites.
frames: 9
site: {latitude_deg: 48, longitude_deg: 11}
time: {utc_start: 2020-01-01T00:00:00Z, exposure_s: 1}
camera: {width: 160, height: 120, hfov_deg: 100, aperture_mm: 4}
"""


class Off(Contestant):
    """A kilometre north of the truth; refuses the brightest sky."""

    def solve(self, detections: object, observation: Observation) -> Answer:
        where = self.frame_of(observation).conditions
        if where.bortle == 7:
            return Answer(ok=False, reason="no consensus")
        return Answer(ok=True, lat_deg=where.latitude_deg + 0.009, lon_deg=where.longitude_deg)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    root = tmp_path_factory.mktemp("demo")
    folder = write_dataset(root / "night", (1, 4, 7), per_class=3)
    frames = open_dataset(folder).frames
    solvers = (Truth("truth", frames), Off("off", frames), Random("random", frames), Refusing("refusing", frames))
    engine.run(folder, solvers, root / "results")
    return root, frames


@pytest.fixture(scope="module")
def demo(place):
    root, frames = place
    (board,) = make_boards(root / "results", lambda done, of: None)
    return make_demo(parse_scenario(SCENARIO, "night.yaml"), root / "night", frames, board, ["x: needs <y>"])


def test_rows_count_what_became_of_all_frames(demo) -> None:
    rows = {row.name: row for row in demo.rows}
    assert [row.name for row in demo.rows] == ["truth", "off", "random", "refusing"]
    assert (rows["truth"].found, rows["truth"].wrong, rows["truth"].refused) == (9, 0, 0)
    assert (rows["off"].found, rows["off"].wrong, rows["off"].refused) == (6, 0, 3)
    assert (rows["random"].found, rows["random"].wrong, rows["random"].refused) == (0, 9, 0)
    assert (rows["refusing"].found, rows["refusing"].wrong, rows["refusing"].refused) == (0, 0, 9)
    assert rows["off"].median_km == pytest.approx(1.0, rel=0.01)
    assert rows["off"].by_bortle == ((1, 3, 3), (4, 3, 3), (7, 0, 3))
    assert (rows["random"].distance, rows["off"].distance[:4]) == ("—", "1.00")
    assert [picture.found for picture in demo.pictures] == [2, 2, 1]


def test_pictures_go_from_the_darkest_to_the_brightest_sky_of_one_place(place) -> None:
    frames = place[1]
    assert [frame.conditions.bortle for frame in shown_frames(frames)] == [1, 4, 7]
    assert len({frame.conditions.latitude_deg for frame in shown_frames(frames)}) == 1
    assert [frame.index for frame in shown_frames(frames[:2])] == [0, 1]
    assert [frame.index for frame in shown_frames(frames[:1])] == [0]


def test_the_page_shows_it_with_everything_escaped_and_links_to_the_details(place, demo) -> None:
    root = place[0]
    details = write_site(make_boards(root / "results", lambda done, of: None), Places(root / "results"))
    page = write_demo(demo, root / "results", details)
    text = page.read_text(encoding="utf-8")
    assert "&lt;b&gt;nine" in text.lower()
    assert "needs &lt;y&gt;" in text
    assert "<b>6</b> of 9" in text
    links = re.findall(r'href="([^"]+)"', text)
    assert links == ["site/index.html"]
    assert (page.parent / links[0]).is_file()
    assert len(re.findall(r'src="data:image/webp;base64,', text)) == 3
    assert "<script" not in text


def test_the_command_that_it_shows_is_acceptable(demo) -> None:
    assert demo.solve_command.startswith("celnav solve ")
    assert refusal(demo.solve_command) is None
    assert np.isfinite(demo.rows[0].median_ms)


def test_a_rival_whose_packages_are_missing_is_named_with_the_remedy(monkeypatch) -> None:
    monkeypatch.setattr(registry, "_installed_version", lambda package: "")
    found = running.obstacles(["skybench", "tetra3rs"])
    assert set(found) == {"tetra3rs"}
    assert "pip install 'skybench[peers]'" in found["tetra3rs"]
