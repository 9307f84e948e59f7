"""Pages: one Jinja environment that escapes and refuses gaps; one drawing of marks over a frame."""

import re
from pathlib import Path

import jinja2
import pytest
from markupsafe import Markup

from benchmark.judge.outcome import DetectionRow
from benchmark.report.overlay import draw_overlay
from benchmark.report.templates import environment, read_sheet

ROOT = Path(__file__).parents[3]


def test_pages_come_from_one_environment():
    sources = [path for package in ("benchmark", "generator", "celnav") for path in (ROOT / package).rglob("*.py")]
    found = [path.name for path in sources if "jinja2.Environment(" in path.read_text(encoding="utf-8")]
    assert found == ["templates.py"]


def test_values_are_escaped_and_gaps_refused():
    template = environment(shared="<&>").from_string("{{ shared }} {{ one }} {{ trusted }}")
    assert template.render(one="<b>", trusted=Markup("<i>")) == "&lt;&amp;&gt; &lt;b&gt; <i>"
    with pytest.raises(jinja2.UndefinedError, match="'trusted' is undefined"):
        template.render(one=1)
    assert read_sheet("site/site.js").startswith('"use strict";')


def detection(u_px, v_px, star_id=None, correct=None):
    return DetectionRow("f", 0, u_px, v_px, 1.0, star_id, correct)


def numbers(path):
    return [float(one) for one in re.findall(r"-?[\d.]+", path)]


def test_marks_stand_where_the_frame_has_its_stars():
    rows = [detection(10.0, 20.0), detection(30.0, 40.0, 7, True), detection(300.0, 200.0, 8, False)]
    overlay = draw_overlay(900, 600, rows, [(50.0, 60.0)])
    assert overlay.view_box == "-0.5 -0.5 900 600"  # the first pixel's centre is at 0, 0
    assert overlay.found == "M10 20h.1"
    left, middle, radius, *_ = numbers(overlay.right)
    assert (left + radius, middle) == (30.0, 40.0)
    left, top, side, *_ = numbers(overlay.wrong)
    assert (left + side / 2, top + side / 2) == (300.0, 200.0)
    left, middle, length, _, half, down = numbers(overlay.truth)
    assert (left + length / 2, middle) == (50.0, 60.0)
    assert (length, half, down) == (14.0, -7.0, 14.0)
    assert overlay.size == len(overlay.truth + overlay.found + overlay.right + overlay.wrong)


def test_marks_grow_with_the_frame_and_an_empty_frame_has_none():
    assert draw_overlay(90, 60, []).stroke_px == "1.0"
    assert draw_overlay(9000, 6000, []).stroke_px == "30.0"
    assert draw_overlay(90, 60, []).size == 0
