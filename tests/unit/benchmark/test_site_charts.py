"""Charts of the report, its numbers for the terminal, and the scales of both."""

import dataclasses
import io
import itertools
import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from unit.benchmark.fake_results import SOLVERS, TASKS, write_results

from benchmark.report.site.boards import make_board
from benchmark.report.site.charts import _apart, _front, error_curves, success_curves
from benchmark.report.site.columns import p_value, script_number, signed
from benchmark.report.site.commands import Places
from benchmark.report.site.pages import render_figure
from benchmark.report.site.scales import level_scale, log_scale
from benchmark.report.site.site_view import make_styles
from benchmark.report.site.terminal import result_tables
from benchmark.report.site.tree import read_tree


@pytest.fixture(scope="module")
def boards(tmp_path_factory):
    root = write_results(tmp_path_factory.mktemp("tree") / "results", frames_per_level=3, modes=("own",))
    return [make_board(group) for group in read_tree(root)]


def test_a_terminal_shows_any_number_of_solvers(boards):
    board = dataclasses.replace(boards[0], entries=tuple(itertools.islice(itertools.cycle(boards[0].entries), 30)))
    tables = result_tables([board])
    assert [len(table.columns) for table in tables] == [5] * 7 + [3]
    assert sum(table.title is not None for table in tables) == 1
    console = Console(width=80, file=io.StringIO(), record=True)
    for table in tables:
        console.print(table)
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= 80
    values = [line.strip("│").split("│")[1:] for line in lines if "success" in line]
    assert all(re.match(r" \d+(\.\d)? % ", value) for row in values for value in row)
    assert sum(map(len, values)) == 30


def test_the_leaderboard_as_a_picture_stands_alone(boards):
    drawing = render_figure(boards, Places(Path("results")), Path("board.svg"))
    root = ET.fromstring(drawing)
    words = [one.text for one in root.iter("{http://www.w3.org/2000/svg}text")]
    assert {"skybench", "never", "bortle", "motion", "thesis-mag"} <= set(words)
    assert "light-dark" not in drawing
    assert "prefers-color-scheme:dark" in drawing
    assert "http" not in drawing.replace("http://www.w3.org/2000/svg", "")
    assert len(list(root.iter("{http://www.w3.org/2000/svg}circle"))) == len(SOLVERS) * len(TASKS)


def test_panels_show_each_value_in_words_and_each_interval_as_a_bar(boards):
    board = boards[0]
    styles = make_styles(boards)
    curves = [(entry.label, styles[entry.label], entry.levels) for entry in board.entries]
    backdrop, panels = error_curves(curves, board.task, "behind")
    assert backdrop.count("<use") == 0
    assert "stroke-dasharray" in backdrop  # the Cramér-Rao bound
    assert [words in backdrop for words in (">km<", ">∞<", f">{board.task.axis}<")] == [True] * 3
    for (name, style, levels), panel in zip(curves, panels, strict=True):
        root = ET.fromstring(panel)
        assert name in root.attrib["aria-label"]
        assert root.find("use").attrib["href"] == "#behind"
        words = [one.text for one in root.iter("title")]
        assert [one.split(":")[0] for one in words] == [f"{level.condition:g}" for level in levels]
        assert f"var(--series-{style.colour})" in panel
        bars = [path for path in root.iter("path") if "stroke-opacity" in path.attrib]
        drawn = sum(path.attrib["d"].count("M") for path in bars)
        assert drawn == sum(not math.isnan(level.median_error_km.low) for level in levels)
    _, panels = success_curves(curves, board.task, "behind")
    for _, _, levels in curves:
        (band,) = re.findall(r'fill-opacity="0.17" d="([^"]+)z"', panels.pop(0))
        assert len(re.findall("[MLHV]", band)) == 2 * len(levels)


def test_axes_place_values_where_they_belong():
    log = log_scale([0.02, 500.0], "km", refused=True)
    assert (log.place(0.01), log.place(math.inf), log.place(0.0)) == (0.0, 1.0, 0.0)
    assert log.place(1000.0) == pytest.approx(5 / 6)  # the last sixth is for the refused
    assert log.ticks[-1] == (math.inf, "∞")
    levels = level_scale([0.0, 1.0, 10.0], "rate")
    assert [levels.place(value) for value in (-1.0, 0.0, 0.5, 1.0, 5.5, 10.0, 11.0)] == [0, 0, 0.25, 0.5, 0.75, 1, 1]
    assert level_scale([4.0], "one").place(4.0) == 0.5
    assert [words for _, words in level_scale([0.003, 4000.0, 240_000.0], "rays").ticks] == ["0.003", "4k", "240k"]


def test_names_stand_apart_and_the_front_holds_what_none_beats():
    places = _apart([0.5, 0.5, 0.51, 0.0, 1.0], 0.1)
    assert np.diff(sorted(places)).min() >= 0.1 - 1e-9
    assert max(places) <= 1.0
    assert _front([(10.0, 0.5), (5.0, 0.4), (20.0, 0.45), (8.0, 0.4), (30.0, 0.9)]) == [(5, 0.4), (10, 0.5), (30, 0.9)]


def test_numbers_for_script_and_reader():
    assert [script_number(value) for value in (math.nan, math.inf, -math.inf, 0.25)] == [
        "",
        "Infinity",
        "-Infinity",
        "0.25",
    ]
    assert (signed(0.123), signed(-0.05), signed(-0.0001), p_value(0.0004), p_value(0.04)) == (
        "+12.3",
        "−5.0",
        "+0.0",
        "< 0.001",
        "0.040",
    )
