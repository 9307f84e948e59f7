import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import numpy as np
import pytest
from typer.testing import CliRunner
from unit.benchmark.fake_night import Mixed, Raising, Refusing, write_dataset

from benchmark.cli.bench import app
from benchmark.errors import ResultsError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.preview import preview_webp, stretch
from benchmark.report import contact_sheet
from benchmark.report.formatting import interval, number, percent
from benchmark.report.report import write_report
from benchmark.run.run import run_benchmark
from benchmark.stats.intervals import Estimate


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    root = tmp_path_factory.mktemp("report")
    folder = write_dataset(root / "night", (1, 9), per_class=2, scenario='<b>fake</b> & "night"')
    frames = open_dataset(folder).frames
    solvers = [Mixed("mixed", frames), Refusing("empty", frames), Raising("raising", frames)]
    run_benchmark(folder, solvers, root / "out", progress=False)
    write_report(root / "out")
    return root / "out"


@pytest.fixture(scope="module")
def page(out):
    return (out / "report.html").read_text(encoding="utf-8")


class Addresses(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found = []
        self.tags = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.found += [value for name, value in attrs if name in {"src", "href", "srcset", "action", "poster", "data"}]


def test_the_page_needs_nothing_from_outside(page):
    parser = Addresses()
    parser.feed(page)
    assert all(address.startswith(("#", "data:image/webp;base64,")) for address in parser.found)
    assert parser.tags.count("img") == 4
    assert "script" not in parser.tags
    assert "link" not in parser.tags
    assert not re.search(r"url\((?!#)", page)
    assert not re.search(r"@import", page)


def test_text_from_data_is_escaped(page):
    assert "<b>fake</b>" not in page
    assert "&lt;b&gt;fake&lt;/b&gt;" in page
    assert "<script>alert" not in page
    assert "error: RuntimeError: singular matrix &lt;script&gt;" in page


def test_figures_are_well_formed_and_have_axes_with_units(page):
    drawings = re.findall(r"<figure role=\"group\".*?(<svg.*?</svg>)", page, flags=re.S)
    assert len(drawings) == 4
    texts = ["".join(ET.fromstring(drawing).itertext()) for drawing in drawings]
    assert "recall (error < 10 km)" in texts[0]
    assert "median error, km" in texts[1]
    assert "refused" in texts[1]
    assert "error, km" in texts[2]
    assert "star-ID recall" in texts[3]
    assert all("mixed" in text and "raising" in text for text in texts)
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert "#0a0b0" not in page


def test_the_table_is_honest_about_refusals(page):
    row = re.search(r"<th scope=\"row\">empty.*?</tr>", page, flags=re.S).group()
    assert "0 %" in row
    assert "∞" in row
    assert "—" in row
    assert "<b>4 errors</b>" in re.search(r"<th scope=\"row\">raising.*?</tr>", page, flags=re.S).group()


def test_pictures_fit_the_budget(out, monkeypatch):
    noise = np.random.default_rng(np.random.SeedSequence(3)).integers(0, 4096, (400, 600)).astype(np.uint16)
    pictures = [preview_webp(noise)] * 3
    assert contact_sheet._fit(pictures) == pictures
    monkeypatch.setattr(contact_sheet, "IMAGE_BUDGET_BYTES", 4 * len(pictures[0]) // 2)
    fitted = contact_sheet._fit(pictures)
    assert sum(map(len, fitted)) * 4 // 3 <= contact_sheet.IMAGE_BUDGET_BYTES


def test_many_frames_are_thinned_evenly():
    chosen = contact_sheet._spread(list(range(600)))
    assert (len(chosen), chosen[0], chosen[1], chosen[-1]) == (60, 0, 10, 590)


def test_a_missing_preview_is_refused_by_name(out, tmp_path):
    for path in out.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    with pytest.raises(ResultsError, match=r"frame-00000\.webp: missing preview"):
        write_report(tmp_path)


def test_stretch_keeps_order_and_uses_the_range():
    ramp = np.random.default_rng(np.random.SeedSequence(4)).normal(200.0, 5.0, (100, 100))
    ramp[50, 50], ramp[20, 20] = 4000.0, 1000.0
    picture = stretch(ramp.astype(np.uint16))
    assert picture[50, 50] == 255
    assert picture[20, 20] > np.median(picture)
    assert 10 < np.median(picture) < 180
    assert stretch(np.full((5, 5), 7, dtype=np.uint16)).std() == 0


def test_numbers_are_printed_with_three_digits():
    assert [number(value) for value in (0.0, 0.01234, 1.234, 12.34, 12345.6)] == [
        "0",
        "0.0123",
        "1.23",
        "12.3",
        "12\u2009346",
    ]
    assert (number(float("inf")), number(float("nan")), percent(float("nan"))) == ("∞", "—", "—")
    assert [percent(value) for value in (0.0, 0.5556, 1.0)] == ["0 %", "55.6 %", "100 %"]
    assert interval(Estimate(0.5, 0.25, 0.75, 4), percent) == "25.0 – 75.0 %"


def test_the_command_line_reports_and_refuses(out, tmp_path):
    runner = CliRunner()
    result = runner.invoke(app, ["report", "--out", str(out)], env={"COLUMNS": "120"})
    assert result.exit_code == 0, result.output
    assert "median error, km" in result.stdout
    assert str(out / "report.html") in result.stdout
    result = runner.invoke(app, ["report", "--out", str(tmp_path / "nothing")])
    assert result.exit_code == 2
    assert "no results" in result.stderr
    result = runner.invoke(
        app, ["run", str(tmp_path / "nothing"), "--solver", "thesis-adaptive", "--out", str(tmp_path)]
    )
    assert result.exit_code == 2
    assert "no such folder" in result.stderr
    assert "Traceback" not in result.output
    result = runner.invoke(app, ["run", str(tmp_path), "--solver", "no-such", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "thesis-baseline" in result.stderr
