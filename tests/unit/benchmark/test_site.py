"""The report over a tree of results: what it says, and that what it is given cannot harm it."""

import dataclasses
import itertools
import json
import math
import re
import shutil
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from urllib.parse import unquote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from folded_pages import unfolded
from PIL import Image
from typer.testing import CliRunner
from unit.benchmark.fake_results import SOLVERS, FakeSolver, write_frames, write_results
from unit.benchmark.fake_results import TASKS as ALL_TASKS

from benchmark.cli.bench import app
from benchmark.errors import ResultsError
from benchmark.report.site import tree
from benchmark.report.site.boards import make_board
from benchmark.report.site.columns import SUCCESS, break_interval, break_words
from benchmark.report.site.commands import Places
from benchmark.report.site.failures import KINDS, failures_of, listed, pictured_frames, worst_first
from benchmark.report.site.frame_source import FrameSource
from benchmark.report.site.pages import make_boards, render_site, write_site
from benchmark.report.site.pictures import Pictures
from benchmark.report.site.tree import read_tree
from benchmark.report.site.words import left_out_words
from benchmark.run.packing import pack_tree
from benchmark.stats.intervals import Estimate
from generator.identity.pixels import pixels_sha256

FIVE_MB = 5_000_000
TASKS = ALL_TASKS[::2]  # one whose larger conditions are harder, and one whose smaller are
SHARED = ("site.css", "site.js", "failures.js")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_results(tmp_path_factory.mktemp("tree") / "results", TASKS, frames_per_level=9, modes=("own",))


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_frames(tmp_path_factory.mktemp("data"), TASKS, frames_per_level=9)


@pytest.fixture(scope="module")
def boards(root):
    return [make_board(group) for group in read_tree(root)]


@pytest.fixture(scope="module")
def pages(root, boards, data):
    folder = write_site(boards, Places(root, data)).parent
    return {path.name: unfolded(path.read_text(encoding="utf-8")) for path in folder.glob("*.html")}


class Outline(HTMLParser):
    """Tags, attributes and ids of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.addresses, self.ids, self.attributes = [], [], [], set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes |= {name for name, _ in attrs}
        self.addresses += [value for name, value in attrs if name in {"src", "href", "srcset", "action", "data"}]
        self.ids += [value for name, value in attrs if name == "id"]


def test_every_link_leads_somewhere_in_the_folder(pages, root):
    outlines = {name: Outline(text) for name, text in pages.items()}
    assert len(pages) == 1 + 2 * len(TASKS) + len(SOLVERS)
    for name, outline in outlines.items():
        assert len(outline.ids) == len(set(outline.ids)), name
        for address in outline.addresses:
            page, _, anchor = address.partition("#")
            if page.startswith("pictures/") or page in SHARED:
                assert (root / "site" / page).is_file(), (name, address)
                continue
            assert (page or name) in pages, (name, address)
            if page.endswith("-failures.html"):  # its script reads the solver's name
                assert not anchor or unquote(anchor) in {solver.name for solver in SOLVERS}
            else:
                assert not anchor or anchor in outlines[page or name].ids, (name, address)


def test_nothing_runs_but_the_files_beside_the_pages(pages, root):
    for name, text in pages.items():
        policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]+)"', text).group(1)
        assert policy.startswith("default-src 'none'")
        assert "script-src 'self' file:; style-src 'self' file:" in policy
        loaded = re.findall(r'<script src="([^"]+)">', text) + re.findall(
            r'<link rel="stylesheet" href="([^"]+)">', text
        )
        assert set(loaded) == {"site.js", "site.css"} | ({"failures.js"} if name.endswith("-failures.html") else set())
        assert all((root / "site" / one).is_file() for one in loaded)
        # Scripts and styles in the page itself do not run; what stands there is data.
        stored = (root / "site" / name).read_text(encoding="utf-8")
        for seen in (stored, text):
            scripts = set(re.findall(r"<script(?! src)[^>]*>", seen))
            assert scripts <= {'<script type="text/plain" id="failure-data">', '<script type="text/plain">'}
        assert '<script type="text/plain">' not in text
        outline = Outline(text)
        assert not {one for one in outline.attributes if one.startswith("on")}
        assert "style" not in outline.attributes
        assert not {"iframe", "object", "embed", "style", "base"} & set(outline.tags)


def test_results_of_the_split_for_development_are_called_so(boards, pages, root):
    named = [boards[0].file_name, "index.html"]
    assert all("Development results." in pages[name] for name in named)
    judged = [dataclasses.replace(board, split="test") for board in boards]
    again = render_site(judged, [[] for _ in judged], [Pictures()] * len(judged), Places(root))
    assert not any("Development results." in text for text in again.values())


def test_words_from_results_are_escaped(pages):
    page = pages["solver-skybench.html"]
    assert "no &lt;b&gt;consensus&lt;/b&gt;" in page
    assert "&lt;i&gt;its&lt;/i&gt; title" in page
    assert all("<b>consensus" not in text and "<i>its" not in text for text in pages.values())


def test_figures_are_well_formed_and_have_words_for_those_who_cannot_see_them(pages):
    page = pages["bortle@1-dev-own.html"]
    drawings = re.findall(r'<svg class="panel" .*?</svg>', page, re.DOTALL)
    assert len(drawings) == 2 + 2 * len(SOLVERS) + 2 * (len(SOLVERS) - 1)  # one solver never has a confidence
    for drawing in drawings:
        assert ET.fromstring(drawing).attrib["aria-label"]
    assert page.count("<summary>The same as a table</summary>") == 3


def test_the_numbers_on_a_page_are_those_of_the_metrics(pages, boards):
    entry = boards[0].entries[0]
    frames = entry.stored.frames
    share = float((frames["error_km"].fillna(math.inf) < 10.0).mean())
    assert entry.success.value == pytest.approx(share)
    row = re.search(
        rf'<tr><th scope="row">(?:(?!</tr>).)*{entry.label}</a>.*?</tr>', pages[boards[0].file_name], re.DOTALL
    )
    assert SUCCESS.value(entry) in row.group()
    assert f'data-value="{share:.6g}"' in row.group()


def test_success_is_shown_by_what_varies_besides_the_condition(boards):
    board = next(board for board in boards if board.task.name == "bortle")
    assert [one.name for one in board.circumstances] == ["altitude of the Moon", "latitude"]
    moon, latitude = board.circumstances
    assert moon.groups == ((0.0, 0.0), (1.0, 1.0), (2.0, 2.0))
    assert len(latitude.groups) == 4
    for entry in board.entries:
        by_moon, by_latitude = entry.by_circumstance
        assert sum(one.n for one in by_moon) == sum(one.n for one in by_latitude) == board.n_frames
        mean = np.average([one.value for one in by_moon], weights=[one.n for one in by_moon])
        assert mean == pytest.approx(entry.success.value)


def test_the_harmful_frame_is_the_farthest_fix_or_else_the_easiest_refusal(boards):
    board = boards[0]
    for entry in board.entries:
        frames = entry.stored.frames.set_index("frame_id")
        worst = frames.loc[entry.worst.frame_id]
        failed = frames[~(frames["error_km"].fillna(math.inf) < 10.0)]
        if (failed["status"] == "fix").any():
            assert worst["error_km"] == failed["error_km"].max()
        else:
            assert worst["condition"] == failed["condition"].min()


def test_break_points_beyond_the_test_are_said_in_words(boards):
    never = next(entry for board in boards for entry in board.entries if entry.label == "never")
    assert (break_words(never), break_interval(never)) == ("never ≥ 50 %", "")
    task = next(board for board in boards if board.task.harder < 0).entries[0]
    strong = dataclasses.replace(task, break_point=Estimate(-math.inf, -math.inf, 3.0, 9))
    assert break_words(strong) == "not reached"
    half = dataclasses.replace(task, break_point=Estimate(4.0, -math.inf, 4.5, 9))
    assert (break_words(half), break_interval(half)) == ("4", "< 3 – 4.5")
    rays = dataclasses.replace(task, break_point=Estimate(114_800.0, 9_876.0, 1.3e5, 9))
    assert (break_words(rays), break_interval(rays)) == ("115\u2009000", "9\u2009880 – 130\u2009000")


def test_results_of_two_configurations_of_a_solver_are_told_apart_by_their_keys(root, tmp_path):
    copy = shutil.copytree(root / "bortle@1", tmp_path / "tree" / "bortle@1")
    folder = next((copy / "dev" / "own").glob("skybench-*"))
    other = shutil.copytree(folder, folder.with_name("skybench-000000000000")) / "summary.json"
    other.write_text(other.read_text().replace(folder.name.removeprefix("skybench-"), "000000000000"))
    labels = {result.label for result in read_tree(tmp_path / "tree")[0] if result.solver == "skybench"}
    assert labels == {"skybench 000000", f"skybench {folder.name.removeprefix('skybench-')[:6]}"}


def test_a_result_in_the_wrong_place_or_without_its_task_is_refused(root, tmp_path):
    shutil.copytree(root / "bortle@1" / "dev", tmp_path / "a" / "other@1" / "dev")
    with pytest.raises(ResultsError, match="bortle@1/dev, own detections, which its folder does not say"):
        read_tree(tmp_path / "a")
    folder = next((root / "bortle@1" / "dev" / "own").glob("never-*"))
    copy = shutil.copytree(folder, tmp_path / "b" / "bortle@1" / "dev" / "own" / folder.name)
    summary = json.loads((copy / "summary.json").read_text(encoding="utf-8"))
    del summary["provenance"]["frames"]["grading"]["values"]
    (copy / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    with pytest.raises(ResultsError, match=r"provenance\.frames\.grading\.values"):
        read_tree(tmp_path / "b")
    with pytest.raises(ResultsError, match="no results in it"):
        read_tree(tmp_path / "nothing")


def test_results_of_different_frames_are_not_compared(root):
    one, two = read_tree(root)[0][:2]
    with pytest.raises(ResultsError, match="81 and 80 frames cannot be compared"):
        make_board([one, dataclasses.replace(two, frames=two.frames.iloc[1:])])
    for change in ({"scenario_sha256": "ef" * 32}, {"truth_sha256": "ef" * 32}):
        frames = dataclasses.replace(two.provenance.frames, **change)
        other = dataclasses.replace(two.provenance, frames=frames)
        with pytest.raises(ResultsError, match="different scenarios"):
            make_board([one, dataclasses.replace(two, provenance=other)])


def test_a_result_on_a_part_of_the_frames_is_left_out_and_said_to_be(root, tmp_path):
    """Other solvers' results on all frames are compared as they were, also by the command."""
    out = tmp_path / "tree"
    shutil.copytree(root, out)
    write_results(out, TASKS[:1], (FakeSolver("short", 1.0, 9.0),), frames_per_level=3, modes=("own",))
    told = []
    found = make_boards(out, tell=lambda part, whole: told.append(left_out_words(part, whole)))
    assert [[entry.label for entry in board.entries] for board in found] == [
        [entry.label for entry in board.entries] for board in make_boards(root)
    ]
    assert len(told) == 1
    assert re.search(r"own/short-\w+: has 27 of the 81 frames of \S+; run it on all of them, or give", told[0])
    done = CliRunner().invoke(app, ["report", "--out", str(out), "--pictures", "0"])
    assert done.exit_code == 0, done.output
    assert told[0] in done.stderr


def test_a_raw_result_on_a_part_of_the_frames_does_not_replace_the_packed_one(root, tmp_path):
    out = tmp_path / "tree"
    shutil.copytree(root / "bortle@1", out / "bortle@1")
    pack_tree(out)
    write_results(out, TASKS[:1], SOLVERS[:1], frames_per_level=3, modes=("own",))
    told = []
    (group,) = read_tree(out, lambda part, whole: told.append((part.solver, len(part.frames), len(whole.frames))))
    assert told == [("skybench", 27, 81)]
    assert {(result.label, len(result.frames)) for result in group} == {(solver.name, 81) for solver in SOLVERS}


def test_every_failure_is_listed_and_no_success(boards):
    for board in boards:
        failures = failures_of(board)
        for place, entry in enumerate(board.entries):
            mine = [failure for failure in failures if failure.entry == place]
            frames = entry.stored.frames
            failed = frames[~(frames["error_km"].fillna(math.inf) < 10.0)]
            assert [failure.frame_id for failure in mine] == failed["frame_id"].tolist()
            assert [KINDS[failure.kind] for failure in mine] == [
                "wrong fix" if status == "fix" else "refused" for status in failed["status"]
            ]
        rows = listed(board, failures)["rows"]
        assert len(rows) == len(failures)


def test_the_list_says_of_a_failure_what_the_table_says(boards):
    board = boards[0]
    content = json.loads(json.dumps(listed(board, failures_of(board)), allow_nan=False))
    for solver, frame, kind, value, correct, matches, detections in content["rows"][::17]:
        frames = board.entries[solver].stored.frames.set_index("frame_id")
        row = frames.loc[content["frames"][frame]]
        assert content["conditions"][frame] == row["condition"]
        assert (correct, matches, detections) == (row["n_correct"], row["n_matches"], row["n_detections"])
        if content["kinds"][kind] == "wrong fix":
            assert value == pytest.approx(row["error_km"], rel=1e-3)
        else:
            assert content["reasons"][value] == row["reason"]


def test_the_most_harmful_failures_have_pictures_and_solvers_take_turns(boards):
    board = boards[0]
    failures = failures_of(board)
    ordered = worst_first(board, failures)
    assert sorted(ordered, key=repr) == sorted(failures, key=repr)
    first = ordered[: len({failure.entry for failure in failures})]
    assert {failure.frame_id for failure in first} == {entry.worst.frame_id for entry in board.entries if entry.worst}
    assert len(pictured_frames(board, failures, 7)) == 7
    assert pictured_frames(board, failures, 7) == pictured_frames(board, failures, 20)[:7]


@pytest.mark.journey
def test_pictures_are_bounded_in_number_and_size_and_old_ones_go(root, boards, data, tmp_path):
    out = shutil.copytree(root, tmp_path / "tree")
    site = write_site(boards, Places(out, data), most_pictures=5).parent
    pictures = sorted(site.glob("pictures/*/*.webp"))
    assert len(pictures) == 5 * len(boards)
    assert all(path.stat().st_size < 60_000 for path in pictures)
    drawn = sorted(site.glob("pictures/*/*.svg"))
    assert drawn
    assert all(ET.fromstring(path.read_text()).tag.endswith("svg") for path in drawn)
    write_site(boards, Places(out, data), most_pictures=2)
    assert len(list(site.glob("pictures/*/*.webp"))) == 2 * len(boards)
    write_site(boards, Places(out, tmp_path / "no data"))
    assert not list(site.glob("pictures/*"))
    assert "There are no pictures" in (site / boards[0].file_name).read_text(encoding="utf-8")


def test_pictures_come_from_the_rendered_frames_where_they_are_at_hand(root, tmp_path):
    result = read_tree(root)[0][0]
    assert FrameSource(tmp_path).picture(result, "frame-00003", 640) is None
    folder = tmp_path / "bortle@1" / f"dev-{'ab' * 6}"
    (folder / "unpacked").mkdir(parents=True)
    pixels = np.random.default_rng(np.random.SeedSequence(5)).integers(90, 130, (40, 60)).astype(np.uint16)
    Image.fromarray(pixels).save(folder / "unpacked" / "frame-00003.png")
    picture = FrameSource(tmp_path).picture(result, "frame-00003", 640)
    assert picture[8:12] == b"WEBP"
    for stated, shown in ((pixels_sha256(pixels), True), (pixels_sha256(pixels + 1), False)):
        told = dataclasses.replace(result, frames=result.frames.assign(image_sha256=stated, truth_sha256=None))
        assert (FrameSource(tmp_path).picture(told, "frame-00003", 640) is not None) == shown
    (folder / "stars" / "dev").mkdir(parents=True)
    stars = {
        "frame_id": ["frame-00003", "frame-00003", "frame-00004"],
        "u_px": [1.0, 2.0, 3.0],
        "v_px": [4.0, 5.0, 6.0],
        "electrons_e": [10.0, 20.0, 30.0],
        "snr": [2.0, 9.0, 9.0],
    }
    pq.write_table(pa.table(stars), folder / "stars" / "dev" / "shard-000000.parquet")
    (folder / "stars" / "dev" / ".shard-000001-of_a_killed_run.parquet").write_bytes(b"PAR1")
    assert FrameSource(tmp_path).true_stars(result, ["frame-00003"]) == {"frame-00003": [(2.0, 5.0)]}
    # A choice of few frames has tables of its own, which repeat frames of the whole shards or are alone.
    for number, table in (("04", stars), ("05", stars | {"frame_id": ["frame-00005"] * 3})):
        place = folder / "beginnings" / number / "stars" / "dev"
        place.mkdir(parents=True)
        pq.write_table(pa.table(table), place / "shard-000000.parquet")
    found = FrameSource(tmp_path).true_stars(result, ["frame-00003", "frame-00005"])
    assert found == {"frame-00003": [(2.0, 5.0)], "frame-00005": [(3.0, 6.0), (2.0, 5.0)]}
    (folder / "unpacked" / "frame-00003.png").write_bytes(b"no picture")
    with pytest.raises(ResultsError, match="not a readable image"):
        FrameSource(tmp_path).picture(result, "frame-00003", 640)
    for other in ("../../secret", "frame-00003-2"):
        assert FrameSource(tmp_path).picture(result, other, 640) is None
        assert FrameSource(tmp_path).true_stars(result, [other]) == {}


def test_tables_beside_the_stars_of_a_rendered_folder_are_not_read_as_stars(root, tmp_path):
    """`skybench render` puts flying objects, the Moon and an inertial unit's readings beside them."""
    result = read_tree(root)[0][0]
    facts = result.provenance.frames
    of_folder = dataclasses.replace(facts, target=str(tmp_path), grading=None, definition_sha256=None)
    rendered = dataclasses.replace(result, provenance=dataclasses.replace(result.provenance, frames=of_folder))
    record = {"scenario": {"sha256": facts.scenario_sha256}}
    (tmp_path / "frame-00003.json").write_text(json.dumps(record))
    stars = {"frame_id": ["frame-00003"], "u_px": [2.0], "v_px": [5.0], "electrons_e": [20.0], "snr": [9.0]}
    pq.write_table(pa.table(stars), tmp_path / "stars.parquet")
    pq.write_table(pa.table({"frame_id": ["frame-00003"], "snr": [9.0]}), tmp_path / "objects.parquet")
    assert FrameSource(None).true_stars(rendered, ["frame-00003"]) == {"frame-00003": [(2.0, 5.0)]}


@pytest.mark.journey
def test_four_boards_of_twelve_solvers_stay_below_a_quarter_of_five_megabytes(boards, tmp_path):
    """A quarter of the leaderboard's sixteen boards."""
    many = []
    for task in range(2):
        for mode in ("own", "shared"):
            board = boards[0]
            entries = [
                dataclasses.replace(
                    entry,
                    stored=dataclasses.replace(entry.stored, solver=f"{entry.label}{n}", label=f"{entry.label}{n}"),
                )
                for entry in board.entries
                for n in range(2)
            ]
            names = [entry.label for entry in entries]
            pairs = [
                dataclasses.replace(board.comparisons[0], first=first, second=second)
                for first, second in itertools.combinations(names, 2)
            ]
            facts = dataclasses.replace(board.task, name=f"task{task}")
            many.append(
                dataclasses.replace(
                    board, task=facts, detections=mode, entries=tuple(entries), comparisons=tuple(pairs)
                )
            )
    pages = render_site(many, [failures_of(board) for board in many], [Pictures()] * 4, Places(tmp_path))
    assert len(pages) == 1 + 2 * 4 + 12
    size = sum(len(text.encode()) for text in pages.values())
    assert FIVE_MB / 16 < size < FIVE_MB / 4


@pytest.mark.journey
def test_the_command_writes_the_site_and_the_picture(root, tmp_path):
    copy = shutil.copytree(root, tmp_path / "tree")
    (copy / "site").mkdir(exist_ok=True)
    (copy / "site" / "solver-gone.html").write_text("of a solver that is no more", encoding="utf-8")
    result = CliRunner().invoke(app, ["report", "--out", str(copy), "--figure", str(tmp_path / "board.svg")])
    assert result.exit_code == 0, result.output
    assert str(copy / "site" / "index.html") in result.stdout
    assert "skybench" in result.stdout
    assert "bortle@1" in result.stdout
    assert not (copy / "site" / "solver-gone.html").exists()
    assert (tmp_path / "board.svg").is_file()
    result = CliRunner().invoke(app, ["report", "--out", str(tmp_path / "nothing")])
    assert result.exit_code == 2
    assert "no results in it" in result.stderr


def test_solvers_files_are_read_once_however_many_rows_there_are(monkeypatch):
    read = []
    monkeypatch.setattr(tree, "known_solvers", lambda: read.append(1) or ("skybench", "tetra3rs"))
    tree.family_of.cache_clear()
    assert [tree.family_of(name) for name in ("skybench", "tetra3rs", "mine") * 5] == ["celnav", "peers", "others"] * 5
    assert len(read) == 3
    tree.family_of.cache_clear()
