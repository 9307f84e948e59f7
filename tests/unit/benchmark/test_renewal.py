"""A generator that changes a few frames: only these are solved again, and the result is what a complete run would give."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner
from unit.benchmark.fake_night import Raising, write_dataset
from unit.benchmark.test_engine_resumes import Counting, StoppedError
from unit.benchmark.test_tasks import PROGRAM, TINY, TINY_SCENARIO

from benchmark.cli.bench import app
from benchmark.errors import ResultsError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import FrameSet, ungraded
from benchmark.frames.identity import UNKNOWN
from benchmark.frames.task_frames import FrameChoice, make_task_frames
from benchmark.protocol import SequencePlace
from benchmark.report.site.boards import make_board
from benchmark.report.site.tree import read_tree
from benchmark.report.site.words import board_provenance
from benchmark.run import engine
from benchmark.run.contestants import contestant_of
from benchmark.run.packed import PackedRow, read_packed
from benchmark.run.packing import pack_tree, write_packed
from benchmark.run.renewal import outcome_before
from benchmark.tasks.definition import load_task_file
from generator.identity.revision import GENERATOR_REVISION
from generator.scenario import file as scenario_file

LISTING = "night@1/dev.json"
N_FRAMES = 6
NEVER_THE_SAME = ["time_ms", "peak_memory_mib"]
FIRST, LATER = "1" * 16, "2" * 16


def night(folder: Path, revision: str, length: int = 1) -> FrameSet:
    """The frames of a folder as a task's by a generator of this revision, in sequences of this length."""
    found = ungraded(open_dataset(folder), str(folder))
    facts = dataclasses.replace(
        found.facts,
        label="night@1",
        split="dev",
        definition_sha256="d" * 64,
        scenario_sha256=4 * revision,
        rendered_with={"skybench": "9.9", GENERATOR_REVISION: revision},
    )
    frames = found.frames
    if length > 1:
        places = [SequencePlace(f"sequence-{i // length:05d}", i % length, length, 0.5) for i in range(len(frames))]
        frames = tuple(
            dataclasses.replace(frame, observation=dataclasses.replace(frame.observation, sequence=place))
            for frame, place in zip(frames, places, strict=True)
        )
    return FrameSet(facts, frames)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "night", (1, 2, 3), per_class=2)


def solve(frames, solvers, out, **more):
    return list(engine.run_all([contestant_of(solver) for solver in solvers], [frames], out, "own", 1, **more))


def packed(out: Path, folder: Path, names=("truth",), length: int = 1) -> None:
    """Packed results of the first generator's frames."""
    frames = night(folder, FIRST, length)
    solve(frames, [Counting(name, frames.frames) for name in names], out)
    pack_tree(out)


def rows_of(out: Path) -> dict[str, PackedRow]:
    return {row.solver: row for row in read_packed(out / LISTING)}


def change(folder: Path, *numbers: int) -> None:
    """A star more in some frames, which a detector finds."""
    for number in numbers:
        path = folder / f"frame-{number:05d}.png"
        with Image.open(path) as picture:
            image = np.array(picture).astype(np.uint16)
        image[1:4, 1:4] = 4000
        Image.fromarray(image).save(path)


def renew(folder: Path, out: Path, length: int = 1, name: str = "truth", **more):
    """Renew one solver's row; the run, and the times of the frames that it was asked, in their order."""
    frames = night(folder, LATER, length)
    solver = Counting(name, frames.frames, **more)
    (run,) = solve(frames, [solver], out, renew=True)
    return run, solver.asked[1:]  # the first is put once more, for the warm-up


def assert_as_a_complete_run(out: Path, folder: Path, whole: Path, length: int = 1) -> None:
    frames = night(folder, LATER, length)
    solve(frames, [Counting("truth", frames.frames)], whole)
    pack_tree(whole)
    mine, its = rows_of(out)["truth"], rows_of(whole)["truth"]
    assert mine.key == its.key
    assert mine.frames.drop(columns=NEVER_THE_SAME).equals(its.frames.drop(columns=NEVER_THE_SAME))
    facts = mine.provenance["frames"], its.provenance["frames"]
    assert [part["truth_sha256"] for part in facts] == [frames.facts.truth_sha256] * 2
    assert [part["scenario_sha256"] for part in facts] == [4 * LATER] * 2


def test_a_packed_result_is_finished(folder: Path, tmp_path: Path) -> None:
    out, frames = tmp_path / "out", night(folder, FIRST)
    (whole,) = solve(frames, [Counting("truth", frames.frames)], tmp_path / "whole")
    packed(out, folder)
    again = Counting("truth", frames.frames)
    (run,) = solve(frames, [again], out)
    assert (run.n_solved, again.asked) == (0, [])
    assert not list(out.rglob("summary.json"))
    for name in ("n_frames", "n_fixes", "n_refused", "n_errors", "recall", "wrong_and_confident", "star_recall"):
        assert repr(getattr(run.summary, name)) == repr(getattr(whole.summary, name)), name
    assert run.summary.median_error_km.value == pytest.approx(whole.summary.median_error_km.value, rel=1e-5)
    # Neither one of fewer frames than are wanted, nor one of another revision.
    more = FrameSet(dataclasses.replace(frames.facts, per_condition=9), frames.frames)
    assert [one.n_solved for one in solve(more, [Counting("truth", frames.frames)], out)] == [N_FRAMES]
    other = Counting("truth", frames.frames, revision="second")
    assert [one.n_solved for one in solve(frames, [other], out)] == [N_FRAMES]


def test_a_packed_result_of_errors_alone_is_not_finished(folder: Path, tmp_path: Path) -> None:
    class Settled(Raising):
        revision = "one"

    frames = night(folder, FIRST)
    for _ in range(2):
        (run,) = solve(frames, [Settled("raising", frames.frames)], tmp_path / "out")
        assert run.n_solved == N_FRAMES
        pack_tree(tmp_path / "out")


def test_only_frames_that_changed_are_solved_again(folder, tmp_path):
    out = tmp_path / "out"
    packed(out, folder)
    before = rows_of(out)["truth"]
    change(folder, 1, 4)
    run, asked = renew(folder, out)
    assert (run.n_kept, run.n_solved, len(asked)) == (4, 2, 2)
    pack_tree(out)
    assert_as_a_complete_run(out, folder, tmp_path / "whole")
    after = rows_of(out)["truth"]
    same = [0, 2, 3, 5]
    assert after.frames.loc[same].equals(before.frames.loc[same])
    assert after.frames.loc[[1, 4], "n_detections"].tolist() != before.frames.loc[[1, 4], "n_detections"].tolist()
    assert after.provenance["frames"]["rendered_with"][GENERATOR_REVISION] == LATER
    assert after.provenance["renewed"] == {
        "n_kept": 4,
        "n_solved": 2,
        "date_utc": before.provenance["date_utc"],
        "scenario_sha256": 4 * FIRST,
        "rendered_with": {"skybench": "9.9", GENERATOR_REVISION: FIRST},
    }
    # Reports say so.
    (group,) = read_tree(out)
    words = dict(board_provenance(make_board(group)))["truth"]
    assert "; 4 of 6 answers are of runs from " in words
    assert words.endswith(f"by generator's revision {FIRST}; 2 frames solved again")


def test_a_row_of_unchanged_frames_is_the_earlier_run_on_frames_rendered_again(folder, tmp_path):
    out = tmp_path / "out"
    packed(out, folder)
    before = rows_of(out)["truth"]
    run, asked = renew(folder, out)
    assert (run.n_kept, asked) == (N_FRAMES, [])
    pack_tree(out)
    after = rows_of(out)["truth"]
    assert after.frames.equals(before.frames)
    assert after.provenance["date_utc"] == before.provenance["date_utc"]
    assert after.provenance["renewed"] is None
    facts = after.provenance["frames"]
    assert (facts["rendered_with"][GENERATOR_REVISION], facts["rendered_again_with"][GENERATOR_REVISION]) == (
        FIRST,
        LATER,
    )


def test_a_second_renewal_states_the_first_run(folder, tmp_path):
    out = tmp_path / "out"
    packed(out, folder)
    date = rows_of(out)["truth"].provenance["date_utc"]
    change(folder, 1)
    renew(folder, out)
    pack_tree(out)
    change(folder, 2)
    frames = night(folder, "3" * 16)
    (run,) = solve(frames, [Counting("truth", frames.frames)], out, renew=True)
    assert (run.n_kept, run.n_solved) == (5, 1)
    pack_tree(out)
    stated = rows_of(out)["truth"].provenance["renewed"]
    assert (stated["n_kept"], stated["n_solved"], stated["date_utc"]) == (5, 1, date)
    assert stated["rendered_with"][GENERATOR_REVISION] == FIRST


def test_of_a_sequence_with_a_changed_frame_all_are_solved_again_in_order(folder, tmp_path):
    out = tmp_path / "out"
    packed(out, folder, length=3)
    change(folder, 4)
    run, asked = renew(folder, out, length=3)
    assert (run.n_kept, run.n_solved) == (3, 3)
    assert asked == [frame.observation.utc for frame in night(folder, LATER, 3).frames[3:]]
    pack_tree(out)
    assert_as_a_complete_run(out, folder, tmp_path / "whole", length=3)


def test_kept_answers_are_counted_with_the_site_of_their_frame(folder, tmp_path):
    """Frames of one flight are one site, though each is at a place of its own."""
    packed(tmp_path, folder)
    frame = dataclasses.replace(night(folder, LATER).frames[2], site="a flight")
    kept = outcome_before(rows_of(tmp_path)["truth"], frame, None, UNKNOWN)
    assert (kept.score.site, kept.details.site) == ("a flight", "a flight")


def test_answers_of_another_revision_of_the_solver_are_not_kept(folder, tmp_path):
    packed(tmp_path, folder)
    change(folder, 1)
    run, asked = renew(folder, tmp_path, revision="second")
    assert (run.n_kept, len(asked)) == (0, N_FRAMES)


def altered(row: PackedRow, **frames) -> PackedRow:
    return dataclasses.replace(row, frames=row.frames.assign(**frames))


@pytest.mark.parametrize(
    "old",
    [
        lambda row: altered(row, image_sha256=None),
        lambda row: altered(row, truth_sha256="0" * 64),
        lambda row: altered(row, utc_mid="2020-01-01T00:00:59Z"),
        lambda row: altered(row, status="error"),
        lambda row: dataclasses.replace(row, detections="shared", provenance=row.provenance | {"detections": "shared"}),
        lambda row: dataclasses.replace(row, provenance=row.provenance | {"versions": {"numpy": "1.0"}}),
        lambda row: dataclasses.replace(
            row, provenance=row.provenance | {"frames": row.provenance["frames"] | {"definition_sha256": "e" * 64}}
        ),
    ],
    ids=["no hashes", "truth", "time", "errors", "detections", "libraries", "definition"],
)
def test_answers_that_a_run_might_not_give_are_not_kept(folder, tmp_path, old):
    packed(tmp_path, folder)
    write_packed(tmp_path / LISTING, [old(row) for row in read_packed(tmp_path / LISTING)])
    run, _ = renew(folder, tmp_path)
    assert (run.n_kept, run.n_solved) == (0, N_FRAMES)


def test_a_frame_without_stars_is_solved_again(folder, tmp_path):
    def without_stars(frames: FrameSet) -> FrameSet:
        first, *others = frames.frames
        none = dataclasses.replace(
            first.truth, **{name: getattr(first.truth, name)[:0] for name in ("star_id", "uv", "electrons_e", "snr")}
        )
        return FrameSet(frames.facts, (dataclasses.replace(first, truth=none), *others))

    frames = without_stars(night(folder, FIRST))
    solve(frames, [Counting("truth", night(folder, FIRST).frames)], tmp_path)
    pack_tree(tmp_path)
    (run,) = solve(
        without_stars(night(folder, LATER)), [Counting("truth", night(folder, LATER).frames)], tmp_path, renew=True
    )
    assert (run.n_kept, run.n_solved) == (N_FRAMES - 1, 1)


def test_a_plain_run_keeps_no_answers(folder, tmp_path):
    packed(tmp_path, folder)
    frames = night(folder, LATER)
    (run,) = solve(frames, [Counting("truth", frames.frames)], tmp_path)
    assert (run.n_kept, run.n_solved) == (0, N_FRAMES)


def test_nothing_is_lost_where_a_renewal_is_interrupted(folder, tmp_path):
    out = tmp_path / "out"
    packed(out, folder)
    before = {path.name: path.read_bytes() for path in (out / "night@1").iterdir()}
    change(folder, 1, 3, 4)
    done = []

    def stop(name: str, count: int) -> None:
        done.extend([name] * count)
        if len(done) == 4:
            raise StoppedError

    frames = night(folder, LATER)
    with pytest.raises(StoppedError):
        solve(frames, [Counting("truth", frames.frames)], out, renew=True, progress=stop)
    assert {path.name: path.read_bytes() for path in (out / "night@1").iterdir() if path.is_file()} == before
    run, asked = renew(folder, out)
    assert (run.n_kept, run.n_solved, len(asked)) == (3, 2, 2)
    pack_tree(out)
    assert_as_a_complete_run(out, folder, tmp_path / "whole")
    stated = rows_of(out)["truth"].provenance["renewed"]
    assert (stated["n_kept"], stated["n_solved"]) == (3, 3)


def test_renewed_rows_wait_for_the_others_of_their_table(folder, tmp_path):
    packed(tmp_path, folder, ("one", "two"))
    before = (tmp_path / LISTING).read_bytes()
    change(folder, 1)
    renew(folder, tmp_path, name="one")
    assert pack_tree(tmp_path, leave_others=True) == []
    with pytest.raises(ResultsError, match=r"night@1/dev: .*their frames differ"):
        pack_tree(tmp_path)
    assert (tmp_path / LISTING).read_bytes() == before
    renew(folder, tmp_path, name="two")
    (table,) = pack_tree(tmp_path)
    assert (table.n_new, table.n_rows) == (2, 2)


def test_raw_results_are_renewed_too_and_replaced(folder, tmp_path):
    """Rows on other frames may keep them from being packed."""
    frames = night(folder, FIRST)
    solve(frames, [Counting("truth", frames.frames), Counting("other", frames.frames)], tmp_path)
    change(folder, 1)
    run, asked = renew(folder, tmp_path)
    assert (run.n_kept, run.n_solved, len(asked)) == (N_FRAMES - 1, 1, 1)
    folders = sorted(path.name.partition("-")[0] for path in (tmp_path / "night@1/dev/own").iterdir())
    assert folders == ["other", "truth"]


def test_packed_rows_on_other_frames_are_removed_only_when_asked(folder, tmp_path):
    packed(tmp_path, folder, ("one", "two"))
    change(folder, 1)
    renew(folder, tmp_path, name="one")
    with pytest.raises(ResultsError, match="their frames differ"):
        pack_tree(tmp_path)
    assert set(rows_of(tmp_path)) == {"one", "two"}
    (table,) = pack_tree(tmp_path, remove_others=True)
    assert (table.n_new, table.n_rows, table.removed, set(rows_of(tmp_path))) == (1, 1, ("two",), {"one"})


def test_packed_rows_of_some_of_the_same_frames_are_kept(folder, tmp_path):
    packed(tmp_path, folder, ("one", "two"))
    one, two = read_packed(tmp_path / LISTING)
    write_packed(tmp_path / LISTING, [dataclasses.replace(one, frames=one.frames[:4]), two])
    renew(folder, tmp_path, name="two")
    pack_tree(tmp_path, remove_others=True)
    assert {name: len(row.frames) for name, row in rows_of(tmp_path).items()} == {"one": 4, "two": N_FRAMES}


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    (tmp_path / "tiny.task.yaml").write_text(TINY)
    (tmp_path / "tiny.scenario.yaml").write_text(TINY_SCENARIO)
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        shutil.copy(PROGRAM, tmp_path / name / "program.py")
        (tmp_path / name / "solver.yaml").write_text(
            f'name: {name}\ntitle: Says Munich\nlicence: MIT\nversion: "1"\ncommand: [python, program.py, well]\n'
        )
    return tmp_path


def boards(folder: Path, *arguments: str) -> str:
    solvers = ["--solver", str(folder / "one"), "--solver", str(folder / "two")]
    places = ["--out", str(folder / "results"), "--data", str(folder / "data"), "--frames", "1"]
    command = ["boards", str(folder / "tiny.task.yaml"), *solvers, *places, *arguments]
    outcome = CliRunner().invoke(app, command, catch_exceptions=False)
    assert outcome.exit_code == 0, outcome.output
    return outcome.stdout


@pytest.mark.journey
def test_boards_solve_what_a_change_of_physics_changed(tiny, monkeypatch):
    boards(tiny)
    monkeypatch.setattr(scenario_file, "generator_revision", lambda: "f" * 16)
    assert "3 frames to be rendered" in boards(tiny, "--plan")
    task = load_task_file(tiny / "tiny.task.yaml")
    made = make_task_frames(task, "tiny", FrameChoice(per_condition=1, data=tiny / "data", workers=0))
    change(made.frames[1].image_path.parent, made.frames[1].index)
    (tiny / "two" / "program.py").write_text((tiny / "two" / "program.py").read_text() + "\nANOTHER = 1\n")
    rows = {row["solver"]: row for row in json.loads(boards(tiny, "--plan", "--json"))["rows"]}
    assert {Path(name).name: (row["frames"], row["as_before"]) for name, row in rows.items()} == {
        "one": (3, 2),
        "two": (3, 0),
    }
    printed = boards(tiny)
    assert "1 of 3" in printed
    assert "tiny@1, own detections: one: 2 of 3 frames as before, 1 solved again" in printed
    assert "two: " not in printed
    assert "0 rows to be made, 2 of today's code" in boards(tiny, "--plan")


@pytest.mark.journey
def test_frames_of_several_tasks_are_compared_in_parallel(tiny):
    """With more frames, the answers to those that were there are kept; in one process or in two."""
    (tiny / "small.task.yaml").write_text(TINY.replace("name: tiny", "name: small", 1))
    other = str(tiny / "small.task.yaml")
    boards(tiny, other)
    for name in ("tiny", "small"):
        choice = FrameChoice(per_condition=2, data=tiny / "data", workers=0)
        make_task_frames(load_task_file(tiny / f"{name}.task.yaml"), str(tiny / f"{name}.task.yaml"), choice)
    for jobs in ("1", "2"):
        rows = json.loads(boards(tiny, other, "--frames", "2", "--jobs", jobs, "--plan", "--json"))["rows"]
        counts = [(row["task"], row["frames"], row["as_before"]) for row in rows]
        assert counts == [("tiny@1", 6, 3)] * 2 + [("small@1", 6, 3)] * 2
