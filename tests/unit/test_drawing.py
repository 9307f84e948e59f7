"""The house's drawing: SVG that is lean, the same every time, safe, and follows a page from light to dark."""

import re
import subprocess
import sys
import threading
import xml.etree.ElementTree as ET

import matplotlib as mpl
import numpy as np
import pytest

from generator.drawing.histograms import draw_histograms
from generator.drawing.palette import INK, PALETTE, PAPER, SERIES, palette_sheet
from generator.drawing.style import axes_at, house_style, new_figure
from generator.drawing.svg import inline_svg, standalone_svg, svg_marks

SVG = "{http://www.w3.org/2000/svg}"


def drawing(words="a line", draw=lambda axes: None):
    with house_style():
        figure = new_figure(300, 200)
        axes = axes_at(figure, 50, 20, 200, 100)
        axes.set(xlim=(0.0, 10.0), ylim=(0.0, 1.0), xlabel=words, autoscale_on=False)
        axes.plot([0.0, 10.0], [0.0, 1.0])
        draw(axes)
    return figure


def contrast(one, other):
    def luminance(colour):
        parts = [int(colour[n : n + 2], 16) / 255 for n in (1, 3, 5)]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))

    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_every_series_stands_out_by_day_and_by_night():
    for one in (*SERIES, INK):
        assert contrast(one.light, PAPER.light) > 4.0, one
        assert contrast(one.dark, PAPER.dark) > 4.0, one
    assert len({one.light for one in PALETTE}) == len(PALETTE)  # a colour is known by its value by day
    assert all(f"--{one.name}: light-dark({one.light}, {one.dark});" in palette_sheet() for one in PALETTE)


def test_the_same_figure_gives_the_same_bytes():
    assert inline_svg(drawing(), "x") == inline_svg(drawing(), "x")
    assert standalone_svg(drawing(), "x") == standalone_svg(drawing(), "x")


def test_colours_of_a_page_are_its_variables_and_nothing_needs_a_style_or_an_id():
    text = inline_svg(drawing(), "what it shows")
    root = ET.fromstring(text)
    assert root.attrib["aria-label"] == "what it shows"
    assert (root.attrib["width"], root.attrib["viewBox"]) == ("300", "0 0 300 200")
    assert "#" not in text
    assert not {"id", "style", "class"} & {name for node in root.iter() if node is not root for name in node.attrib}
    assert set(re.findall(r"var\(--([\w-]+)\)", text)) == {"soft", "line", "ink", "series-0"}
    assert len(text) < 4000


def test_a_picture_that_stands_alone_has_its_colours_by_day_and_by_night():
    text = standalone_svg(drawing(), "title & more", "described <here>")
    root = ET.fromstring(text)
    assert root.find(f"{SVG}title").text == "title & more"
    assert root.find(f"{SVG}desc").text == "described <here>"
    assert f'<rect width="300" height="200" fill="{PAPER.light}"/>' in text
    night = re.search(r"@media\(prefers-color-scheme:dark\)\{(.*)\}</style>", text).group(1)
    rules = dict(re.findall(r'\[(\w+="#\w{6}")\]\{\w+:(#\w{6})\}', night))
    assert rules[f'stroke="{SERIES[0].light}"'] == SERIES[0].dark
    assert rules[f'fill="{PAPER.light}"'] == PAPER.dark
    used = {f'{kind}="{colour}"' for kind, colour in re.findall(r'(fill|stroke)="(#\w{6})"', text.split("</style>")[1])}
    assert used == set(rules)
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "")


def test_words_are_escaped_and_dollars_are_no_mathematics():
    words = "$5 <script>alert(\"&\")</script> 'q' $"

    def draw(axes):
        (dot,) = axes.plot([5.0], [0.5], "o")
        dot.set_gid(words)

    root = ET.fromstring(inline_svg(drawing(words, draw), words))
    assert root.attrib["aria-label"] == words
    assert [node.text for node in root.iter("title")] == [words]
    assert words in [node.text for node in root.iter("text")]
    assert not list(root.iter("script"))


def test_a_text_in_any_script_needs_no_font_of_this_machine():
    assert "Где я? 我在哪里" in inline_svg(drawing("Где я? 我在哪里"), "x")  # Matplotlib warns of glyphs its fonts lack


def test_marks_lie_where_the_axes_say():
    def draw(axes):
        axes.plot([2.5, np.nan, 7.5], [0.25, 0.5, 0.75], "o", markersize=8.0)
        axes.plot([5.0], [0.5], "s", markersize=8.0)

    root = ET.fromstring(inline_svg(drawing(draw=draw), "x"))
    circles = [
        (float(one.attrib["cx"]), float(one.attrib["cy"]), float(one.attrib["r"])) for one in root.iter("circle")
    ]
    assert circles == [(100.0, 95.0, 4.0), (200.0, 45.0, 4.0)]
    assert "M146 74H154V66H146z" in svg_marks(drawing(draw=draw))


def test_lines_areas_and_marks_end_at_the_axes():
    def draw(axes):
        axes.plot([-10.0, 20.0], [0.5, 0.5], color=SERIES[1].light)
        axes.fill_between([-5.0, 15.0], [-1.0, -1.0], [2.0, 2.0], color=SERIES[2].light, alpha=0.2, linewidth=0.0)
        axes.plot([-3.0, 3.0], [0.5, 0.5], "o", color=SERIES[3].light)

    text = svg_marks(drawing(draw=draw))
    (line,) = re.findall(rf'<path stroke="var\(--{SERIES[1].name}\)"[^>]*d="M([\d.]+) 70H([\d.]+)"', text)
    assert [float(one) for one in line] == pytest.approx([50.0, 250.0], abs=1.5)  # a pixel beyond is not seen
    (area,) = re.findall(rf'fill="var\(--{SERIES[2].name}\)" fill-opacity="0.2" d="([^"]+)"', text)
    places = [float(one) for one in re.findall(r"[\d.]+", area)]
    assert min(places) == 20.0
    assert max(places) == 250.0
    assert text.count("<circle") == 1


def test_the_style_holds_only_while_drawing_and_against_what_a_user_has_set():
    with mpl.rc_context({"axes.grid": False, "font.size": 40.0, "lines.linewidth": 9.0}):
        mine = inline_svg(drawing(), "x")
        assert mpl.rcParams["font.size"] == 40.0
    assert mine == inline_svg(drawing(), "x")


def test_threads_that_draw_do_not_disturb_each_other():
    expected = {n: inline_svg(drawing(str(n)), "x") for n in range(4)}
    found = {}

    def work(n):
        for _ in range(5):
            found.setdefault(n, set()).add(inline_svg(drawing(str(n)), "x"))

    threads = [threading.Thread(target=work, args=(n,)) for n in expected]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {n: {text} for n, text in expected.items()}


def test_neither_the_command_line_nor_celnav_waits_for_matplotlib():
    code = "import sys, benchmark.cli.app, celnav; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_histograms_hold_every_value_and_say_when_nothing_varies():
    rng = np.random.default_rng(np.random.SeedSequence(1))
    values = rng.integers(0, 4, 50).astype(np.float64)
    text = draw_histograms([("exposure, s", values), ("a < b", rng.normal(size=30))], "frames")
    words = [node.text for node in ET.fromstring(text).iter(f"{SVG}text")]
    assert words.count("frames") == 2
    assert {"exposure, s", "a < b"} <= set(words)
    bars = re.findall(rf'<path fill="{SERIES[0].light}" d="([^"]+)"', text)[0]
    counts = np.histogram(values, 5)[0]
    tops = np.array([float(one) for one in re.findall(r"V([\d.]+)", bars)])
    heights = (tops.max() - tops) / (tops.max() - tops.min()) * counts.max()
    assert heights == pytest.approx([*counts, 0.0], abs=0.05)
    assert "All frames have the same conditions." in draw_histograms([], "frames")
